/** The plots of a mark with evidence: residuals over time, and over the quantity that explains them. */

import { rangeOf } from "./torque_plot.js";

/** @typedef {import("./data.js").Run} Run */
/** @typedef {import("./data.js").MarkPlot} MarkPlot */
/** @typedef {import("./graph.js").Content} Content */

const BEFORE = [0.62, 0.65, 0.68], AFTER = [0.45, 0.78, 1], FIT = [0.85, 0.53, 0.87];
const HEIGHT = 10; // height of the plots, in text heights

/** Returns the pairs of known values in ascending order of x. @param {(number | null)[]} x @param {(number | null)[]} y */
function inOrder(x, y) {
  /** @type {[number, number][]} */
  const pairs = [];
  x.forEach((each, k) => {
    const other = y[k];
    if (each !== null && other !== null) pairs.push([each, other]);
  });
  return pairs.sort((a, b) => a[0] - b[0]);
}

/** Returns the plots of a mark, as nodes without the marker. @param {Run} run @param {MarkPlot} plot @returns {[Content, Content]} */
export function evidencePlots(run, { label, times, before, after, quantity, unit, values, fit }) {
  const seconds = times.map((time) => run.begin + time), yRange = rangeOf([...before, ...after]);
  const common = { yRange, limits: [], height: HEIGHT };
  const overTime = { ...common, x: "s", y: label, xRange: /** @type {[number, number]} */ ([run.begin, seconds[seconds.length - 1]]),
    lines: [{ name: "before", rgb: BEFORE, x: seconds, y: before }, { name: "after", rgb: AFTER, x: seconds, y: after }] };
  const points = /** @type {const} */ ([["before", BEFORE, before], ["after", AFTER, after]]).map(([name, rgb, y]) => {
    const pairs = inOrder(values, y);
    return { name, rgb, isPoints: true, x: pairs.map(([each]) => each), y: pairs.map(([, each]) => each) };
  });
  const curve = { name: "fit", rgb: FIT, x: fit.map(([each]) => each), y: fit.map(([, each]) => each) };
  const overQuantity = { ...common, x: unit, y: quantity, xRange: rangeOf(values, 0), lines: [...points, curve] };
  return [overTime, overQuantity];
}
