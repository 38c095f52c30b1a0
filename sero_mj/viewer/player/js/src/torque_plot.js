/** The plot of a joint of a recorded run, with commanded and measured torque, or with the angle. */

import uPlot from "uplot";

/** @typedef {import("./data.js").Run} Run */
/** @typedef {import("./graph.js").Content} Content */

const WORDS = { torques: "measured", commanded_torques: "commanded", joint_angles: "angle" };
// Torque plots of live pages have the same colors, see `torque_plots.py`.
const RGB = { torques: [0.45, 0.78, 1], commanded_torques: [1, 0.62, 0.18], joint_angles: [0.45, 0.78, 1] };
const HEIGHT = 10; // height of the plot, in text heights
const MIN_RANGE = 0.01; // minimum range, relative to the largest value and also in the unit of the plot
const MAX_NAME = 28; // maximum number of characters of a file name

/**
 * Returns the range of a plot for values, with a minimum so that noise is not enlarged.
 * @param {(number | null)[]} values @param {number} [least] minimum of the range @returns {[number, number]}
 */
export function rangeOf(values, least = MIN_RANGE) {
  let [low, high] = [Infinity, -Infinity];
  for (const each of values) if (each !== null) [low, high] = [Math.min(low, each), Math.max(high, each)];
  if (low > high) return [-1, 1];
  const minimum = least * Math.max(Math.abs(low), Math.abs(high), 1), more = Math.max(minimum - (high - low), 0) / 2;
  return /** @type {[number, number]} */ (uPlot.rangeNum(low - more, high + more, 0.1, true));
}

/**
 * Returns a file name without the folders that all files share. The middle of a long name is cut.
 * @param {Record<string, string>} files @param {string} which @returns {string}
 */
export function shortName(files, which) {
  const paths = Object.values(files).map((file) => file.split(/[\\/]/)), half = MAX_NAME / 2;
  let parts = 1;
  while (parts < 9 && new Set(paths.map((path) => path.slice(-parts).join("/"))).size < paths.length) parts++;
  const name = files[which].split(/[\\/]/).slice(-parts).join("/");
  return name.length > MAX_NAME ? `${name.slice(0, half)}…${name.slice(1 - half)}` : name;
}

/**
 * Returns the name of a line, which is the label on the joint's billboard with its file, or the quantity.
 * @param {Run} run @param {number} joint @param {keyof typeof WORDS} key @returns {{name: string, tip?: string}}
 */
function nameOf({ joints, meanings }, joint, key) {
  const label = joints[joint].lines.find((line) => line.key === key && /^[A-Z]$/.test(line.label))?.label;
  if (!label || !meanings[label]) return { name: label ?? WORDS[key] };
  return { name: `${label}: ${shortName(meanings, label)}`, tip: meanings[label] };
}

/** Returns the plot of a joint, as a node without the marker. @param {Run} run @param {number} joint @returns {Content} */
export function torquePlot(run, joint) {
  const { frames, values, begin, fps } = run;
  /** @param {string} key */
  const own = (key) => values[key]?.subarray(joint * frames, (joint + 1) * frames) ?? [];
  /** @type {(keyof typeof WORDS)[]} */
  const keys = [];
  for (const key of /** @type {const} */ (["torques", "commanded_torques"])) if (own(key).some(Number.isFinite)) keys.push(key);
  if (!keys.length && values.joint_angles) keys.push("joint_angles");
  const { torqueLabel, torqueFactor, angleUnit } = run.joints[joint], isAngle = keys[0] === "joint_angles";
  const x = Array.from({ length: frames }, (_, k) => begin + k / fps);
  const lines = keys.map((key) => ({
    ...nameOf(run, joint, key), rgb: RGB[key], isDashed: key === "commanded_torques", x,
    y: Array.from(own(key), (value) => Number.isFinite(value) ? (isAngle ? 1 : torqueFactor) * value : null),
  }));
  // A must be before B, independent of which one was measured.
  if (lines.every(({ tip }) => tip)) lines.sort((a, b) => a.name.localeCompare(b.name));
  return { x: "s", y: isAngle ? `angle [${angleUnit}]` : torqueLabel, xRange: [begin, x[frames - 1]],
    yRange: rangeOf(lines.flatMap(({ y }) => y)), limits: [], height: HEIGHT, lines };
}
