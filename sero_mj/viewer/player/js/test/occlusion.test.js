/** Tests the visible fraction of the sky against integrals over the sky. */

import assert from "node:assert/strict";
import test from "node:test";
import { visibleSky } from "../src/occlusion.js";

/**
 * Returns the fraction of a uniform sky that is visible beside a sphere, by summing over directions.
 * @param {number} x @param {number} y @param {number} height @param {number} radius
 */
function summed(x, y, height, radius, steps = 700) {
  let passed = 0;
  for (let i = 0; i < steps; i++) {
    for (let j = 0; j < steps; j++) {
      // Each direction of this grid has the same weight, because the squared sine is uniform.
      const sine = Math.sqrt((i + 0.5) / steps), turn = 2 * Math.PI * (j + 0.5) / steps;
      const way = [sine * Math.cos(turn), sine * Math.sin(turn), Math.sqrt(1 - sine * sine)];
      const ahead = x * way[0] + y * way[1] + height * way[2];
      const beside = x * x + y * y + height * height - ahead * ahead;
      if (ahead < 0 || beside > radius * radius) passed += 1;
    }
  }
  return passed / steps ** 2;
}

test("a sphere hides the right fraction of a uniform sky", () => {
  for (const [x, y, height, radius] of [[0, 0, 1, 0.3], [0.4, 0, 0.5, 0.2], [1, -0.5, 0.8, 0.5]]) {
    const ball = [x, y, height, x, y, height, radius];
    assert.ok(Math.abs(visibleSky(ball, 0, 0) - summed(x, y, height, radius)) < 2e-3);
  }
});

test("a capsule hides the same fraction as a sphere at its nearest point", () => {
  const capsule = [-1, 0, 0.3, 1, 0, 0.3, 0.1];
  assert.equal(visibleSky(capsule, 0.5, 0.2), visibleSky([0.5, 0, 0.3, 0.5, 0, 0.3, 0.1], 0.5, 0.2));
  assert.equal(visibleSky(capsule, 3, 0), visibleSky([1, 0, 0.3, 1, 0, 0.3, 0.1], 3, 0));
});

test("a capsule below the floor hides nothing, and the sky is never completely hidden", () => {
  assert.equal(visibleSky([0, 0, -0.1, 0, 0, -0.1, 0.2], 0, 0), 1);
  assert.ok(Math.abs(visibleSky([0, 0, 0.2, 0, 0, 0.2, 0.2], 0, 0) - 0.05) < 1e-9);
});
