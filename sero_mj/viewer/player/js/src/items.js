/** Decor that is stored geom by geom: smart arrows, axes and what other packages draw. */

import * as THREE from "three";

/** @typedef {import("./data.js").Run} Run */

const ARROW = 100, TRIANGLE = 106; // mjtGeom: mjGEOM_ARROW, mjGEOM_TRIANGLE
const TURNED = Math.PI / 2;

/** The unit shapes of a type, each with how a geom's size scales it. @param {number} type */
function shapesOf(type) {
  /** @typedef {(size: number[]) => [number[], number]} Scale scale, and offset along z */
  /** @type {[THREE.BufferGeometry, Scale][]} */
  let shapes = [];
  if (type === ARROW) {
    // Drawn half as long as its size, a third of that head.
    shapes = [
      [new THREE.CylinderGeometry(1, 1, 1, 20).rotateX(TURNED),
        ([a, , c]) => [[a, a, c / 3], c / 6]],
      [new THREE.ConeGeometry(1, 1, 24).rotateX(TURNED),
        ([a, , c]) => [[1.75 * a, 1.75 * a, c / 6], c * 5 / 12]],
    ];
  } else if (type === TRIANGLE) {
    const triangle = new THREE.BufferGeometry();
    const corners = new Float32Array([0, 0, 0, 1, 0, 0, 0, 1, 0]);
    triangle.setAttribute("position", new THREE.BufferAttribute(corners, 3));
    triangle.computeVertexNormals();
    shapes = [[triangle, ([a, b]) => [[a, b, 1], 0]]];
  } else if (type === 2 || type === 4) {
    const scale = /** @type {Scale} */ ((s) => [type === 2 ? [s[0], s[0], s[0]] : s, 0]);
    shapes = [[new THREE.SphereGeometry(1, 20, 14), scale]];
  } else if (type === 3 || type === 5) {
    shapes = [[new THREE.CylinderGeometry(1, 1, 2, 20).rotateX(TURNED), ([a, b]) => [[a, a, b], 0]]];
  } else if (type === 6) {
    shapes = [[new THREE.BoxGeometry(2, 2, 2), (s) => [s, 0]]];
  }
  return shapes;
}

/** All of it, one mesh for each shape. */
export class Items {
  /** @param {Run} run */
  constructor(run) {
    this.run = run;
    this.group = new THREE.Group();
    /** Where each kind and item is, for cards. @type {Map<string, THREE.Vector3>} */
    this.places = new Map();
    /** @type {{mesh: THREE.InstancedMesh, of: number[], scale: (s: number[]) => any}[]} */
    this.meshes = [];
    const types = new Set(run.items.of.map((/** @type {number[]} */ each) => each[2]));
    for (const type of types) {
      const of = [...run.items.of.keys()].filter((k) => run.items.of[k][2] === type);
      for (const [shape, scale] of shapesOf(type)) {
        const material = new THREE.MeshPhongMaterial({
          specular: 0x202020, side: THREE.DoubleSide, transparent: false,
        });
        // As bright as round arrows, also where no lamp is.
        material.onBeforeCompile = (shader) => {
          shader.fragmentShader = shader.fragmentShader.replace("#include <emissivemap_fragment>",
            "totalEmissiveRadiance += .45 * diffuseColor.rgb;");
        };
        const mesh = new THREE.InstancedMesh(shape, material, of.length);
        mesh.frustumCulled = false;
        this.group.add(mesh);
        this.meshes.push({ mesh, of, scale });
      }
    }
  }

  /** Places it. @param {number} frame */
  place(frame) {
    const { items, frames } = this.run, { visible, positions, rotations, sizes, colours } = items;
    if (!visible || !positions || !rotations || !sizes || !colours) return;
    const turn = new THREE.Quaternion(), at = new THREE.Vector3(), matrix = new THREE.Matrix4();
    const own = new THREE.Vector3(), scaled = new THREE.Vector3(), colour = new THREE.Color();
    /** @param {Float32Array} of @param {number} channel */
    const read = (of, channel) => of[channel * frames + frame];
    this.places.clear();
    for (const { mesh, of, scale } of this.meshes) {
      of.forEach((k, i) => {
        const isShown = read(visible, k) > 0.5;
        turn.set(read(rotations, 4 * k + 1), read(rotations, 4 * k + 2),
          read(rotations, 4 * k + 3), read(rotations, 4 * k)).normalize();
        at.set(read(positions, 3 * k), read(positions, 3 * k + 1), read(positions, 3 * k + 2));
        const [factors, offset] = scale([0, 1, 2].map((c) => read(sizes, 3 * k + c)));
        own.set(0, 0, offset).applyQuaternion(turn).add(at);
        scaled.fromArray(factors).multiplyScalar(isShown ? 1 : 0);
        mesh.setMatrixAt(i, matrix.compose(own, turn, scaled));
        mesh.setColorAt(i, colour.setRGB(
          read(colours, 4 * k), read(colours, 4 * k + 1), read(colours, 4 * k + 2)));
        const key = `${items.of[k][0]} ${items.of[k][1]}`;
        if (isShown && !this.places.has(key)) this.places.set(key, own.clone());
      });
      mesh.instanceMatrix.needsUpdate = true;
      if (mesh.instanceColor) mesh.instanceColor.needsUpdate = true;
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
