/** The billboards of a recorded run, which show values of joints and smart arrows. */

import { textOf, valueOf } from "./data.js";
import { BILLBOARD, VECTOR } from "./geoms.js";

/** @typedef {import("./data.js").Run} Run */
/** @typedef {import("./billboards.js").Content} Content */

const TORQUES = ["torques", "torque_error"];

/** Computes the contents of the billboards of a run. Their keys consist of kind and item. */
export class JointBillboards {
  /** @param {Run} run */
  constructor(run) {
    this.run = run;
    const areSome = run.joints.some((joint) => joint.card); // If none is on, all joints have billboards.
    this.joints = [...run.joints.keys()].filter((j) => (run.joints[j].card || !areSome) && run.joints[j].lines.length);
    this.chosen = -1;
    this.vector = -1; // smart arrow that was clicked on
    this.quantity = ""; // quantity of the arrows, or an empty string for the quantity in the file
  }

  /**
   * Returns the contents of the billboards at a frame.
   * @param {import("./stage.js").Stage} stage @param {number} frame @returns {Content[]}
   */
  at(stage, frame) {
    const found = this.joints.map((joint) => this.#ofJoint(stage, joint, frame));
    for (const { item, texts, at } of this.run.arrowTexts) {
      const place = stage.items.places.get(`${VECTOR} ${item}`), text = texts[at[frame]];
      if (item !== this.vector || !place || !text) continue;
      found.push({ key: `${VECTOR} ${item}`, title: "", lines: [["", text]], sign: "", isStale: false,
        at: place, load: Infinity, isChosen: false });
    }
    return found;
  }

  /** Returns the lines of a joint's billboard. A default line with a torque shows the quantity of arrows. @param {number} joint */
  #linesOf(joint) {
    const { lines, details, follows } = this.run.joints[joint];
    const isTorque = follows && lines.length === 1 && TORQUES.includes(lines[0].key);
    const shown = isTorque && details.find(({ key }) => key === this.quantity);
    if (!shown) return lines;
    const label = shown.key === "torques" ? "" : shown.label;
    return [{ ...shown, title: lines[0].title, label }];
  }

  /** @param {import("./stage.js").Stage} stage @param {number} joint @param {number} frame @returns {Content} */
  #ofJoint(stage, joint, frame) {
    const { run } = this, lines = this.#linesOf(joint), isChosen = joint === this.chosen;
    const values = lines.map((line) => valueOf(run, joint, line.key, frame));
    const texts = lines.map((line, k) => textOf(line, values[k]));
    const isNothing = !Number.isFinite(values[0]) || !/[1-9]/.test(texts[0]);
    const share = valueOf(run, joint, "torque_share", frame);
    return {
      key: `${BILLBOARD} ${joint}`, title: lines[0].title, lines: lines.map(({ label }, k) => [label, texts[k]]),
      sign: isNothing ? "" : values[0] > 0 ? "positive" : "negative", isStale: false,
      at: stage.centre(joint), load: isChosen ? Infinity : Number.isFinite(share) ? share : -1, isChosen,
    };
  }
}
