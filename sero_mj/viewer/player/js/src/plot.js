/** The plot of a joint: commanded and measured torque, or its angle, along the time line. */

import uPlot from "uplot";
import { VALUE_AXIS, namesOf, timeAxis } from "./graph.js";

/** @typedef {import("./data.js").Run} Run */

/** @param {string} name */
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

const WORDS = { torques: "measured", commanded_torques: "commanded", joint_angles: "angle" };

const LEAST = 0.01; // of the largest value, and in its unit: what is shown of what hardly changes

/** The range of values in a plot, which does not enlarge their noise. @param {number} low @param {number} high */
function rangeOf(low, high) {
  const least = LEAST * Math.max(Math.abs(low), Math.abs(high), 1), more = Math.max(least - (high - low), 0) / 2;
  return uPlot.rangeNum(low - more, high + more, 0.1, true);
}

const LONGEST = 28; // characters of a file's name

/**
 * Names of files without the folders that all are in; of a long one both ends, in which names of runs differ.
 * @param {Record<string, string>} files @param {string} which @returns {string}
 */
export function shortName(files, which) {
  const paths = Object.values(files).map((file) => file.split(/[\\/]/)), half = LONGEST / 2;
  let parts = 1;
  while (parts < 9 && new Set(paths.map((path) => path.slice(-parts).join("/"))).size < paths.length) parts++;
  const name = files[which].split(/[\\/]/).slice(-parts).join("/");
  return name.length > LONGEST ? `${name.slice(0, half)}…${name.slice(1 - half)}` : name;
}

/**
 * How a line is called: as the joint's card says, with the file that is meant, else as the field does.
 * @param {Run} run @param {number} joint @param {keyof typeof WORDS} key
 * @returns {{name: string, tip?: string}}
 */
function nameOf({ joints, meanings }, joint, key) {
  const label = joints[joint].lines.find((line) => line.key === key && /^[A-Z]$/.test(line.label))?.label;
  if (!label || !meanings[label]) return { name: label ?? WORDS[key] };
  return { name: `${label}: ${shortName(meanings, label)}`, tip: meanings[label] };
}

/** A plot that is made anew for every joint and look. */
export class Plot {
  /**
   * @param {Run} run @param {HTMLElement} room @param {HTMLElement} names what is plotted
   * @param {(seconds: number) => void} onSeek
   */
  constructor(run, room, names, onSeek) {
    this.run = run;
    this.room = room;
    this.names = names;
    this.onSeek = onSeek;
    this.times = Float64Array.from({ length: run.frames }, (_, k) => run.begin + k / run.fps);
    /** @type {uPlot | null} */
    this.plot = null;
    this.joint = -1;
    this.now = 0;
    this.drawn = NaN;
  }

  #size() {
    return { width: this.room.clientWidth, height: Math.max(this.room.clientHeight, 40) };
  }

  /** Shows a joint. @param {number} joint */
  show(joint) {
    const { run } = this, { frames, values } = run;
    this.plot?.destroy();
    this.plot = null;
    this.joint = joint;
    this.room.hidden = this.names.hidden = joint < 0 || frames < 2;
    if (this.room.hidden) return;
    const keys = ["torques", "commanded_torques"].filter((key) =>
      values[key]?.subarray(joint * frames, (joint + 1) * frames).some(Number.isFinite));
    if (!keys.length && values.joint_angles) keys.push("joint_angles");
    const { name, torqueLabel, torqueFactor, angleUnit } = run.joints[joint];
    const isAngle = keys[0] === "joint_angles", factor = isAngle ? 1 : torqueFactor;
    const what = isAngle ? `angle [${angleUnit}]` : torqueLabel;
    const looks = keys.map((key) => {
      const isDashed = key === "commanded_torques";
      return { isDashed, colour: css(isDashed ? "--positive" : "--negative"),
        ...nameOf(run, joint, /** @type {keyof typeof WORDS} */ (key)) };
    });
    // A before B, whichever was measured.
    const isNamed = looks.every(({ tip }) => tip), inOrder = [...looks].sort((a, b) => isNamed ? a.name.localeCompare(b.name) : 0);
    this.names.replaceChildren(...namesOf(what, inOrder));
    const lines = keys.map((key) => Array.from(
      values[key].subarray(joint * frames, (joint + 1) * frames),
      (value) => Number.isFinite(value) ? factor * value : null));
    const axis = { stroke: css("--dim"), grid: { stroke: css("--edge"), width: 1 },
      ticks: { stroke: css("--edge"), width: 1 } };
    this.plot = new uPlot({
      ...this.#size(),
      cursor: { y: false, drag: { x: false, y: false } },
      scales: { x: { time: false }, y: { range: (_, low, high) => rangeOf(low ?? 0, high ?? 0) } },
      legend: { show: false },
      padding: [8, 8, 0, 0],
      axes: [{ ...axis, size: 26, ...timeAxis("s") }, { ...axis, ...VALUE_AXIS }],
      series: [{}, ...looks.map(({ colour, isDashed }) => ({ stroke: colour, points: { show: false },
        ...isDashed ? { width: 1.5, dash: [6, 4] } : { width: 2 } }))],
      hooks: { draw: [(plot) => this.#drawTime(plot)] },
    }, /** @type {uPlot.AlignedData} */ (/** @type {unknown} */ ([this.times, ...lines])), this.room);
    const { over } = this.plot;
    /** @param {PointerEvent} event */
    const seek = (event) => {
      if (!event.buttons || !this.plot) return;
      const { left } = over.getBoundingClientRect();
      this.onSeek(this.plot.posToVal(event.clientX - left, "x") - this.run.begin);
    };
    over.addEventListener("pointerdown", (event) => {
      over.setPointerCapture(event.pointerId);
      seek(event);
    });
    over.addEventListener("pointermove", seek);
    this.room.setAttribute("aria-label", `${name}, ${what}: ${looks.map((look) => look.name).join(" and ")}`);
  }

  /** @param {uPlot} plot */
  #drawTime(plot) {
    const x = plot.valToPos(this.run.begin + this.now, "x", true), { ctx, bbox } = plot;
    ctx.save();
    ctx.strokeStyle = css("--ink");
    ctx.lineWidth = devicePixelRatio;
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
    ctx.restore();
  }

  /** Moves the line of the time. @param {number} seconds since the start */
  setTime(seconds) {
    this.now = seconds;
    if (!this.plot || Math.abs(this.drawn - seconds) < 1e-9) return;
    this.drawn = seconds;
    this.plot.redraw(false, false);
  }

  /** Fits the room. */
  resize() {
    this.plot?.setSize(this.#size());
  }
}
