// Movements on machines that draw at different speeds, with and without pauses.

import assert from "node:assert";

import { clock, element, load } from "./window.mjs";

const [WIDTH, HEIGHT, FRAME_MS, SORT_MS] = [1200, 800, 16.7, 50];

// Orders that come, each with its time.
let orders = [];
globalThis.Worker = class {
  postMessage({ depthRow }) {
    if (depthRow) orders.push({ at: clock.now + SORT_MS, tell: () => this.onmessage({ data: [] }) });
  }
};
URL.createObjectURL = () => "";
const { Stage } = await load("sent", "stage.js");

// A page on a machine that draws a picture in full in so many milliseconds.
class Page {
  widths = [];
  #canvas = element(WIDTH, HEIGHT);
  #drawn = false;
  #angle = 0;
  #stage = new Stage(this.#canvas, { setOrder() {}, draw: () => { this.#drawn = true; } }, new Float32Array(3), "", assert.fail);

  constructor(fullMs) {
    this.fullMs = fullMs;
    this.rest();
  }

  #frame() {
    orders.filter(({ at }) => at <= clock.now).forEach(({ tell }) => tell());
    orders = orders.filter(({ at }) => at > clock.now);
    this.#drawn = false;
    const lens = { aspect: 1.5, focal: [1, 1], principal: [0, 0] };
    const rotation = [Math.cos(this.#angle), 0, Math.sin(this.#angle), 0];
    this.#stage.tick(clock.now, { pose: { position: [0, 0, -4], rotation, fov_y: 1 }, lens });
    const { width, height } = this.#canvas;
    if (this.#drawn) this.widths.push(width);
    clock.now += Math.max(FRAME_MS, this.#drawn ? (this.fullMs * width * height) / (WIDTH * HEIGHT) : 0);
  }

  rest() {
    for (const end = clock.now + 1000; clock.now < end;) this.#frame();
    assert.strictEqual(this.#canvas.width, WIDTH, "what rests is shown in full");
  }

  // Moves in each frame, or every so many milliseconds; the width of the last picture.
  move(everyMs = 0) {
    for (const end = clock.now + 3000; clock.now < end;) {
      this.#angle += 0.01;
      this.#stage.redraw();
      const next = clock.now + everyMs;
      do this.#frame(); while (clock.now < next);
    }
    return this.widths.at(-1);
  }
}

// Pauses between movements are no slow frames.
for (const everyMs of [0, 50, 100, 150, 400]) {
  const fast = new Page(5);
  fast.move(everyMs);
  assert(fast.widths.every((width) => width === WIDTH), `moved every ${everyMs} ms: ${fast.widths}`);
}

// Nor is a frame longer than a rest a rest.
for (const [fullMs, part] of [[30, 1], [70, 0.7], [100, 0.5], [400, 0.35]]) {
  const slow = new Page(fullMs);
  assert.strictEqual(slow.move(), WIDTH * part, `${fullMs} ms in full`);
  slow.rest();
  assert.strictEqual(slow.move(), WIDTH * part, `${fullMs} ms in full, after a rest`);
}

// What was busy for a while comes back, a step at each rest.
const page = new Page(400);
page.move();
page.fullMs = 5;
const back = [0, 1, 2, 3].map(() => { page.move(); page.rest(); return page.move() / WIDTH; });
assert.deepStrictEqual(back, [0.5, 0.7, 1, 1]);
