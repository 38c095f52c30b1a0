/** What connects a live page with its server: a websocket that is opened anew when it ends. */

/**
 * What a page needs of a connection; a notebook's channel can take the websocket's place.
 * @typedef {{send: (message: string | ArrayBuffer) => void, onopen: () => void,
 *   onmessage: (message: ArrayBuffer | string) => void, onclose: () => void, onother: () => void}} Transport
 *   onopen: it is there, and the state comes from the start; onclose: it is gone;
 *   onother: another page is served there now
 */

const LEAST_PAUSE = 250, MOST_PAUSE = 2000; // ms, between two attempts

/** @implements {Transport} */
export class SocketTransport {
  /** @param {string} url */
  constructor(url) {
    this.url = url;
    this.pause = LEAST_PAUSE;
    /** @type {WebSocket | null} */
    this.socket = null;
    this.onopen = () => {};
    this.onclose = () => {};
    this.onother = () => {};
    /** @type {Transport["onmessage"]} */
    this.onmessage = () => {};
  }

  /** Connects, and again whenever it is gone. */
  open() {
    const socket = this.socket = new WebSocket(this.url);
    socket.binaryType = "arraybuffer";
    socket.addEventListener("open", () => {
      this.pause = LEAST_PAUSE;
      this.onopen();
    });
    socket.addEventListener("message", (event) => this.onmessage(event.data));
    socket.addEventListener("close", () => {
      this.socket = null;
      this.onclose();
      setTimeout(() => this.#openAgain(), this.pause);
      this.pause = Math.min(2 * this.pause, MOST_PAUSE);
    });
  }

  /** Connects, unless another page is served there, the start page say. */
  async #openAgain() {
    const page = await fetch(location.href).then((found) => found.text(), () => "");
    if (page && !page.includes("data-live")) this.onother();
    else this.open();
  }

  /** Sends, unless it is gone. @param {string | ArrayBuffer} message */
  send(message) {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(message);
  }
}

/** The address of a page's own server. @param {Location} location */
export const liveUrl = ({ protocol, host, search }) =>
  `${protocol === "https:" ? "wss" : "ws"}://${host}/live${search}`;
