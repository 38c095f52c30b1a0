/** The connection of a live page to its server: a websocket that reconnects. */

/**
 * The source of a page's state: a websocket, a notebook's channel, or a recording.
 * @typedef {{open: () => void, send: (message: string | ArrayBuffer) => void, onopen: () => void,
 *   onmessage: (message: ArrayBuffer | string | import("./sections.js").Sections) => void, onclose: () => void,
 *   onlocked: () => void, onother: () => void, onframe?: () => void, hadControl: () => boolean,
 *   noteControl: (isInControl: boolean) => void}} Transport
 *   onopen: connected, and the complete state follows; onclose: disconnected;
 *   onlocked: the server needs a token that this browser does not have; onother: another page is served now;
 *   onframe: the image has changed; hadControl, noteControl: whether this tab was in control of the connection before
 */

/**
 * The access of a page to its server, see `web/static/access.js`.
 * @typedef {{token: () => string, socket: (path: string) => URL, page: () => Promise<string>,
 *   unlocked: () => Promise<unknown>, locked: string, hadControl: () => boolean,
 *   noteControl: (isInControl: boolean) => void}} Access
 */

/** The access of this page. */
export const accessOf = () => /** @type {Access} */ (/** @type {any} */ (globalThis).access);

const LEAST_PAUSE = 250, MOST_PAUSE = 2000; // ms, between two attempts

/** @implements {Transport} */
export class SocketTransport {
  /** @param {string} path of the websocket @param {Access} access */
  constructor(path, access) {
    this.path = path;
    this.access = access;
    this.pause = LEAST_PAUSE;
    /** @type {WebSocket | null} */
    this.socket = null;
    this.onopen = () => {};
    this.onclose = () => {};
    this.onlocked = () => {};
    this.onother = () => {};
    /** @type {Transport["onmessage"]} */
    this.onmessage = () => {};
  }

  /** Connects, and reconnects whenever the connection is lost. */
  open() {
    if (this.access.token()) this.#connect();
    else this.#openAgain(); // a page without a token, or one that is locked
  }

  #connect() {
    const socket = this.socket = new WebSocket(this.access.socket(this.path));
    socket.binaryType = "arraybuffer";
    socket.addEventListener("open", () => {
      this.pause = LEAST_PAUSE;
      this.onopen();
    });
    socket.addEventListener("message", (event) => this.onmessage(event.data));
    socket.addEventListener("close", () => {
      this.socket = null;
      this.onclose();
      this.#wait();
    });
  }

  #wait() {
    setTimeout(() => this.#openAgain(), this.pause);
    this.pause = Math.min(2 * this.pause, MOST_PAUSE);
  }

  /** Connects, unless another page is served there, for example the start page. */
  async #openAgain() {
    const page = await this.access.page();
    if (page === "locked") {
      this.onlocked();
      await this.access.unlocked();
      this.#openAgain();
    } else if (page && page !== this.path) this.onother();
    else this.#connect();
  }

  hadControl() { return this.access.hadControl(); }

  /** @param {boolean} isInControl */
  noteControl(isInControl) { this.access.noteControl(isInControl); }

  /** Sends, unless it is gone. @param {string | ArrayBuffer} message */
  send(message) {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(message);
  }
}

const ASKING = 500, ALIVE = 4000, GONE = 20_000, LOST = 2000; // ms

/**
 * A page in a cell of a notebook. Messages go to the parent of the frame, in which `bridge.js`
 * forwards them to the kernel.
 * @implements {Transport}
 */
export class CellTransport {
  /** @param {string} cell id of the cell's page, which its kernel knows */
  constructor(cell) {
    this.cell = cell;
    this.client = crypto.getRandomValues(new Uint32Array(2)).join("-"); // several browsers may show a cell
    this.isOpen = false;
    this.heard = 0; // time of the last message, ms
    this.onopen = () => {};
    this.onclose = () => {};
    this.onlocked = () => {};
    this.onother = () => {};
    this.onlost = () => {}; // the connection is lost and does not return soon
    /** @type {Transport["onmessage"]} */
    this.onmessage = () => {};
    this.isAsking = false;
    this.hadControl = () => false; // a cell does not change its page
    this.noteControl = () => {};
  }

  /** Returns whether the kernel answers. @param {number} patience ms */
  finds(patience) {
    return new Promise((/** @type {(found: boolean) => void} */ answer) => {
      this.onopen = () => answer(true);
      this.open();
      setTimeout(() => answer(false), patience);
    });
  }

  /** Calls the kernel until it answers, and again whenever the connection is lost. */
  open() {
    if (this.isOpen) queueMicrotask(() => this.onopen());
    if (this.isAsking) return;
    this.isAsking = true;
    addEventListener("message", ({ data, source }) => {
      if (source === parent && data?.cell === this.cell && data.to === this.client) this.#hear(data);
    });
    addEventListener("pagehide", () => this.#post("close"));
    setInterval(() => { if (!this.isOpen) this.#post("open"); }, ASKING);
    setInterval(() => {
      if (this.isOpen && performance.now() - this.heard > GONE) this.#hear({ kind: "closed" });
      if (this.isOpen) this.#post("alive");
    }, ALIVE);
    this.#post("open");
  }

  /** @param {{kind: string, message?: ArrayBuffer | string}} data */
  #hear({ kind, message }) {
    this.heard = performance.now();
    if (kind === "opened" && !this.isOpen) {
      this.isOpen = true;
      this.onopen();
    } else if (kind === "closed" && this.isOpen) {
      this.isOpen = false;
      this.onclose();
      setTimeout(() => { if (!this.isOpen) this.onlost(); }, LOST);
    } else if (kind === "message" && this.isOpen && message !== undefined) this.onmessage(message);
  }

  /** @param {string} kind @param {string | ArrayBuffer} [message] */
  #post(kind, message) {
    parent.postMessage({ cell: this.cell, from: this.client, kind, message }, "*");
  }

  /** Sends, unless it is gone. @param {string | ArrayBuffer} message */
  send(message) {
    if (this.isOpen) this.#post("say", message);
  }
}
