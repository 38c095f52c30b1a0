/** What surfaces look like: materials, textures, and the places in these, by MuJoCo's rules. */

import * as THREE from "three";

/** @typedef {import("./data.js").Run} Run */
/** @typedef {import("./data.js").Geom} Geom */

const PLANE = 0, SPHERE = 2, CAPSULE = 3, CYLINDER = 5, MESH = 7; // mjtGeom
const PLAIN = [0, 128, 128, 0]; // finish of what has no material
export const ENDLESS = 100; // m, half the side of planes without an end

/** The textures of a run. @param {Run} run @returns {THREE.Texture[]} */
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

/** The number of a geom's texture; -1 for none. @param {Run} run @param {{material?: number}} of */
export const textureOf = (run, { material }) =>
  material === undefined ? -1 : run.materials[material].texture;

/**
 * Emission, specular and shininess of 0 to 255, and nothing.
 * @param {Run} run @param {{material?: number}} of
 */
export function finishOf(run, { material }) {
  if (material === undefined) return PLAIN;
  const [emission, specular, shininess] = run.materials[material].finish;
  return [emission, specular, shininess, 0].map((each) => Math.round(255 * Math.min(each, 1)));
}

/** Half the extents of a geom, as MuJoCo scales its shapes. @param {Geom} geom */
function extentsOf({ type, size: [a, b, c] }) {
  if (type === SPHERE) return [a, a, a];
  return type === CAPSULE || type === CYLINDER ? [a, a, b] : [a, b, c];
}

/**
 * The places of a shape's vertices in its texture: (u, v, 0), or of a cube a direction.
 * @param {Run} run @param {Geom} geom @param {THREE.BufferGeometry} shape in the geom's frame
 */
export function placesIn(run, geom, shape) {
  const { position } = shape.attributes, places = new Float32Array(3 * position.count);
  const material = run.materials[geom.material ?? 0], { repeat, uniform } = material;
  const extents = extentsOf(geom), isMesh = geom.type === MESH;
  const uv = isMesh ? run.meshes[geom.mesh ?? 0].uv : undefined;
  const { cube } = run.textures[material.texture];
  for (let i = 0; i < position.count; i++) {
    const at = [position.getX(i), position.getY(i), position.getZ(i)];
    if (!cube && uv) places.set([uv[2 * i], uv[2 * i + 1], 0], 3 * i);
    else if (!cube) {
      for (const k of [0, 1]) {
        const scale = repeat[k] / (uniform || extents[k] <= 0 ? 1 : extents[k]);
        places[3 * i + k] = (k ? -0.5 : 0.5) * scale * at[k] - 0.5;
      }
    } else {
      const beyond = Math.abs(at[2]) - extents[2], isCap = geom.type === CAPSULE && beyond > 0;
      const unit = isMesh ? at : at.map((each, k) => each / (extents[k] || 1));
      if (isCap) unit[2] = Math.sign(at[2]) * (1 + beyond / extents[0]);
      unit.forEach((each, k) => { places[3 * i + k] = uniform ? each * extents[k] : each; });
    }
  }
  return places;
}

/** A plane, also one without an end. @param {Geom} geom */
export const planeOf = ({ size: [a, b] }) =>
  new THREE.PlaneGeometry(2 * (a || ENDLESS), 2 * (b || ENDLESS));

/** Whether a geom is a plane. @param {Geom} geom */
export const isPlane = ({ type }) => type === PLANE;

/**
 * Lets a Phong shader have the finish of every vertex, and a texture.
 * @param {THREE.WebGLProgramParametersWithUniforms} shader
 * @param {THREE.Texture | null} texture @param {boolean} isCube
 */
export function finish(shader, texture, isCube) {
  const has = texture ? "varying vec3 spot;\n" : "";
  if (texture) shader.uniforms.picture = { value: texture };
  shader.vertexShader = `attribute vec4 finish; varying vec3 shine;\n${has && "attribute vec3 place; "}${has}`
    + shader.vertexShader.replace("#include <beginnormal_vertex>",
      `shine = finish.xyz;${has && " spot = place;"}\n#include <beginnormal_vertex>`);
  const sampler = isCube ? "uniform samplerCube picture;\n" : "uniform sampler2D picture;\n";
  shader.fragmentShader = `varying vec3 shine;\n${has}${has && sampler}` + shader.fragmentShader
    .replace("#include <map_fragment>", !texture ? "" : isCube
      ? "diffuseColor *= textureCube(picture, spot);" : "diffuseColor *= texture2D(picture, spot.xy);")
    .replace("#include <lights_phong_fragment>", `BlinnPhongMaterial material;
      material.diffuseColor = diffuseColor.rgb;
      material.specularShininess = 80. * shine.z + 1.;
      material.specularColor = vec3(.38 * shine.y * 42. / (material.specularShininess + 2.));
      material.specularStrength = 1.;`)
    .replace("#include <emissivemap_fragment>", "totalEmissiveRadiance += shine.x * diffuseColor.rgb;");
}

/**
 * A material for what is no geom.
 * @param {Run} run @param {import("./data.js").Soft} of @param {THREE.Texture[]} textures
 * @param {object} [more]
 */
export function materialOf(run, of, textures, more = {}) {
  const [r, g, b, a] = of.rgba.map((each) => each / 255), number = textureOf(run, of);
  const [emission, specular, shininess] = finishOf(run, of).map((each) => each / 255);
  const power = 80 * shininess + 1, color = new THREE.Color(r, g, b);
  const map = of.uv && number >= 0 ? { map: textures[number] } : {};
  return new THREE.MeshPhongMaterial({
    color, emissive: color.clone().multiplyScalar(emission), shininess: power,
    specular: new THREE.Color().setScalar(0.38 * specular * 42 / (power + 2)),
    opacity: a, transparent: a < 1, ...map, ...more,
  });
}
