// What the pages' scripts need of a browser: a clock that the test moves on, and elements that know their size.

import { pathToFileURL } from "node:url";

export const clock = { now: 0 };

Object.assign(globalThis, {
  devicePixelRatio: 1,
  ResizeObserver: class { observe() {} },
  createImageBitmap: async () => ({ width: 1, height: 1 }),
  addEventListener: () => {},
});
performance.now = () => clock.now;

// An element; `listeners` has those of its events.
export function element(width, height) {
  const parts = {};
  return {
    width: 0,
    height: 0,
    clientWidth: width,
    clientHeight: height,
    dataset: {},
    style: {},
    listeners: {},
    classes: new Set(),
    classList: { toggle: () => {} },
    addEventListener(type, listener) { this.listeners[type] = listener; },
    querySelector(name) { return (parts[name] ??= element(width, height)); },
    getBoundingClientRect() {
      const side = (name, whole) => (this.style[name] ? parseFloat(this.style[name]) : whole);
      return { left: 0, top: 0, width: side("width", width), height: side("height", height) };
    },
    getContext: () => ({ drawImage() {} }),
    setPointerCapture() {},
    focus() {},
  };
}

// A module of the page `live` or `sent`.
export const load = (page, name) => import(pathToFileURL(`${process.argv[2]}/${page}/${name}`));
