/** Converts free cameras between positions and parameters of MuJoCo. */

/** @typedef {{lookAt: number[], distance: number, azimuth: number, elevation: number}} View
 *   parameters of an `MjvCamera` in m and degrees */

const DEGREES = 180 / Math.PI;

/**
 * Returns the factor for the camera's distance, which is above 1 in narrow images.
 * @param {number} aspect minimum aspect ratio (width over height) at which the distance is unchanged
 * @param {number} width of the image, pixels @param {number} height of the image, pixels
 */
export const standingBack = (aspect, width, height) => Math.max(aspect * height / Math.max(width, 1), 1);

/** Returns the position of a camera in m. @param {View} view @returns {number[]} */
export function placeOf({ lookAt: [x, y, z], distance, azimuth, elevation }) {
  const flat = distance * Math.cos(elevation / DEGREES), turn = azimuth / DEGREES;
  return [x - flat * Math.cos(turn), y - flat * Math.sin(turn), z - distance * Math.sin(elevation / DEGREES)];
}

/**
 * Returns the parameters of a camera that looks at a point from a position.
 * @param {number[]} place m @param {number[]} lookAt m @returns {View}
 */
export function viewFrom(place, lookAt) {
  const [x, y, z] = lookAt.map((each, k) => each - place[k]), flat = Math.hypot(x, y);
  return { lookAt: [...lookAt], distance: Math.hypot(flat, z), azimuth: Math.atan2(y, x) * DEGREES,
    elevation: Math.atan2(z, flat) * DEGREES };
}
