/**
 * The page in a cell of a notebook: live as long as its kernel shows it, else the run that the
 * notebook has kept beside it.
 */

import { decode, inflate } from "./data.js";
import { Player } from "./file.js";
import { Live } from "./live.js";
import { byId } from "./page.js";
import { CellTransport } from "./transport.js";

const PATIENCE = 1500, PATIENCE_AFTER_ANSWER = 10_000; // ms for the kernel to answer

/** The run that is kept in another output of the cell; empty for none. @param {string} cell */
function keptRun(cell) {
  try {
    return parent.document.querySelector(`[data-sero-mj-run="${cell}"]`)?.textContent?.trim() ?? "";
  } catch { // the notebook's page is none of ours
    return "";
  }
}

/** The element that this page is in. */
const frame = () => /** @type {HTMLIFrameElement | null} */ (globalThis.frameElement);

/** Begins again. @param {boolean} hasAnswered whether the kernel has just answered */
function again(hasAnswered) {
  const element = frame();
  if (!element?.isConnected) return;
  element.dataset.answered = hasAnswered ? "1" : "";
  element.srcdoc = String(element.srcdoc);
}

/** @param {string} name of the template of the page's body */
function build(name) {
  const template = /** @type {HTMLTemplateElement} */ (byId(name));
  document.body.append(template.content);
  document.body.classList.toggle("live", name === "live");
}

/** @param {string} cell @returns {Promise<Live | Player>} */
export async function fromNotebook(cell) {
  const transport = new CellTransport(cell);
  if (keptRun(cell) && !await transport.finds(frame()?.dataset.answered ? PATIENCE_AFTER_ANSWER : PATIENCE)) {
    transport.onopen = () => again(true);
    build("file");
    return new Player(decode(await inflate(keptRun(cell))));
  }
  transport.onlost = () => { if (keptRun(cell)) again(false); };
  build("live");
  return new Live(transport);
}
