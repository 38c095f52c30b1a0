/** Soft parts: skins, which bones move, and flexes and tendons, whose positions the run contains. */

import * as THREE from "three";
import { mixer } from "./data.js";
import { materialOf, repeated, texturesOf } from "./surfaces.js";
import { Tubes } from "./tubes.js";

/** @typedef {import("./data.js").Run} Run */
/** @typedef {import("./data.js").Skin} Skin */
/** @typedef {import("./data.js").Flex} Flex */
/** @typedef {import("./shading.js").SkyUniforms | null} Sky */

/** @param {ArrayLike<number>} of @param {number} k */
const at = (of, k) => new THREE.Vector3(of[3 * k], of[3 * k + 1], of[3 * k + 2]);

/**
 * Returns a mesh whose vertices move.
 * @param {number} count number of vertices @param {ArrayLike<number>} triangles
 * @param {THREE.Material} material @param {Float32Array} [uv]
 */
function meshOf(count, triangles, material, uv) {
  const shape = new THREE.BufferGeometry();
  shape.setAttribute("position", new THREE.BufferAttribute(new Float32Array(3 * count), 3));
  shape.setIndex(new THREE.BufferAttribute(Uint32Array.from(triangles), 1));
  if (uv) shape.setAttribute("uv", new THREE.BufferAttribute(uv, 2));
  const mesh = new THREE.Mesh(shape, material);
  mesh.frustumCulled = false;
  mesh.castShadow = mesh.receiveShadow = true;
  return mesh;
}

/** Moves vertices along their normals. @param {THREE.BufferGeometry} shape @param {number} far m */
function inflate(shape, far) {
  const { position, normal } = shape.attributes;
  for (let i = 0; i < position.array.length; i++) position.array[i] += far * normal.array[i];
}

/** A skin. The position of a vertex is a weighted mean of its positions in the frames of the bones. */
class MovedSkin {
  /** @param {Run} run @param {Sky} sky @param {Skin} skin @param {THREE.Texture[]} textures */
  constructor(run, sky, skin, textures) {
    this.skin = skin;
    const count = skin.positions.length / 3;
    this.mesh = meshOf(count, skin.triangles, materialOf(run, sky, skin, textures),
      repeated(run, skin));
    // These transforms convert from world coordinates in the bind pose to the frames of the bones.
    this.bind = skin.bones.map(({ pos, quat: [w, x, y, z] }) => new THREE.Matrix4().compose(
      new THREE.Vector3().fromArray(pos), new THREE.Quaternion(x, y, z, w),
      new THREE.Vector3(1, 1, 1)).invert());
  }

  /** @param {THREE.Matrix4[]} bodies */
  place(bodies) {
    const { skin, bind, mesh: { geometry } } = this, { position } = geometry.attributes;
    const to = position.array, { positions: from, moved, weights } = skin;
    to.fill(0);
    let k = 0;
    skin.bones.forEach(({ body, count }, b) => {
      const e = bodies[body].clone().multiply(bind[b]).elements;
      for (const end = k + count; k < end; k++) {
        const i = 3 * moved[k], weight = weights[k] / 65535;
        const x = from[i], y = from[i + 1], z = from[i + 2];
        to[i] += weight * (e[0] * x + e[4] * y + e[8] * z + e[12]);
        to[i + 1] += weight * (e[1] * x + e[5] * y + e[9] * z + e[13]);
        to[i + 2] += weight * (e[2] * x + e[6] * y + e[10] * z + e[14]);
      }
    });
    geometry.computeVertexNormals();
    if (skin.inflate) inflate(geometry, skin.inflate);
    position.needsUpdate = geometry.attributes.normal.needsUpdate = true;
  }
}

/** A flex: a cable that consists of tubes, a cloth with two sides and a seam, or the shell of a solid. */
class MovedFlex {
  /** @param {Run} run @param {Sky} sky @param {Flex} flex @param {THREE.Texture[]} textures */
  constructor(run, sky, flex, textures) {
    this.flex = flex;
    const { count, triangles, edges, dim } = flex;
    const isFlat = flex.flat && { flatShading: true };
    const material = materialOf(run, sky, flex, textures, isFlat || {});
    if (dim === 1) {
      this.tubes = new Tubes(material, edges.length / 2);
      this.mesh = this.tubes.mesh;
      return;
    }
    /** The other side of a cloth has separate vertices. */
    const sides = [...triangles];
    if (dim === 2) {
      for (let k = 0; k < triangles.length; k += 3) {
        sides.push(triangles[k] + count, triangles[k + 2] + count, triangles[k + 1] + count);
      }
      for (let k = 0; k < edges.length; k += 2) {
        const [a, b] = [edges[k], edges[k + 1]];
        sides.push(a, a + count, b, b, a + count, b + count);
      }
    }
    const own = repeated(run, flex);
    const uv = own && new Float32Array([...own, ...(dim === 2 ? own : [])]);
    this.mesh = meshOf(count * (dim === 2 ? 2 : 1), sides, material, uv);
    // The normals of a cloth are computed on one side, without the seam.
    this.sheet = meshOf(count, triangles, material).geometry;
  }

  /** @param {Float32Array} places of all vertices of flexes */
  place(places) {
    const { first, count, edges, radius, dim } = this.flex;
    const own = places.subarray(3 * first, 3 * (first + count));
    if (this.tubes) {
      for (let k = 0; k < edges.length; k += 2) {
        this.tubes.place(k / 2, at(own, edges[k]), at(own, edges[k + 1]), Math.max(radius, 1e-4));
      }
      return;
    }
    const { geometry } = this.mesh, { position } = geometry.attributes, { sheet } = this;
    if (!sheet) return;
    sheet.attributes.position.array.set(own);
    sheet.computeVertexNormals();
    const normals = sheet.attributes.normal.array;
    geometry.computeVertexNormals();
    const facing = geometry.attributes.normal.array;
    for (let i = 0; i < own.length; i++) {
      position.array[i] = own[i] + radius * normals[i];
      facing[i] = normals[i];
      if (dim !== 2) continue;
      position.array[own.length + i] = own[i] - radius * normals[i];
      facing[own.length + i] = -normals[i];
    }
    position.needsUpdate = geometry.attributes.normal.needsUpdate = true;
  }
}

/** All soft parts of a run. */
export class SoftParts {
  /** @param {Run} run @param {Sky} sky null if the model has its own lights */
  constructor(run, sky) {
    this.run = run;
    this.group = new THREE.Group();
    const textures = run.skins.length + run.flexes.length ? texturesOf(run) : [];
    this.skins = run.skins.map((skin) => new MovedSkin(run, sky, skin, textures));
    this.flexes = run.flexes.map((flex) => new MovedFlex(run, sky, flex, textures));
    for (const { mesh } of [...this.skins, ...this.flexes]) this.group.add(mesh);
    if (!run.tendons) return;
    const { rgba } = run.tendons;
    const material = materialOf(run, sky, { rgba: [255, 255, 255, 255 * rgba[0][3]] }, textures);
    this.tendons = new Tubes(material, rgba.length);
    rgba.forEach(([r, g, b], k) => this.tendons?.mesh.setColorAt(k, new THREE.Color(r, g, b)));
    this.group.add(this.tendons.mesh);
  }

  /** Updates the soft parts. @param {number} time frame with a fractional part @param {THREE.Matrix4[]} bodies */
  place(time, bodies) {
    const { soft, tendons, frames } = this.run;
    const before = Math.floor(time), mix = mixer(time, frames);
    for (const skin of this.skins) skin.place(bodies);
    if (soft) {
      const places = new Float32Array(soft.length / frames);
      for (let i = 0; i < places.length; i++) places[i] = mix(soft, i);
      for (const flex of this.flexes) flex.place(places);
    }
    if (!tendons) return;
    for (let k = 0; k < tendons.rgba.length; k++) {
      const [from, to] = [0, 3].map((end) =>
        new THREE.Vector3(...[0, 1, 2].map((c) => mix(tendons.ends, 6 * k + end + c))));
      this.tendons?.place(k, from, to, tendons.radius[k * frames + before]);
    }
  }
}
