// The button for a snapshot counts down to when the run saves the next.

import assert from "node:assert";

import { element, load } from "./window.mjs";

const parts = {};
globalThis.document = { getElementById: (id) => (parts[id] ??= element(10, 10)) };
const { Status } = await load("live", "status.js");
const status = new Status(() => {});
const button = document.getElementById("snapshot");
const show = (phase, snapshot_wait) => {
  status.show({ phase, iteration: 1, iterations: 2, gaussians: 3, loss: null, psnr: null, device: "x", snapshot_wait });
  return [button.disabled, button.textContent];
};

assert.deepStrictEqual(show("training", 0), [false, "Snapshot"]);
assert.deepStrictEqual(show("training", 9), [true, "Snapshot (in 9 s)"]);
assert.deepStrictEqual(show("paused", 1), [true, "Snapshot (in 1 s)"]);
assert.deepStrictEqual(show("paused", 0), [false, "Snapshot"]);
assert.deepStrictEqual(show("ended", 0), [true, "Snapshot"]);

// How long is left is said while training.
const { timeLeft } = await load("live", "status.js");
assert.deepStrictEqual([30.2, 200, 3900].map(timeLeft), ["31 s left", "3 min left", "1 h 05 min left"]);
const showLeft = (phase, seconds_left, can_download) => {
  status.show({ phase, iteration: 1, iterations: 2, gaussians: 3, loss: null, psnr: null, device: "x", snapshot_wait: 0, seconds_left, can_download });
  return [document.getElementById("left").textContent, document.getElementById("downloads").hidden];
};
assert.deepStrictEqual(showLeft("training", 30, false), ["30 s left", true]);
assert.deepStrictEqual(showLeft("viewing", 30, true), ["", false]);
