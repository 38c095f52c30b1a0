/** Detects whether the pointer is on a drag handle. The tolerance is necessary because handles are thin. */

import * as THREE from "three";

const HANDLE = 8; // value of the Python enum `Kind`
const SPHERE = 2, ARROW = 100, ARROW2 = 102; // mjtGeom

const turn = new THREE.Quaternion(), along = new THREE.Vector3(), end = new THREE.Vector3();

/**
 * Computes the ends of the center line of a geom, and returns its radius in m.
 * @param {import("./geoms.js").Geoms} geoms @param {number} k
 * @param {THREE.Vector3} from @param {THREE.Vector3} to
 */
function lineOf({ of, positions, rotations, sizes }, k, from, to) {
  const type = of[3 * k + 2], size = [0, 1, 2].map((c) => sizes[3 * k + c]);
  turn.set(rotations[4 * k + 1], rotations[4 * k + 2], rotations[4 * k + 3], rotations[4 * k]);
  from.fromArray(positions, 3 * k);
  if (type === SPHERE) {
    to.copy(from);
    return size[0];
  }
  const isArrow = type >= ARROW && type <= ARROW2;
  const longest = isArrow ? 2 : size.indexOf(Math.max(...size));
  along.setComponent(longest, isArrow ? size[2] / 2 : size[longest]);
  along.setComponent((longest + 1) % 3, 0).setComponent((longest + 2) % 3, 0).applyQuaternion(turn);
  to.copy(from).add(along);
  if (!isArrow) from.sub(along);
  return Math.min(...size.filter((_, c) => c !== longest));
}

/** @typedef {{x: number, y: number}} Pixel */
/** Returns the distance in pixels of a point from the line segment between two points. @param {Pixel} at @param {Pixel} a @param {Pixel} b */
export function distanceTo(at, a, b) {
  const [x, y] = [b.x - a.x, b.y - a.y], length = x * x + y * y;
  const share = length ? Math.min(Math.max(((at.x - a.x) * x + (at.y - a.y) * y) / length, 0), 1) : 0;
  return Math.hypot(at.x - a.x - share * x, at.y - a.y - share * y);
}

/**
 * Returns whether a pixel is on a handle or close to it.
 * @param {import("./stage.js").Stage} stage @param {import("./geoms.js").Geoms} geoms
 * @param {Pixel} at @param {number} tolerance pixels
 */
export function isOnHandle(stage, geoms, at, tolerance) {
  const from = new THREE.Vector3(), to = new THREE.Vector3();
  const perMetre = stage.size.height / (2 * Math.tan(stage.camera.fov / 360 * Math.PI)); // at a distance of 1 m
  for (let k = 0; k < geoms.count; k++) {
    if (geoms.of[3 * k] !== HANDLE) continue;
    const radius = lineOf(geoms, k, from, to), away = end.copy(from).distanceTo(stage.camera.position);
    const [a, b] = [stage.pixel(from), stage.pixel(to)];
    if (!a.isSeen || !b.isSeen) continue;
    if (distanceTo(at, a, b) < tolerance + radius * perMetre / Math.max(away, 1e-3)) return true;
  }
  return false;
}
