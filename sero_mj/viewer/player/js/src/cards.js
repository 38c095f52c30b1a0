/** Billboards: text beside the robots, with leaders to the items, laid out in every frame. */

import * as THREE from "three";
import { stacked } from "./layout.js";
import { made, write } from "./page.js";

/** @typedef {import("./stage.js").Stage} Stage */
/** @typedef {{key: string, title: string, lines: [label: string, value: string][],
 *   sign: "" | "positive" | "negative", isStale: boolean, at: THREE.Vector3, load: number,
 *   isChosen: boolean}} Content
 *   at: end of the leader, m; load: priority if there is little space */
/** @typedef {{content: Content, box: HTMLButtonElement, title: HTMLElement, lines: HTMLElement[][],
 *   path: SVGPathElement, dot: SVGCircleElement, side: number, at: {x: number, y: number},
 *   width: number, height: number, longest: number}} Card */

const SVG = "http://www.w3.org/2000/svg";
const GAP = 6; // pixels between billboards
const HYSTERESIS = 12; // pixels; joints nearer to the center do not change sides

/** All billboards. */
export class Cards {
  /**
   * @param {HTMLElement} room @param {SVGElement} leaders
   * @param {(key: string, event: MouseEvent) => void} onClick
   */
  constructor(room, leaders, onClick) {
    this.room = room;
    this.leaders = leaders;
    this.onClick = onClick;
    /** @type {Map<string, Card>} */
    this.cards = new Map();
    this.place = new THREE.Vector3();
  }

  /** @param {Content} content @returns {Card} */
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
    for (const [key, card] of this.cards) {
      if (wanted.has(key)) continue;
      for (const each of [card.box, card.path, card.dot]) each.remove();
      this.cards.delete(key);
    }
    for (const content of contents) {
      let card = this.cards.get(content.key);
      if (!card) this.cards.set(content.key, card = this.#make(content));
      card.content = content;
      this.#fill(card);
    }
  }

  /** @param {Card} card */
  #fill(card) {
    const { box, title, lines, content } = card;
    const look = `card ${content.lines.length > 1 ? "many" : ""} ${content.isStale ? "stale" : content.sign}`
      + (content.isChosen ? " chosen" : "");
    if (box.className !== look) box.className = look;
    // A billboard with other lines or another title is measured again, even if it has become smaller.
    const isOther = lines.length !== content.lines.length || title.hidden === Boolean(content.title);
    if (isOther) card.longest = card.width = 0;
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
    if (longest > card.longest) [card.longest, card.width] = [longest, 0];
  }

  /**
   * Places billboards in columns beside the robots.
   * @param {Stage} stage @param {Content[]} contents @param {number} top free pixels
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
    for (const card of this.cards.values()) {
      const pixel = stage.pixel(card.content.at);
      const isShown = pixel.isSeen && pixel.x > 0 && pixel.x < width && pixel.y > 0 && pixel.y < height;
      show(card, isShown);
      if (!isShown) continue;
      card.at = pixel;
      if (!card.width) card.box.style.width = "";
      if (!card.width) [card.width, card.height] = [card.box.offsetWidth, card.box.offsetHeight];
      shown.push(card);
    }
    if (!shown.length) return;
    const widest = Math.max(...shown.map((card) => card.width));
    const tall = Math.min(...shown.map((card) => card.height));
    const margin = Math.min(90, width * 0.07);
    const left = Math.max(first - margin - widest, 8);
    const columns = [left, Math.min(last + margin, width - widest - 8)];
    const ends = columns.map((x) => endOf(x, x + widest));
    const room = Math.max(Math.floor((Math.min(...ends) - top + GAP) / (tall + GAP)), 1);
    const kept = mostLoaded(shown, 2 * room);
    this.#chooseSides(kept, middle, room);
    for (const side of [0, 1]) {
      const column = kept.filter((card) => card.side === side).sort((a, b) => a.at.y - b.at.y);
      const x = columns[side];
      const ys = stacked(column.map((card) => card.at.y), column.map((card) => card.height), GAP,
        top, ends[side]);
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

  /**
   * Places each billboard on the side of its joint; both columns are about equally long.
   * @param {Card[]} cards @param {number} middle @param {number} room billboards per column
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

  /** Measures all billboards again, for another text size. */
  forgetSizes() {
    for (const card of this.cards.values()) {
      card.width = 0;
      card.box.style.width = "";
    }
  }
}

/** @param {Card} card @param {boolean} isShown */
function show({ box, path, dot }, isShown) {
  for (const each of [box, path, dot]) each.style.display = isShown ? "" : "none";
}

/** Returns the billboards with the highest load that fit, and hides all others. @param {Card[]} shown @param {number} most */
function mostLoaded(shown, most) {
  if (shown.length <= most) return shown;
  const sorted = [...shown].sort((a, b) => b.content.load - a.content.load);
  for (const card of sorted.slice(most)) show(card, false);
  return sorted.slice(0, most);
}
