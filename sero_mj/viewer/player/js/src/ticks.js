/** Ticks on a time line: what happened when. What is near the time that is shown is told above it. */

import { made, mark, write } from "./page.js";

/**
 * What happened at a time, or for some time.
 * @typedef {{begin: number, end: number, text: string, kind: string, label?: string}} Tick
 *   text: with its time, where that is not beside it; label: on what takes some time, where there is room
 */

const NEAR = 0.012; // of the time line
const AFTER = 1; // s for which what has just happened is told: time to read it
const MOST_LINES = 3;

/**
 * The ticks that are told: the nearest one, with what happened at the same time.
 * @param {Tick[]} ticks @param {number} at what is shown, s @param {number} length of the time line, s
 * @returns {Tick[]}
 */
export function toldAt(ticks, at, length) {
  const near = NEAR * length, after = Math.max(near, AFTER);
  /** @type {Tick[]} */
  let told = [];
  let least = Infinity;
  for (const tick of ticks) {
    const passed = at - tick.begin, isIn = tick.end > tick.begin && !tick.label && passed >= 0 && at <= tick.end;
    if (!tick.text || !isIn && (passed < -near || passed > after)) continue;
    const away = Math.abs(passed);
    if (away < least - 1e-3) [told, least] = [[], away];
    if (away <= least + 1e-3) told.push(tick);
  }
  return told;
}

/** The lines of a text, without what would be too many. @param {string[]} lines */
const few = (lines) => lines.length <= MOST_LINES ? lines
  : [...lines.slice(0, MOST_LINES - 1), `and ${lines.length - MOST_LINES + 1} more`];

/** The ticks of a time line, as buttons that go there. */
export class Ticks {
  /** @param {HTMLElement} room over the time line @param {(time: number) => void} onSeek */
  constructor(room, onSeek) {
    this.room = room;
    this.onSeek = onSeek;
    /** @type {Tick[]} */
    this.ticks = [];
    /** @type {Map<string, HTMLButtonElement>} */
    this.buttons = new Map();
    this.bubble = made("div", "", { class: "told", hidden: "" });
    room.append(this.bubble);
    this.low = 0; // s, ends of the time line
    this.high = 1;
    this.told = ""; // what is told now
  }

  /** @param {number} time */
  #share(time) {
    return Math.min(Math.max((time - this.low) / (this.high - this.low || 1), 0), 1);
  }

  /** Buttons that are still there stay what they are. @param {Tick[]} ticks @param {number} low @param {number} high s */
  update(ticks, low, high) {
    [this.ticks, this.low, this.high] = [ticks, low, high];
    const before = this.buttons;
    this.buttons = new Map();
    for (const tick of ticks) {
      const key = JSON.stringify([tick.begin, tick.end, tick.kind, tick.text]);
      if (this.buttons.has(key)) continue;
      const button = before.get(key) ?? this.#make(tick);
      before.delete(key);
      const begin = this.#share(tick.begin);
      button.style.left = `${100 * begin}%`;
      if (tick.end > tick.begin) button.style.width = `${100 * (this.#share(tick.end) - begin)}%`;
      this.buttons.set(key, button);
    }
    for (const button of before.values()) button.remove();
  }

  /** @param {Tick} tick */
  #make({ begin, end, text, kind, label }) {
    const point = end > begin ? "" : " point";
    const button = made("button", "", { type: "button", class: `mark ${kind}${point}`, title: text, "aria-label": text });
    if (label) button.append(made("span", label));
    button.addEventListener("click", () => this.onSeek(begin));
    this.room.append(button);
    return button;
  }

  /** Tells what is near a time. @param {number} at s */
  tell(at) {
    const told = toldAt(this.ticks, at, this.high - this.low), { bubble } = this;
    this.told = few(told.map(({ text }) => text)).join("\n");
    bubble.hidden = !told.length;
    if (!told.length) return;
    write(bubble, this.told);
    mark(bubble, "class", `told ${(told.find(({ kind }) => kind === "failed") ?? told[0]).kind}`);
    // Beside its tick, and never beyond the ends of the time line.
    const share = 100 * this.#share(told[0].begin);
    bubble.style.left = `${share}%`;
    bubble.style.transform = `translateX(${-share}%)`;
  }
}
