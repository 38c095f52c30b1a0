/** Straight tubes with round ends between moving points, which show tendons and one-dimensional flexes. */

import * as THREE from "three";

const TURN = Math.PI / 2;

/**
 * Returns a capsule of radius 1. The scale of a matrix makes it longer, but the ends remain round: z
 * of a vertex is relative to the center of its end sphere, and the attribute `end` is the sign of z.
 */
export function tube() {
  const shape = new THREE.CapsuleGeometry(1, 2, 6, 16).rotateX(TURN);
  const { position } = shape.attributes, end = new Float32Array(position.count);
  for (let i = 0; i < position.count; i++) {
    end[i] = Math.sign(position.getZ(i)) || 1;
    position.setZ(i, position.getZ(i) - end[i]);
  }
  shape.setAttribute("end", new THREE.BufferAttribute(end, 1));
  return shape;
}

/** Makes a shader draw `tube` with instances. @param {{vertexShader: string}} shader */
export function stretch(shader) {
  shader.vertexShader = "attribute float end;\n" + shader.vertexShader
    .replace("#include <beginnormal_vertex>", `vec2 scale = vec2(length(instanceMatrix[0]), length(instanceMatrix[2]));
      vec3 objectNormal = vec3(normal.xy, normal.z * scale.y / max(scale.x, 1e-9));`)
    .replace("#include <begin_vertex>", `vec2 thick = vec2(length(instanceMatrix[0]), length(instanceMatrix[2]));
      vec3 transformed = vec3(position.xy, end + position.z * thick.x / max(thick.y, 1e-9));`);
}

/** Many tubes in one mesh. */
export class Tubes {
  /** @param {THREE.Material} material @param {number} count */
  constructor(material, count) {
    const { onBeforeCompile: finish } = material;
    material.onBeforeCompile = (shader, renderer) => {
      stretch(shader);
      finish(shader, renderer);
    };
    this.mesh = new THREE.InstancedMesh(tube(), material, count);
    this.mesh.frustumCulled = false;
    this.mesh.castShadow = true;
    this.mesh.customDepthMaterial = new THREE.MeshDepthMaterial();
    this.mesh.customDepthMaterial.onBeforeCompile = stretch;
  }

  /**
   * Updates a tube.
   * @param {number} k @param {THREE.Vector3} from @param {THREE.Vector3} to
   * @param {number} radius m; 0 hides the tube
   */
  place(k, from, to, radius) {
    const way = to.clone().sub(from), half = Math.max(way.length() / 2, 1e-6);
    const turn = new THREE.Quaternion().setFromUnitVectors(new THREE.Vector3(0, 0, 1), way.normalize());
    const scale = radius > 0 ? new THREE.Vector3(radius, radius, half) : new THREE.Vector3();
    const middle = from.clone().add(to).multiplyScalar(0.5);
    this.mesh.setMatrixAt(k, new THREE.Matrix4().compose(middle, turn, scale));
    this.mesh.instanceMatrix.needsUpdate = true;
  }
}
