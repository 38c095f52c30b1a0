/** Text at places of the world: names of frames, and labels of decor. */

import * as THREE from "three";

/** @typedef {import("./data.js").Run} Run */

/** All of it. */
export class Labels {
  /** @param {Run} run @param {HTMLElement} room */
  constructor(run, room) {
    this.run = run;
    const count = run.labels ? run.labels.at.length / run.frames : 0;
    this.boxes = Array.from({ length: count }, () => {
      const box = document.createElement("span");
      box.className = "label";
      room.append(box);
      return box;
    });
  }

  /**
   * Writes what a frame has, below its places.
   * @param {import("./stage.js").Stage} stage @param {number} frame
   */
  layOut(stage, frame) {
    const { labels, frames } = this.run, { width, height } = stage.size;
    if (!labels) return;
    this.boxes.forEach((box, k) => {
      const text = labels.texts[labels.at[k * frames + frame]];
      const place = [0, 1, 2].map((c) => labels.positions[(3 * k + c) * frames + frame]);
      const { x, y, isSeen } = stage.pixel(new THREE.Vector3().fromArray(place));
      const isShown = text && isSeen && x > 0 && x < width && y > 0 && y < height;
      box.style.display = isShown ? "" : "none";
      if (!isShown) return;
      if (box.textContent !== text) box.textContent = text;
      box.style.transform = `translate(${x.toFixed(1)}px,${(y + 8).toFixed(1)}px) translateX(-50%)`;
    });
  }
}
