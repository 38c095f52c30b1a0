/** The surroundings of a scene, which are declared for both looks: sky, floor, haze and light. */

import * as THREE from "three";
import { Occlusion } from "./occlusion.js";
import { shade } from "./shading.js";

/** @typedef {import("./data.js").Run} Run */
/** @typedef {import("./view.js").Look} Look */

export const BACKDROP = 1; // layer of the sky, which planes do not reflect
const SOFTNESS = 0.1; // half the width of a shadow's edge for a lamp with a radius of 1 m, m
const MAX_BLUR = 4; // maximum blur, above which shadow edges become grainy, texels

// By default, three.js computes and rotates the five points at which it samples shadows for every pixel.
// Constant points save a tenth of the time in software, and edges have no grain.
const chunks = THREE.ShaderChunk, disk = /vec2 vogelDiskSample\([^{]*{[^}]*}/;
chunks.shadowmap_pars_fragment = chunks.shadowmap_pars_fragment.replace(disk,
  `const vec2 DISK[5] = vec2[5](vec2(0.3162, 0.0000), vec2(-0.4039, 0.3700), vec2(0.0618, -0.7044), vec2(0.5091, 0.6640), vec2(-0.9342, -0.1652));
  vec2 vogelDiskSample(int k, int count, float phi) { return DISK[k]; }`);

/** @param {number[]} rgb */
const vector = (rgb) => new THREE.Vector3().fromArray(rgb);

/** Converts displayed colors to linear light. @param {number[]} rgb */
function lightOf([r, g, b]) {
  const { r: x, g: y, b: z } = new THREE.Color(r, g, b).convertSRGBToLinear();
  return new THREE.Vector3(x, y, z);
}

const SKY = `
  varying vec3 way; uniform vec3 sky[2]; uniform vec3 haze; uniform float edge;
  void main() {
    float up = normalize(way).z; // The gradient is that of MuJoCo's skybox.
    vec3 rgb = mix(sky[0], sky[1], clamp(.5 + .7071 * up, 0., 1.));
    gl_FragColor = vec4(mix(rgb, haze, clamp(-up / edge, 0., 1.)), 1.);
  }`;

// This function returns the color of a checkerboard with lines around every two tiles. Source of the
// filter: Quilez, Filtering the checkerboard pattern, 2017.
const TILES = `
  vec3 tiled(vec2 at) {
    vec2 wide = max(fwidth(at), 1e-4), whole = abs(fract(.5 * at) - .5);
    vec2 odd = 2. * (abs(fract((at - .5 * wide) * .5) - .5) - abs(fract((at + .5 * wide) * .5) - .5)) / wide;
    vec2 line = clamp((1. / 128. + .5 * wide - 2. * whole) / wide, 0., 1.) * min(vec2(1.), 1. / 64. / wide);
    return mix(mix(tiles[0], tiles[1], .5 + .5 * odd.x * odd.y), tiles[2], max(line.x, line.y));
  }`;

/** Draws sky and floor, and provides the light from both. */
export class Surroundings {
  /** @param {Run} run */
  constructor(run) {
    this.run = run;
    /** Half the side length of the area with shadows, m. */
    this.reach = 0.6 * run.eye.distance;
    const { looks, floor } = run.surroundings;
    const { reflections: levels } = looks.light;
    this.uniforms = {
      fill: { value: new THREE.Vector3() },
      reflections: { value: new THREE.DataTexture(new Uint16Array(levels.length * levels[0].length),
        levels[0].length, levels.length, THREE.RedFormat, THREE.HalfFloatType) },
      sky: { value: [new THREE.Vector3(), new THREE.Vector3()] },
      tiles: { value: [0, 0, 0].map(() => new THREE.Vector3()) },
      haze: { value: new THREE.Vector3() },
      edge: { value: 1e9 },
    };
    const { value: texture } = this.uniforms.reflections;
    texture.minFilter = texture.magFilter = THREE.LinearFilter;
    this.backdrop = this.#backdrop();
    this.occlusion = new Occlusion(run, floor?.height ?? 0);
    this.floor = this.#floor();
    this.sun = run.lights ? null : this.#sun();
    this.group = new THREE.Group().add(this.backdrop, this.floor);
    if (this.sun) this.group.add(this.sun, this.sun.target);
    this.far = floor ? floor.far : 0;
  }

  #backdrop() {
    const shape = new THREE.BufferGeometry();
    shape.setAttribute("position", new THREE.Float32BufferAttribute([-1, -1, 0, 3, -1, 0, -1, 3, 0], 3));
    const sky = new THREE.Mesh(shape, new THREE.ShaderMaterial({
      uniforms: this.uniforms, depthWrite: false, fragmentShader: SKY,
      vertexShader: `varying vec3 way;
        void main() {
          vec2 at = vec2(position.x / projectionMatrix[0][0], position.y / projectionMatrix[1][1]);
          way = vec3(at, -1.) * mat3(viewMatrix);
          gl_Position = vec4(position.xy, 1., 1.);
        }`,
    }));
    sky.layers.set(BACKDROP);
    sky.frustumCulled = false;
    sky.renderOrder = 0.5; // The sky is drawn after opaque parts and before transparent ones.
    return sky;
  }

  #floor() {
    const { lights, surroundings: { floor } } = this.run;
    const { far, haze, tile, height } = floor ?? { far: 1, haze: 1, tile: 1, height: 0 };
    const material = new THREE.MeshPhongMaterial({
      specular: 0, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1,
    });
    material.defines = { MATTE: "" };
    material.onBeforeCompile = (shader) => {
      Object.assign(shader.uniforms, { tiles: this.uniforms.tiles, haze: this.uniforms.haze });
      shader.vertexShader = "varying vec2 spot;\n" + shader.vertexShader.replace("#include <begin_vertex>",
        "#include <begin_vertex>\nspot = (modelMatrix * vec4(position, 1.)).xy;");
      shader.fragmentShader = `varying vec2 spot; uniform vec3 tiles[3]; uniform vec3 haze;${TILES}\n`
        + shader.fragmentShader
          .replace("#include <color_fragment>", `diffuseColor.rgb = tiled(spot / ${tile.toFixed(6)});`)
          .replace("#include <fog_fragment>", `gl_FragColor.rgb = mix(gl_FragColor.rgb, haze,
            clamp((length(vViewPosition) - ${haze.toFixed(3)}) / ${(far - haze).toFixed(3)}, 0., 1.));`);
      if (lights) return;
      shade(shader, this.uniforms, "Surface(diffuseColor.rgb, vec3(0.), 1.)");
      this.occlusion.shade(shader);
    };
    const mesh = new THREE.Mesh(new THREE.CircleGeometry(far, 64), material);
    mesh.position.z = height;
    mesh.visible = floor !== null;
    mesh.frustumCulled = false;
    mesh.receiveShadow = true;
    mesh.renderOrder = 0.4;
    return mesh;
  }

  #sun() {
    const reach = this.reach, sun = new THREE.DirectionalLight(0xffffff);
    sun.castShadow = true;
    const side = 1024, { bulb } = this.run.surroundings.looks.light;
    sun.shadow.mapSize.set(side, side);
    sun.shadow.radius = Math.min(SOFTNESS * bulb / (2 * reach / side), MAX_BLUR);
    Object.assign(sun.shadow.camera, {
      left: -reach, right: reach, top: reach, bottom: -reach, near: 0.1, far: 5 * reach,
    });
    sun.shadow.bias = -0.0006;
    sun.shadow.normalBias = 0.006;
    return sun;
  }

  /** @param {THREE.DirectionalLight} sun @param {number[]} moved m */
  #aim(sun, moved) {
    const { eye, surroundings } = this.run;
    sun.target.position.fromArray(eye.lookAt).add(vector(moved));
    sun.position.copy(sun.target.position)
      .addScaledVector(vector(surroundings.towards).normalize(), -2 * this.reach);
  }

  /** @param {Look} look */
  setLook(look) {
    const { uniforms, run } = this, { sky, tiles, haze, fill, reflections, key } = run.surroundings.looks[look];
    uniforms.sky.value = sky.map(vector);
    uniforms.tiles.value = tiles.map((rgb) => this.run.lights ? vector(rgb) : lightOf(rgb));
    uniforms.haze.value.fromArray(haze);
    uniforms.fill.value.fromArray(fill);
    const { value: texture } = uniforms.reflections;
    /** @type {Uint16Array} */ (texture.image.data).set(reflections.flat().map(THREE.DataUtils.toHalfFloat));
    texture.needsUpdate = true;
    if (this.sun) this.sun.intensity = Math.PI * key; // three.js divides by pi.
  }

  /**
   * Moves sky and floor with the camera.
   * @param {THREE.Camera} camera @param {number[]} moved displacement of the followed frame, m
   * @param {THREE.Matrix4[]} matrices poses of bodies
   */
  place(camera, moved, matrices) {
    if (this.sun) this.#aim(this.sun, moved);
    const { x, y, z } = camera.position, { floor } = this;
    if (!floor.visible) return;
    if (!this.run.lights) this.occlusion.place(matrices);
    floor.position.set(x, y, floor.position.z);
    this.uniforms.edge.value = z > floor.position.z ? (z - floor.position.z) / this.far : 1e9;
  }

  /** Frees the textures. */
  dispose() {
    this.uniforms.reflections.value.dispose();
    this.occlusion.dispose();
  }
}
