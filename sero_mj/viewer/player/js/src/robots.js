/** The bodies of a model. Opaque parts and doubles are one geometry each. A texture has the poses of bodies. */

import * as THREE from "three";
import { mixer } from "./data.js";
import { Mirror, mirrorOf } from "./mirror.js";
import { backOf, ball, capsule, cylinder, finish, finishOf, isPlane, metallicOf, placesIn, planeOf, textureOf, texturesOf }
  from "./surfaces.js";

/** @typedef {import("./data.js").Run} Run */
/** @typedef {import("./data.js").Geom} Geom */

const ONE = new THREE.Vector3(1, 1, 1);
const FAINT = 0.3; // opacity of surfaces in the transparent mode, as in MuJoCo
const TEXELS = 5; // number of texels per body, for pose, opacity and grayness

/** Returns the matrix of a pose. @param {number[]} pos @param {number[]} quat in the order w, x, y, z */
export function matrixOf(pos, quat) {
  const turn = new THREE.Quaternion(quat[1], quat[2], quat[3], quat[0]);
  return new THREE.Matrix4().compose(new THREE.Vector3(pos[0], pos[1], pos[2]), turn, ONE);
}

/** Returns the shape of a geom, in the frame of the geom. @param {Geom} geom @param {Run} run */
function shapeOf(geom, run) {
  const [a, b, c] = geom.size;
  switch (geom.type) {
    case 0: return planeOf(geom, run);
    case 2: return ball(a).scale(a, a, a);
    case 3: return capsule(a, b);
    case 4: return ball(Math.max(a, b, c)).scale(a, b, c);
    case 5: return cylinder(a, b);
    case 6: return new THREE.BoxGeometry(2 * a, 2 * b, 2 * c);
    default: {
      const mesh = run.meshes[geom.mesh ?? 0], shape = new THREE.BufferGeometry();
      shape.setAttribute("position", new THREE.BufferAttribute(mesh.positions, 3));
      shape.setAttribute("normal", new THREE.BufferAttribute(mesh.normals, 3));
      return shape.setIndex(new THREE.BufferAttribute(mesh.triangles, 1));
    }
  }
}

/** Returns the opacity of a double, which MuJoCo blends twice. @param {number[]} rgba */
const blendedTwice = ([r, g, b, a]) => [r, g, b, Math.round(255 * (1 - (1 - a / 255) ** 2))];

/**
 * Joins geoms into one geometry in the frames of the bodies, with a group for each part.
 * @param {Geom[][]} parts @param {Run} run @param {number} texture index of the texture; -1 for none
 */
function merged(parts, run, texture) {
  const geoms = parts.flat();
  const shapes = geoms.map((geom) => shapeOf(geom, run));
  const vertices = shapes.reduce((sum, each) => sum + each.attributes.position.count, 0);
  const corners = shapes.reduce((sum, each) => sum + (each.index ? each.index.count : 0), 0);
  const position = new Float32Array(3 * vertices), normal = new Int8Array(3 * vertices);
  const color = new Uint8Array(4 * vertices), body = new Uint16Array(vertices);
  const shine = new Uint8Array(4 * vertices), mirror = mirrorOf(run);
  const metal = new Uint8Array(vertices);
  const spots = texture < 0 ? null : new Float32Array(3 * vertices);
  const index = new Uint32Array(corners), vector = new THREE.Vector3();
  const turn = new THREE.Matrix3();
  let vertex = 0, corner = 0;
  geoms.forEach((geom, k) => {
    const shape = shapes[k], at = matrixOf(geom.pos, geom.quat), first = vertex;
    const { position: places, normal: normals } = shape.attributes;
    turn.setFromMatrix4(at);
    const rgba = run.bodies[geom.body].double < 0 ? geom.rgba : blendedTwice(geom.rgba);
    const look = finishOf(run, geom), metallic = metallicOf(run, geom);
    if (geom === mirror?.geom) look[3] = Math.round(255 * Math.min(mirror.share, 1));
    for (const each of shape.index ? shape.index.array : []) index[corner++] = each + first;
    spots?.set(placesIn(run, geom, shape), 3 * vertex);
    for (let i = 0; i < places.count; i++, vertex++) {
      vector.fromBufferAttribute(places, i).applyMatrix4(at).toArray(position, 3 * vertex);
      vector.fromBufferAttribute(normals, i).applyMatrix3(turn).multiplyScalar(127).round()
        .toArray(normal, 3 * vertex);
      color.set(rgba, 4 * vertex);
      shine.set(look, 4 * vertex);
      metal[vertex] = metallic;
      body[vertex] = geom.body;
    }
  });
  const geometry = new THREE.BufferGeometry();
  let begin = 0, count = 0;
  parts.forEach((part, k) => {
    const length = shapes.slice(count, count += part.length)
      .reduce((sum, { index: of }) => sum + (of ? of.count : 0), 0);
    geometry.addGroup(begin, length, k);
    begin += length;
  });
  geometry.setAttribute("position", new THREE.BufferAttribute(position, 3));
  geometry.setAttribute("normal", new THREE.BufferAttribute(normal, 3, true));
  geometry.setAttribute("color", new THREE.BufferAttribute(color, 4, true));
  geometry.setAttribute("body", new THREE.BufferAttribute(body, 1));
  geometry.setAttribute("finish", new THREE.BufferAttribute(shine, 4, true));
  geometry.setAttribute("metal", new THREE.BufferAttribute(metal, 1, true));
  if (spots) geometry.setAttribute("place", new THREE.BufferAttribute(spots, 3));
  return geometry.setIndex(new THREE.BufferAttribute(index, 1));
}

/** Draws all bodies of a run. */
export class Robots {
  /** @param {Run} run @param {import("./shading.js").SkyUniforms | null} sky null if the model has its own lights */
  constructor(run, sky) {
    this.run = run;
    this.sky = sky;
    this.group = new THREE.Group();
    this.matrices = run.bodies.map(() => new THREE.Matrix4());
    this.texels = new Float32Array(4 * TEXELS * run.bodies.length);
    this.texture = new THREE.DataTexture(
      this.texels, TEXELS, run.bodies.length, THREE.RGBAFormat, THREE.FloatType);
    const isGhost = (/** @type {Geom} */ geom) =>
      geom.rgba[3] < 255 || run.bodies[geom.body].double >= 0;
    this.geoms = run.geoms.concat(run.geoms.filter(isPlane).map(backOf));
    this.solidGeoms = run.geoms.filter((geom) => !isGhost(geom));
    this.textures = texturesOf(run);
    /** Materials of opaque parts: for each texture, one of static parts and one of moving parts. @type {THREE.MeshPhongMaterial[][]} */
    this.surfaces = [];
    this.mirrorGeom = mirrorOf(run)?.geom;
    this.mirror = this.mirrorGeom ? new Mirror() : null;
    const [solid, depth, ghosts] = this.#meshes(-1, isGhost);
    this.solid = solid;
    this.depth = depth;
    this.ghosts = ghosts;
    // Each texture needs its own meshes.
    this.textured = this.textures.flatMap((_, k) => this.#meshes(k, isGhost));
  }

  /**
   * Returns the meshes of all geoms with a texture: one of opaque geoms, and two for depth and color of others.
   * @param {number} texture -1 for none @param {(geom: Geom) => boolean} isGhost
   */
  #meshes(texture, isGhost) {
    const geoms = this.geoms.filter((geom) => textureOf(this.run, geom) === texture);
    const ghosts = geoms.filter(isGhost);
    const solids = geoms.filter((geom) => !isGhost(geom));
    const moves = (/** @type {Geom} */ geom) => Boolean(this.run.bodies[geom.body].moves);
    const parts = [solids.filter((geom) => !moves(geom)), solids.filter(moves)];
    const looks = parts.map(() => this.#material({}, false, texture));
    const solid = this.#mesh(merged(parts, this.run, texture), looks);
    solid.castShadow = solid.receiveShadow = true;
    this.surfaces.push(looks);
    // The depth is drawn before the color, so that only the nearest surface is visible.
    const shape = merged([ghosts], this.run, texture);
    const depth = this.#mesh(shape, this.#material({ colorWrite: false }, true, texture));
    const colour = this.#mesh(shape, this.#material({ transparent: true, depthWrite: false }, true, texture));
    depth.renderOrder = 1;
    colour.renderOrder = 2;
    depth.visible = colour.visible = ghosts.length > 0;
    solid.visible = geoms.length > ghosts.length;
    return [solid, depth, colour];
  }

  /**
   * Makes a shader place vertices by the poses of the bodies.
   * @param {THREE.WebGLProgramParametersWithUniforms} shader @param {boolean} isBehind
   */
  #pose(shader, isBehind) {
    const grey = this.run.greyRgb.join(",");
    const texel = (/** @type {number} */ k) => `texelFetch(poses, ivec2(${k}, at), 0)`;
    shader.uniforms.poses = { value: this.texture };
    shader.vertexShader = "attribute float body; uniform highp sampler2D poses;"
      + "varying vec2 state;\n" + shader.vertexShader
      .replace("void main() {", `void main() { int at = int(body + .5);
        mat4 own = mat4(${[0, 1, 2, 3].map(texel)}); state = ${texel(4)}.xy;`)
      .replace("#include <beginnormal_vertex>", "vec3 objectNormal = mat3(own) * normal;")
      .replace("#include <begin_vertex>", "vec3 transformed = (own * vec4(position, 1.)).xyz;")
      .replace("#include <project_vertex>", "#include <project_vertex>\n" + (isBehind
        ? "gl_Position = projectionMatrix * vec4(mvPosition.xyz * 1.002, 1.);" : ""));
    shader.fragmentShader = "varying vec2 state;\n" + shader.fragmentShader
      .replace("void main() {", "void main() { if (state.x < .004) discard;")
      .replace("#include <color_fragment>", `#include <color_fragment>
        diffuseColor.a *= state.x;
        diffuseColor.rgb = mix(diffuseColor.rgb, vec3(${grey}), .8 * state.y);`);
  }

  /**
   * @param {object} look @param {boolean} isBehind whether surfaces are drawn a little farther away, so
   * that they do not flicker where they coincide with a robot @param {number} texture -1 for none
   */
  #material(look, isBehind, texture) {
    const material = new THREE.MeshPhongMaterial({ vertexColors: true, ...look });
    const image = this.textures[texture] ?? null;
    const isCube = texture >= 0 && this.run.textures[texture].cube;
    material.onBeforeCompile = (shader) => {
      finish(shader, this.run, this.sky, image, isCube, isBehind ? null : this.mirror);
      this.#pose(shader, isBehind);
    };
    material.customProgramCacheKey = () => `body ${isBehind} ${texture < 0 ? "" : isCube}`;
    return material;
  }

  /**
   * @template {THREE.Material | THREE.Material[]} Look
   * @param {THREE.BufferGeometry} geometry @param {Look} look
   */
  #mesh(geometry, look) {
    const mesh = new THREE.Mesh(geometry, look);
    mesh.frustumCulled = false;
    mesh.customDepthMaterial = new THREE.MeshDepthMaterial();
    mesh.customDepthMaterial.onBeforeCompile = (shader) => this.#pose(shader, false);
    this.group.add(mesh);
    return mesh;
  }

  /** Updates the poses of the bodies. @param {number} at frame with a fractional part @param {boolean} hasDoubles */
  place(at, hasDoubles) {
    const { run, texels } = this, { frames } = run;
    const before = Math.floor(at), mix = mixer(at, frames);
    const position = new THREE.Vector3(), turn = new THREE.Quaternion();
    const { positions: P, rotations: R } = run;
    for (let b = 0; b < run.bodies.length; b++) {
      position.set(mix(P, 3 * b), mix(P, 3 * b + 1), mix(P, 3 * b + 2));
      turn.set(mix(R, 4 * b + 1), mix(R, 4 * b + 2), mix(R, 4 * b + 3), mix(R, 4 * b)).normalize();
      this.matrices[b].compose(position, turn, ONE).toArray(texels, 4 * TEXELS * b);
      const isOff = run.bodies[b].double >= 0 && !hasDoubles;
      texels[4 * TEXELS * b + 16] = isOff ? 0 : mix(run.opacity, b);
      texels[4 * TEXELS * b + 17] = run.grey[b * frames + before];
    }
    this.texture.needsUpdate = true;
  }

  /**
   * Makes moving bodies transparent, or shows only the edges of all bodies.
   * @param {{transparent?: boolean, wireframe?: boolean}} how
   */
  shade({ transparent = false, wireframe = false }) {
    for (const looks of this.surfaces) {
      looks.forEach((material, k) => {
        const isFaint = transparent && k === 1;
        Object.assign(material, { transparent: isFaint, depthWrite: !isFaint, opacity: isFaint ? FAINT : 1, wireframe });
        material.needsUpdate = true;
      });
    }
  }

  /** Frees the textures and the render target of the mirror. */
  dispose() {
    for (const each of [this.texture, ...this.textures]) each.dispose();
    this.mirror?.target.dispose();
  }

  /**
   * Draws the reflection in the reflecting plane, if there is one.
   * @param {THREE.WebGLRenderer} renderer @param {THREE.Scene} scene
   * @param {THREE.PerspectiveCamera} camera @param {boolean} isOn
   */
  reflect(renderer, scene, camera, isOn) {
    const { mirror, mirrorGeom: geom } = this;
    if (!mirror || !geom) return;
    mirror.uniforms.isMirror.value = 0;
    if (!isOn) return;
    const pose = this.matrices[geom.body].clone().multiply(matrixOf(geom.pos, geom.quat));
    // Transparent parts, such as the back of the plane, are not reflected.
    const faint = this.group.children.filter((each) => each.visible && each.renderOrder > 0);
    for (const each of faint) each.visible = false;
    mirror.draw(renderer, scene, camera, pose);
    for (const each of faint) each.visible = true;
  }

  /** Returns the nearest geom on a ray, and the point of intersection. @param {THREE.Ray} ray */
  pick(ray) {
    const own = new THREE.Ray(), pose = new THREE.Matrix4(), point = new THREE.Vector3();
    const [a, b, c] = [new THREE.Vector3(), new THREE.Vector3(), new THREE.Vector3()];
    /** @type {{geom: Geom, point: THREE.Vector3, distance: number} | null} */
    let best = null;
    for (const geom of this.solidGeoms) {
      if (isPlane(geom)) continue;
      const shape = this.#shape(geom);
      pose.multiplyMatrices(this.matrices[geom.body], matrixOf(geom.pos, geom.quat));
      own.copy(ray).applyMatrix4(pose.clone().invert());
      if (!shape.boundingSphere) shape.computeBoundingSphere();
      if (shape.boundingSphere && !own.intersectsSphere(shape.boundingSphere)) continue;
      const places = shape.attributes.position, index = shape.index ? shape.index.array : [];
      for (let k = 0; k < index.length; k += 3) {
        a.fromBufferAttribute(places, index[k]);
        b.fromBufferAttribute(places, index[k + 1]);
        c.fromBufferAttribute(places, index[k + 2]);
        if (!own.intersectTriangle(a, b, c, true, point)) continue;
        const distance = point.distanceTo(own.origin);
        if (best && distance >= best.distance) continue;
        best = { geom, point: point.clone().applyMatrix4(pose), distance };
      }
    }
    return best;
  }

  /** @type {Map<Geom, THREE.BufferGeometry>} */
  #shapes = new Map();

  /** @param {Geom} geom */
  #shape(geom) {
    let shape = this.#shapes.get(geom);
    if (!shape) this.#shapes.set(geom, shape = shapeOf(geom, this.run));
    return shape;
  }
}
