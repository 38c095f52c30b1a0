/** Decodes the bytes of a run, which `encode.py` writes. */

/** @typedef {[number, string, number]} Part number of the array, type and number of its elements */
/** @typedef {{title: string, label: string, key: string, scale: number, decimals: number,
 *   unit: string}} Line */
/** @typedef {{on: boolean, round: boolean, radius: number, opacity: number, scale: number,
 *   band: number, limit: number | null, widest: number}} Arrow */
/** @typedef {{name: string, torqueLabel: string, torqueFactor: number, angleUnit: string, double: number, body: number,
 *   pos: number[], quat: number[], torqueLimit: number | null, lines: Line[], details: Line[],
 *   card: boolean, follows: boolean, arrow: Arrow}} Joint */
/** @typedef {{body: number, type: number, pos: number[], quat: number[], size: number[],
 *   rgba: number[], mesh?: number, material?: number, isBack?: boolean}} Geom */
/** @typedef {{finish: number[], texture: number, repeat: number[], uniform: boolean,
 *   roughness?: number, metallic?: number}} Material
 *   finish: emission, specular, shininess and reflectance. If roughness is set, it replaces shininess. */
/** @typedef {{cube: boolean, width: number, height: number, pixels: Uint8Array}} Texture
 *   pixels: RGBA values. A cube has six faces one after the other. */
/** @typedef {{rgba: number[], material?: number, uv?: Float32Array}} Soft */
/** @typedef {Soft & {positions: Float32Array, triangles: Uint32Array, inflate: number,
 *   bones: {body: number, pos: number[], quat: number[], count: number}[],
 *   moved: Uint32Array, weights: Uint16Array}} Skin
 *   moved: indices of the vertices of each bone; weights: weights of these vertices in units of 1 / 65535 */
/** @typedef {Soft & {dim: number, radius: number, first: number, count: number, flat: boolean,
 *   triangles: Uint32Array, edges: Uint32Array}} Flex */
/** @typedef {{body: number, type: number, pos: number[], dir: number[], diffuse: number[],
 *   ambient: number[], cutoff: number, exponent: number, shadow: boolean}} Lamp */
/** @typedef {{ambient: number[], diffuse: number[], gloss: number, others: Lamp[]}} Lights
 *   ambient, diffuse: headlight of the model; gloss: brightness of lamp reflections relative to surfaces */
/** @typedef {{sky: number[][], tiles: number[][], haze: number[], key: number, bulb: number,
 *   fill: number[], reflections: number[][]}} Palette displayed colors, and light relative to white */
/** @typedef {{looks: {light: Palette, dark: Palette}, towards: number[], floor: {height: number,
 *   tile: number, far: number, haze: number} | null}} Surroundings */
/** @typedef {{joint: string, notes: string[], label: string, times: number[], before: (number | null)[],
 *   after: (number | null)[], quantity: string, unit: string, values: (number | null)[], fit: [number, number][]}} MarkPlot
 *   as in `MarkPlot` of `capture.py` */
/** @typedef {{begin: number, end: number, text: string, kind: string, plot?: MarkPlot | null}} Mark */
/** @typedef {{positions: Float32Array, normals: Float32Array, triangles: Uint32Array,
 *   uv?: Float32Array}} MeshData */
/** @typedef {{texts: string[], at: Float32Array}} Texts */
/** @typedef {{name: string, body: number, pos: number[], quat: number[], fovy: number}} Camera */
/** @typedef {{lookAt: number[], distance: number, azimuth: number, elevation: number,
 *   fovy: number, aspect: number, fixed: number}} Eye */

/** @type {Record<string, {new (bytes: ArrayBuffer): any, BYTES_PER_ELEMENT: number}>} */
const KINDS = {
  u1: Uint8Array, i1: Int8Array, u2: Uint16Array, u4: Uint32Array, f8: Float64Array,
};
const VERSION = 1;

/** Decodes a signed integer with the sign in the lowest bit. @param {number} folded */
export const unfold = (folded) => (folded >>> 1) ^ -(folded & 1);

/**
 * Decompresses the base64 text of a raw deflate stream.
 * @param {string} text
 * @returns {Promise<ArrayBuffer>}
 */
export async function inflate(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Response(stream).arrayBuffer();
}

/** Reads the arrays that follow the head. */
class Arrays {
  /** @param {ArrayBuffer} bytes @param {number[]} lengths @param {number} begin */
  constructor(bytes, lengths, begin) {
    this.bytes = bytes;
    /** @type {number[]} */
    this.starts = [];
    for (const length of lengths) {
      this.starts.push(begin);
      begin += length;
    }
  }

  /** Reads an array in which bytes of the same significance are grouped. @param {Part} part */
  get([part, kind, count]) {
    const Kind = KINDS[kind];
    const size = Kind.BYTES_PER_ELEMENT;
    const planes = new Uint8Array(this.bytes, this.starts[part], count * size);
    const bytes = new Uint8Array(count * size);
    for (let k = 0; k < size; k++) {
      for (let i = 0; i < count; i++) bytes[i * size + k] = planes[k * count + i];
    }
    return new Kind(bytes.buffer);
  }

  /**
   * Reads channels, shape (C, F), which are stored as differences between frames.
   * @param {Part} part @param {number} frames @param {number} step
   */
  moving(part, frames, step) {
    const folded = this.get(part), numbers = new Float32Array(folded.length);
    for (let i = 0, sum = 0; i < folded.length; i++) {
      sum = (i % frames ? sum : 0) + unfold(folded[i]);
      numbers[i] = sum * step;
    }
    return numbers;
  }

  /** Reads integers, which are stored as differences between neighbors in the form of `unfold`. @param {Part} part */
  differing(part) {
    const folded = this.get(part), numbers = new Uint32Array(folded.length);
    for (let i = 0, at = 0; i < folded.length; i++) numbers[i] = at += unfold(folded[i]);
    return numbers;
  }

  /**
   * Reads positions, shape (n, dimensions), which are stored as steps from the lower bounds.
   * @param {Part} part @param {number[]} low @param {number} step
   */
  places(part, low, step) {
    const steps = this.get(part), size = low.length, count = steps.length / size;
    const places = new Float32Array(steps.length);
    for (let axis = 0; axis < size; axis++) {
      for (let i = 0, at = 0; i < count; i++) {
        at = (at + steps[axis * count + i]) & 65535;
        places[size * i + axis] = low[axis] + at * step;
      }
    }
    return places;
  }

  /** @param {any} uv @returns {{uv?: Float32Array}} */
  uv(uv) {
    return uv ? { uv: this.places(uv.places, uv.low, uv.step) } : {};
  }

  /** @param {any} mesh @returns {MeshData} */
  mesh(mesh) {
    const square = this.get(mesh.normals), count = square.length / 2;
    const normals = new Float32Array(3 * count);
    for (let i = 0; i < count; i++) normals.set(normalOf(square[i], square[count + i]), 3 * i);
    return { positions: this.places(mesh.vertices, mesh.low, mesh.step), normals,
      triangles: this.differing(mesh.triangles), ...this.uv(mesh.uv) };
  }

  /** Reads the meshes of arrows and axes. @param {any} shapes */
  shapes({ first, step, groups }) {
    /** @type {{positions: Float32Array, index: Uint32Array}[]} */
    const meshes = [];
    for (const { count, vertices, faces } of groups) {
      const numbers = this.moving(vertices, count, step), index = this.differing(faces);
      for (let k = 0; k < count; k++) meshes.push({ positions: numbers.filter((_, i) => i % count === k), index });
    }
    return { first: Number(first), meshes };
  }

  /** @param {any} texture @returns {Texture} */
  texture({ cube, width, height, channels, way, pixels }) {
    const numbers = this.get(pixels), row = width * channels;
    const back = [row, channels][way] ?? 0, few = channels < 3;
    for (let i = 0; back && i < numbers.length; i++) {
      const isFirst = way ? i % row < channels : i < row;
      if (!isFirst) numbers[i] += numbers[i - back];
    }
    const rgba = new Uint8Array(4 * numbers.length / channels);
    for (let from = 0, to = 0; from < numbers.length; from += channels, to += 4) {
      for (let c = 0; c < 3; c++) rgba[to + c] = numbers[from + (few ? 0 : c)];
      rgba[to + 3] = channels % 2 ? 255 : numbers[from + channels - 1];
    }
    return { cube, width, height, pixels: rgba };
  }

  /** @param {any} skin @returns {Skin} */
  skin(skin) {
    return { ...skin, positions: this.places(skin.vertices, skin.low, skin.step),
      triangles: this.differing(skin.triangles), moved: this.differing(skin.moved),
      weights: this.get(skin.weights), ...this.uv(skin.uv) };
  }

  /** @param {any} flex @returns {Flex} */
  flex(flex) {
    return { ...flex, triangles: this.differing(flex.triangles), edges: this.differing(flex.edges),
      ...this.uv(flex.uv) };
  }
}

/** Converts the octahedral encoding of a unit vector to the vector. @param {number} u @param {number} v */
export function normalOf(u, v) {
  let x = u / 127, y = v / 127;
  const z = 1 - Math.abs(x) - Math.abs(y);
  if (z < 0) {
    [x, y] = [(1 - Math.abs(y)) * (x < 0 ? -1 : 1), (1 - Math.abs(x)) * (y < 0 ? -1 : 1)];
  }
  const length = Math.hypot(x, y, z) || 1;
  return [x / length, y / length, z / length];
}

/**
 * Decodes a run.
 * @param {ArrayBuffer} bytes
 */
export function decode(bytes) {
  const size = new DataView(bytes).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 4, size)));
  if (head.version !== VERSION) throw new Error(`found format ${head.version}, expected ${VERSION}`);
  const arrays = new Arrays(bytes, head.lengths, 4 + size);
  /** @type {number} */
  const frames = head.frames;
  const [metre, turn] = head.steps;
  /** @param {Part} part @param {number} [step] */
  const moving = (part, step = 1) => arrays.moving(part, frames, step);
  /** @type {Record<string, Float64Array>} */
  const values = {};
  for (const [key, part] of Object.entries(head.values)) values[key] = arrays.get(part);
  const { torques, commanded_torques: commanded } = values;
  if (torques && commanded) values.torque_error = commanded.map((each, i) => each - torques[i]);
  const items = head.items.of.length && {
    visible: moving(head.items.visible),
    positions: moving(head.items.positions, metre),
    rotations: moving(head.items.rotations, turn),
    sizes: moving(head.items.sizes, metre),
    colours: moving(head.items.colours, 1 / 255),
  };
  /** @param {any} texts @returns {Texts} */
  const read = (texts) => ({ texts: texts.texts, at: moving(texts.at) });
  return {
    title: /** @type {string} */ (head.title),
    fps: /** @type {number} */ (head.fps),
    begin: /** @type {number} */ (head.begin),
    frames,
    eye: /** @type {Eye} */ (head.eye),
    /** Displacement of the free camera, which follows a frame, m. */
    follow: head.follow ? moving(head.follow, metre) : null,
    cameras: /** @type {Camera[]} */ (head.cameras),
    bodies: /** @type {{name: string, joint: number, double: number, moves: boolean}[]} */ (head.bodies),
    positions: moving(head.positions, metre),
    rotations: moving(head.rotations, turn),
    opacity: moving(head.opacity, 1 / 255),
    grey: moving(head.grey),
    greyRgb: /** @type {number[]} */ (head.greyRgb),
    meshes: /** @type {MeshData[]} */ (head.meshes.map((/** @type {any} */ m) => arrays.mesh(m))),
    geoms: /** @type {Geom[]} */ (head.geoms),
    surroundings: /** @type {Surroundings} */ (head.surroundings),
    reach: /** @type {number | null} */ (head.reach ?? null),
    materials: /** @type {Material[]} */ (head.materials ?? []),
    textures: /** @type {Texture[]} */ ((head.textures ?? []).map((/** @type {any} */ each) => arrays.texture(each))),
    skins: /** @type {Skin[]} */ ((head.skins ?? []).map((/** @type {any} */ s) => arrays.skin(s))),
    flexes: /** @type {Flex[]} */ ((head.flexes ?? []).map((/** @type {any} */ f) => arrays.flex(f))),
    lights: /** @type {Lights | null} */ (head.lights ?? null),
    soft: head.soft ? moving(head.soft, metre) : null,
    tendons: head.tendons ? {
      ends: moving(head.tendons.ends, metre),
      radius: moving(head.tendons.radius, metre),
      rgba: /** @type {number[][]} */ (head.tendons.rgba),
    } : null,
    joints: /** @type {Joint[]} */ (head.joints),
    values,
    arrows: {
      ...head.arrows,
      shapes: arrays.shapes(head.arrows.shapes),
      stale: moving(head.arrows.stale),
      values: /** @type {Float64Array | undefined} */ (
        head.arrows.values ? arrays.get(head.arrows.values) : torques),
      /** Quantities that the user can choose for arrows, with the current one first. */
      quantities: /** @type {{key: string, name: string, line: string}[]} */ (head.arrows.quantities ?? []),
    },
    items: { of: /** @type {[number, number, number][]} */ (head.items.of), ...(items || null) },
    labels: head.labels ? {
      texts: /** @type {string[]} */ (head.labels.texts), at: moving(head.labels.at),
      positions: moving(head.labels.positions, metre),
    } : null,
    notes: read(head.notes),
    /** Lines of the legend in each frame. The line about the quantity of the arrows is null. */
    legend: /** @type {{texts: (string | null)[][], at: Float32Array}} */ (/** @type {unknown} */ (read(head.legend))),
    arrowTexts: /** @type {{item: number, name: string, texts: string[], at: Float32Array}[]} */ (
      head.cards.map((/** @type {any} */ each) => ({ ...each, ...read(each) }))),
    vectors: /** @type {string[]} */ (head.vectors),
    marks: /** @type {Mark[]} */ (head.marks),
    /** Mapping from labels on billboards to meanings, such as from A to a file name. */
    meanings: /** @type {Record<string, string>} */ (head.meanings ?? {}),
    switches: /** @type {Record<string, boolean>} */ (head.switches),
    silent: /** @type {string[]} */ (head.silent),
  };
}

/** @typedef {ReturnType<typeof decode>} Run */

/**
 * Returns a function that interpolates channels between two frames.
 * @param {number} at frame with a fractional part @param {number} frames
 * @returns {(of: Float32Array, channel: number) => number}
 */
export function mixer(at, frames) {
  const before = Math.floor(at), after = Math.min(before + 1, frames - 1), part = at - before;
  return (of, channel) => of[channel * frames + before] * (1 - part) + of[channel * frames + after] * part;
}

/**
 * Returns the value for a line of a billboard: a recorded value, the torque limit, or the torque in percent of it.
 * @param {Run} run @param {number} joint @param {string} key @param {number} frame
 */
export function valueOf(run, joint, key, frame) {
  const limit = run.joints[joint].torqueLimit ?? Infinity;
  if (key === "torque_limit") return limit;
  const of = run.values[key === "torque_share" ? "torques" : key];
  if (!of) return NaN;
  const value = of[joint * run.frames + frame];
  return key === "torque_share" ? 100 * Math.abs(value) / limit : value;
}

/**
 * Formats a value with a number of decimals. The text of 0 has no sign.
 * @param {number} value @param {number} digits
 */
export function fixed(value, digits) {
  const text = value.toFixed(digits);
  return /^-[0.]+$/.test(text) ? text.slice(1) : text;
}

/** Formats the value of a billboard line as Python does. @param {Line} line @param {number} value */
export function textOf(line, value) {
  if (!Number.isFinite(value)) return line.key === "torque_limit" ? "none" : "no data";
  const scaled = value * line.scale;
  const number = Math.abs(scaled) < 1e6 ? fixed(scaled, line.decimals) : scaled.toExponential(3);
  return line.unit ? `${number} ${line.unit}` : number;
}
