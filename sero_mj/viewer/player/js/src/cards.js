/** Cards: real text beside the robots, with leaders to their joints, laid out in every picture. */

import * as THREE from "three";
import { textOf, valueOf } from "./data.js";
import { stacked } from "./layout.js";

/** @typedef {import("./data.js").Run} Run */
/** @typedef {import("./stage.js").Stage} Stage */
/** @typedef {{joint: number, vector: number, box: HTMLButtonElement, values: HTMLElement[],
 *   path: SVGPathElement, dot: SVGCircleElement, side: number, at: {x: number, y: number},
 *   width: number, height: number, sign: string, longest: number}} Card */

const SVG = "http://www.w3.org/2000/svg";
const GAP = 6; // pixels between cards
const VECTOR = 5; // kind of smart arrows, `Kind` in Python
const HYSTERESIS = 12; // pixels, by which a joint has to be beside the middle to change sides

/** All cards. */
export class Cards {
  /**
   * @param {Run} run @param {HTMLElement} room @param {SVGElement} leaders
   * @param {(joint: number) => void} onClick
   */
  constructor(run, room, leaders, onClick) {
    this.run = run;
    this.room = room;
    this.leaders = leaders;
    this.onClick = onClick;
    /** @type {Card[]} */
    this.cards = [];
    run.joints.forEach((joint, j) => {
      if (joint.card && joint.lines.length) {
        this.cards.push(this.#make(j, -1, joint.lines[0].title, joint.lines.length));
      }
    });
    run.cards.forEach((card, k) => this.cards.push(this.#make(-1, k, "", 1)));
    this.chosen = -1;
    this.vector = -1; // smart arrow that was clicked on
    this.last = -1;
  }

  /**
   * @param {number} joint @param {number} vector @param {string} title @param {number} count
   * @returns {Card}
   */
  #make(joint, vector, title, count) {
    const box = document.createElement("button"), values = [];
    box.className = count > 1 ? "card many" : "card";
    box.type = "button";
    if (title) box.append(Object.assign(document.createElement("i"), { textContent: title }));
    for (let k = 0; k < count; k++) {
      const line = document.createElement("span"), value = document.createElement("b");
      const label = joint < 0 ? "" : this.run.joints[joint].lines[k].label;
      if (label) line.append(Object.assign(document.createElement("i"), { textContent: label }));
      line.append(value);
      values.push(value);
      box.append(line);
    }
    if (joint >= 0) box.addEventListener("click", () => this.onClick(joint));
    const path = document.createElementNS(SVG, "path");
    const dot = document.createElementNS(SVG, "circle");
    dot.setAttribute("r", "2.6");
    this.leaders.append(path, dot);
    this.room.append(box);
    return { joint, vector, box, values, path, dot, side: -1, at: { x: 0, y: 0 }, width: 0,
      height: 0, sign: "", longest: 0 };
  }

  /** Writes the numbers of a frame. @param {number} frame */
  write(frame) {
    if (frame === this.last) return;
    this.last = frame;
    const { run } = this;
    for (const card of this.cards) {
      if (card.vector >= 0) {
        const { texts, at } = run.cards[card.vector];
        set(card.values[0], texts[at[frame]]);
        continue;
      }
      run.joints[card.joint].lines.forEach((line, k) => {
        const value = valueOf(run, card.joint, line.key, frame);
        const text = textOf(line, value);
        set(card.values[k], text);
        if (text.length > card.longest) [card.longest, card.width] = [text.length, 0];
        if (k) return;
        const isNothing = !Number.isFinite(value) || !/[1-9]/.test(text);
        const sign = isNothing ? "" : value > 0 ? "positive" : "negative";
        if (sign === card.sign) return;
        card.box.classList.remove("positive", "negative");
        if (sign) card.box.classList.add(sign);
        card.sign = sign;
      });
    }
  }

  /** @param {number} joint -1 for none */
  choose(joint) {
    this.chosen = joint;
    for (const card of this.cards) card.box.classList.toggle("chosen", card.joint === joint && joint >= 0);
  }

  /**
   * Places cards in columns beside the robots.
   * @param {Stage} stage @param {number} frame @param {boolean} isOn @param {number} top free pixels
   */
  layOut(stage, frame, isOn, top) {
    this.room.hidden = !isOn;
    this.leaders.style.display = isOn ? "" : "none";
    if (!isOn) return;
    this.write(frame);
    const { width, height } = stage.size, place = new THREE.Vector3(), shown = [];
    let [first, last] = [Infinity, -Infinity];
    const { run } = this, { bodies } = run;
    for (const [b, pose] of stage.robots.matrices.entries()) {
      const pixel = stage.pixel(place.setFromMatrixPosition(pose));
      if (!pixel.isSeen || !stage.robots.texels[20 * b + 16] || bodies[b].name === "world") continue;
      first = Math.min(first, pixel.x);
      last = Math.max(last, pixel.x);
    }
    const middle = (first + last) / 2;
    for (const card of this.cards) {
      const isWanted = card.vector < 0 || run.cards[card.vector].item === this.vector;
      const at = isWanted && this.#place(card, stage, place), pixel = at && stage.pixel(at);
      const isShown = Boolean(pixel && pixel.isSeen && card.values[0].textContent
        && pixel.x > 0 && pixel.x < width && pixel.y > 0 && pixel.y < height);
      for (const each of [card.box, card.path, card.dot]) each.style.display = isShown ? "" : "none";
      if (!isShown || !pixel) continue;
      card.at = pixel;
      if (!card.width) card.box.style.width = "";
      if (!card.width) [card.width, card.height] = [card.box.offsetWidth, card.box.offsetHeight];
      shown.push(card);
    }
    if (!shown.length) return;
    const widest = Math.max(...shown.map((card) => card.width));
    const tall = Math.min(...shown.map((card) => card.height));
    const room = Math.max(Math.floor((height - top - 12) / (tall + GAP)), 1);
    const kept = this.#kept(shown, 2 * room, frame);
    this.#chooseSides(kept, middle, room);
    const margin = Math.min(90, width * 0.07);
    for (const side of [0, 1]) {
      const column = kept.filter((card) => card.side === side).sort((a, b) => a.at.y - b.at.y);
      const x = side ? Math.min(last + margin, width - widest - 8) : Math.max(first - margin - widest, 8);
      const ys = stacked(column.map((card) => card.at.y), column.map((card) => card.height), GAP,
        top, height - 8);
      column.forEach((card, k) => {
        const y = ys[k], edge = side ? x : x + widest;
        card.box.style.width = `${widest}px`;
        card.box.style.transform = `translate(${x.toFixed(1)}px,${(y - card.height / 2).toFixed(1)}px)`;
        const { x: toX, y: toY } = card.at;
        card.path.setAttribute("d", `M${edge.toFixed(1)} ${y.toFixed(1)}L${toX.toFixed(1)} ${toY.toFixed(1)}`);
        card.dot.setAttribute("cx", toX.toFixed(1));
        card.dot.setAttribute("cy", toY.toFixed(1));
      });
    }
  }

  /** @param {Card} card @param {Stage} stage @param {THREE.Vector3} place */
  #place(card, stage, place) {
    if (card.vector < 0) return place.setFromMatrixPosition(stage.sites[card.joint]);
    return stage.items.places.get(`${VECTOR} ${this.run.cards[card.vector].item}`);
  }

  /**
   * As many as there is room for: the chosen one, then those of the most loaded joints.
   * @param {Card[]} shown @param {number} most @param {number} frame
   */
  #kept(shown, most, frame) {
    if (shown.length <= most) return shown;
    const load = (/** @type {Card} */ card) => {
      if (card.joint < 0 || card.joint === this.chosen) return Infinity;
      const share = valueOf(this.run, card.joint, "torque_share", frame);
      return Number.isFinite(share) ? share : -1;
    };
    const kept = [...shown].sort((a, b) => load(b) - load(a)).slice(0, most);
    for (const card of shown) {
      if (kept.includes(card)) continue;
      for (const each of [card.box, card.path, card.dot]) each.style.display = "none";
    }
    return kept;
  }

  /**
   * The side of each card is that of its joint in the picture; columns are about equally long.
   * @param {Card[]} cards @param {number} middle @param {number} room cards in a column
   */
  #chooseSides(cards, middle, room) {
    for (const card of cards) {
      const away = card.at.x - middle;
      if (card.side < 0 || Math.abs(away) > HYSTERESIS) card.side = away < 0 ? 0 : 1;
    }
    const most = Math.min(Math.max(Math.ceil(cards.length / 2) + 1, 2), room);
    for (const side of [0, 1]) {
      const column = cards.filter((card) => card.side === side);
      column.sort((a, b) => Math.abs(a.at.x - middle) - Math.abs(b.at.x - middle));
      for (const card of column.slice(0, Math.max(column.length - most, 0))) card.side = 1 - side;
    }
  }

  /** Measures anew, for another size of text. */
  forgetSizes() {
    for (const card of this.cards) {
      card.width = 0;
      card.box.style.width = "";
    }
  }
}

/** @param {HTMLElement} element @param {string} text */
function set(element, text) {
  if (element.textContent !== text) element.textContent = text;
}
