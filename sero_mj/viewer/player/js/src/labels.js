/** Text at places of the world: names of frames, and labels of decor. */

import * as THREE from "three";
import { made, write } from "./page.js";

/** @typedef {import("./data.js").Run} Run */
/** @typedef {[text: string, x: number, y: number, z: number]} Label m */

/** The labels of a run at a frame. @param {Run} run @param {number} frame @returns {Label[]} */
export function labelsAt({ labels, frames }, frame) {
  if (!labels) return [];
  return Array.from({ length: labels.at.length / frames }, (_, k) => {
    const [x, y, z] = [0, 1, 2].map((c) => labels.positions[(3 * k + c) * frames + frame]);
    return [labels.texts[labels.at[k * frames + frame]], x, y, z];
  });
}

/** All of it. */
export class Labels {
  /** @param {HTMLElement} room */
  constructor(room) {
    this.room = room;
    /** @type {HTMLElement[]} */
    this.boxes = [];
    this.place = new THREE.Vector3();
  }

  /** Writes them below their places. @param {import("./stage.js").Stage} stage @param {Label[]} labels */
  layOut(stage, labels) {
    const { width, height } = stage.size;
    while (this.boxes.length < labels.length) {
      this.boxes.push(made("span", "", { class: "label" }));
      this.room.append(this.boxes[this.boxes.length - 1]);
    }
    this.boxes.forEach((box, k) => {
      const [text, ...at] = labels[k] ?? [""];
      const { x, y, isSeen } = stage.pixel(this.place.fromArray(at));
      const isShown = text && isSeen && x > 0 && x < width && y > 0 && y < height;
      box.style.display = isShown ? "" : "none";
      if (!isShown) return;
      write(box, text);
      box.style.transform = `translate(${x.toFixed(1)}px,${(y + 8).toFixed(1)}px) translateX(-50%)`;
    });
  }
}
