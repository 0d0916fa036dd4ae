// Without cameras, a page with y down and a sent one, half a turn about x from it, begin at the same place: in front, and above.

import assert from "node:assert";

import { element, load } from "./window.mjs";

const { dot, down, forward } = await load("sent", "vector.js");

async function overview(page, up, centre) {
  const { Navigator } = await load(page, "navigation.js");
  const navigator = new Navigator(element(400, 300), () => {}, () => {});
  navigator.frame({ up, centre, distance: 4 });
  const pose = navigator.overview();
  assert(dot(down(pose.rotation), up) < -0.9, `${page}: it is upside down`);
  return { position: pose.position, ahead: forward(pose.rotation) };
}

const live = await overview("live", [0, -1, 0], [1, 2, 3]);
const sent = await overview("sent", [0, 1, 0], [1, -2, -3]);
assert(live.position[2] < 3 && live.position[1] < 2, `${live.position} is not in front of the scene and above it`);
for (const what of ["position", "ahead"]) {
  const [x, y, z] = sent[what];
  [x, -y, -z].forEach((value, axis) => assert(Math.abs(value - live[what][axis]) < 1e-9, `${what}: ${sent[what]}, ${live[what]}`));
}
