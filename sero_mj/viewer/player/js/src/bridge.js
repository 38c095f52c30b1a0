/**
 * Connects the pages in the cells of a notebook with the kernel, as an anywidget without a view.
 *
 * Pages are iframes in the same notebook. Several browsers and several cells may show one page.
 */

/** @typedef {{get: (name: string) => any, send: (content: object, callbacks?: object, buffers?: ArrayBuffer[]) => void,
 *   on: (event: string, act: (content: any, buffers: DataView[]) => void) => void}} Model */

const FIRST = "first"; // name of the connection that the kernel opens when it shows the cell
const MAX_EARLY = 2000; // maximum number of messages that are stored for the first page

/** Forwards messages between pages and the kernel. @param {{model: Model}} widget */
function initialize({ model }) {
  const cell = model.get("cell");
  /** @type {Map<string, MessageEventSource>} */
  const pages = new Map();
  // The first page receives all messages that the kernel has sent to the first connection. The page
  // need not send a request, because a kernel that is executing a cell would only receive it afterwards.
  /** @type {string | null} */
  let first = null;
  /** @type {{kind: string, message?: ArrayBuffer | string}[] | null} */
  let early = null;
  /** @param {string | null} to @param {{kind: string, message?: ArrayBuffer | string}} packet */
  const forward = (to, packet) => pages.get(to ?? "")?.postMessage({ cell, to, ...packet }, { targetOrigin: "*" });
  /** @param {MessageEvent} event */
  const toKernel = ({ data, source }) => {
    if (data?.cell !== cell || typeof data.from !== "string" || !source) return;
    const { from, kind, message } = data;
    pages.set(from, source);
    if (kind === "open" && early) {
      first = from;
      for (const packet of early) forward(first, packet);
      early = null;
      return;
    }
    model.send({ from: from === first ? FIRST : from, kind, message });
    if (kind !== "close") return;
    pages.delete(from);
    if (from === first) first = null;
  };
  model.on("msg:custom", ({ to, kind, message }, buffers) => {
    const bytes = buffers?.[0];
    const content = bytes ? bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength) : message;
    const packet = { kind, message: content };
    if (to !== FIRST) return forward(to, packet);
    if (kind === "opened" && first === null) early = [];
    else if (kind === "closed" || (early?.length ?? 0) > MAX_EARLY) early = null;
    if (early) early.push(packet);
    else forward(first, packet);
  });
  globalThis.addEventListener("message", toKernel);
  return () => globalThis.removeEventListener("message", toKernel);
}

export default { initialize };
