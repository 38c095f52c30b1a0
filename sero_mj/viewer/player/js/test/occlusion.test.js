/** What hides the sky from the floor, against integrals over the sky. */

import assert from "node:assert/strict";
import test from "node:test";
import { seenPast } from "../src/occlusion.js";

/**
 * The share of the light of an even sky that passes a ball, by summing over directions.
 * @param {number} x @param {number} y @param {number} height @param {number} radius
 */
function summed(x, y, height, radius, steps = 700) {
  let passed = 0;
  for (let i = 0; i < steps; i++) {
    for (let j = 0; j < steps; j++) {
      // Every direction of this grid brings as much light: its square sine is even.
      const sine = Math.sqrt((i + 0.5) / steps), turn = 2 * Math.PI * (j + 0.5) / steps;
      const way = [sine * Math.cos(turn), sine * Math.sin(turn), Math.sqrt(1 - sine * sine)];
      const ahead = x * way[0] + y * way[1] + height * way[2];
      const beside = x * x + y * y + height * height - ahead * ahead;
      if (ahead < 0 || beside > radius * radius) passed += 1;
    }
  }
  return passed / steps ** 2;
}

test("a ball hides what it does of an even sky", () => {
  for (const [x, y, height, radius] of [[0, 0, 1, 0.3], [0.4, 0, 0.5, 0.2], [1, -0.5, 0.8, 0.5]]) {
    const ball = [x, y, height, x, y, height, radius];
    assert.ok(Math.abs(seenPast(ball, 0, 0) - summed(x, y, height, radius)) < 2e-3);
  }
});

test("a capsule hides what a ball at its nearest point does", () => {
  const capsule = [-1, 0, 0.3, 1, 0, 0.3, 0.1];
  assert.equal(seenPast(capsule, 0.5, 0.2), seenPast([0.5, 0, 0.3, 0.5, 0, 0.3, 0.1], 0.5, 0.2));
  assert.equal(seenPast(capsule, 3, 0), seenPast([1, 0, 0.3, 1, 0, 0.3, 0.1], 3, 0));
});

test("the sky is left where a capsule lies beneath the floor, and is never gone", () => {
  assert.equal(seenPast([0, 0, -0.1, 0, 0, -0.1, 0.2], 0, 0), 1);
  assert.ok(Math.abs(seenPast([0, 0, 0.2, 0, 0, 0.2, 0.2], 0, 0) - 0.05) < 1e-9);
});
