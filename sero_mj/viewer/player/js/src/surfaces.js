/** Materials, textures and texture coordinates, with the rules of MuJoCo. */

import * as THREE from "three";
import { shade } from "./shading.js";

/** @typedef {import("./data.js").Run} Run */
/** @typedef {import("./data.js").Geom} Geom */
/** @typedef {import("./shading.js").SkyUniforms} SkyUniforms */

const PLANE = 0, SPHERE = 2, CAPSULE = 3, CYLINDER = 5, BOX = 6; // mjtGeom
export const MESH = 7;
const PLAIN = [0, 0.5, 0.5, 0]; // finish of geoms without a material
const UP = Math.PI / 2;

/** Returns the textures of a run. @param {Run} run @returns {THREE.Texture[]} */
export function texturesOf(run) {
  return run.textures.map(({ cube, width, height, pixels }) => {
    const size = 4 * width * height;
    const faces = [...Array(cube ? 6 : 1).keys()].map((k) => {
      const face = new THREE.DataTexture(pixels.subarray(k * size, (k + 1) * size), width, height);
      face.needsUpdate = true;
      return face;
    });
    const texture = cube ? new THREE.CubeTexture(faces) : faces[0];
    texture.wrapS = texture.wrapT = cube ? THREE.ClampToEdgeWrapping : THREE.RepeatWrapping;
    texture.magFilter = THREE.LinearFilter;
    texture.minFilter = THREE.LinearMipmapLinearFilter;
    texture.anisotropy = 4;
    texture.generateMipmaps = texture.needsUpdate = true;
    return texture;
  });
}

/** Returns the index of a geom's texture, or -1. @param {Run} run @param {{material?: number}} of */
export const textureOf = (run, { material }) =>
  material === undefined ? -1 : run.materials[material].texture;

/**
 * Returns emission, specular and shininess from 0 to 255, and 0 for the reflectance. In the light of
 * the sky, roughness replaces shininess.
 * @param {Run} run @param {{material?: number}} of
 */
export function finishOf(run, { material }) {
  const own = material === undefined ? PLAIN : run.materials[material].finish;
  const [emission, specular, shininess] = own;
  const roughness = material === undefined ? -1 : run.materials[material].roughness ?? -1;
  const smooth = run.lights ? shininess : roughness >= 0 ? roughness : roughnessOf(shininess);
  return [emission, roughness >= 0 ? 0.5 : specular, smooth, 0].map((each) => Math.round(255 * Math.min(each, 1)));
}

/** Converts a shininess to a roughness, both from 0 to 1, as `finish` for Filament does in Python. */
const roughnessOf = (/** @type {number} */ shininess) => (2 / (128 * Math.max(shininess, 0) + 2)) ** 0.25;

/** Returns the metallic value of a geom from 0 to 255. @param {Run} run @param {{material?: number}} of */
export const metallicOf = (run, { material }) =>
  material === undefined ? 0 : Math.round(255 * (run.materials[material].metallic ?? 0));

/** Returns half the extents of a geom, with which MuJoCo scales the shape. @param {Geom} geom */
export function extentsOf({ type, size: [a, b, c] }) {
  if (type === SPHERE) return [a, a, a];
  return type === CAPSULE || type === CYLINDER ? [a, a, b] : [a, b, c];
}

/** Returns how often a texture is repeated on a geom, along u and v. @param {Run} run @param {Geom} geom */
function timesOf(run, geom) {
  const { repeat, uniform } = run.materials[geom.material ?? 0], extents = extentsOf(geom);
  return [0, 1].map((k) => (repeat[k] > 0 ? repeat[k] : 1) * (uniform && extents[k] > 0 ? extents[k] : 1));
}

/**
 * Returns the texture coordinates of a shape's vertices: (u, v, 0), or a direction for a cube map.
 * @param {Run} run @param {Geom} geom @param {THREE.BufferGeometry} shape result of `shapeOf`
 */
export function placesIn(run, geom, shape) {
  const material = run.materials[geom.material ?? 0];
  const find = run.textures[material.texture].cube ? direction : flat;
  const places = new Float32Array(3 * shape.attributes.position.count), times = timesOf(run, geom);
  for (let i = 0; i < places.length / 3; i++) {
    places.set(find(run, geom, shape, i, times), 3 * i);
  }
  return places;
}

/** @type {(run: Run, geom: Geom, shape: THREE.BufferGeometry, i: number, times: number[]) => number[]} */
function flat(run, geom, shape, i, [often, high]) {
  const { position, normal, uv } = shape.attributes, { type } = geom;
  const [x, y, z] = [position.getX(i), position.getY(i), position.getZ(i)];
  const [a, b, c] = extentsOf(geom);
  const own = type === MESH ? run.meshes[geom.mesh ?? 0].uv : undefined;
  if (own) return [often * own[2 * i], high * own[2 * i + 1], 0];
  if (type === MESH) return [often * x / a / 2 - 0.5, -high * y / b / 2 - 0.5, 0];
  if (type === PLANE && (a <= 0 || b <= 0)) return [often * x / 2 - 0.5, -high * y / 2 - 0.5, 0];
  if (type === PLANE) return [often * (1 + x / a) / 2, high * (1 - y / b) / 2, 0];
  const isTop = Math.abs(normal.getZ(i)) > 0.9;
  if (type === BOX) {
    const first = Math.abs(normal.getX(i)) > 0.9 ? y / b : x / a, second = isTop ? y / b : z / c;
    return [often * (1 + first) / 2, high * (1 - second) / 2, 0];
  }
  if (type === CYLINDER && isTop) return [often * (1 + x / a) / 2, high * (1 + y / b) / 2, 0];
  return [often * uv.getX(i), high * (1 - uv.getY(i)), 0];
}

/** @type {typeof flat} */
function direction(run, geom, { attributes: { position } }, i) {
  const at = [position.getX(i), position.getY(i), position.getZ(i)], extents = extentsOf(geom);
  const beyond = Math.abs(at[2]) - extents[2];
  const unit = geom.type === MESH ? at : at.map((each, k) => each / (extents[k] || 1));
  if (geom.type === CAPSULE && beyond > 0) unit[2] = Math.sign(at[2]) * (1 + beyond / extents[0]);
  const { uniform } = run.materials[geom.material ?? 0];
  return unit.map((each, k) => uniform ? each * extents[k] : each);
}

/** Returns the number of sides of a round shape with a radius in m. Large shapes have more sides. */
const sides = (/** @type {number} */ radius) =>
  Math.round(28 * Math.min(Math.max(Math.sqrt(radius / 0.14), 1), 2.5));

/**
 * Returns a sphere of radius 1 about z, or a part of it. @param {number} radius displayed radius, m
 * @param {number} share fraction of the sphere's rows @param {number[]} part
 */
export const ball = (radius, share = 1, ...part) =>
  new THREE.SphereGeometry(1, sides(radius), Math.round(sides(radius) * 0.58 * share), 0,
    2 * Math.PI, ...part).rotateX(UP).rotateZ(2 * UP);

/** Returns a cylinder about z. @param {number} a radius @param {number} b half its length @param {boolean} isOpen */
export const cylinder = (a, b, isOpen = false) =>
  new THREE.CylinderGeometry(a, a, 2 * b, sides(a), 1, isOpen).rotateX(UP).rotateZ(UP);

/** Returns a capsule about z. @param {number} a radius @param {number} b half the length between its ends */
export function capsule(a, b) {
  const ends = [ball(a, 0.5, 0, UP), ball(a, 0.5, UP, UP)].map((each, k) =>
    each.scale(a, a, a).translate(0, 0, k ? -b : b));
  const parts = [cylinder(a, b, true), ...ends].map((each) => each.toNonIndexed());
  const whole = new THREE.BufferGeometry();
  for (const name of ["position", "normal", "uv"]) {
    const numbers = parts.flatMap((each) => [...each.attributes[name].array]);
    whole.setAttribute(name, new THREE.Float32BufferAttribute(numbers, name === "uv" ? 2 : 3));
  }
  return whole.setIndex([...Array(whole.attributes.position.count).keys()]);
}

/** Returns a plane, which may be infinite. @param {Geom} geom @param {Run} run */
export function planeOf({ size: [a, b], isBack }, { reach }) {
  const far = 4 * (reach ?? 0); // An infinite plane ends where the camera cannot see it.
  const shape = new THREE.PlaneGeometry(2 * (a || far), 2 * (b || far));
  return isBack ? shape.rotateX(Math.PI) : shape;
}

/** Returns the back side of a plane, which is transparent. @param {Geom} plane @returns {Geom} */
export const backOf = (plane) =>
  ({ ...plane, isBack: true, rgba: plane.rgba.map((each, k) => k < 3 ? each : Math.round(0.3 * each)) });

/**
 * Returns the parameters of specular highlights: the exponent for a shininess of 1, and the strength
 * divided by exponent + 2 for a specular value of 1. Lights of a model have the same highlights as
 * in OpenGL.
 * @param {Run} run
 */
const glossOf = ({ lights }) => lights ? { power: 128, strength: 8 * lights.gloss }
  : { power: 80, strength: 16 };

/** Returns whether a geom is a plane. @param {Geom} geom */
export const isPlane = ({ type }) => type === PLANE;

/**
 * Adds the finish of each vertex and a texture to a Phong shader.
 * @param {THREE.WebGLProgramParametersWithUniforms} shader @param {Run} run
 * @param {SkyUniforms | null} sky null if the model has its own lights
 * @param {THREE.Texture | null} texture @param {boolean} isCube
 * @param {import("./mirror.js").Mirror | null} mirror
 */
export function finish(shader, run, sky, texture, isCube, mirror) {
  if (sky) shade(shader, sky, "surfaceOf(diffuseColor.rgb, shine.y, shine.z, own_metal)");
  if (mirror) reflect(shader, mirror);
  const { power, strength } = glossOf(run);
  const has = texture ? "varying vec3 spot;\n" : "";
  if (texture) shader.uniforms.picture = { value: texture };
  shader.vertexShader = `attribute vec4 finish; attribute float metal; varying vec4 shine; varying float own_metal;\n${has && "attribute vec3 place; "}${has}`
    + shader.vertexShader.replace("#include <beginnormal_vertex>",
      `shine = finish; own_metal = metal;${has && " spot = place;"}\n#include <beginnormal_vertex>`);
  const sampler = isCube ? "uniform samplerCube picture;\n" : "uniform sampler2D picture;\n";
  shader.fragmentShader = `varying vec4 shine; varying float own_metal;\n${has}${has && sampler}` + shader.fragmentShader
    .replace("#include <map_fragment>", !texture ? "" : isCube
      ? "diffuseColor *= textureCube(picture, spot);" : "diffuseColor *= texture2D(picture, spot.xy);")
    .replace("#include <lights_phong_fragment>", `BlinnPhongMaterial material;
      material.diffuseColor = diffuseColor.rgb;
      material.specularShininess = ${power.toFixed(1)} * shine.z + 1.;
      material.specularColor = vec3(${strength.toFixed(3)} * shine.y / (material.specularShininess + 2.));
      material.specularStrength = 1.;`)
    .replace("#include <emissivemap_fragment>", sky ? "totalEmissiveRadiance += shine.x * toLight(diffuseColor.rgb);"
      : "totalEmissiveRadiance += shine.x * diffuseColor.rgb;");
}

/**
 * Makes a shader show the reflection in a plane.
 * @param {THREE.WebGLProgramParametersWithUniforms} shader
 * @param {import("./mirror.js").Mirror} mirror
 */
function reflect(shader, { uniforms }) {
  Object.assign(shader.uniforms, uniforms);
  shader.vertexShader = "uniform mat4 toMirror; varying vec4 inMirror;\n" + shader.vertexShader
    .replace("#include <project_vertex>", `#include <project_vertex>
      inMirror = toMirror * vec4(transformed, 1.);`);
  shader.fragmentShader = "uniform sampler2D mirror; uniform float isMirror; varying vec4 inMirror;\n"
    + shader.fragmentShader.replace("#include <opaque_fragment>", `
      vec4 seen = texture2DProj(mirror, inMirror);
      outgoingLight += isMirror * shine.w * seen.a * seen.rgb;
      #include <opaque_fragment>`);
}

/**
 * Returns a material for a skin, flex or tendon.
 * @param {Run} run @param {SkyUniforms | null} sky @param {import("./data.js").Soft} of @param {THREE.Texture[]} textures
 * @param {object} [more]
 */
export function materialOf(run, sky, of, textures, more = {}) {
  const [r, g, b, a] = of.rgba.map((each) => each / 255), number = textureOf(run, of);
  const [emission, specular, shininess] = finishOf(run, of).map((each) => each / 255);
  const gloss = glossOf(run), power = gloss.power * shininess + 1, color = new THREE.Color(r, g, b);
  const map = of.uv && number >= 0 ? { map: textures[number] } : {};
  const material = new THREE.MeshPhongMaterial({
    color, emissive: color.clone().multiplyScalar(emission), shininess: power,
    specular: new THREE.Color().setScalar(gloss.strength * specular / (power + 2)),
    opacity: a, transparent: a < 1, ...map, ...more,
  });
  const numbers = [specular, shininess, metallicOf(run, of) / 255].map((each) => each.toFixed(3));
  const surface = `surfaceOf(diffuseColor.rgb, ${numbers.join(", ")})`;
  if (!sky) return material;
  material.onBeforeCompile = (shader) => shade(shader, sky, surface);
  material.customProgramCacheKey = () => surface;
  return material;
}

/** Returns the coordinates in a repeated texture. @param {Run} run @param {import("./data.js").Soft} of */
export function repeated(run, { uv, material }) {
  if (!uv || material === undefined) return uv;
  const { repeat } = run.materials[material];
  return uv.map((each, k) => each * (repeat[k % 2] || 1));
}
