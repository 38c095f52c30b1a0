/** The player: of a run in a file, of a live page, or of a cell of a notebook. */

import { decode, inflate } from "./data.js";
import { fromNotebook } from "./notebook.js";
import { byId } from "./page.js";
import { Player } from "./player.js";
import { Recording } from "./recording.js";

/** The run in the page, base64 of a raw deflate stream. */
async function fromFile() {
  const data = byId("run"), text = data.textContent ?? "";
  data.textContent = "";
  return new Player(new Recording(decode(await inflate(text))));
}

/** Begins, and says so for tests. */
async function main() {
  const { live, cell } = document.documentElement.dataset;
  const player = cell ? await fromNotebook(cell) : live === undefined ? await fromFile() : new Player();
  Object.assign(globalThis, { player }); // for consoles and tests
  document.documentElement.dataset.ready = "1";
}

main().catch((error) => {
  const problem = byId("problem");
  problem.hidden = false;
  problem.append(` (${error.message})`);
  document.documentElement.dataset.ready = "0"; // hides what cannot act
});
