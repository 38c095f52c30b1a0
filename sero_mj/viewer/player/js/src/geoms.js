/** The geoms of overlays, such as arrows and axes, at one time. */

/** @typedef {import("./data.js").Run} Run */

/** Kinds of items as in the Python enum `Kind`: arrows and billboards of joints, and smart arrows. */
export const ARROW = 1, BILLBOARD = 2, VECTOR = 5;

/** A list of `count` geoms, stored in arrays that grow as needed. */
export class Geoms {
  capacity = 0;
  count = 0;
  /** Kind, item and type of each geom. */
  of = new Int32Array();
  positions = new Float32Array();
  /** Quaternions in the order w, x, y, z. */
  rotations = new Float32Array();
  sizes = new Float32Array();
  /** Color components and opacity from 0 to 255. */
  rgba = new Uint8Array();

  /** Sets the number of geoms. The caller must then set their values. @param {number} count */
  resize(count) {
    this.count = count;
    if (count <= this.capacity) return;
    const capacity = this.capacity = 2 * count;
    this.of = new Int32Array(3 * capacity);
    this.positions = new Float32Array(3 * capacity);
    this.rotations = new Float32Array(4 * capacity);
    this.sizes = new Float32Array(3 * capacity);
    this.rgba = new Uint8Array(4 * capacity);
  }

  /**
   * Adds a geom, for which there must be space, and returns its index. The caller must then set its values.
   * @param {number[]} of kind, item and type
   */
  add(...of) {
    this.of.set(of, 3 * this.count);
    return this.count++;
  }
}

/**
 * Collects the visible geoms of a run at a frame. Space for two geoms of each joint's arrow is reserved.
 * @param {Run} run @param {number} frame @param {boolean} hasArrows whether arrows are on
 * @param {Geoms} to
 */
export function geomsAt({ items, joints, frames }, frame, hasArrows, to) {
  const { visible, positions, rotations, sizes, colours, of } = items;
  to.resize(of.length + 2 * joints.length);
  to.count = 0;
  if (!visible || !positions || !rotations || !sizes || !colours) return;
  of.forEach((/** @type {number[]} */ each, /** @type {number} */ k) => {
    if (visible[k * frames + frame] < 0.5 || (!hasArrows && each[0] === VECTOR)) return;
    const i = to.add(...each);
    for (let c = 0; c < 3; c++) {
      to.positions[3 * i + c] = positions[(3 * k + c) * frames + frame];
      to.sizes[3 * i + c] = sizes[(3 * k + c) * frames + frame];
    }
    for (let c = 0; c < 4; c++) {
      to.rotations[4 * i + c] = rotations[(4 * k + c) * frames + frame];
      to.rgba[4 * i + c] = Math.round(255 * colours[(4 * k + c) * frames + frame]);
    }
  });
}
