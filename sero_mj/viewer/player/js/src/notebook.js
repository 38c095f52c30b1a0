/**
 * The page in a cell of a notebook: live as long as its kernel shows it, else the run that the
 * notebook has kept beside it.
 */

import { decode, inflate } from "./data.js";
import { Player } from "./player.js";
import { Recording } from "./recording.js";
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

/** @param {string} cell @returns {Promise<Player>} */
export async function fromNotebook(cell) {
  const transport = new CellTransport(cell);
  if (keptRun(cell) && !await transport.finds(frame()?.dataset.answered ? PATIENCE_AFTER_ANSWER : PATIENCE)) {
    transport.onopen = () => again(true);
    return new Player(new Recording(decode(await inflate(keptRun(cell)))));
  }
  transport.onlost = () => { if (keptRun(cell)) again(false); };
  return new Player(transport);
}
