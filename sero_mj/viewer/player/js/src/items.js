/** Overlays that are drawn as geoms: smart arrows, axes and the overlays of other packages. */

import * as THREE from "three";
import { VECTOR } from "./geoms.js";
import { stretch, tube } from "./tubes.js";

/** @typedef {import("./geoms.js").Geoms} Geoms */
/** @typedef {import("./data.js").Run} Run */

// mjtGeom
const SPHERE = 2, CAPSULE = 3, ELLIPSOID = 4, CYLINDER = 5, BOX = 6;
const ARROW = 100, ARROW1 = 101, ARROW2 = 102, LINE = 103, LINEBOX = 104, TRIANGLE = 108;
const UP = Math.PI / 2;

/** @typedef {(size: number[]) => [number[], number]} Scale scale, and offset along z */
/** @typedef {[THREE.BufferGeometry, Scale]} Shape */

/** Returns a cone of radius 1 from z = 0 to 1, or to -1. @param {number} [way] */
const cone = (way = 1) => new THREE.ConeGeometry(1, 1, 24).translate(0, 0.5, 0).rotateX(way * UP);

/** Returns a cylinder of radius 1 from z = -1 to 1. @param {boolean} [isOpen] */
const rod = (isOpen = false) => new THREE.CylinderGeometry(1, 1, 2, 20, 1, isOpen).rotateX(UP);

/** @param {ArrayLike<number>} corners @param {ArrayLike<number>} [index] */
function made(corners, index) {
  const shape = new THREE.BufferGeometry();
  shape.setAttribute("position", new THREE.BufferAttribute(new Float32Array(corners), 3));
  if (index) shape.setIndex(new THREE.BufferAttribute(new Uint16Array(index), 1));
  shape.computeVertexNormals();
  return shape;
}

/** For each type of geoms: unit shapes with functions that scale them by the size of a geom. @type {Record<number, () => Shape[]>} */
const SHAPES = {
  [SPHERE]: () => [[new THREE.SphereGeometry(1, 20, 14), (s) => [s, 0]]],
  [ELLIPSOID]: () => [[new THREE.SphereGeometry(1, 20, 14), (s) => [s, 0]]],
  [CAPSULE]: () => [[tube(), (s) => [s, 0]]],
  [CYLINDER]: () => [[rod(), (s) => [s, 0]]],
  [BOX]: () => [[new THREE.BoxGeometry(2, 2, 2), (s) => [s, 0]]],
  // An arrow is half as long as its size, and a third of its length is the head.
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

/** End points of the lines that draw a type of geoms. @type {Record<number, number[]>} */
const LINES = {
  [LINE]: [0, 0, 0, 0, 0, 1],
  [LINEBOX]: [0, 1, 2].flatMap((axis) => [[-1, -1], [-1, 1], [1, -1], [1, 1]].flatMap(([a, b]) =>
    [-1, 1].flatMap((end) => [0, 1, 2].map((k) =>
      k === axis ? end : k === (axis + 1) % 3 ? a : b)))),
};

/** Shears the y axis toward the x axis. @param {THREE.Matrix4} matrix @param {number} share shear factor */
function lean({ elements }, share) {
  for (let c = 0; c < 3; c++) elements[4 + c] += share * elements[c];
}

// The computation of each geom reuses these temporary objects.
const turn = new THREE.Quaternion(), at = new THREE.Vector3(), own = new THREE.Vector3();
const matrix = new THREE.Matrix4(), scaled = new THREE.Vector3(), colour = new THREE.Color();
/** @type {number[]} */
const size = [0, 0, 0];

/** Reads pose, size and color of a geom. @param {Geoms} geoms @param {number} k */
function read({ positions, rotations, sizes, rgba }, k) {
  turn.set(rotations[4 * k + 1], rotations[4 * k + 2], rotations[4 * k + 3], rotations[4 * k]).normalize();
  at.fromArray(positions, 3 * k);
  for (let c = 0; c < 3; c++) size[c] = sizes[3 * k + c];
  colour.setRGB(rgba[4 * k] / 255, rgba[4 * k + 1] / 255, rgba[4 * k + 2] / 255);
}

/** GLSL code for the light on arrows and axes from above the camera, with about the brightness in MuJoCo. */
const LIT = `#include <project_vertex>
  mat3 placed = mat3(instanceMatrix);
  vec3 across = normal / vec3(dot(placed[0], placed[0]), dot(placed[1], placed[1]), dot(placed[2], placed[2]));
  lit = .68 + .36 * max(dot(normalize(normalMatrix * (placed * across)), vec3(.23, .68, .69)), 0.);`;

/** Returns the material of a type of geoms. @param {number} type @param {boolean} isTransparent @param {boolean} isLit */
function materialOf(type, isTransparent, isLit) {
  const material = new THREE.MeshBasicMaterial({ side: THREE.DoubleSide, transparent: isTransparent });
  material.onBeforeCompile = (shader) => {
    if (type === CAPSULE) stretch(shader);
    shader.vertexShader = "attribute float look; varying float own, lit;\n" + shader.vertexShader
      .replace("void main() {", "void main() { own = look; lit = 1.;")
      .replace("#include <project_vertex>", isLit ? LIT : "#include <project_vertex>");
    shader.fragmentShader = "varying float own, lit;\n" + shader.fragmentShader
      .replace("#include <color_fragment>", "#include <color_fragment>\ndiffuseColor *= vec4(vec3(lit), own);");
  };
  material.customProgramCacheKey = () => `decor ${type === CAPSULE} ${isLit}`;
  return material;
}

/** A mesh that draws one shape of all geoms of a type, and grows with the number of geoms. */
class Solids {
  /** @param {number} type @param {boolean} isFaint @param {Shape} shape @param {THREE.Group} group */
  constructor(type, isFaint, [shape, scale], group) {
    this.type = type;
    this.shape = shape;
    this.scale = scale;
    this.group = group;
    this.material = materialOf(type, isFaint, Boolean(shape.userData.isLit));
    this.capacity = 0;
    this.look = new THREE.InstancedBufferAttribute(new Float32Array(0), 1);
    this.mesh = this.#make(4);
    /** Indices of the geoms that the instances show. @type {number[]} */
    this.shown = [];
  }

  /** @param {number} capacity */
  #make(capacity) {
    this.capacity = capacity;
    this.look = new THREE.InstancedBufferAttribute(new Float32Array(capacity), 1);
    this.shape.setAttribute("look", this.look);
    const mesh = new THREE.InstancedMesh(this.shape, this.material, capacity);
    mesh.setColorAt(0, colour);
    mesh.frustumCulled = false;
    this.group.add(mesh);
    return mesh;
  }

  /**
   * @param {Geoms} geoms @param {number[]} shown indices of the shown geoms
   * @param {Map<string, THREE.Vector3>} places of smart arrows
   */
  place(geoms, shown, places) {
    this.shown = shown;
    if (shown.length > this.capacity) {
      this.group.remove(this.mesh);
      this.mesh.dispose();
      this.shape.dispose(); // frees the attributes of the old instances, too
      this.mesh = this.#make(2 * shown.length);
    }
    const { mesh, look, scale, type } = this;
    mesh.count = shown.length;
    if (!shown.length) return;
    shown.forEach((k, i) => {
      read(geoms, k);
      const [factors, offset] = scale(size);
      own.set(0, 0, offset).applyQuaternion(turn).add(at);
      matrix.compose(own, turn, scaled.fromArray(factors));
      if (type === TRIANGLE) lean(matrix, size[2] / (size[0] || 1));
      mesh.setMatrixAt(i, matrix);
      mesh.setColorAt(i, colour);
      look.setX(i, geoms.rgba[4 * k + 3] / 255);
      if (geoms.of[3 * k] !== VECTOR) return;
      const key = `${VECTOR} ${geoms.of[3 * k + 1]}`;
      if (!places.has(key)) places.set(key, own.clone());
    });
    mesh.instanceMatrix.needsUpdate = look.needsUpdate = true;
    if (mesh.instanceColor) mesh.instanceColor.needsUpdate = true;
  }
}

/** A mesh of lines that draws all geoms of a type. */
class Lines {
  /** @param {number} type @param {THREE.Group} group */
  constructor(type, group) {
    this.type = type;
    this.corners = LINES[type];
    this.mesh = new THREE.LineSegments(new THREE.BufferGeometry(),
      new THREE.LineBasicMaterial({ vertexColors: true }));
    this.mesh.frustumCulled = false;
    this.capacity = 0;
    group.add(this.mesh);
  }

  /** @param {number} capacity */
  #make(capacity) {
    this.capacity = capacity;
    this.mesh.geometry.dispose();
    this.mesh.geometry = new THREE.BufferGeometry();
    for (const name of ["position", "color"]) {
      const numbers = new Float32Array(this.corners.length * capacity);
      this.mesh.geometry.setAttribute(name, new THREE.BufferAttribute(numbers, 3));
    }
  }

  /** @param {Geoms} geoms @param {number[]} shown indices of the shown geoms */
  place(geoms, shown) {
    if (shown.length > this.capacity) this.#make(2 * shown.length);
    const { geometry } = this.mesh, { position, color } = geometry.attributes, count = this.corners.length / 3;
    this.mesh.visible = shown.length > 0;
    if (!shown.length) return;
    geometry.setDrawRange(0, count * shown.length);
    shown.forEach((k, i) => {
      read(geoms, k);
      if (this.type === LINE) size[0] = size[1] = 1;
      for (let c = 0; c < count; c++) {
        own.fromArray(this.corners, 3 * c).multiply(scaled.fromArray(size));
        own.applyQuaternion(turn).add(at);
        position.setXYZ(count * i + c, own.x, own.y, own.z);
        color.setXYZ(count * i + c, colour.r, colour.g, colour.b);
      }
    });
    position.needsUpdate = color.needsUpdate = true;
  }
}

/** Draws all overlays, with one mesh per shape for opaque geoms, and one for transparent geoms. */
export class Items {
  /** @param {Run["arrows"]["shapes"]} arrows meshes of arrows and axes */
  constructor(arrows) {
    this.arrows = arrows;
    this.group = new THREE.Group();
    /** Positions of smart arrows, which billboards need. @type {Map<string, THREE.Vector3>} */
    this.places = new Map();
    /** Drawn objects by geom type. Keys of transparent geoms are negative. @type {Map<number, {shown: number[], solids: Solids[], lines: Lines[]}>} */
    this.types = new Map();
    /** @type {Geoms | null} */
    this.geoms = null;
  }

  /** @param {number} type @param {boolean} isFaint */
  #of(type, isFaint) {
    const key = isFaint ? -type : type;
    let found = this.types.get(key);
    if (!found) {
      const shapes = type >= this.arrows.first ? [this.#arrow(type)] : SHAPES[type]?.() ?? [];
      found = { shown: [], solids: shapes.map((shape) => new Solids(type, isFaint, shape, this.group)),
        lines: LINES[type] ? [new Lines(type, this.group)] : [] };
      this.types.set(key, found);
    }
    return found;
  }

  /** Returns a mesh of arrows or axes. @param {number} type @returns {Shape} */
  #arrow(type) {
    const { positions, index } = this.arrows.meshes[type - this.arrows.first];
    const shape = made(positions, index);
    shape.userData.isLit = true;
    return [shape, (size) => [size, 0]];
  }

  /** Updates all overlays. @param {Geoms} geoms */
  place(geoms) {
    this.geoms = geoms;
    for (const each of this.types.values()) each.shown.length = 0;
    for (let k = 0; k < geoms.count; k++) {
      const alpha = geoms.rgba[4 * k + 3];
      if (alpha) this.#of(geoms.of[3 * k + 2], alpha < 254).shown.push(k);
    }
    this.places.clear();
    for (const { shown, solids, lines } of this.types.values()) {
      for (const each of solids) each.place(geoms, shown, this.places);
      for (const each of lines) each.place(geoms, shown);
    }
  }

  /** Returns the nearest item on a ray. @param {THREE.Raycaster} ray */
  pick(ray) {
    const all = [...this.types.values()].flatMap(({ solids }) => solids).filter(({ mesh }) => mesh.count);
    for (const { mesh } of all) mesh.boundingSphere = null; // The bounding sphere is out of date.
    const [hit] = ray.intersectObjects(all.map(({ mesh }) => mesh));
    if (!hit || hit.instanceId === undefined || !this.geoms) return null;
    const k = all.find(({ mesh }) => mesh === hit.object)?.shown[hit.instanceId] ?? 0;
    return { of: [...this.geoms.of.subarray(3 * k, 3 * k + 3)], distance: hit.distance };
  }
}
