/** Ambient occlusion: darkens the floor below robots, where they hide a part of the sky. */

import * as THREE from "three";
import { matrixOf } from "./robots.js";
import { MESH, extentsOf, isPlane } from "./surfaces.js";

/** @typedef {import("./data.js").Run} Run */
/** @typedef {import("./data.js").Geom} Geom */

const MAX_CAPSULES = 16; // maximum number of capsules; those that hide the largest fractions of the sky are used
const MIN_SHARE = 0.004; // hidden fraction of the sky below which a capsule is ignored
const MARGIN = 0.4; // size of the darkened area around the capsules, m
// The map has 64 x 64 texels. Computing every pixel of the image would take 30 to 50 ms in software.
const SIDE = 64;

/**
 * Returns a capsule around the bounding box of a geom, with ends and radius in m in the frame of the body.
 * @param {Geom} geom @param {Run} run
 */
function capsuleOf(geom, run) {
  const box = new THREE.Box3(), extents = new THREE.Vector3(...extentsOf(geom));
  if (geom.type === MESH) box.setFromArray(run.meshes[geom.mesh ?? 0].positions);
  else box.set(extents.clone().negate(), extents);
  const centre = box.getCenter(new THREE.Vector3());
  const sizes = box.getSize(extents).multiplyScalar(0.5).toArray();
  const [long, middle, short] = [0, 1, 2].sort((a, b) => sizes[b] - sizes[a]);
  const radius = Math.sqrt(sizes[middle] * sizes[short]);
  const half = new THREE.Vector3().setComponent(long, Math.max(sizes[long] - radius, 0));
  const pose = matrixOf(geom.pos, geom.quat);
  return { body: geom.body, radius, begin: centre.clone().sub(half).applyMatrix4(pose),
    end: centre.add(half).applyMatrix4(pose) };
}

/**
 * Returns the fraction of the sky that a capsule leaves visible at a point on the floor. The capsule
 * hides as much as a sphere around its nearest point, cos(angle to the normal) r^2 / d^2.
 * Source: Quilez, Sphere - ambient occlusion, 2006.
 * @param {number[]} capsule ends, each x, y and height over the floor, and radius, m
 * @param {number} x @param {number} y m
 */
export function visibleSky([ax, ay, az, bx, by, bz, radius], x, y) {
  const dx = bx - ax, dy = by - ay, dz = bz - az, square = radius * radius;
  const along = ((x - ax) * dx + (y - ay) * dy - az * dz) / (dx * dx + dy * dy + dz * dz + 1e-12);
  const t = along < 0 ? 0 : along > 1 ? 1 : along, height = az + t * dz;
  const far = Math.max((ax + t * dx - x) ** 2 + (ay + t * dy - y) ** 2 + height * height, square);
  return height > 0 ? 1 - Math.min(height / Math.sqrt(far) * square / far, 0.95) : 1;
}

/** A map of the floor around robots, which has the visible fraction of the sky at each point. */
export class Occlusion {
  /** @param {Run} run @param {number} floor height of the floor, m */
  constructor(run, floor) {
    this.floor = floor;
    this.capsules = run.geoms
      .filter((geom) => geom.rgba[3] === 255 && run.bodies[geom.body].double < 0 && !isPlane(geom))
      .map((geom) => capsuleOf(geom, run));
    this.texels = new Uint8Array(SIDE * SIDE).fill(255);
    this.texture = new THREE.DataTexture(this.texels, SIDE, SIDE, THREE.RedFormat);
    this.texture.minFilter = this.texture.magFilter = THREE.LinearFilter;
    this.texture.needsUpdate = true;
    /** Corner of the map, m, and reciprocal of its side length, 1/m. */
    this.uniforms = { open: { value: this.texture }, map: { value: new THREE.Vector3(0, 0, 1) } };
    /** Capsules in the map. @type {number[][]} */
    this.drawn = [];
  }

  /** Draws the map again if something has moved. @param {THREE.Matrix4[]} matrices poses of bodies */
  place(matrices) {
    const near = this.#near(matrices), { drawn } = this;
    const isSame = near.length === drawn.length
      && near.every((each, k) => each.every((one, i) => Math.abs(one - drawn[k][i]) < 1e-4));
    if (isSame) return;
    this.drawn = near;
    this.texels.fill(255);
    this.texture.needsUpdate = true;
    if (!near.length) return;
    const reach = (/** @type {number} */ axis, /** @type {number} */ sign) => Math.max(...near.map((each) =>
      Math.max(sign * each[axis], sign * each[axis + 3]) + each[6])) + MARGIN;
    const low = [-reach(0, -1), -reach(1, -1)], high = [reach(0, 1), reach(1, 1)];
    // Side and corner change in steps of texels, so that edges do not flicker while robots move.
    const side = 2 ** Math.ceil(Math.log2(Math.max(high[0] - low[0], high[1] - low[1]) + 1e-6));
    const texel = side / SIDE;
    const [x, y] = [0, 1].map((axis) => Math.round((low[axis] + high[axis] - side) / 2 / texel) * texel);
    this.uniforms.map.value.set(x, y, 1 / side);
    for (let i = 1; i < SIDE - 1; i++) {
      for (let j = 1; j < SIDE - 1; j++) {
        let share = 255;
        for (const capsule of near) share *= visibleSky(capsule, x + (j + 0.5) * texel, y + (i + 0.5) * texel);
        this.texels[i * SIDE + j] = share;
      }
    }
  }

  /** Returns the capsules that hide the largest fractions of the sky. @param {THREE.Matrix4[]} matrices */
  #near(matrices) {
    return this.capsules.map(({ body, radius, begin, end }) => {
      const [a, b] = [begin, end].map((each) => each.clone().applyMatrix4(matrices[body]));
      const height = Math.max(Math.min(a.z, b.z) - this.floor, radius);
      const numbers = [a.x, a.y, a.z - this.floor, b.x, b.y, b.z - this.floor, radius];
      return { numbers, share: (radius / height) ** 2 };
    }).filter(({ share }) => share > MIN_SHARE).sort((one, other) => other.share - one.share)
      .slice(0, MAX_CAPSULES).map(({ numbers }) => numbers);
  }

  /**
   * Makes the shader of the floor hide the sky at `spot`.
   * @param {THREE.WebGLProgramParametersWithUniforms} shader that `shade` has changed
   */
  shade(shader) {
    Object.assign(shader.uniforms, this.uniforms);
    shader.fragmentShader = "uniform sampler2D open; uniform vec3 map;\n" + shader.fragmentShader.replace(
      "fromSky(normal, geometryViewDir, material, reflectedLight);",
      "$& reflectedLight.indirectDiffuse *= texture2D(open, (spot - map.xy) * map.z).r;");
  }

  /** Frees the texture. */
  dispose() { this.texture.dispose(); }
}
