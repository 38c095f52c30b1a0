/**
 * The page in a cell of a notebook. It is live while the kernel runs the viewer. Otherwise, it plays
 * the run that the notebook has stored.
 */

import { decode, inflate } from "./data.js";
import { Player } from "./player.js";
import { Recording } from "./recording.js";
import { CellTransport } from "./transport.js";

const TIMEOUT = 1500, TIMEOUT_AFTER_ANSWER = 10_000; // ms for the kernel to answer

/** Returns the run that another output of the cell stores, or an empty string. @param {string} cell */
function storedRun(cell) {
  try {
    return parent.document.querySelector(`[data-sero-mj-run="${cell}"]`)?.textContent?.trim() ?? "";
  } catch { // The page of the notebook has another origin.
    return "";
  }
}

/** The element that contains this page. */
const frame = () => /** @type {HTMLIFrameElement | null} */ (globalThis.frameElement);

/** Loads the page again. @param {boolean} hasAnswered whether the kernel has just answered */
function again(hasAnswered) {
  const element = frame();
  if (!element?.isConnected) return;
  element.dataset.answered = hasAnswered ? "1" : "";
  element.srcdoc = String(element.srcdoc);
}

/** @param {string} cell @returns {Promise<Player>} */
export async function fromNotebook(cell) {
  const transport = new CellTransport(cell);
  if (storedRun(cell) && !await transport.finds(frame()?.dataset.answered ? TIMEOUT_AFTER_ANSWER : TIMEOUT)) {
    transport.onopen = () => again(true);
    return new Player(new Recording(decode(await inflate(storedRun(cell)))));
  }
  transport.onlost = () => { if (storedRun(cell)) again(false); };
  return new Player(transport);
}
