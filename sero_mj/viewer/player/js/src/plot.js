/** The plot of a joint: commanded and measured torque, or its angle, along the time line. */

import uPlot from "uplot";

/** @typedef {import("./data.js").Run} Run */

/** @param {string} name */
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

const WORDS = { torques: "measured", commanded_torques: "commanded", joint_angles: "angle" };

/**
 * How a value of a joint is called: as its card says, else as the field does.
 * @param {Run} run @param {number} joint @param {keyof typeof WORDS} key
 */
export const wordFor = (run, joint, key) =>
  run.joints[joint].lines.find((line) => line.key === key && /^[A-Z]$/.test(line.label))?.label
  ?? WORDS[key];

/** A plot that is made anew for every joint and look. */
export class Plot {
  /**
   * @param {Run} run @param {HTMLElement} room @param {(seconds: number) => void} onSeek
   */
  constructor(run, room, onSeek) {
    this.run = run;
    this.room = room;
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
    this.room.hidden = joint < 0 || frames < 2;
    if (this.room.hidden) return;
    const keys = ["torques", "commanded_torques"].filter((key) =>
      values[key]?.subarray(joint * frames, (joint + 1) * frames).some(Number.isFinite));
    if (!keys.length && values.joint_angles) keys.push("joint_angles");
    const { unit, angleUnit } = run.joints[joint];
    /** @type {Record<string, uPlot.Series>} */
    const looks = {
      torques: { label: `${wordFor(run, joint, "torques")}, ${unit}`, stroke: css("--negative"), width: 2 },
      commanded_torques: { label: `${wordFor(run, joint, "commanded_torques")}, ${unit}`, stroke: css("--positive"), width: 1.5,
        dash: [6, 4] },
      joint_angles: { label: `angle, ${angleUnit}`, stroke: css("--negative"), width: 2 },
    };
    const lines = keys.map((key) => Array.from(
      values[key].subarray(joint * frames, (joint + 1) * frames),
      (value) => Number.isFinite(value) ? value : null));
    const axis = { stroke: css("--dim"), grid: { stroke: css("--edge"), width: 1 },
      ticks: { stroke: css("--edge"), width: 1 } };
    this.plot = new uPlot({
      ...this.#size(),
      cursor: { y: false, drag: { x: false, y: false } },
      scales: { x: { time: false } },
      legend: { show: false },
      padding: [8, 8, 0, 0],
      axes: [{ ...axis, size: 26 }, { ...axis, size: 50 }],
      series: [{}, ...keys.map((key) => ({ ...looks[key], points: { show: false } }))],
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
    this.room.setAttribute("aria-label", `${run.joints[joint].name}: `
      + keys.map((key) => String(looks[key].label)).join(" and "));
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
