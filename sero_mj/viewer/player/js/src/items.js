/** Decor that is stored geom by geom: smart arrows, axes and what other packages draw. */

import * as THREE from "three";
import { stretch, tube } from "./tubes.js";

/** @typedef {import("./data.js").Run} Run */

// mjtGeom
const SPHERE = 2, CAPSULE = 3, ELLIPSOID = 4, CYLINDER = 5, BOX = 6;
const ARROW = 100, ARROW1 = 101, ARROW2 = 102, LINE = 103, LINEBOX = 104, TRIANGLE = 108;
const ARROWS = [1, 5]; // kinds of joints' arrows and smart arrows, `Kind` in Python
const UP = Math.PI / 2;
const GLOW = 0.35; // emission of decor that does not say otherwise
const LIT = 0.45 / GLOW; // as bright as round arrows, also where no lamp is

/** @typedef {(size: number[]) => [number[], number]} Scale scale, and offset along z */
/** @typedef {[THREE.BufferGeometry, Scale]} Shape */

/** A cone of radius 1 from z = 0 to 1, or down. @param {number} [way] */
const cone = (way = 1) => new THREE.ConeGeometry(1, 1, 24).translate(0, 0.5, 0).rotateX(way * UP);

/** A cylinder of radius 1 from z = -1 to 1. @param {boolean} [isOpen] */
const rod = (isOpen = false) => new THREE.CylinderGeometry(1, 1, 2, 20, 1, isOpen).rotateX(UP);

/** @param {number[]} corners @param {number[]} [index] */
function made(corners, index) {
  const shape = new THREE.BufferGeometry();
  shape.setAttribute("position", new THREE.Float32BufferAttribute(corners, 3));
  if (index) shape.setIndex(index);
  shape.computeVertexNormals();
  return shape;
}

/** The unit shapes of a type, each with how a geom's size scales it. @type {Record<number, () => Shape[]>} */
const SHAPES = {
  [SPHERE]: () => [[new THREE.SphereGeometry(1, 20, 14), (s) => [s, 0]]],
  [ELLIPSOID]: () => [[new THREE.SphereGeometry(1, 20, 14), (s) => [s, 0]]],
  [CAPSULE]: () => [[tube(), (s) => [s, 0]]],
  [CYLINDER]: () => [[rod(), (s) => [s, 0]]],
  [BOX]: () => [[new THREE.BoxGeometry(2, 2, 2), (s) => [s, 0]]],
  // Drawn half as long as its size, a third of that head.
  [ARROW]: () => [
    [rod(), ([a, b, c]) => [[a, b, c / 6], c / 6]],
    [cone(), ([a, b, c]) => [[1.75 * a, 1.75 * b, c / 6], c / 3]],
  ],
  [ARROW1]: () => [
    [rod(), ([a, b, c]) => [[a, b, c / 6], c / 6]],
    [cone(), ([a, b, c]) => [[a, b, c / 6], c / 3]],
  ],
  [ARROW2]: () => [
    [rod(true), ([a, b, c]) => [[a, b, c / 3], 0]],
    [cone(), ([a, b, c]) => [[1.75 * a, 1.75 * b, c / 6], c / 3]],
    [cone(-1), ([a, b, c]) => [[1.75 * a, 1.75 * b, c / 6], -c / 3]],
  ],
  [TRIANGLE]: () => [[made([0, 0, 0, 1, 0, 0, 0, 1, 0]), ([a, b]) => [[a, b, 1], 0]]],
};

/** Corners of what is drawn as lines, pairs of ends. @type {Record<number, number[]>} */
const LINES = {
  [LINE]: [0, 0, 0, 0, 0, 1],
  [LINEBOX]: [0, 1, 2].flatMap((axis) => [[-1, -1], [-1, 1], [1, -1], [1, 1]].flatMap(([a, b]) =>
    [-1, 1].flatMap((end) => [0, 1, 2].map((k) =>
      k === axis ? end : k === (axis + 1) % 3 ? a : b)))),
};

/** Lets y lean towards x. @param {THREE.Matrix4} matrix @param {number} share of x */
function lean({ elements }, share) {
  for (const c of [0, 1, 2]) elements[4 + c] += share * elements[c];
}

/** The material of a type of geoms. @param {number} type @param {boolean} isTransparent */
function materialOf(type, isTransparent) {
  const material = new THREE.MeshPhongMaterial({
    specular: 0x202020, side: THREE.DoubleSide, transparent: isTransparent,
  });
  material.onBeforeCompile = (shader) => {
    if (type === CAPSULE) stretch(shader);
    shader.vertexShader = "attribute vec2 look; varying vec2 own;\n" + shader.vertexShader
      .replace("void main() {", "void main() { own = look;");
    shader.fragmentShader = "varying vec2 own;\n" + shader.fragmentShader
      .replace("#include <color_fragment>", "#include <color_fragment>\ndiffuseColor.a *= own.x;")
      .replace("#include <emissivemap_fragment>", "totalEmissiveRadiance += own.y * diffuseColor.rgb;");
  };
  material.customProgramCacheKey = () => `decor ${type === CAPSULE}`;
  return material;
}

/** All of it, one mesh for each shape. */
export class Items {
  /** @param {Run} run */
  constructor(run) {
    this.run = run;
    this.group = new THREE.Group();
    /** Where each kind and item is, for cards. @type {Map<string, THREE.Vector3>} */
    this.places = new Map();
    /** @type {{mesh: THREE.InstancedMesh, of: number[], scale: Scale, look: THREE.InstancedBufferAttribute}[]} */
    this.meshes = [];
    /** @type {{mesh: THREE.LineSegments, of: number[]}[]} */
    this.lines = [];
    const types = new Set(run.items.of.map((/** @type {number[]} */ each) => each[2]));
    for (const type of types) {
      const of = [...run.items.of.keys()].filter((k) => run.items.of[k][2] === type);
      if (LINES[type]) this.#addLines(type, of);
      for (const [shape, scale] of SHAPES[type]?.() ?? []) {
        const look = new THREE.InstancedBufferAttribute(new Float32Array(2 * of.length), 2);
        shape.setAttribute("look", look);
        const mesh = new THREE.InstancedMesh(shape, materialOf(type, this.#isFaint(of)), of.length);
        mesh.frustumCulled = false;
        this.group.add(mesh);
        this.meshes.push({ mesh, of, scale, look });
      }
    }
  }

  /** Whether one of these is ever transparent. @param {number[]} of */
  #isFaint(of) {
    const { items: { colours }, frames } = this.run;
    return of.some((k) => colours?.subarray((4 * k + 3) * frames, (4 * k + 4) * frames)
      .some((/** @type {number} */ alpha) => alpha > 0 && alpha < 0.995));
  }

  /** @param {number} type @param {number[]} of */
  #addLines(type, of) {
    const corners = LINES[type].length * of.length, shape = new THREE.BufferGeometry();
    shape.setAttribute("position", new THREE.BufferAttribute(new Float32Array(corners), 3));
    shape.setAttribute("color", new THREE.BufferAttribute(new Float32Array(corners), 3));
    const mesh = new THREE.LineSegments(shape, new THREE.LineBasicMaterial({ vertexColors: true }));
    mesh.frustumCulled = false;
    this.group.add(mesh);
    this.lines.push({ mesh, of });
  }

  /** Places it. @param {number} frame @param {boolean} hasArrows whether arrows are on */
  place(frame, hasArrows) {
    const { items, frames } = this.run, { visible, positions, rotations, sizes, colours } = items;
    if (!visible || !positions || !rotations || !sizes || !colours) return;
    const turn = new THREE.Quaternion(), at = new THREE.Vector3(), matrix = new THREE.Matrix4();
    const own = new THREE.Vector3(), scaled = new THREE.Vector3(), colour = new THREE.Color();
    /** @param {Float32Array} of @param {number} channel */
    const read = (of, channel) => of[channel * frames + frame];
    this.places.clear();
    /** @param {number} k */
    const isSeen = (k) => read(visible, k) > 0.5 && (hasArrows || !ARROWS.includes(items.of[k][0]));
    /** @param {number} k */
    const pose = (k) => {
      turn.set(read(rotations, 4 * k + 1), read(rotations, 4 * k + 2),
        read(rotations, 4 * k + 3), read(rotations, 4 * k)).normalize();
      at.set(read(positions, 3 * k), read(positions, 3 * k + 1), read(positions, 3 * k + 2));
      return [0, 1, 2].map((c) => read(sizes, 3 * k + c));
    };
    for (const { mesh, of, scale, look } of this.meshes) {
      of.forEach((k, i) => {
        const isShown = isSeen(k), size = pose(k), [factors, offset] = scale(size);
        own.set(0, 0, offset).applyQuaternion(turn).add(at);
        scaled.fromArray(factors).multiplyScalar(isShown ? 1 : 0);
        matrix.compose(own, turn, scaled);
        if (items.of[k][2] === TRIANGLE) lean(matrix, size[2] / (size[0] || 1));
        mesh.setMatrixAt(i, matrix);
        mesh.setColorAt(i, colour.setRGB(
          read(colours, 4 * k), read(colours, 4 * k + 1), read(colours, 4 * k + 2)));
        look.setXY(i, read(colours, 4 * k + 3), Math.min(LIT * (items.glow?.[k] ?? GLOW), 1));
        const key = `${items.of[k][0]} ${items.of[k][1]}`;
        if (isShown && !this.places.has(key)) this.places.set(key, own.clone());
      });
      mesh.instanceMatrix.needsUpdate = look.needsUpdate = true;
      if (mesh.instanceColor) mesh.instanceColor.needsUpdate = true;
    }
    for (const { mesh, of } of this.lines) {
      const { position, color } = mesh.geometry.attributes, count = position.count / of.length;
      of.forEach((k, i) => {
        const type = items.of[k][2], isShown = isSeen(k), size = pose(k);
        if (type === LINE) size[0] = size[1] = 1;
        colour.setRGB(read(colours, 4 * k), read(colours, 4 * k + 1), read(colours, 4 * k + 2));
        for (let c = 0; c < count; c++) {
          own.fromArray(LINES[type], 3 * c).multiply(scaled.fromArray(size));
          own.multiplyScalar(isShown ? 1 : 0).applyQuaternion(turn).add(at);
          position.setXYZ(count * i + c, own.x, own.y, own.z);
          color.setXYZ(count * i + c, colour.r, colour.g, colour.b);
        }
      });
      position.needsUpdate = color.needsUpdate = true;
    }
  }

  /** The item on a ray, nearest first. @param {THREE.Raycaster} ray */
  pick(ray) {
    for (const { mesh } of this.meshes) mesh.boundingSphere = null; // it has moved
    const [hit] = ray.intersectObjects(this.meshes.map((each) => each.mesh));
    if (!hit) return null;
    const found = this.meshes.find((each) => each.mesh === hit.object);
    const item = found && hit.instanceId !== undefined ? found.of[hit.instanceId] : undefined;
    return item === undefined ? null : { of: this.run.items.of[item], distance: hit.distance };
  }
}
