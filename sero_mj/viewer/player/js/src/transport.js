/** Connections of a live page to its server, which reconnect automatically. */

/**
 * The source of a page's state: a websocket, a notebook's channel, or a recording.
 * @typedef {{open: () => void, send: (message: string | ArrayBuffer) => void, onopen: () => void,
 *   onmessage: (message: ArrayBuffer | string | import("./sections.js").Sections) => void, onclose: () => void,
 *   onlocked: () => void, onother: () => void, onframe?: () => void, hadControl: () => boolean,
 *   noteControl: (isInControl: boolean) => void}} Transport
 *   onopen: called when connected, before the complete state; onclose: called when disconnected;
 *   onlocked: called if the server needs a token that this browser does not have;
 *   onother: called if another page is served now; onframe: called when the image has changed;
 *   hadControl: returns whether this tab was in control before; noteControl: stores whether it is in control
 */

/**
 * The access of a page to its server, see `web/static/access.js`.
 * @typedef {{token: () => string, socket: (path: string) => URL, page: () => Promise<string>,
 *   unlocked: () => Promise<unknown>, locked: string, hadControl: () => boolean,
 *   noteControl: (isInControl: boolean) => void}} Access
 */

/** Returns the access of this page to its server. */
export const accessOf = () => /** @type {Access} */ (/** @type {any} */ (globalThis).access);

const MIN_PAUSE = 250, MAX_PAUSE = 2000; // minimum and maximum time between two attempts to connect, ms

/** @implements {Transport} */
export class SocketTransport {
  /** @param {string} path of the websocket @param {Access} access */
  constructor(path, access) {
    this.path = path;
    this.access = access;
    this.pause = MIN_PAUSE;
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
    else this.#openAgain(); // The page has no token, or it is locked.
  }

  #connect() {
    const socket = this.socket = new WebSocket(this.access.socket(this.path));
    socket.binaryType = "arraybuffer";
    socket.addEventListener("open", () => {
      this.pause = MIN_PAUSE;
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
    this.pause = Math.min(2 * this.pause, MAX_PAUSE);
  }

  /** Connects unless the server now serves another page, for example the start page. */
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

// Time between attempts to connect, and between messages that report a running page, ms.
const RETRY = 500, ALIVE = 4000;
// Time without messages after which the connection is closed, and then until it is lost, ms.
const TIMEOUT = 20_000, LOST = 2000;

/**
 * The connection of a page in a cell of a notebook. The page sends messages to the parent of its frame,
 * where `bridge.js` forwards them to the kernel.
 * @implements {Transport}
 */
export class CellTransport {
  /** @param {string} cell id of the cell */
  constructor(cell) {
    this.cell = cell;
    this.client = crypto.getRandomValues(new Uint32Array(2)).join("-"); // Several browsers may show the same cell.
    this.isOpen = false;
    this.received = 0; // time of the last message, ms
    this.onopen = () => {};
    this.onclose = () => {};
    this.onlocked = () => {};
    this.onother = () => {};
    this.onlost = () => {}; // called if a closed connection is not opened again
    /** @type {Transport["onmessage"]} */
    this.onmessage = () => {};
    this.hasStarted = false;
    this.hadControl = () => false; // A cell does not change its page.
    this.noteControl = () => {};
  }

  /** Returns whether the kernel answers. @param {number} patience maximum time to wait, ms */
  finds(patience) {
    return new Promise((/** @type {(found: boolean) => void} */ answer) => {
      this.onopen = () => answer(true);
      this.open();
      setTimeout(() => answer(false), patience);
    });
  }

  /** Sends requests to the kernel until it answers, and again whenever the connection is closed. */
  open() {
    if (this.isOpen) queueMicrotask(() => this.onopen());
    if (this.hasStarted) return;
    this.hasStarted = true;
    addEventListener("message", ({ data, source }) => {
      if (source === parent && data?.cell === this.cell && data.to === this.client) this.#receive(data);
    });
    addEventListener("pagehide", () => this.#post("close"));
    setInterval(() => { if (!this.isOpen) this.#post("open"); }, RETRY);
    setInterval(() => {
      if (this.isOpen && performance.now() - this.received > TIMEOUT) this.#receive({ kind: "closed" });
      if (this.isOpen) this.#post("alive");
    }, ALIVE);
    this.#post("open");
  }

  /** @param {{kind: string, message?: ArrayBuffer | string}} data */
  #receive({ kind, message }) {
    this.received = performance.now();
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
