/** The lights of a model with its own lights, as bright as in MuJoCo's classic renderer. */

import * as THREE from "three";

/** @typedef {import("./data.js").Run} Run */
/** @typedef {import("./data.js").Lamp} Lamp */

const FULL = Math.PI; // intensity at which a lamp does not change colors
const DIRECTIONAL = 1, POINT = 2; // mjtLightType
const MAX_LIGHTS = 8; // maximum number of lights in MuJoCo's classic renderer
const MAX_EXPONENT = 128; // maximum exponent with which the intensity of a spot light decreases off its axis

// The edges of spot lights are as soft as in OpenGL, where the exponent determines the softness.
const chunks = THREE.ShaderChunk;
chunks.lights_pars_begin = chunks.lights_pars_begin.replace(
  "return smoothstep( coneCosine, penumbraCosine, angleCosine );",
  `float exponent = ${MAX_EXPONENT}. * (1. - acos(penumbraCosine) / acos(coneCosine));
  return step(coneCosine, angleCosine) * pow(max(angleCosine, 0.), exponent);`);

/** @param {number[]} rgb */
const colour = ([r, g, b]) => new THREE.Color(r, g, b);

/** The lights of a model, which are attached to the camera and to bodies. */
export class Lamps {
  /**
   * @param {import("./data.js").Lights} lights @param {THREE.Scene} scene
   * @param {THREE.Camera} camera @param {number} reach half the side length of the area with shadows, m
   */
  constructor(lights, scene, camera, reach) {
    const ambient = lights.others.reduce(
      (sum, { ambient: each }) => sum.add(colour(each)), colour(lights.ambient));
    const head = new THREE.DirectionalLight(colour(lights.diffuse), FULL);
    head.position.set(0, 0, 0);
    head.target.position.set(0, 0, -1);
    camera.add(head, head.target);
    scene.add(new THREE.AmbientLight(ambient, FULL));
    this.lamps = lights.others.slice(0, MAX_LIGHTS).map((lamp) => ({ lamp, light: this.#made(lamp) }));
    for (const { light } of this.lamps) {
      scene.add(light);
      if (!(light instanceof THREE.PointLight)) scene.add(light.target);
    }
    const found = this.lamps.find(({ lamp }) => lamp.shadow && lamp.type !== POINT);
    /** The lamp that casts shadows. */
    this.sun = /** @type {THREE.DirectionalLight | THREE.SpotLight} */ (
      found ? found.light : new THREE.DirectionalLight());
    this.sun.shadow.mapSize.set(1024, 1024);
    this.sun.shadow.bias = -0.0006;
    this.sun.shadow.normalBias = 0.006;
    if (this.sun instanceof THREE.DirectionalLight) {
      Object.assign(this.sun.shadow.camera,
        { left: -reach, right: reach, top: reach, bottom: -reach, near: 0.1, far: 100 });
    }
  }

  /** @param {Lamp} lamp */
  #made({ type, diffuse, cutoff, exponent }) {
    const rgb = colour(diffuse), angle = Math.min(cutoff, 89) * Math.PI / 180;
    if (type === DIRECTIONAL) return new THREE.DirectionalLight(rgb, FULL);
    if (type === POINT || cutoff >= 180) return new THREE.PointLight(rgb, FULL, 0, 0);
    return new THREE.SpotLight(rgb, FULL, 0, angle, Math.min(exponent / MAX_EXPONENT, 1), 0);
  }

  /** Updates the lights. @param {THREE.Matrix4[]} bodies */
  place(bodies) {
    for (const { lamp, light } of this.lamps) {
      const at = new THREE.Vector3().fromArray(lamp.pos), way = new THREE.Vector3().fromArray(lamp.dir);
      light.position.copy(at.clone().applyMatrix4(bodies[lamp.body]));
      if (light instanceof THREE.PointLight) continue;
      light.target.position.copy(at.add(way).applyMatrix4(bodies[lamp.body]));
    }
  }
}
