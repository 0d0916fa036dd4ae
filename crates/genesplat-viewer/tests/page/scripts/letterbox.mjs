// A picture of another shape than its place keeps its shape, and one whose sides are only rounded fills it.

import assert from "node:assert";

import { clock, element, load } from "./window.mjs";

const { Stage, isApart } = await load("live", "stage.js");
for (const [picture, box] of [[[1200, 800], [1200, 800]], [[301, 200], [1200, 800]], [[16, 11], [1200, 800]], [[77, 231], [400, 1200]]]) {
  assert(!isApart(picture, box), `${picture} in ${box}`);
}
for (const [picture, box] of [[[1200, 800], [1000, 800]], [[300, 200], [1200, 900]], [[800, 1200], [1200, 800]]]) {
  assert(isApart(picture, box), `${picture} in ${box}`);
}

// A picture that takes its time is said to be on its way, until it is there.
const place = element(1200, 800);
const badge = place.querySelector("#rendering");
badge.hidden = true;
let look;
const stage = new Stage(place, (asked) => { look = asked; }, () => {});
const pose = { position: [0, 0, 0], rotation: [1, 0, 0, 0], fov_y: 1 };
clock.now = 5000;
stage.moved(pose);
stage.tick(clock.now);
assert.strictEqual(badge.hidden, true);
clock.now += 300;
stage.tick(clock.now);
assert.strictEqual(badge.hidden, false, "it is late");
clock.now += 100;
await stage.show({ sequence: look.sequence, error: false, milliseconds: 300 }, null);
stage.tick(clock.now);
assert.strictEqual(badge.hidden, true, "it is there");
