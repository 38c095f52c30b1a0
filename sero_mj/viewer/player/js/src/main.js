/** Starts the player of a file, a live page or a notebook cell. */

import { decode, inflate } from "./data.js";
import { fromNotebook } from "./notebook.js";
import { byId } from "./page.js";
import { Player } from "./player.js";
import { Recording } from "./recording.js";

/** Starts the player with the run in the page, which is a raw deflate stream in base64. */
async function fromFile() {
  const data = byId("run"), text = data.textContent ?? "";
  data.textContent = "";
  return new Player(new Recording(decode(await inflate(text))));
}

/** Starts the player, and marks the page as ready for tests. */
async function main() {
  const { live, cell } = document.documentElement.dataset;
  const player = cell ? await fromNotebook(cell) : live === undefined ? await fromFile() : new Player();
  Object.assign(globalThis, { player }); // Consoles and tests need it.
  document.documentElement.dataset.ready = "1";
}

main().catch((error) => {
  const problem = byId("problem");
  problem.hidden = false;
  problem.append(` (${error.message})`);
  document.documentElement.dataset.ready = "0"; // This hides controls that do not work.
});
