/** The arrows of joints: round arrows, which a shader bends about axes, and straight arrows along axes. */

import * as THREE from "three";
import { ARROW } from "./geoms.js";

/** @typedef {import("./data.js").Run} Run */

/**
 * Returns the width of an arrow in m, or 0 if it is too small to be visible. See `arrow_widths` in Python.
 * @param {import("./data.js").Arrow} arrow @param {number} value @param {number} invisible
 */
export function widthOf(arrow, value, invisible) {
  const size = Number.isFinite(value) ? Math.abs(value) : 0;
  let width = size * arrow.scale;
  if (arrow.limit !== null) {
    const share = size / arrow.limit, band = Math.max(arrow.band, 1e-9);
    const grown = Math.min(Math.max(share / band - 1, 0), 1);
    width = arrow.radius * (arrow.scale / 0.01) * Math.sqrt(share) * grown;
  }
  width = Math.min(width, arrow.widest * arrow.radius);
  return width > invisible * arrow.radius ? width : 0;
}

/** Returns the boxes and heads of a ribbon, with positions along the arc. @param {any} shape */
function ribbon(shape) {
  /** @type {number[]} */
  const along = [];
  /** @type {number[]} */
  const across = [];
  /** @type {(angle: number, ahead: number, own: number, flare: number, out: number,
   *          side: number, dark: number) => void} */
  const corner = (angle, ahead, own, flare, out, side, dark) => {
    along.push(angle, ahead, own, flare);
    across.push(out, side, dark);
  };
  const faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
  shape.middle.forEach((/** @type {number} */ middle, /** @type {number} */ box) => {
    const half = 1.025 * Math.tan(shape.half_angle[box]);
    for (const [a, b, c, d] of faces) {
      for (const k of [a, b, c, a, c, d]) {
        const [ahead, out, side] = [k & 1 ? half : -half, k & 2 ? 1 : -1, k & 4 ? 1 : -1];
        corner(middle, ahead, 1, 0, out, side, shape.dark[box]);
      }
    }
  });
  shape.triangles.forEach((/** @type {number[]} */ triangle, /** @type {number} */ k) => {
    for (const each of triangle) {
      const ring = each >> 2, out = [1, 1, -1, -1][each & 3], side = [1, -1, -1, 1][each & 3];
      const dark = shape.dark[shape.middle.length + k];
      corner(shape.rings[ring], 0, shape.own[ring], shape.flare[ring], out, side, dark);
    }
  });
  const geometry = new THREE.BufferGeometry(), count = across.length / 3;
  const nothing = new Float32Array(3 * count).fill(0.5);
  geometry.setAttribute("position", new THREE.BufferAttribute(nothing, 3));
  geometry.setAttribute("normal", new THREE.BufferAttribute(nothing, 3));
  geometry.setAttribute("along", new THREE.BufferAttribute(new Float32Array(along), 4));
  geometry.setAttribute("across", new THREE.BufferAttribute(new Float32Array(across), 3));
  return geometry;
}

/** GLSL code for the position of a vertex in the joint's frame. A test compares it with geoms drawn by Python. */
const PLACE = `
  float r = how.x, w = how.y, turn = how.w, grown = min(w / (.14 * r), 1.);
  float wide = w * along.z + (.5 * w + .28 * r * grown) * along.w;
  float thick = r * max(.3 * grown * along.w, .05) * step(1e-6, along.z);
  float angle = turn * (how.z + along.x), far = r + .5 * thick * across.x;
  vec2 out2 = vec2(cos(angle), sin(angle));
  vec3 transformed = vec3(far * out2 + along.y * r * vec2(-out2.y, out2.x), .5 * wide * across.y);
  dark = across.z * striped;`;

const STRAIGHT = 100; // mjGEOM_ARROW, whose length is half of its size
const centre = new THREE.Vector3(), along = new THREE.Vector3(), turn = new THREE.Quaternion();
const one = new THREE.Vector3(), BACK = new THREE.Quaternion(1, 0, 0, 0); // rotation by 180 degrees about x

/**
 * Adds the arrows of prismatic joints, as `RoundArrows` in Python does.
 * @param {Run} run @param {number} at frame, with a fraction
 * @param {THREE.Matrix4[]} sites of all joints
 * @param {(joint: number) => boolean} isOn @param {import("./geoms.js").Geoms} to
 */
export function addStraight(run, at, sites, isOn, to) {
  const { arrows, frames, greyRgb } = run, frame = Math.round(at);
  run.joints.forEach(({ arrow }, j) => {
    if (arrow.round || !isOn(j)) return;
    const value = arrows.values ? arrows.values[j * frames + frame] : NaN;
    const width = widthOf(arrow, value, arrows.invisible), length = arrows.straight * arrow.radius;
    if (!width) return;
    sites[j].decompose(centre, turn, one);
    centre.add(along.set(arrow.radius, 0, 0).applyQuaternion(turn));
    if (value < 0) turn.multiply(BACK);
    centre.add(along.set(0, 0, -length / 2).applyQuaternion(turn));
    const i = to.add(ARROW, j, STRAIGHT), isStale = arrows.stale[j * frames + frame] > 0.5;
    const rgb = isStale ? greyRgb : value > 0 ? arrows.positive : arrows.negative;
    const bright = arrow.limit !== null && Math.abs(value) > arrow.limit ? arrows.darker : 1;
    to.positions.set(centre.toArray(), 3 * i);
    to.rotations.set([turn.w, turn.x, turn.y, turn.z], 4 * i);
    to.sizes.set([width / 4, width / 4, 2 * length], 3 * i);
    const rgba = [bright * rgb[0], bright * rgb[1], bright * rgb[2], arrow.opacity];
    to.rgba.set(rgba.map((each) => Math.round(255 * each)), 4 * i);
  });
}

/** The round arrows of all joints, as one mesh. */
export class RoundArrows {
  /** @param {Run} run */
  constructor(run) {
    this.run = run;
    this.joints = [...run.joints.keys()].filter((j) => run.joints[j].arrow.round);
    const count = this.joints.length, geometry = ribbon(run.arrows.shape);
    this.how = new THREE.InstancedBufferAttribute(new Float32Array(4 * count), 4);
    this.striped = new THREE.InstancedBufferAttribute(new Float32Array(count), 1);
    geometry.setAttribute("how", this.how);
    geometry.setAttribute("striped", this.striped);
    const material = new THREE.MeshBasicMaterial({ side: THREE.DoubleSide });
    material.onBeforeCompile = (shader) => {
      shader.vertexShader = "attribute vec4 along; attribute vec3 across; attribute vec4 how;"
        + "attribute float striped; varying float dark;\n"
        + shader.vertexShader.replace("#include <begin_vertex>", PLACE);
      shader.fragmentShader = "varying float dark;\n" + shader.fragmentShader
        .replace("#include <color_fragment>", `#include <color_fragment>
          diffuseColor.rgb = mix(diffuseColor.rgb, vec3(.08, .08, .09), step(.5, dark));`);
    };
    this.formula = PLACE;
    this.mesh = new THREE.InstancedMesh(geometry, material, count);
    this.mesh.frustumCulled = false;
    this.colour = new THREE.Color();
  }

  /**
   * Updates the arrows.
   * @param {number} at frame, with a fraction @param {THREE.Matrix4[]} sites of all joints
   * @param {(joint: number) => boolean} isOn
   */
  place(at, sites, isOn) {
    const { run, how, striped, mesh, colour } = this, { arrows, frames } = run;
    const frame = Math.round(at), angles = run.values.joint_angles;
    this.joints.forEach((j, k) => {
      const { arrow } = run.joints[j], value = arrows.values ? arrows.values[j * frames + frame] : 0;
      const width = isOn(j) ? widthOf(arrow, value, arrows.invisible) : 0;
      const sign = Math.sign(value) || 1, angle = angles ? angles[j * frames + frame] : 0;
      const phase = arrows.speed * (run.begin + at / run.fps) - (angle || 0) * sign;
      how.setXYZW(k, width ? arrow.radius : 0, width, phase, sign);
      striped.setX(k, Number(arrow.limit !== null && Math.abs(value) > arrow.limit));
      mesh.setMatrixAt(k, sites[j]);
      const isStale = arrows.stale[j * frames + frame] > 0.5;
      const rgb = isStale ? run.greyRgb : value > 0 ? arrows.positive : arrows.negative;
      mesh.setColorAt(k, colour.setRGB(rgb[0], rgb[1], rgb[2]));
    });
    how.needsUpdate = striped.needsUpdate = mesh.instanceMatrix.needsUpdate = true;
    if (mesh.instanceColor) mesh.instanceColor.needsUpdate = true;
  }
}
