// A stage that is narrower than the photo: the first touch does not zoom, and a finger takes along what is under it.

import assert from "node:assert";

import { clock, element, load } from "./window.mjs";

const { Stage } = await load("live", "stage.js");
const { Navigator } = await load("sent", "navigation.js");
const { fit, fittedHeight, lensOf } = await load("sent", "journey.js");
const { conjugate, rotate, subtract } = await load("sent", "vector.js");

const card = { index: 0, width: 1200, height: 800, focal: [1000, 1000], principal: [600, 400], position: [0, 0, -4] };
const pose = { position: card.position, rotation: [1, 0, 0, 0], fov_y: 2 * Math.atan(400 / 1000) };
const isNear = (a, b, what) => assert(Math.abs(a / b - 1) < 1e-6, `${what}: ${a}, not ${b}`);

for (const [width, height] of [[390, 844], [390, 200], [1200, 700]]) {
  const looks = [];
  const stage = new Stage(element(width, height), (look) => looks.push(look), () => {});
  // Focal length of the next picture in a frame of this width, px.
  const focal = (fov_y, frameWidth) => {
    stage.moved({ ...pose, fov_y });
    stage.tick((clock.now += 5000));
    const look = looks.at(-1);
    return ((look.height / 2 / Math.tan(look.pose.fov_y / 2)) * frameWidth) / look.width;
  };
  stage.camera = card;
  const before = focal(pose.fov_y, Math.min(width, 1.5 * height));
  const after = focal(stage.leaveCamera(pose.fov_y), width);
  assert.strictEqual(stage.camera, null);
  assert(Math.abs(after / before - 1) < 0.01, `${width}x${height}: a focal length of ${before} px becomes ${after} px`);
}

for (const [width, height] of [[390, 844], [1200, 800]]) {
  const [view, lens] = [element(width, height), lensOf(card)];
  const navigator = new Navigator(view, () => {}, () => {}, () => fittedHeight(lens, width, height));
  navigator.frame({ up: [0, -1, 0], centre: [0, 0, 0], distance: 4 });
  navigator.goTo(pose);
  const centre = () => {
    const { rotation, position } = navigator.pose;
    const [x, y, z] = rotate(conjugate(rotation), subtract([0, 0, 0], position));
    const { focal, principal } = fit(lens, width, height);
    return [(focal[0] * x) / z + principal[0], (focal[1] * y) / z + principal[1]];
  };
  const before = centre();
  view.listeners.pointerdown({ pointerId: 1, clientX: 100, clientY: 100 });
  view.listeners.pointermove({ pointerId: 1, clientX: 200, clientY: 70, shiftKey: true, buttons: 1 });
  const [dx, dy] = subtract(centre(), before);
  isNear(dx, 100, `${width}x${height}, sideways`);
  isNear(dy, -30, `${width}x${height}, upwards`);
}
