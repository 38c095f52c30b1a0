/** The displayed scene, with camera, surroundings and robots. */

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { mixer } from "./data.js";
import { placeOf, standingBack, viewFrom } from "./eye.js";
import { ARROW } from "./geoms.js";
import { Items } from "./items.js";
import { Lamps } from "./lights.js";
import { Robots, matrixOf } from "./robots.js";
import { SoftParts } from "./soft.js";
import { BACKDROP, Surroundings } from "./surroundings.js";

/** @typedef {import("./data.js").Run} Run */

const CLOSE = 5; // distance within which arrows are hit, pixels
const SLOW = 60; // time per frame above which shadows are omitted, and then the depth of doubles, ms

/** Returns the renderer of a canvas. Throws an error if WebGL 2 is not available. @param {HTMLCanvasElement} canvas */
export function rendererOf(canvas) {
  // MuJoCo's classic renderer computes with displayed colors, not linear ones.
  THREE.ColorManagement.enabled = false;
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
  renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
  renderer.shadowMap.enabled = true;
  renderer.shadowMap.type = THREE.PCFShadowMap;
  return renderer;
}

/** The scene that WebGL draws. */
export class Stage {
  /** @param {Run} run @param {THREE.WebGLRenderer} renderer */
  constructor(run, renderer) {
    this.run = run;
    this.renderer = renderer;
    const canvas = this.canvas = renderer.domElement;
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(run.eye.fovy, 1, 0.01,
      Math.max(100, 4 * run.eye.distance, run.reach ?? 0, 1.1 * (run.surroundings.floor?.far ?? 0)));
    this.camera.up.set(0, 0, 1);
    this.camera.layers.enable(BACKDROP);
    this.orbit = new OrbitControls(this.camera, canvas);
    this.orbit.mouseButtons.MIDDLE = THREE.MOUSE.PAN;
    this.fixed = -1;
    /** Displacement of the camera, which follows a frame, m. */
    this.followed = [0, 0, 0];
    this.surroundings = new Surroundings(run);
    const sky = run.lights ? null : this.surroundings.uniforms;
    this.robots = new Robots(run, sky);
    this.items = new Items(run.arrows.shapes);
    this.soft = new SoftParts(run, sky);
    this.lamps = run.lights && new Lamps(run.lights, this.scene, this.camera, 0.6 * run.eye.distance);
    /** The light that casts shadows. */
    this.sun = this.lamps ? this.lamps.sun : this.surroundings.sun;
    this.sites = run.joints.map(() => new THREE.Matrix4());
    this.own = run.joints.map((joint) => matrixOf(joint.pos, joint.quat));
    this.scene.add(this.robots.group, this.items.group, this.soft.group,
      this.surroundings.group, this.camera);
    this.size = { width: 1, height: 1 };
    this.spent = 0; // smoothed time per frame, ms
    this.hasShadows = true;
    this.chooseCamera(run.eye.fixed);
  }

  /** Uses a camera of the scene, or the initial view. @param {number} number -1 for the initial view */
  chooseCamera(number) {
    const { eye, cameras } = this.run;
    this.fixed = number < cameras.length ? number : -1;
    this.orbit.enabled = true;
    if (this.fixed >= 0) return;
    this.followed = [0, 0, 0];
    this.look(eye);
  }

  /** Factor for the camera's distance, which is above 1 in narrow images. */
  get back() { return standingBack(this.run.eye.aspect, this.size.width, this.size.height); }

  /** Uses a free camera. @param {import("./eye.js").View} view its distance is that for wide images */
  look(view) {
    this.fixed = -1;
    this.camera.fov = this.run.eye.fovy;
    this.camera.position.fromArray(placeOf({ ...view, distance: view.distance * this.back }));
    this.orbit.target.fromArray(view.lookAt);
    this.camera.updateProjectionMatrix();
    this.orbit.update();
  }

  /** Moves the free camera with the followed frame. @param {number[]} way m */
  shift(way) {
    this.followed = this.followed.map((each, k) => each + way[k]);
    const moved = new THREE.Vector3().fromArray(way);
    this.camera.position.add(moved);
    this.orbit.target.add(moved);
    this.orbit.update();
  }

  /** Moves the camera along its path in the run. The user can still rotate the camera. @param {number} at frame */
  #follow(at) {
    const { follow, frames } = this.run;
    if (!follow) return;
    const mix = mixer(at, frames), now = [0, 1, 2].map((c) => mix(follow, c));
    if (this.fixed < 0) this.shift(now.map((each, k) => each - this.followed[k]));
    else this.followed = now;
  }

  /** Parameters of the free camera, with its distance for wide images. */
  get view() {
    const view = viewFrom(this.camera.position.toArray(), this.orbit.target.toArray());
    return { ...view, distance: view.distance / this.back };
  }

  /** Replaces a camera of the scene by a free camera with the same view, which the user can rotate. */
  free() {
    if (this.fixed < 0) return;
    this.fixed = -1;
    const ahead = new THREE.Vector3(0, 0, -this.run.eye.distance);
    this.orbit.target.copy(ahead.applyQuaternion(this.camera.quaternion).add(this.camera.position));
    this.orbit.update();
  }

  /** @param {number} width @param {number} height pixels of the page */
  resize(width, height) {
    const isFirst = this.size.width === 1, before = this.back;
    this.size = { width, height };
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / Math.max(height, 1);
    this.camera.updateProjectionMatrix();
    if (isFirst) this.chooseCamera(this.fixed);
    else if (this.fixed < 0) this.camera.position.sub(this.orbit.target).multiplyScalar(this.back / before).add(this.orbit.target);
  }

  /** @param {import("./view.js").Look} look */
  setLook(look) { this.surroundings.setLook(look); }

  /**
   * Updates all parts of the scene.
   * @param {number} at frame with a fractional part @param {boolean} hasDoubles
   * @param {(sites: THREE.Matrix4[]) => import("./geoms.js").Geoms} geoms
   *   returns the geoms of overlays for the poses of the joints
   * @param {{positions: Float32Array, turns: Float32Array} | null} [sites] poses of joints in the world
   */
  place(at, hasDoubles, geoms, sites = null) {
    const { run, robots } = this;
    robots.place(at, hasDoubles);
    run.joints.forEach((joint, j) => {
      if (sites) this.sites[j].copy(matrixOf([...sites.positions.subarray(3 * j, 3 * j + 3)], [...sites.turns.subarray(4 * j, 4 * j + 4)]));
      else this.sites[j].multiplyMatrices(robots.matrices[joint.body], this.own[j]);
    });
    this.items.place(geoms(this.sites));
    this.soft.place(at, robots.matrices);
    this.lamps?.place(robots.matrices);
    if (this.sun) this.sun.castShadow = this.hasShadows;
    if (this.fixed >= 0) {
      const { body, pos, quat, fovy } = run.cameras[this.fixed];
      const pose = robots.matrices[body].clone().multiply(matrixOf(pos, quat));
      pose.decompose(this.camera.position, this.camera.quaternion, new THREE.Vector3());
      if (this.camera.fov !== fovy) {
        this.camera.fov = fovy;
        this.camera.updateProjectionMatrix();
      }
    }
    this.#follow(at);
    this.camera.updateMatrixWorld();
    this.surroundings.place(this.camera, this.followed, robots.matrices);
  }

  /** Draws the scene. @returns {number} number of draw calls */
  draw() {
    this.robots.reflect(this.renderer, this.scene, this.camera, this.hasShadows);
    this.renderer.render(this.scene, this.camera);
    return this.renderer.info.render.calls;
  }

  /**
   * Omits expensive effects if rendering is slow.
   * @param {number} spent time since the last frame in ms, while frames are drawn continuously
   */
  notePace(spent) {
    this.spent += 0.1 * (Math.min(spent, 500) - this.spent);
    if (this.spent < SLOW) return;
    this.spent = 0;
    if (this.hasShadows) this.hasShadows = false;
    else this.robots.depth.visible = false;
  }

  /** Returns the center of a joint in m. @param {number} joint */
  centre(joint) { return new THREE.Vector3().setFromMatrixPosition(this.sites[joint]); }

  /** Returns the pixel of a point (y points down), and whether the point is in front of the camera. @param {THREE.Vector3} place */
  pixel(place) {
    const { x, y, z } = place.clone().project(this.camera), { width, height } = this.size;
    return { x: (x + 1) / 2 * width, y: (1 - y) / 2 * height, isSeen: z < 1 };
  }

  /** Returns the item at a pixel (y points down), or null. @param {number} x @param {number} y */
  pick(x, y) {
    const [item, geom] = this.#hit(x, y);
    if (item) {
      const [kind, number] = item.of;
      return kind === ARROW ? { joint: number } : { kind, item: number };
    }
    for (let k = 0; k < 8; k++) { // Thin arrows are hit by pixels that are close to them.
      const angle = k * Math.PI / 4, [near] = this.#hit(x + CLOSE * Math.cos(angle), y + CLOSE * Math.sin(angle));
      if (near?.of[0] === ARROW) return { joint: near.of[1] };
    }
    if (!geom) return null;
    const body = this.run.bodies[geom.geom.body];
    return { body: body.name, joint: body.joint };
  }

  /** Returns the item at a pixel unless a robot covers it, and the geom of a robot at this pixel. */
  #hit(/** @type {number} */ x, /** @type {number} */ y) {
    const { width, height } = this.size, ray = new THREE.Raycaster();
    ray.setFromCamera(new THREE.Vector2(2 * x / width - 1, 1 - 2 * y / height), this.camera);
    const geom = this.robots.pick(ray.ray), item = this.items.pick(ray);
    return /** @type {const} */ ([item && geom && geom.distance < item.distance ? null : item, geom]);
  }

  /** Frees all resources on the graphics card except the renderer. */
  dispose() {
    this.orbit.dispose();
    this.robots.dispose();
    this.surroundings.dispose();
    this.scene.traverse((each) => {
      if (each instanceof THREE.Light && "shadow" in each) each.dispose();
      if (!(each instanceof THREE.Mesh || each instanceof THREE.LineSegments)) return;
      each.geometry.dispose();
      for (const material of [each.material].flat()) material.dispose();
      if (each instanceof THREE.InstancedMesh) each.dispose();
      each.customDepthMaterial?.dispose();
    });
  }
}
