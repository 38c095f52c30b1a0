/** The state of a live page. It is a run with one frame, whose arrays are overwritten by sections of the server. */

import { addArrows } from "./arrows.js";
import { decode } from "./data.js";
import * as THREE from "three";
import { BILLBOARD, Geoms } from "./geoms.js";
import { Reader, fill } from "./sections.js";

/** @typedef {import("./data.js").Run} Run */
/** @typedef {{kind: number, item: number, at: number[], lines: [string, string][], title: string,
 *   share: number | null, sign: "" | "positive" | "negative", stale: boolean, always: boolean}} SentBillboard */

const TURN = 1 / 16384; // resolution of the components of unit quaternions
const BYTES_OF_GEOM = 12 + 12 + 16 + 12 + 4;

/** The displayed state of a live page. */
export class State {
  /**
   * @param {Uint8Array} bytes contents of the section `run` @param {string[]} [keys] names of the values
   * @throws {Error} if the bytes are invalid
   */
  constructor(bytes, keys = []) {
    const run = this.run = decode(bytes.slice().buffer);
    if (run.frames !== 1) throw new Error(`found a run of ${run.frames} frames`);
    const joints = run.joints.length;
    this.geoms = new Geoms();
    this.geoms.resize(2 * joints);
    this.count = 0; // number of geoms that the server has sent
    this.arrowOn = new Uint8Array(joints);
    this.turns = new Int16Array(run.rotations.length);
    this.opacities = new Uint8Array(run.opacity.length);
    this.greys = new Uint8Array(run.grey.length);
    this.stales = new Uint8Array(joints);
    this.keys = keys;
    /** @type {{positions: Float32Array, turns: Float32Array} | null} */
    this.sites = null;
    run.arrows.values = new Float64Array(joints);
    run.joints.forEach(({ arrow }, j) => { this.arrowOn[j] = Number(arrow.on); });
  }

  /**
   * Returns the current state to draw.
   * @param {unknown} _ @param {Record<string, any>} now the latest JSON sections @returns {import("./view.js").Moment}
   */
  moment(_, now) {
    return {
      at: 0, hasDoubles: true, sites: this.sites,
      geoms: (sites) => {
        this.geoms.count = this.count;
        const isOn = (/** @type {number} */ joint) => this.arrowOn[joint] > 0 && this.run.joints[joint].arrow.round;
        addArrows(this.run, 0, sites, isOn, this.geoms);
        return this.geoms;
      },
      labels: now.labels ?? [], billboards: () => contentsOf(now.cards ?? [], now.selected ?? -1),
    };
  }

  /**
   * Applies a section of bytes.
   * @param {string} name @param {Uint8Array} bytes
   * @returns {boolean} whether the section is part of the state @throws {Error} if its length is wrong
   */
  take(name, bytes) {
    const { run } = this;
    switch (name) {
      case "poses": return this.#poses(new Reader(bytes));
      case "opacity": return this.#scaled(bytes, this.opacities, run.opacity, 1 / 255);
      case "grey": return this.#scaled(bytes, this.greys, run.grey, 1);
      case "stale": return this.#scaled(bytes, this.stales, run.arrows.stale, 1);
      case "values": return this.#values(new Reader(bytes));
      case "items": return this.#items(new Reader(bytes));
      case "sites": return this.#sites(new Reader(bytes));
      case "arrowValues": return fill(bytes, run.arrows.values ?? new Float64Array());
      case "arrowOn": return fill(bytes, this.arrowOn);
      case "soft": return fill(bytes, run.soft ?? new Float32Array());
      default: return false;
    }
  }

  /**
   * Applies a section of JSON.
   * @param {string} name @param {any} value @returns {boolean} whether the section is part of the state
   */
  takeJson(name, value) {
    if (name === "valueKeys") this.keys = value.map(String);
    else if (name === "time") this.run.begin = Number(value);
    else if (name === "arrowLook") this.run.joints.forEach(({ arrow }, j) => Object.assign(arrow, value[j]));
    else return false;
    return true;
  }

  /** @param {Reader} reader */
  #poses(reader) {
    const { run, turns } = this;
    reader.take(run.positions);
    reader.take(turns);
    for (let k = 0; k < turns.length; k++) run.rotations[k] = turns[k] * TURN;
    return true;
  }

  /** @param {Uint8Array} bytes @param {Uint8Array} through @param {Float32Array} to @param {number} step */
  #scaled(bytes, through, to, step) {
    fill(bytes, through);
    for (let k = 0; k < through.length; k++) to[k] = step * through[k];
    return true;
  }

  /** @param {Reader} reader */
  #values(reader) {
    const { run } = this;
    for (const key of this.keys) {
      const joints = run.joints.length;
      if (run.values[key]?.length !== joints) run.values[key] = new Float64Array(joints);
      reader.take(run.values[key]);
    }
    return true;
  }

  /** @param {Reader} reader */
  #items(reader) {
    const count = reader.count(BYTES_OF_GEOM), { geoms } = this;
    geoms.resize(count + 2 * this.run.joints.length);
    this.count = count;
    reader.take(geoms.of.subarray(0, 3 * count));
    reader.take(geoms.positions.subarray(0, 3 * count));
    reader.take(geoms.rotations.subarray(0, 4 * count));
    reader.take(geoms.sizes.subarray(0, 3 * count));
    reader.take(geoms.rgba.subarray(0, 4 * count));
    return true;
  }

  /** Reads poses of the joints in the world, for models whose joints have no sites. @param {Reader} reader */
  #sites(reader) {
    const joints = this.run.joints.length;
    this.sites ??= { positions: new Float32Array(3 * joints), turns: new Float32Array(4 * joints) };
    reader.take(this.sites.positions);
    reader.take(this.sites.turns);
    return true;
  }
}

/**
 * Returns the contents of the billboards that the server has sent. Their keys consist of kind and item.
 * @param {SentBillboard[]} billboards @param {number} selected joint; -1 for none @returns {import("./billboards.js").Content[]}
 */
function contentsOf(billboards, selected) {
  return billboards.map(({ kind, item, at, lines, title, share, sign, stale, always }) => {
    const isChosen = kind === BILLBOARD && item === selected;
    return { key: `${kind} ${item}`, title, lines, sign, isStale: stale, isChosen,
      at: new THREE.Vector3().fromArray(at), load: always || isChosen ? Infinity : share ?? -1 };
  });
}
