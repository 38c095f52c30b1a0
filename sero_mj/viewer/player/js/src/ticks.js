/** Marks on a timeline. The text of marks near the displayed time is shown above the timeline. */

import { boxesOf, byId, made, mark, write } from "./page.js";

/**
 * A mark at a time, or for a duration.
 * @typedef {{begin: number, end: number, text: string, kind: string, label?: string}} Tick
 *   text: description with the time; label: text on marks with a duration, shown if there is space
 */


const NEAR = 0.012; // maximum distance of a shown mark from the displayed time, as a fraction of the timeline
const SHOWN_AFTER = 0.5; // time after a mark during which its text is shown, s
const MAX_LINES = 3; // maximum number of lines of text
const TICK_WIDTH = 3; // width of a mark, pixels
const MIN_LABEL = 40; // minimum width of a cut label, pixels
const BESIDE = 8; // distance between boxes at the lower edge of the image, pixels
const NARROW = 280; // minimum width of a space for text, pixels

/**
 * Returns the marks whose text is shown: the nearest one, and others at the same time.
 * @param {Tick[]} ticks @param {number} at displayed time, s @param {number} length of the timeline, s
 * @returns {Tick[]}
 */
export function ticksAt(ticks, at, length) {
  const near = NEAR * length, after = Math.max(near, SHOWN_AFTER);
  /** @type {Tick[]} */
  let found = [];
  let nearest = Infinity;
  for (const tick of ticks) {
    const passed = at - tick.begin, isIn = tick.end > tick.begin && !tick.label && passed >= 0 && at <= tick.end;
    if (!tick.text || !isIn && (passed < -near || passed > after)) continue;
    const away = Math.abs(passed);
    if (away < nearest - 1e-3) [found, nearest] = [[], away];
    if (away <= nearest + 1e-3) found.push(tick);
  }
  return found;
}

/** Returns a key that identifies a mark. @param {Tick} tick */
const keyOf = ({ begin, end, kind, text }) => JSON.stringify([begin, end, kind, text]);

/** Returns the first lines of a text, and the number of omitted lines. @param {string[]} lines */
const firstLines = (lines) => lines.length <= MAX_LINES ? lines
  : [...lines.slice(0, MAX_LINES - 1), `and ${lines.length - MAX_LINES + 1} more`];

/**
 * Returns the gap between marks for a label: the first one that is long enough, or the longest one.
 * @param {number} needed width of the label, pixels @param {number[]} edges of the marks in ascending order, pixels
 * @returns {[begin: number, length: number]}
 */
export function gapFor(needed, edges) {
  /** @type {[number, number][]} */
  const gaps = edges.slice(1).map((end, k) => [edges[k], end - edges[k] - TICK_WIDTH]);
  return gaps.find(([, length]) => length >= needed) ?? gaps.reduce((a, b) => b[1] > a[1] ? b : a);
}

/** Returns the space at the lower edge of the image, beside or above the legend and the details, in pixels. */
function roomAbove() {
  const stage = byId("stage").getBoundingClientRect();
  const room = { left: stage.left + BESIDE, right: stage.right - BESIDE, up: 0, foot: stage.bottom }, whole = { ...room };
  for (const { left, right, top } of boxesOf(["#notes", "#details"])) {
    whole.up = Math.max(whole.up, stage.bottom - top);
    if (left + right < stage.left + stage.right) room.left = Math.max(room.left, right + BESIDE);
    else room.right = Math.min(room.right, left - BESIDE);
  }
  return room.right - room.left < NARROW ? whole : room;
}

/** Shows the marks of a timeline as buttons, which seek the time of the mark. */
export class Ticks {
  /** @param {HTMLElement} room element over the timeline @param {(time: number) => void} onSeek */
  constructor(room, onSeek) {
    this.room = room;
    this.onSeek = onSeek;
    /** @type {Tick[]} */
    this.ticks = [];
    /** @type {Map<string, HTMLButtonElement>} */
    this.buttons = new Map();
    this.bubble = made("div", "", { class: "told", hidden: "" });
    room.append(this.bubble);
    this.low = 0; // start and end of the timeline, s
    this.high = 1;
    this.text = ""; // displayed text
    this.tallest = 0; // maximum height of the text so far, pixels
    new ResizeObserver(() => {
      this.tallest = 0;
      this.#label();
    }).observe(room);
  }

  /** @param {number} time */
  #share(time) {
    return Math.min(Math.max((time - this.low) / (this.high - this.low || 1), 0), 1);
  }

  /** Updates the buttons. Those of unchanged marks are reused. @param {Tick[]} ticks @param {number} low @param {number} high s */
  update(ticks, low, high) {
    [this.ticks, this.low, this.high] = [ticks.map((tick) => ({ ...tick })), low, high];
    const before = this.buttons;
    this.buttons = new Map();
    for (const tick of ticks) {
      const key = keyOf(tick);
      if (this.buttons.has(key)) continue;
      const button = before.get(key) ?? this.#make(tick);
      before.delete(key);
      const begin = this.#share(tick.begin);
      button.style.left = `${100 * begin}%`;
      if (tick.end > tick.begin) button.style.width = `${100 * (this.#share(tick.end) - begin)}%`;
      this.buttons.set(key, button);
    }
    for (const button of before.values()) button.remove();
    this.#label();
  }

  /** Places labels in gaps between marks, and hides labels without space. */
  #label() {
    const { ticks, room: { clientWidth: width } } = this;
    const begins = ticks.map(({ begin }) => width * this.#share(begin));
    const inOrder = [...begins].sort((a, b) => a - b);
    let free = -Infinity; // right edge of the last label
    for (const [k, tick] of width ? ticks.entries() : []) {
      const words = this.buttons.get(keyOf(tick))?.querySelector("span");
      if (!words) continue;
      words.style.maxWidth = "";
      words.hidden = false;
      const begin = begins[k], end = width * this.#share(tick.end);
      const from = Math.min(Math.max(begin, free), end);
      const edges = [from, ...inOrder.filter((each) => each > from + 1 && each < end), end];
      const needed = words.offsetWidth, [at, length] = gapFor(needed, edges);
      words.hidden = length < Math.min(needed, MIN_LABEL);
      tick.label = words.hidden ? "" : words.textContent ?? "";
      if (words.hidden) continue;
      words.style.left = `${at - begin}px`;
      words.style.maxWidth = `${length}px`;
      free = at + TICK_WIDTH + Math.min(needed, length);
    }
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

  /** Shows the text of marks near a time. @param {number} at s */
  showAt(at) {
    const shown = ticksAt(this.ticks, at, this.high - this.low), { bubble } = this;
    this.text = firstLines(shown.map(({ text }) => text)).join("\n");
    bubble.hidden = !shown.length;
    if (!shown.length) return;
    const isBelow = this.room.closest("#timeline") !== null; // whether the timeline is below the image
    write(bubble, this.text);
    mark(bubble, "class", `told ${(shown.find(({ kind }) => kind === "failed") ?? shown[0]).kind}`);
    // The text is beside its mark, within the timeline.
    const share = this.#share(shown[0].begin);
    bubble.style.left = `${100 * share}%`;
    bubble.style.transform = `translateX(${-100 * share}%)`;
    const room = isBelow ? roomAbove() : null;
    if (room) this.#move(share, room);
    this.tallest = Math.max(this.tallest, bubble.offsetHeight);
    if (room) bubble.dataset.room = String(room.up + this.tallest + BESIDE);
  }

  /**
   * Moves the text to where it has space.
   * @param {number} share position of the mark as a fraction of the timeline @param {ReturnType<typeof roomAbove>} room
   */
  #move(share, { left: first, right: last, up, foot }) {
    const { bubble } = this, { left, width, top } = this.room.getBoundingClientRect();
    bubble.style.maxWidth = `min(60ch, ${last - first}px)`;
    bubble.style.bottom = `calc(100% + ${top - foot + BESIDE + up}px)`;
    const wanted = left + share * (width - bubble.offsetWidth);
    bubble.style.left = `${Math.max(Math.min(wanted, last - bubble.offsetWidth), first) - left}px`;
    bubble.style.transform = "";
  }
}
