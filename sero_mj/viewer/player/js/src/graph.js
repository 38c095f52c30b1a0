/** A plot in a panel, with colored lines that may have gaps, and limits. */

import uPlot from "uplot";
import { fixed } from "./data.js";
import { made, mark } from "./page.js";

/** @typedef {{name: string, rgb: number[], x: number[], y: (number | null)[], isDashed?: boolean, isPoints?: boolean,
 *   tip?: string}} Line isPoints: whether the values are not connected */
/** @typedef {{x: string, y: string, xRange: [number, number], yRange: [number, number],
 *   limits: number[], height: number, lines: Line[], name?: string, now?: number}} Content
 *   x: unit of the x axis; y: quantity and unit of the y axis; name: name of the plotted signal;
 *   now: displayed time, which the user changes with clicks */

const LIMIT = "rgb(217 77 77)";

/** @param {string} name */
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

const DARKER = 0.62; // factor for line colors in the light look, because the colors are for dark windows

/** @param {number[]} rgb 0 to 1 */
const colourOf = (rgb) => {
  const share = document.documentElement.dataset.look === "dark" ? 1 : DARKER;
  return `rgb(${rgb.map((each) => Math.round(255 * share * each)).join(" ")})`;
};

/**
 * Returns the values of lines in the format of uPlot, in which all lines have the same x coordinates.
 * @param {Line[]} lines @returns {uPlot.AlignedData}
 */
export function dataOf(lines) {
  const [first] = lines, ends = (/** @type {Line} */ { x }) => [x.length, x[0], x[x.length - 1]].join();
  if (!first) return [[]];
  if (lines.every((line) => ends(line) === ends(first))) return [first.x, ...lines.map(({ y }) => y)];
  return uPlot.join(lines.map(({ x, y }) => /** @type {uPlot.AlignedData} */ ([x, y])));
}

/** Creates the heading of a plot, with quantity, unit and names of the lines. @param {Content} content */
function namesOf({ y, lines }) {
  return [made("span", y), ...lines.map(({ name, rgb, isDashed, tip }) => {
    const entry = made("span", "", tip ? { title: tip } : {}), line = made("i", "");
    line.style.borderTop = `3px ${isDashed ? "dashed" : "solid"} ${colourOf(rgb)}`;
    entry.append(line, name);
    return entry;
  })];
}

/** Returns the options of a time axis, which shows the unit at every number. @param {string} unit */
const timeAxis = (unit) => ({
  values: (/** @type {unknown} */ _, /** @type {number[]} */ all) => all.map((each) => `${each} ${unit}`),
});

/** Returns the number of decimals that a step needs. @param {number} step */
export function digitsOf(step) {
  let digits = 0;
  while (digits < 9 && Math.abs(1 - Math.round(step * 10 ** digits) / (step * 10 ** digits)) > 1e-6) digits++;
  return digits;
}

const SPACE = 30; // minimum distance between two numbers, pixels

/** Options of the value axis, which shows enough digits to distinguish the numbers. @type {uPlot.Axis} */
const VALUE_AXIS = {
  // Steps are at most 2.5 times as long as necessary, so that short plots also have two numbers.
  space: (_plot, _axis, _min, _max, length) => Math.min(SPACE, length / 5),
  values: (_plot, all, _axis, _space, step) => {
    const digits = digitsOf(step);
    return all.map((each) => fixed(each, digits));
  },
  size: (_plot, texts) => 24 + 7 * Math.max(3, ...(texts ?? []).map(({ length }) => length)),
};

/** A plot that fills the width of its container. */
export class Graph {
  /** @param {(x: number) => void} onSeek */
  constructor(onSeek) {
    this.onSeek = onSeek;
    this.element = made("div", "", { class: "graph" });
    this.legend = made("div", "", { class: "names" });
    this.room = made("div", "", { role: "img" });
    this.element.append(this.legend, this.room);
    /** @type {uPlot | null} */
    this.plot = null;
    /** @type {Content | null} */
    this.content = null;
    this.look = ""; // properties that uPlot cannot change later, as JSON
    this.drawn = ""; // value of `look` when the lines were last drawn
    this.seen = new ResizeObserver(() => this.plot?.setSize(this.#size()));
    this.seen.observe(this.room);
  }

  #size() {
    const em = parseFloat(getComputedStyle(this.room).fontSize) || 14;
    return { width: Math.max(this.room.clientWidth, 40), height: Math.max((this.content?.height ?? 10) * em - 20, 60) };
  }

  /** @param {Content} content */
  update(content) {
    const before = this.content;
    this.content = content;
    const look = JSON.stringify([content.name, content.y, content.x, content.lines.map(({ name, rgb }) => [name, rgb]),
      document.documentElement.dataset.look]);
    if (look !== this.look) this.#make(look);
    else if (before?.height !== content.height) this.plot?.setSize(this.#size());
    const { plot } = this, [[left, right], [low, high]] = [content.xRange, content.yRange];
    if (!plot) return;
    if (before?.lines === content.lines && look === this.drawn) return plot.redraw(false, false);
    this.drawn = look;
    plot.batch(() => {
      plot.setData(dataOf(content.lines), false);
      plot.setScale("x", { min: left, max: right });
      plot.setScale("y", { min: low, max: high });
    });
  }

  /** @param {string} look */
  #make(look) {
    const { content } = this;
    if (!content) return;
    this.look = look;
    this.plot?.destroy();
    const axis = { stroke: css("--dim"), grid: { stroke: css("--edge"), width: 1 },
      ticks: { stroke: css("--edge"), width: 1 }, font: "11px system-ui, sans-serif" };
    this.plot = new uPlot({
      ...this.#size(),
      cursor: { show: false },
      legend: { show: false },
      scales: { x: { time: false, auto: false }, y: { auto: false } },
      padding: [6, 10, 0, 0],
      axes: [{ ...axis, size: 24, ...timeAxis(content.x) },
        { ...axis, ...VALUE_AXIS }],
      series: [{}, ...content.lines.map(({ rgb, isDashed, isPoints }) => ({ stroke: colourOf(rgb), width: 1.75,
        points: { show: isPoints ?? false, size: 4, fill: colourOf(rgb) }, ...isPoints ? { paths: () => null } : {}, ...isDashed ? { dash: [6, 4] } : {} }))],
      hooks: { drawAxes: [(plot) => this.#drawLimits(plot)], draw: [(plot) => this.#drawNow(plot)] },
    }, dataOf(content.lines), this.room);
    this.#listen(this.plot);
    this.legend.replaceChildren(...namesOf(content));
    const what = [...(content.name ? [content.name] : []), content.y].join(", ");
    mark(this.room, "aria-label", `${what}: ${content.lines.map(({ name }) => name).join(", ")}`);
  }

  /** Makes a plot with a displayed time seek the time at which the user presses. @param {uPlot} plot */
  #listen({ over }) {
    /** @param {PointerEvent} event */
    const seek = (event) => {
      if (!event.buttons || !this.plot || this.content?.now === undefined) return;
      this.onSeek(this.plot.posToVal(event.clientX - over.getBoundingClientRect().left, "x"));
    };
    over.addEventListener("pointerdown", (event) => {
      over.setPointerCapture(event.pointerId);
      seek(event);
    });
    over.addEventListener("pointermove", seek);
  }

  /** @param {uPlot} plot */
  #drawNow(plot) {
    const { ctx, bbox: { top, height } } = plot, now = this.content?.now;
    if (now === undefined) return;
    const x = plot.valToPos(now, "x", true);
    ctx.save();
    ctx.strokeStyle = css("--ink");
    ctx.lineWidth = devicePixelRatio;
    ctx.beginPath();
    ctx.moveTo(x, top);
    ctx.lineTo(x, top + height);
    ctx.stroke();
    ctx.restore();
  }

  /** @param {uPlot} plot */
  #drawLimits(plot) {
    const { ctx, bbox } = plot, [low, high] = this.content?.yRange ?? [0, 0];
    ctx.save();
    ctx.strokeStyle = ctx.fillStyle = LIMIT;
    ctx.lineWidth = 1.5 * devicePixelRatio;
    ctx.setLineDash([6 * devicePixelRatio, 4 * devicePixelRatio]);
    for (const limit of this.content?.limits ?? []) {
      if (limit < low || limit > high) continue;
      const y = plot.valToPos(limit, "y", true);
      ctx.beginPath();
      ctx.moveTo(bbox.left, y);
      ctx.lineTo(bbox.left + bbox.width, y);
      ctx.stroke();
    }
    ctx.restore();
  }

  dispose() {
    this.seen.disconnect();
    this.plot?.destroy();
  }
}
