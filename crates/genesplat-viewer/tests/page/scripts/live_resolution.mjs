// A user drags for ten seconds, and a server makes one picture at a time, of the newest look.

import assert from "node:assert";

import { clock, element, load } from "./window.mjs";

const { Stage } = await load("live", "stage.js");
const [WIDTH, HEIGHT, TARGET_MS] = [1200, 800, 40];

// Milliseconds of the last picture, where one of the whole stage takes `fullMs`; and widths that were asked for.
async function drag(fullMs) {
  const widths = [];
  let [wanted, served, last] = [null, null, 0];
  const stage = new Stage(element(WIDTH, HEIGHT), (look) => { wanted = look; widths.push(look.width); }, () => {});
  stage.target = TARGET_MS;
  for (const end = clock.now + 10_000; clock.now < end; clock.now += 16) {
    stage.moved({ position: [clock.now, 0, 0], rotation: [1, 0, 0, 0], fov_y: 1 });
    stage.tick(clock.now);
    if (served && clock.now >= served.end) {
      await stage.show({ sequence: served.sequence, error: false, milliseconds: served.milliseconds }, null);
      [last, served] = [served.milliseconds, null];
    }
    if (!served && wanted) {
      const milliseconds = (fullMs * wanted.width * wanted.height) / (WIDTH * HEIGHT);
      served = { sequence: wanted.sequence, milliseconds, end: clock.now + milliseconds };
      wanted = null;
    }
  }
  return { last, widths };
}

for (const fullMs of [60, 250, 600]) {
  const { last, widths } = await drag(fullMs);
  assert(Math.abs(last / TARGET_MS - 1) < 0.3, `${fullMs} ms at full size: the last picture takes ${last} ms`);
  assert(widths.length > 100, `${widths.length} looks`);
}
// The least that there is, a sixteenth of the pixels.
const slow = await drag(3000);
assert.strictEqual(slow.widths.at(-1), WIDTH / 4);
// A fast machine moves in full.
const fast = await drag(10);
assert.strictEqual(fast.widths.at(-1), WIDTH);

// A large picture that was asked for at rest is no reason for smaller ones.
const looks = [];
const stage = new Stage(element(WIDTH, HEIGHT), (look) => looks.push(look), () => {});
const move = () => {
  clock.now += 1000;
  stage.moved({ position: [0, 0, 0], rotation: [1, 0, 0, 0], fov_y: 1 });
  stage.tick(clock.now);
  return looks.at(-1).width;
};
const before = move();
clock.now += 1000;
stage.tick(clock.now);
const still = looks.at(-1);
assert.strictEqual(still.width, WIDTH);
const during = move();
await stage.show({ sequence: still.sequence, error: false, milliseconds: 2000 }, null);
assert.deepStrictEqual([during, move()], [before, before]);
