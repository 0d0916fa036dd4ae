// The chart of evolution stays within its plot, whatever stages cost, and its caption comes back after the pointer has left.

import assert from "node:assert";

import { element, load } from "./window.mjs";

const { Charts } = await load("live", "charts.js");
const { isTaken, shortcutOf } = await load("live", "navigation.js");

class Node {
  constructor(name) { Object.assign(this, { name, attributes: {}, children: [], listeners: {}, hidden: false, textContent: "" }); }
  setAttribute(key, value) { this.attributes[key] = value; }
  append(...nodes) { this.children.push(...nodes); }
  replaceChildren(...nodes) { this.children = nodes; }
  addEventListener(type, listener) { this.listeners[type] = listener; }
  querySelector(wanted) {
    const found = this.children.find(({ attributes }) => `.${attributes.class}` === wanted);
    return found && { remove: () => (this.children = this.children.filter((child) => child !== found)) };
  }
  getBoundingClientRect() { return { left: 0, width: 300 }; }
}
globalThis.document = { createElement: (name) => new Node(name), createElementNS: (_, name) => new Node(name) };

const place = new Node("div");
const charts = new Charts(place);
const figure = place.children.at(-1);
const [caption, plot] = figure.children;
const [value, drawing] = [caption.children[1], plot.children.at(-1)];

const shown = (stages) => {
  charts.show({ stages: stages.map(([gain, kept], index) => ({ iteration: 10 * (index + 1), gain, kept })), loss: [], psnr: [], gaussians: [] });
  const ticks = drawing.children.filter(({ attributes }) => attributes.class !== "axis").map(({ attributes }) => attributes);
  ticks.forEach(({ y1, y2 }) => assert([y1, y2].every((y) => y >= 0 && y <= 80), `from ${y1} to ${y2} of 80`));
  return ticks;
};
const rises = ({ y1, y2 }) => y2 < y1;
assert.deepStrictEqual(shown([[0.1, true], [0.3, true]]).map(rises), [true, true]);
assert.deepStrictEqual(shown([[-0.5, true]]).map(rises), [false], "what an average cost is below the axis");
assert.deepStrictEqual(shown([[0.2, true], [-0.4, true], [-0.9, false]]).map(rises), [true, false, true]);

assert.strictEqual(value.textContent, "2 of 3 kept");
const point = (iteration) => drawing.listeners.pointermove({ clientX: (iteration / 30) * 300 });
point(20);
assert.strictEqual(value.textContent, "-0.40 at 20");
point(30);
assert.strictEqual(value.textContent, "taken back at 30");
drawing.listeners.pointerleave();
assert.strictEqual(value.textContent, "2 of 3 kept");

// Shortcuts with Caps Lock, and on keyboards that have brackets behind Alt.
const target = { closest: () => null };
assert.strictEqual(shortcutOf({ key: "H" }), "h");
assert.strictEqual(shortcutOf({ key: "Home" }), "Home");
assert(!isTaken({ key: "[", altKey: true, target }) && isTaken({ key: "h", altKey: true, target }));

// A page that is connected again turns around what is ahead of it, and stays where it is.
const { Navigator } = await load("live", "navigation.js");
const stage = element(400, 300);
const navigator = new Navigator(stage, () => {}, () => {});
const scene = { up: [0, -1, 0], centre: [0, 0, 0], distance: 4 };
navigator.frame(scene);
navigator.home = scene.centre;
navigator.goTo({ position: [3, 0, -4], rotation: [1, 0, 0, 0], fov_y: 1 });
navigator.frame(scene);
navigator.goTo(navigator.pose);
const at = { pointerId: 1, pointerType: "mouse", button: 0, buttons: 1, preventDefault() {} };
stage.listeners.pointerdown({ ...at, clientX: 100, clientY: 100 });
stage.listeners.pointermove({ ...at, clientX: 101, clientY: 100 });
const [x, , z] = navigator.pose.position;
assert(Math.hypot(x - 3, z + 4) < 0.1, `a drag by one pixel leads to ${navigator.pose.position}`);
