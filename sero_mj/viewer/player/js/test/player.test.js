import assert from "node:assert/strict";
import { test } from "node:test";
import { widthOf } from "../src/arrows.js";
import { Clock } from "../src/clock.js";
import { evidencePlots } from "../src/evidence_plot.js";
import { digitsOf } from "../src/graph.js";
import { decode, fixed, normalOf, textOf, unfold, valueOf } from "../src/data.js";
import { stacked } from "../src/layout.js";

const LINE = { title: "A1", label: "", key: "torques", scale: 1, decimals: 1, unit: "Nm" };
const ARROW = {
  on: true, round: true, radius: 0.1, opacity: 1, scale: 0.01, band: 0.01, limit: 100, widest: 1.5,
};

const NONE = { first: 0, step: 1, groups: [] }; // meshes of arrows

test("signs in the lowest bit are decoded", () => {
  assert.deepEqual([0, 1, 2, 3, 4].map(unfold), [0, -1, 1, -2, 2]);
});

test("numbers of an axis have as many digits as its steps", () => {
  assert.deepEqual([1e-7, 1e-4, 0.25, 0.1, 1, 50, 2.5].map(digitsOf), [7, 4, 2, 1, 0, 0, 1]);
});

test("evidence is plotted over time, and over its quantity in ascending order", () => {
  const plot = { joint: "a/A1", notes: [], label: "A1 [Nm]", times: [0, 1, 2], before: [3, null, 1], after: [0, null, 0.5],
    quantity: "over angle [deg]", unit: "deg", values: [5, 4, -5], fit: /** @type {[number, number][]} */ ([[-5, 1], [5, 3]]) };
  const [overTime, overQuantity] = evidencePlots(/** @type {any} */ ({ begin: 10 }), plot);
  assert.deepEqual(overTime.xRange, [10, 12]);
  assert.deepEqual(overTime.lines.map(({ x, y }) => [x, y]), [[[10, 11, 12], [3, null, 1]], [[10, 11, 12], [0, null, 0.5]]]);
  assert.deepEqual(overQuantity.lines.map(({ x, y }) => [x, y]), [[[-5, 5], [1, 3]], [[-5, 5], [0.5, 0]], [[-5, 5], [1, 3]]]);
  assert.ok(overQuantity.xRange[0] < -5 && overQuantity.xRange[1] > 5);
  assert.deepEqual(overTime.yRange, overQuantity.yRange);
});

test("normals of all octants have unit length", () => {
  for (const [u, v] of [[0, 0], [127, 0], [-127, 127], [90, 90], [-30, -110]]) {
    assert.ok(Math.abs(Math.hypot(...normalOf(u, v)) - 1) < 1e-12);
  }
  assert.deepEqual(normalOf(127, 127).map(Math.round), [0, 0, -1]);
});

test("numbers are formatted as in Python", () => {
  assert.equal(textOf(LINE, -69.12), "-69.1 Nm");
  assert.equal(textOf(LINE, -0.04), "0.0 Nm");
  assert.equal(textOf({ ...LINE, scale: 1e6, unit: "uNm" }, -5e-6), "-5.0 uNm");
  const small = [-0.0004, -0, -0.0006];
  assert.deepEqual(small.map((each) => fixed(each, 3)), ["0.000", "0.000", "-0.001"]);
  assert.equal(textOf(LINE, NaN), "no data");
  assert.equal(textOf({ ...LINE, key: "torque_limit" }, Infinity), "none");
});

test("arrow widths grow with the square root of the value, between dead band and maximum", () => {
  assert.equal(widthOf(ARROW, 1, 0.03, 1), 0);
  assert.ok(Math.abs(widthOf(ARROW, 100, 0.03, 1) - 0.1) < 1e-12);
  assert.ok(Math.abs(widthOf(ARROW, -25, 0.03, 1) - 0.05) < 1e-12);
  assert.ok(Math.abs(widthOf(ARROW, 1e6, 0.03, 1) - 0.15) < 1e-12);
  assert.equal(widthOf(ARROW, NaN, 0.03, 1), 0);
});

test("boxes do not overlap, stay in their column, and have their preferred positions if possible", () => {
  assert.deepEqual(stacked([50, 200], [20, 20], 6, 0, 300), [50, 200]);
  assert.deepEqual(stacked([100, 100], [20, 20], 6, 0, 300), [87, 113]);
  const middles = stacked([280, 290, 295], [20, 60, 20], 6, 0, 300);
  assert.ok(middles[1] - middles[0] >= 46 && middles[2] - middles[1] >= 46 && middles[2] <= 290);
});

test("a clock loops, steps, and ends", () => {
  const clock = new Clock(11, 10);
  clock.toggle();
  clock.advance(1.25);
  assert.equal(clock.frame, 3);
  clock.step(-1);
  assert.deepEqual([clock.frame, clock.isPlaying], [2, false]);
  clock.isLooping = false;
  clock.toggle();
  clock.advance(5);
  assert.deepEqual([clock.time, clock.isPlaying], [1, false]);
});

test("a head and its arrays are decoded, with one channel after the other", () => {
  const arrays = [
    [2, 0, 0, 1], // two channels with two frames: 1, 1 and 0, -1
    new Uint8Array(new Float64Array([1.5, -2.5]).buffer),
  ];
  const planes = [];
  for (let k = 0; k < 8; k++) for (const i of [0, 1]) planes.push(arrays[1][8 * i + k]);
  const empty = [0, "u1", 0], moving = [0, "u1", 4];
  const head = {
    version: 1, fps: 1, begin: 0, frames: 2, steps: [0.5, 1], positions: moving, rotations: empty,
    opacity: empty, grey: empty, meshes: [], geoms: [], joints: [{ torqueLimit: 5 }],
    values: { torques: [1, "f8", 2] }, arrows: { shapes: NONE, stale: empty, values: null }, items: { of: [] },
    notes: { texts: [""], at: empty }, legend: { texts: [[]], at: empty }, cards: [],
    lengths: [4, 16],
  };
  const text = new TextEncoder().encode(JSON.stringify(head));
  const bytes = new Uint8Array([...new Uint8Array(new Uint32Array([text.length]).buffer), ...text,
    ...arrays[0], ...planes]);
  const run = decode(bytes.buffer);
  assert.deepEqual([...run.positions], [0.5, 0.5, 0, -0.5]);
  assert.equal(valueOf(run, 0, "torques", 1), -2.5);
  assert.equal(valueOf(run, 0, "torque_share", 1), 50);
});
