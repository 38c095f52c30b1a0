/** Billboards: text beside the robots, with leader lines to the items. They are laid out in every frame. */

import * as THREE from "three";
import { stacked } from "./layout.js";
import { made, write } from "./page.js";

/** @typedef {import("./stage.js").Stage} Stage */
/** @typedef {{key: string, title: string, lines: [label: string, value: string][],
 *   sign: "" | "positive" | "negative", isStale: boolean, at: THREE.Vector3, load: number,
 *   isChosen: boolean}} Content
 *   at: end of the leader line, m; load: priority if there is not enough space for all billboards */
/** @typedef {{content: Content, box: HTMLButtonElement, title: HTMLElement, lines: HTMLElement[][],
 *   path: SVGPathElement, dot: SVGCircleElement, side: number, at: {x: number, y: number},
 *   width: number, height: number, longest: number}} Billboard */

const SVG = "http://www.w3.org/2000/svg";
const GAP = 6; // distance between billboards, pixels
const HYSTERESIS = 12; // distance from the center below which a joint's billboard does not change sides, pixels

/** Creates and lays out all billboards. */
export class Billboards {
  /**
   * @param {HTMLElement} room @param {SVGElement} leaders
   * @param {(key: string, event: MouseEvent) => void} onClick
   */
  constructor(room, leaders, onClick) {
    this.room = room;
    this.leaders = leaders;
    this.onClick = onClick;
    /** @type {Map<string, Billboard>} */
    this.billboards = new Map();
    this.place = new THREE.Vector3();
  }

  /** @param {Content} content @returns {Billboard} */
  #make(content) {
    const box = made("button", "", { type: "button" }), title = made("i", "");
    box.append(title);
    box.addEventListener("click", (event) => this.onClick(content.key, event));
    const path = document.createElementNS(SVG, "path");
    const dot = document.createElementNS(SVG, "circle");
    dot.setAttribute("r", "2.6");
    this.leaders.append(path, dot);
    this.room.append(box);
    return { content, box, title, lines: [], path, dot, side: -1, at: { x: 0, y: 0 }, width: 0, height: 0,
      longest: 0 };
  }

  /** Creates, updates and removes billboards. @param {Content[]} contents */
  #write(contents) {
    const wanted = new Set(contents.map(({ key }) => key));
    for (const [key, billboard] of this.billboards) {
      if (wanted.has(key)) continue;
      for (const each of [billboard.box, billboard.path, billboard.dot]) each.remove();
      this.billboards.delete(key);
    }
    for (const content of contents) {
      let billboard = this.billboards.get(content.key);
      if (!billboard) this.billboards.set(content.key, billboard = this.#make(content));
      billboard.content = content;
      this.#fill(billboard);
    }
  }

  /** @param {Billboard} billboard */
  #fill(billboard) {
    const { box, title, lines, content } = billboard;
    const look = `card ${content.lines.length > 1 ? "many" : ""} ${content.isStale ? "stale" : content.sign}`
      + (content.isChosen ? " chosen" : "");
    if (box.className !== look) box.className = look;
    // A billboard with another number of lines, or with or without a title, may have become smaller.
    const isOther = lines.length !== content.lines.length || title.hidden === Boolean(content.title);
    if (isOther) billboard.longest = billboard.width = 0;
    while (lines.length > content.lines.length) lines.pop()?.[0].remove();
    while (lines.length < content.lines.length) {
      const line = [made("span", ""), made("i", ""), made("b", "")];
      line[0].append(line[1], line[2]);
      box.append(line[0]);
      lines.push(line);
    }
    title.hidden = !content.title;
    write(title, content.title);
    let longest = content.title.length;
    content.lines.forEach(([label, value], k) => {
      lines[k][1].hidden = !label;
      write(lines[k][1], label);
      write(lines[k][2], value);
      longest = Math.max(longest, label.length + value.length);
    });
    if (longest > billboard.longest) [billboard.longest, billboard.width] = [longest, 0];
  }

  /**
   * Places billboards in columns beside the robots.
   * @param {Stage} stage @param {Content[]} contents @param {number} top upper end of the columns, pixels
   * @param {(left: number, right: number) => number} endOf
   *   returns the lower end of a column between two x coordinates, pixels
   */
  layOut(stage, contents, top, endOf) {
    this.#write(contents);
    const { width, height } = stage.size, { place } = this, shown = [];
    let [first, last] = [Infinity, -Infinity];
    const { bodies } = stage.run;
    for (const [b, pose] of stage.robots.matrices.entries()) {
      const pixel = stage.pixel(place.setFromMatrixPosition(pose));
      if (!pixel.isSeen || !stage.robots.texels[20 * b + 16] || bodies[b].name === "world") continue;
      first = Math.min(first, pixel.x);
      last = Math.max(last, pixel.x);
    }
    const middle = (first + last) / 2;
    for (const billboard of this.billboards.values()) {
      const pixel = stage.pixel(billboard.content.at);
      const isShown = pixel.isSeen && pixel.x > 0 && pixel.x < width && pixel.y > 0 && pixel.y < height;
      show(billboard, isShown);
      if (!isShown) continue;
      billboard.at = pixel;
      if (!billboard.width) billboard.box.style.width = "";
      if (!billboard.width) [billboard.width, billboard.height] = [billboard.box.offsetWidth, billboard.box.offsetHeight];
      shown.push(billboard);
    }
    if (!shown.length) return;
    const widest = Math.max(...shown.map((billboard) => billboard.width));
    const tall = Math.min(...shown.map((billboard) => billboard.height));
    const margin = Math.min(90, width * 0.07);
    const left = Math.max(first - margin - widest, 8);
    const columns = [left, Math.min(last + margin, width - widest - 8)];
    const ends = columns.map((x) => endOf(x, x + widest));
    const room = Math.max(Math.floor((Math.min(...ends) - top + GAP) / (tall + GAP)), 1);
    const placed = mostLoaded(shown, 2 * room);
    this.#chooseSides(placed, middle, room);
    for (const side of [0, 1]) {
      const column = placed.filter((billboard) => billboard.side === side).sort((a, b) => a.at.y - b.at.y);
      const x = columns[side];
      const ys = stacked(column.map((billboard) => billboard.at.y), column.map((billboard) => billboard.height), GAP,
        top, ends[side]);
      column.forEach((billboard, k) => {
        const y = ys[k], edge = side ? x : x + widest;
        billboard.box.style.width = `${widest}px`;
        billboard.box.style.transform = `translate(${x.toFixed(1)}px,${(y - billboard.height / 2).toFixed(1)}px)`;
        const { x: toX, y: toY } = billboard.at;
        billboard.path.setAttribute("d", `M${edge.toFixed(1)} ${y.toFixed(1)}L${toX.toFixed(1)} ${toY.toFixed(1)}`);
        billboard.dot.setAttribute("cx", toX.toFixed(1));
        billboard.dot.setAttribute("cy", toY.toFixed(1));
      });
    }
  }

  /**
   * Chooses the side of each joint's billboard, so that both columns have about the same length.
   * @param {Billboard[]} billboards @param {number} middle @param {number} room billboards per column
   */
  #chooseSides(billboards, middle, room) {
    for (const billboard of billboards) {
      const away = billboard.at.x - middle;
      if (billboard.side < 0 || Math.abs(away) > HYSTERESIS) billboard.side = away < 0 ? 0 : 1;
    }
    const limit = Math.min(Math.max(Math.ceil(billboards.length / 2) + 1, 2), room);
    for (const side of [0, 1]) {
      const column = billboards.filter((billboard) => billboard.side === side);
      column.sort((a, b) => Math.abs(a.at.x - middle) - Math.abs(b.at.x - middle));
      for (const billboard of column.slice(0, Math.max(column.length - limit, 0))) billboard.side = 1 - side;
    }
  }

  /** Makes the next layout measure all billboards again, because the text size has changed. */
  forgetSizes() {
    for (const billboard of this.billboards.values()) {
      billboard.width = 0;
      billboard.box.style.width = "";
    }
  }
}

/** @param {Billboard} billboard @param {boolean} isShown */
function show({ box, path, dot }, isShown) {
  for (const each of [box, path, dot]) each.style.display = isShown ? "" : "none";
}

/** Returns the `count` billboards with the highest load, and hides all others. @param {Billboard[]} shown @param {number} count */
function mostLoaded(shown, count) {
  if (shown.length <= count) return shown;
  const sorted = [...shown].sort((a, b) => b.content.load - a.content.load);
  for (const billboard of sorted.slice(count)) show(billboard, false);
  return sorted.slice(0, count);
}
