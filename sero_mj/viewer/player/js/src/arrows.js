/** The arrows of joints: round arrows about axes, and straight arrows along axes. */

import * as THREE from "three";
import { ARROW } from "./geoms.js";

/** @typedef {import("./data.js").Run} Run */

/**
 * Returns the width of an arrow in m, or 0 if it is too small to be visible. See `arrow_widths` in Python.
 * @param {import("./data.js").Arrow} arrow @param {number} value @param {number} invisible @param {number} full width at the limit, radii
 */
export function widthOf(arrow, value, invisible, full) {
  const size = Number.isFinite(value) ? Math.abs(value) : 0;
  let width = size * arrow.scale;
  if (arrow.limit !== null) {
    const share = size / arrow.limit, band = Math.max(arrow.band, 1e-9);
    const grown = Math.min(Math.max(share / band - 1, 0), 1);
    width = full * arrow.radius * (arrow.scale / 0.01) * Math.sqrt(share) * grown;
  }
  width = Math.min(width, arrow.widest * arrow.radius);
  return width > invisible * arrow.radius ? width : 0;
}

const centre = new THREE.Vector3(), along = new THREE.Vector3(), turn = new THREE.Quaternion();
const one = new THREE.Vector3(), BACK = new THREE.Quaternion(1, 0, 0, 0); // rotation by 180 degrees about x
const phased = new THREE.Quaternion(), UP = new THREE.Vector3(0, 0, 1);

/**
 * Adds a geom with the pose in `centre` and `turn`.
 * @param {import("./geoms.js").Geoms} to @param {number} joint @param {number} type
 * @param {number[]} size @param {number[]} rgb @param {number} opacity
 */
function put(to, joint, type, size, rgb, opacity) {
  const i = to.add(ARROW, joint, type);
  to.positions.set(centre.toArray(), 3 * i);
  to.rotations.set([turn.w, turn.x, turn.y, turn.z], 4 * i);
  to.sizes.set(size, 3 * i);
  to.rgba.set([...rgb, opacity].map((each) => Math.round(255 * each)), 4 * i);
}

/**
 * Adds the arrows of joints, as `draw_round` and `draw_straight` in Python do.
 * @param {Run} run @param {number} at frame, with a fraction
 * @param {THREE.Matrix4[]} sites of all joints
 * @param {(joint: number) => boolean} isOn @param {import("./geoms.js").Geoms} to
 */
export function addArrows(run, at, sites, isOn, to) {
  const { arrows, frames, greyRgb } = run, frame = Math.round(at);
  run.joints.forEach(({ arrow }, j) => {
    if (!isOn(j)) return;
    const value = arrows.values ? arrows.values[j * frames + frame] : NaN;
    const width = widthOf(arrow, value, arrows.invisible, arrows.full);
    if (!width) return;
    const isStale = arrows.stale[j * frames + frame] > 0.5;
    const rgb = isStale ? greyRgb : value > 0 ? arrows.positive : arrows.negative;
    const isOver = arrow.limit !== null && Math.abs(value) > arrow.limit;
    sites[j].decompose(centre, turn, one);
    if (arrow.round) addRound(run, at, j, value, width, isOver, rgb, to);
    else addStraight(run, j, value, width, isOver, rgb, to);
  });
}

/**
 * @param {Run} run @param {number} at @param {number} joint @param {number} value @param {number} width
 * @param {boolean} isOver @param {number[]} rgb @param {import("./geoms.js").Geoms} to
 */
function addRound(run, at, joint, value, width, isOver, rgb, to) {
  const { arrows, frames } = run, { ratios, shapes } = arrows, { radius, opacity } = run.joints[joint].arrow;
  const angle = run.values.joint_angles?.[joint * frames + Math.round(at)] || 0;
  const phase = arrows.speed * (run.begin + at / run.fps) - angle * Math.sign(value);
  if (value < 0) turn.multiply(BACK);
  turn.multiply(phased.setFromAxisAngle(UP, phase));
  const last = ratios.length - 1, step = Math.log(ratios[last] / ratios[0]) / last;
  const k = Math.min(Math.max(Math.round(Math.log(width / radius / ratios[0]) / step), 0), last);
  const size = [radius, radius, width / ratios[k]];
  put(to, joint, shapes.first + k, size, rgb, opacity);
  if (isOver) put(to, joint, shapes.first + ratios.length + k, size, arrows.stripe, opacity);
}

/**
 * @param {Run} run @param {number} joint @param {number} value @param {number} width
 * @param {boolean} isOver @param {number[]} rgb @param {import("./geoms.js").Geoms} to
 */
function addStraight(run, joint, value, width, isOver, rgb, to) {
  const { arrows } = run, { straight } = arrows, { radius, opacity } = run.joints[joint].arrow;
  const length = straight.length * radius, head = Math.min(straight.headLength * width, straight.longestHead * length);
  const shown = isOver ? rgb.map((each) => straight.darker * each) : rgb;
  centre.add(along.set(radius, 0, 0).applyQuaternion(turn));
  if (value < 0) turn.multiply(BACK);
  centre.add(along.set(0, 0, -length / 2).applyQuaternion(turn));
  put(to, joint, straight.shaft, [width, width, length - (1 - straight.barbs) * head], shown, opacity);
  centre.add(along.set(0, 0, length - head).applyQuaternion(turn));
  put(to, joint, straight.head, [straight.headWidth * width, straight.headWidth * width, head], shown, opacity);
}
