/**
 * The page in a cell of a notebook: live while the kernel runs the viewer, otherwise the run that
 * the notebook has stored.
 */

import { decode, inflate } from "./data.js";
import { Player } from "./player.js";
import { Recording } from "./recording.js";
import { CellTransport } from "./transport.js";

const PATIENCE = 1500, PATIENCE_AFTER_ANSWER = 10_000; // ms for the kernel to answer

/** Returns the run that another output of the cell stores, or an empty string. @param {string} cell */
function keptRun(cell) {
  try {
    return parent.document.querySelector(`[data-sero-mj-run="${cell}"]`)?.textContent?.trim() ?? "";
  } catch { // the page of the notebook has another origin
    return "";
  }
}

/** The element that contains this page. */
const frame = () => /** @type {HTMLIFrameElement | null} */ (globalThis.frameElement);

/** Starts again. @param {boolean} hasAnswered whether the kernel has just answered */
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
