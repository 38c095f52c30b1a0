/** Text at positions in the world: names of frames, and labels of overlays. */

import * as THREE from "three";
import { made, write } from "./page.js";

/** @typedef {import("./data.js").Run} Run */
/** @typedef {[text: string, x: number, y: number, z: number, kind?: number, item?: number]} Label
 *   text and position in m. A click on a label with a kind reports its kind and item, see `Kind` in Python. */

/** Returns the labels of a run at a frame. @param {Run} run @param {number} frame @returns {Label[]} */
export function labelsAt({ labels, frames }, frame) {
  if (!labels) return [];
  return Array.from({ length: labels.at.length / frames }, (_, k) => {
    const [x, y, z] = [0, 1, 2].map((c) => labels.positions[(3 * k + c) * frames + frame]);
    return [labels.texts[labels.at[k * frames + frame]], x, y, z];
  });
}

const LINE = 18, CHARACTER = 7.4, MARGIN = 14; // height of a line, and widths of a character and the margins, pixels
const LOWER = 3; // maximum displacement of a label from its position, lines

/**
 * Returns the y coordinate at which a label covers no earlier label: its position or a few lines below.
 * Returns null if there is no space, because a name farther away would seem to name another item.
 * @param {number} x center of the label @param {number} y @param {string} text
 * @param {[x: number, y: number, width: number][]} taken earlier labels, to which the new label is added
 */
export function clearOf(x, y, text, taken) {
  const width = CHARACTER * Math.max(...text.split("\n").map((line) => line.length)) + MARGIN;
  const near = taken.filter(([at, , wide]) => Math.abs(at - x) < (wide + width) / 2);
  for (let low = y; low <= y + LOWER * LINE; low += LINE) {
    if (near.some(([, at]) => Math.abs(at - low) < LINE)) continue;
    taken.push([x, low, width]);
    return low;
  }
  return null;
}

/** Creates and lays out all labels of the image. */
export class Labels {
  /** @param {HTMLElement} room */
  constructor(room) {
    this.room = room;
    /** @type {HTMLElement[]} */
    this.boxes = [];
    this.place = new THREE.Vector3();
    /** @type {(key: string, event: MouseEvent) => void} */
    this.onClick = () => {};
  }

  #make() {
    const box = made("span", "", { class: "label" });
    box.addEventListener("click", (event) => this.onClick(box.dataset.key ?? "", event));
    this.room.append(box);
    return box;
  }

  /** Writes labels below their positions. @param {import("./stage.js").Stage} stage @param {Label[]} labels */
  layOut(stage, labels) {
    const { width, height } = stage.size;
    /** @type {[number, number, number][]} */
    const taken = [];
    while (this.boxes.length < labels.length) this.boxes.push(this.#make());
    this.boxes.forEach((box, k) => {
      const [text, atX, atY, atZ, kind, item] = labels[k] ?? ["", 0, 0, 0];
      const { x, y, isSeen } = stage.pixel(this.place.set(atX, atY, atZ));
      const isInside = text && isSeen && x > 0 && x < width && y > 0 && y < height;
      const low = isInside ? clearOf(x, y, text, taken) : null;
      box.style.display = low === null ? "none" : "";
      if (low === null) return;
      write(box, text);
      box.dataset.key = kind ? `${kind} ${item}` : "";
      box.style.transform = `translate(${x.toFixed(1)}px,${(low + 8).toFixed(1)}px) translateX(-50%)`;
    });
  }
}
