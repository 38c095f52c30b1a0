/** Converts free cameras between positions and the parameters of MuJoCo. */

/** @typedef {{lookAt: number[], distance: number, azimuth: number, elevation: number}} View
 *   m and degrees, as in `MjvCamera` */

const DEGREES = 180 / Math.PI;

/**
 * Returns the factor of the camera's distance in a narrow image, which is 1 in wide images.
 * @param {number} aspect width over height of images at which distances are unchanged
 * @param {number} width @param {number} height of the image, pixels
 */
export const standingBack = (aspect, width, height) => Math.max(aspect * height / Math.max(width, 1), 1);

/** Returns the position of a camera, m. @param {View} view @returns {number[]} */
export function placeOf({ lookAt: [x, y, z], distance, azimuth, elevation }) {
  const flat = distance * Math.cos(elevation / DEGREES), turn = azimuth / DEGREES;
  return [x - flat * Math.cos(turn), y - flat * Math.sin(turn), z - distance * Math.sin(elevation / DEGREES)];
}

/**
 * Returns the view of a camera at a position that looks at a point.
 * @param {number[]} place m @param {number[]} lookAt m @returns {View}
 */
export function viewFrom(place, lookAt) {
  const [x, y, z] = lookAt.map((each, k) => each - place[k]), flat = Math.hypot(x, y);
  return { lookAt: [...lookAt], distance: Math.hypot(flat, z), azimuth: Math.atan2(y, x) * DEGREES,
    elevation: Math.atan2(z, flat) * DEGREES };
}
