// A box keeps the face across from one that is dragged, lines end before the eye, and long strokes keep their ends.

import assert from "node:assert";

import { load } from "./window.mjs";

const { Box, along, lineOnPicture, project, thinned } = await load("live", "edit.js");
const { dot } = await load("live", "vector.js");
const near = (a, b) => a.forEach((value, index) => assert(Math.abs(value - b[index]) < 1e-6, `${a}, not ${b}`));
const view = { pose: { position: [0, 0, -4], rotation: [1, 0, 0, 0], fov_y: 1 }, width: 400, height: 200 };

near(project(view, [0, 0, 0]), [200, 100, 4]);
// A pointer that goes right by what a step to the right makes on the picture.
const [x] = project(view, [0.5, 0, 0]);
assert(Math.abs(along(view, [0, 0, 0], [1, 0, 0], [x - 200, 7]) - 0.5) < 1e-3);
assert.strictEqual(along(view, [0, 0, 0], [0, 0, 1], [50, 0]), 0, "an axis at the viewer");

assert.strictEqual(lineOnPicture(view, [0, 0, -9], [1, 0, -8], 0.1), null, "all of it is behind");
const [a, b] = lineOnPicture(view, [0, 0, -9], [0, 0, 0], 0.1);
near([...a, ...b], [200, 100, 200, 100]);

for (const up of [[0, -1, 0], [0, 1, 0], [1, 0, 0], [0.6, 0, 0.8]]) {
  const box = new Box([1, 2, 3], [1, 1, 1], up);
  assert(dot(box.axis(1), up) < -0.999, `y is down for ${up}`);
  box.angle = 0.7;
  assert(dot(box.axis(1), up) < -0.999, "also when it is turned");
  const across = box.at(-1, 0, 0);
  box.moveFace({ index: 0, sign: 1 }, 3);
  near(box.at(-1, 0, 0), across);
  near(box.halfSizes, [2.5, 1, 1]);
  box.moveFace({ index: 0, sign: 1 }, -100);
  assert(box.halfSizes[0] > 0, "a box has a size");
  assert.strictEqual(box.edges().length, 12);
  assert.strictEqual(new Set(box.handles().map(({ at }) => String(at))).size, 7);
}
const { type, removes, half_sizes } = new Box([0, 0, 0], [1, 2, 3], [0, -1, 0]).message("outside");
assert.deepStrictEqual([type, removes, half_sizes], ["crop", "outside", [1, 2, 3]]);

const long = Array.from({ length: 1001 }, (_, index) => [index, 0]);
const points = thinned(long);
assert(points.length <= 256 && points[0][0] === 0 && points.at(-1)[0] === 1000, `${points.length}`);
