import assert from "node:assert/strict";
import { test } from "node:test";
import * as THREE from "three";
import { placeOf, standingBack, viewFrom } from "../src/eye.js";
import { Geoms } from "../src/geoms.js";
import { dataOf } from "../src/graph.js";
import { distanceTo } from "../src/handles.js";
import { Items } from "../src/items.js";
import { stepsOf } from "../src/input.js";
import { isTakenBy, nameOf } from "../src/keys.js";
import { clearOf } from "../src/labels.js";
import { keysOf, linesOf } from "../src/panels.js";
import { Reader, fill, readSections } from "../src/sections.js";
import { State } from "../src/state.js";
import { shortName } from "../src/torque_plot.js";
import { gapFor, ticksAt } from "../src/ticks.js";
import { Held, rounded, stepOf } from "../src/widgets.js";

/** @param {ArrayBufferView} array */
const bytesOf = (array) => new Uint8Array(array.buffer, array.byteOffset, array.byteLength);

/** @param {Uint8Array[]} parts */
const joined = (...parts) => Uint8Array.from(parts.flatMap((part) => [...part]));

/** Returns a message with a head, which may be invalid. @param {string} head @param {Uint8Array} [payload] */
function message(head, payload = new Uint8Array()) {
  const text = new TextEncoder().encode(head.padEnd(Math.ceil(head.length / 4) * 4));
  return joined(bytesOf(new Uint32Array([text.length])), text, payload).buffer;
}

/** Returns the bytes of a run with one frame, one body and one joint. */
function run() {
  const empty = [0, "u1", 0];
  const head = {
    version: 1, fps: 1, begin: 0, frames: 1, steps: [1, 1], positions: [0, "u1", 3], rotations: [1, "u1", 4],
    opacity: [2, "u1", 1], grey: [2, "u1", 1], bodies: [{ name: "link", joint: 0, double: -1 }], meshes: [],
    geoms: [], joints: [{ torqueLimit: 5, arrow: { on: true, radius: 0.1 } }], values: {},
    arrows: { shapes: NONE, stale: [2, "u1", 1], values: null }, items: { of: [] }, notes: { texts: [""], at: empty },
    legend: { texts: [[]], at: empty },
    cards: [], lengths: [3, 4, 1],
  };
  const text = new TextEncoder().encode(JSON.stringify(head));
  return joined(bytesOf(new Uint32Array([text.length])), text, new Uint8Array([2, 4, 6, 2, 0, 0, 0, 0]));
}

const NONE = { first: 0, step: 1, groups: [] }; // meshes of arrows

test("sections are read, with payloads aligned to four bytes", () => {
  const head = '{"json": {"time": 1.5, "hover": null}, "bytes": [["stale", 3], ["grey", 1]]}';
  const { json, bytes } = readSections(message(head, new Uint8Array([1, 2, 3, 0, 9])));
  assert.deepEqual([...json], [["time", 1.5], ["hover", null]]);
  assert.deepEqual([...bytes].map(([name, each]) => [name, ...each]), [["stale", 1, 2, 3], ["grey", 9]]);
});

test("messages with wrong lengths are rejected", () => {
  for (const bytes of ["[[\"a\", 5]]", "[[\"a\", -1]]", "[[\"a\", 1e300]]", "[[\"a\", 0.5]]", "[[\"a\"]]", "[7]", "[null]",
    "[[\"a\", 4], [\"b\", 1]]", "{}", `[${Array(300).fill('["a", 0]').join()}]`]) {
    assert.throws(() => readSections(message(`{"bytes": ${bytes}}`, new Uint8Array(4))), Error, bytes);
  }
  assert.throws(() => readSections(new ArrayBuffer(3)), /3 bytes/);
  assert.throws(() => readSections(new Uint32Array([2 ** 32 - 1, 0]).buffer), /head/);
  assert.throws(() => readSections(message("[]")), /tables/);
  assert.throws(() => readSections(message("{")), SyntaxError);
  assert.throws(() => fill(new Uint8Array(7), new Float32Array(2)), /7 bytes, expected 8/);
});

test("counts above the number of following bytes are rejected", () => {
  assert.equal(new Reader(bytesOf(new Uint32Array([2, 1, 1]))).count(4), 2);
  assert.throws(() => new Reader(bytesOf(new Uint32Array([2 ** 31, 1, 1]))).count(60), /found 2147483648/);
  assert.throws(() => new Reader(new Uint8Array(2)).count(4), /expected 4/);
});

test("a state writes received sections to its run", () => {
  const state = new State(run()), { run: shown } = state;
  assert.deepEqual([...shown.positions], [1, 2, 3]);
  const poses = joined(bytesOf(new Float32Array([4, 5, 6])), bytesOf(new Int16Array([0, 16384, 0, -8192])));
  const { positions } = shown;
  assert.ok(state.take("poses", poses));
  assert.equal(shown.positions, positions);
  assert.deepEqual([...positions], [4, 5, 6]);
  assert.deepEqual([...shown.rotations], [0, 1, 0, -0.5]);
  state.takeJson("valueKeys", ["joint_angles"]);
  // Numbers with eight bytes may begin at any multiple of four.
  const values = joined(new Uint8Array(4), bytesOf(new Float64Array([0.25]))).subarray(4);
  assert.ok(state.take("values", values) && state.take("arrowValues", values));
  assert.equal(shown.values.joint_angles[0], 0.25);
  assert.equal(shown.arrows.values?.[0], 0.25);
  state.take("opacity", new Uint8Array([51]));
  assert.ok(Math.abs(shown.opacity[0] - 0.2) < 1e-6);
  state.takeJson("arrowLook", [{ radius: 0.3 }]);
  assert.deepEqual([shown.joints[0].arrow.radius, shown.joints[0].arrow.on], [0.3, true]);
  assert.equal(state.take("of another version", new Uint8Array()), false);
  assert.throws(() => state.take("poses", poses.subarray(1)), /expected/);
  assert.throws(() => state.take("items", bytesOf(new Uint32Array([9]))), /found 9/);
});

test("camera parameters and positions are converted in both directions", () => {
  const view = { lookAt: [1, -2, 0.5], distance: 3, azimuth: 130, elevation: -25 };
  const found = viewFrom(placeOf(view), view.lookAt);
  for (const key of /** @type {const} */ (["distance", "azimuth", "elevation"])) assert.ok(Math.abs(found[key] - view[key]) < 1e-9);
  assert.deepEqual(placeOf({ lookAt: [0, 0, 0], distance: 2, azimuth: 0, elevation: 0 }).map((each) => each + 0), [-2, 0, 0]);
  assert.equal(standingBack(1.2, 1280, 800), 1);
  assert.equal(standingBack(1, 400, 800), 2);
});

test("keys have the names of the server, and keys of the browser have no name", () => {
  const press = (/** @type {string} */ key, more = {}) =>
    nameOf({ key, ctrlKey: false, metaKey: false, altKey: false, shiftKey: false, ...more });
  assert.deepEqual(["ArrowLeft", "A", "?", " ", "F2", "Backspace", "+"].map((key) => press(key)),
    ["left", "a", "?", " ", "f2", "backspace", "+"]);
  assert.deepEqual(["F5", "Tab", "F11", "F12", "Shift", "PageDown"].map((key) => press(key)), Array(6).fill(""));
  assert.deepEqual(["z", "y", "r", "t", "f", "+"].map((key) => press(key, { ctrlKey: true })),
    ["ctrl+z", "ctrl+y", "", "", "", ""]);
  assert.equal(press("Z", { metaKey: true, shiftKey: true }), "ctrl+y");
  assert.equal(press("[", { ctrlKey: true, altKey: true }), "["); // Some keyboards need AltGr for brackets.
  assert.equal(press("ArrowLeft", { altKey: true }), "");
});

test("text fields handle all keys, and buttons and sliders some keys", () => {
  assert.ok(isTakenBy({ tagName: "INPUT", type: "text" }, "a") && isTakenBy({ tagName: "TEXTAREA" }, "z"));
  assert.ok(isTakenBy({ tagName: "SELECT" }, "a") && isTakenBy({ tagName: "BUTTON" }, " "));
  assert.ok(isTakenBy({ tagName: "INPUT", type: "range" }, "ArrowLeft"));
  assert.ok(!isTakenBy({ tagName: "INPUT", type: "range" }, "a") && !isTakenBy({ tagName: "BUTTON" }, "a"));
  assert.ok(!isTakenBy({ tagName: "INPUT", type: "checkbox" }, "ArrowLeft") && !isTakenBy({ tagName: "CANVAS" }, " "));
});

test("nodes are identified by their ids, text by its number, and lines by adjacent nodes", () => {
  const nodes = [{ k: "text", s: "a" }, { k: "button", id: "b" }, { k: "text", s: "c", same: -1 }, { k: "check", id: "b" }];
  assert.deepEqual(keysOf(nodes), ["text#1", "button:b", "text#2", "check:b"]);
  assert.deepEqual(linesOf(nodes), [[0], [1, 2], [3]]);
  assert.deepEqual(linesOf([{ k: "text", same: 0 }]), [[0]]);
});

test("a value set by the user is shown until the server confirms it, or for a limited time", (context) => {
  let now = 0;
  context.mock.method(performance, "now", () => now);
  const held = new Held();
  assert.equal(held.shown(1), 1);
  held.set(2);
  assert.equal(held.shown(1), 2);
  assert.equal(held.shown(2), 2);
  assert.equal(held.shown(1), 1);
  held.set(3);
  now = 1500;
  assert.equal(held.shown(1), 1);
  held.isHeld = true;
  held.set(4);
  now = 9000;
  assert.equal(held.shown(1), 4);
  held.isHeld = false;
  assert.equal(held.shown(1), 1);
});

test("lines of a plot with the same x coordinates share them", () => {
  const line = { name: "", rgb: [0, 0, 0] };
  const [a, b] = [{ ...line, x: [0, 1, 2], y: [1, null, 3] }, { ...line, x: [0, 1, 2], y: [4, 5, 6] }];
  assert.deepEqual(dataOf([a, b]), [[0, 1, 2], [1, null, 3], [4, 5, 6]]);
  const data = dataOf([a, { ...line, x: [0.5, 2], y: [7, 8] }]);
  assert.deepEqual(data[0], [0, 0.5, 1, 2]);
  assert.equal(data[1][2], null); // A gap remains a gap.
});

test("the distance of a pixel from a segment is right beside it and beyond its ends", () => {
  const [a, b] = [{ x: 0, y: 0 }, { x: 10, y: 0 }];
  assert.equal(distanceTo({ x: 5, y: 3 }, a, b), 3);
  assert.equal(distanceTo({ x: 13, y: 4 }, a, b), 5);
  assert.equal(distanceTo({ x: 3, y: 4 }, a, a), 5);
});

test("any number of opaque and transparent overlays is drawn, and can be picked", () => {
  const geoms = new Geoms(), items = new Items({ first: 1 << 20, meshes: [] });
  const put = (/** @type {number} */ count) => {
    geoms.resize(count);
    for (let k = 0; k < count; k++) {
      geoms.of.set([8, k, 2], 3 * k); // spheres
      geoms.positions.set([k, 0, 0], 3 * k);
      geoms.rotations.set([1, 0, 0, 0], 4 * k);
      geoms.sizes.set([0.1, 0.1, 0.1], 3 * k);
      geoms.rgba.set([255, 0, 0, k % 2 ? 255 : 100], 4 * k);
    }
    items.place(geoms);
    return items.group.children.map((each) => /** @type {THREE.InstancedMesh} */ (each).count);
  };
  assert.deepEqual(put(3).sort(), [1, 2]);
  assert.deepEqual(put(90), [45, 45]);
  const ray = new THREE.Raycaster(new THREE.Vector3(71, 0, 5), new THREE.Vector3(0, 0, -1));
  assert.deepEqual(items.pick(ray)?.of, [8, 71, 2]);
  assert.deepEqual(put(0), [0, 0]);
  assert.equal(items.pick(ray), null);
});

test("a wheel notch counts once on every screen and at every zoom of the page", () => {
  for (const ratio of [0.5, 1, 2]) assert.equal(stepsOf({ deltaMode: 0, deltaY: 100 / ratio }, ratio), -1);
  assert.equal(stepsOf({ deltaMode: 1, deltaY: -3 }, 2), 1);
});

test("labels at the same position are placed below each other if there is space", () => {
  /** @type {[number, number, number][]} */
  const taken = [];
  const at = (/** @type {number} */ x, /** @type {number} */ y) => clearOf(x, y, "lwr/A1", taken);
  assert.deepEqual([at(100, 50), at(100, 50), at(104, 50), at(300, 50), at(100, 20)], [50, 68, 86, 50, 20]);
  assert.deepEqual([at(100, 50), at(100, 50)], [104, null]);
});

test("a slider steps by 1, 2 or 5 times a power of ten, to round values", () => {
  const steps = [[0, 1], [-170, 170], [0, 2000], [0, 5.9341], [-1e-3, 1e-3], [3, 3]]
    .map(([low, high]) => Number(stepOf(low, high).toPrecision(9)));
  assert.deepEqual(steps, [0.01, 2, 20, 0.05, 0.00002, 1]);
  let value = 0.123456;
  for (let k = 0; k < 100; k++) value = rounded(value + 0.01, 0.01);
  assert.equal(value, 1.12);
  assert.deepEqual([rounded(0.99999, 0.001), rounded(-31.3, 2), rounded(1234.5, 20)], [1, -32, 1240]);
});

test("the text of the nearest marks is shown near their time", () => {
  const tick = (/** @type {number} */ begin, /** @type {string} */ text, end = begin, label = "") =>
    ({ begin, end, text, kind: "finding", label });
  const ticks = [tick(1, "a"), tick(1.02, "b"), tick(1.02, "c"), tick(4, "d", 9), tick(4.5, "e", 9, "e")];
  const shown = (/** @type {number} */ at) => ticksAt(ticks, at, 10).map(({ text }) => text).join("");
  const times = [0.8, 0.95, 1.009, 1.5, 1.6, 4, 4.6, 7];
  assert.deepEqual(times.map(shown), ["", "a", "a", "bc", "", "d", "e", "d"]);
});

test("a label is placed in a gap between marks, or in the longest gap", () => {
  assert.deepEqual(gapFor(30, [0, 10, 50, 100]), [10, 37]);
  assert.deepEqual(gapFor(30, [0, 100]), [0, 97]);
  assert.deepEqual(gapFor(60, [0, 10, 50, 100]), [50, 47]);
});

test("short names of different files differ", () => {
  assert.equal(shortName({ A: "out/a.mcap", B: "out/b.mcap" }, "A"), "a.mcap");
  assert.equal(shortName({ A: "out/first/run.mcap", B: "out/second/run.mcap" }, "B"), "second/run.mcap");
  assert.equal(shortName({ A: "run.mcap", B: "run.mcap" }, "B"), "run.mcap");
  const [a, b] = [1, 2].map((k) => `lwr_impedance_push_2026-11-25_14-19-4${k}.mcap`);
  assert.deepEqual([shortName({ A: a, B: b }, "A"), shortName({ A: a, B: b }, "B")],
    ["lwr_impedance_…14-19-41.mcap", "lwr_impedance_…14-19-42.mcap"]);
});
