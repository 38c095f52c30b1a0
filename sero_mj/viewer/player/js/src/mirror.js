/** A reflecting plane, which shows the scene as seen by a camera behind the plane. Scenes have at most one. */

import * as THREE from "three";

/** @typedef {import("./data.js").Run} Run */
/** @typedef {import("./data.js").Geom} Geom */

const PLANE = 0; // mjtGeom
const ABOVE = 1e-3; // height above the plane from which objects are reflected, m

/** Returns the reflecting plane and its reflectance, or undefined. @param {Run} run */
export function mirrorOf({ geoms, materials }) {
  const geom = geoms.find(({ type, material, rgba }) => type === PLANE && rgba[3] === 255
    && material !== undefined && materials[material].finish[3] > 0);
  return geom && { geom, share: materials[geom.material ?? 0].finish[3] };
}

/** Draws the reflection in a plane. */
export class Mirror {
  constructor() {
    this.target = new THREE.WebGLRenderTarget(4, 4, { samples: 4 });
    this.camera = new THREE.PerspectiveCamera();
    /** Uniforms for the shader of surfaces. */
    this.uniforms = {
      mirror: { value: this.target.texture },
      toMirror: { value: new THREE.Matrix4() },
      isMirror: { value: 0 },
    };
  }

  /**
   * @param {THREE.WebGLRenderer} renderer @param {THREE.Scene} scene
   * @param {THREE.PerspectiveCamera} eye @param {THREE.Matrix4} pose of the plane
   */
  draw(renderer, scene, eye, pose) {
    const { camera, uniforms, target } = this;
    uniforms.isMirror.value = 0;
    const at = new THREE.Vector3().setFromMatrixPosition(pose);
    const up = new THREE.Vector3().setFromMatrixColumn(pose, 2).normalize();
    const from = new THREE.Vector3().setFromMatrixPosition(eye.matrixWorld);
    if (from.clone().sub(at).dot(up) <= ABOVE) return;
    /** @param {THREE.Vector3} point */
    const mirrored = (point) => point.addScaledVector(up, -2 * point.clone().sub(at).dot(up));
    const ahead = new THREE.Vector3(0, 0, -1).applyMatrix4(eye.matrixWorld);
    const over = new THREE.Vector3(0, 1, 0).transformDirection(eye.matrixWorld);
    camera.position.copy(mirrored(from));
    camera.up.copy(over.reflect(up));
    camera.lookAt(mirrored(ahead));
    camera.projectionMatrix.copy(eye.projectionMatrix);
    camera.updateMatrixWorld();
    uniforms.toMirror.value.set(0.5, 0, 0, 0.5, 0, 0.5, 0, 0.5, 0, 0, 0.5, 0.5, 0, 0, 0, 1)
      .multiply(camera.projectionMatrix).multiply(camera.matrixWorldInverse);
    this.#cut(new THREE.Plane().setFromNormalAndCoplanarPoint(up, at.addScaledVector(up, ABOVE)));
    const size = renderer.getDrawingBufferSize(new THREE.Vector2());
    target.setSize(Math.max(size.x >> 1, 1), Math.max(size.y >> 1, 1));
    const { shadowMap } = renderer, hasShadows = shadowMap.autoUpdate;
    shadowMap.autoUpdate = false;
    renderer.setRenderTarget(target);
    renderer.clear();
    renderer.render(scene, camera);
    renderer.setRenderTarget(null);
    shadowMap.autoUpdate = hasShadows;
    uniforms.isMirror.value = 1;
  }

  /** Makes a plane in the world the near clipping plane of the camera. @param {THREE.Plane} plane */
  #cut(plane) {
    const { camera } = this, { elements: e } = camera.projectionMatrix;
    const { normal: n, constant } = plane.applyMatrix4(camera.matrixWorldInverse);
    const q = new THREE.Vector4((Math.sign(n.x) + e[8]) / e[0], (Math.sign(n.y) + e[9]) / e[5], -1,
      (1 + e[10]) / e[14]);
    const cut = new THREE.Vector4(n.x, n.y, n.z, constant);
    cut.multiplyScalar(2 / cut.dot(q));
    [e[2], e[6], e[10], e[14]] = [cut.x, cut.y, cut.z + 1, cut.w];
    camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
  }
}
