// The picture: when it is drawn, how large, and in which order of Gaussians.

import { dot, down, forward, right } from "./vector.js";
import { fit } from "./journey.js";

// Parts of the full resolution while the view moves on a machine that is slow.
const DETAILS = [1, 0.7, 0.5, 0.35];
const SLOW_MS = 40;
const SLOW_FRAMES = 4;
// A movement of at least so many frames whose mean is below this leaves room for a finer picture.
const FAST_MS = 24;
const FAST_FRAMES = 8;
const REST_MS = 180;
const DREW = { nothing: 0, moving: 1, full: 2 };
const PIXEL_RATIO_MAX = 2;

export class Stage {
  #canvas;
  #renderer;
  #sorter;
  #isSorting = false;
  #sorted = null;
  #isDirty = true;
  #lastDrawn = -Infinity;
  #lastTick = -Infinity;
  // What the last tick drew: nothing, a picture of a movement, or one in full.
  #drew = DREW.nothing;
  #slowFrames = 0;
  // Of the movement, since the resolution is what it is.
  #pace = { frames: 0, milliseconds: 0 };
  #detail = 0;

  constructor(canvas, renderer, positions, sorterSource, fail) {
    [this.#canvas, this.#renderer] = [canvas, renderer];
    // A page from the disk may start workers that are scripts, but none that are modules.
    const script = new Blob([sorterSource], { type: "text/javascript" });
    this.#sorter = new Worker(URL.createObjectURL(script));
    this.#sorter.onerror = () => fail("This browser does not sort the splat.");
    this.#sorter.onmessage = ({ data }) => {
      this.#isSorting = false;
      renderer.setOrder(data);
      this.redraw();
    };
    this.#sorter.postMessage({ positions }, [positions.buffer]);
    new ResizeObserver(() => this.redraw()).observe(canvas);
  }

  redraw() {
    this.#isDirty = true;
    delete this.#canvas.dataset.rest;
  }

  // Draws `view` where something has changed, and once more in full when it rests.
  tick(now, view) {
    // The next frame comes when this one is done; a tick that draws nothing tells nothing.
    if (this.#drew === DREW.moving) this.#judge(now - this.#lastTick);
    const rests = this.#drew === DREW.nothing && now - this.#lastDrawn > REST_MS;
    [this.#lastTick, this.#drew] = [now, DREW.nothing];
    if (!this.#isDirty && rests && !this.#isSorting) this.#rest(view);
    if (!this.#isDirty) return;
    this.#isDirty = false;
    this.#lastDrawn = now;
    this.#drew = rests ? DREW.full : DREW.moving;
    this.#draw(view, rests ? 0 : this.#detail);
  }

  #rest(view) {
    const { frames, milliseconds } = this.#pace;
    const isFast = frames >= FAST_FRAMES && milliseconds < FAST_MS * frames;
    this.#setDetail(isFast ? this.#detail - 1 : this.#detail);
    if (this.#canvas.width !== this.#size(0)[0]) this.#draw(view, 0);
    this.#canvas.dataset.rest = "";
  }

  // One step coarser after some slow frames in a row; one that is slower counts as more.
  #judge(elapsed) {
    this.#pace.frames += 1;
    this.#pace.milliseconds += elapsed;
    this.#slowFrames = elapsed > SLOW_MS ? this.#slowFrames + Math.round(elapsed / SLOW_MS) : 0;
    if (this.#slowFrames >= SLOW_FRAMES) this.#setDetail(this.#detail + 1);
  }

  #setDetail(detail) {
    this.#detail = Math.max(0, Math.min(detail, DETAILS.length - 1));
    this.#slowFrames = 0;
    this.#pace = { frames: 0, milliseconds: 0 };
  }

  #size(detail) {
    const ratio = Math.min(devicePixelRatio, PIXEL_RATIO_MAX) * DETAILS[detail];
    return [this.#canvas.clientWidth, this.#canvas.clientHeight].map((side) => Math.max(1, Math.round(side * ratio)));
  }

  #draw({ pose, lens }, detail) {
    const [width, height] = this.#size(detail);
    const canvas = this.#canvas;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const axes = [right, down, forward].map((axis) => axis(pose.rotation));
    const translation = axes.map((axis) => -dot(axis, pose.position));
    this.#sort([...axes[2], translation[2]]);
    this.#renderer.draw({ rotation: axes.flat(), translation, eye: pose.position, ...fit(lens, width, height) });
  }

  // Asks for another order where depths have changed, one at a time.
  #sort(depthRow) {
    const wanted = depthRow.map((value) => value.toPrecision(6)).join();
    if (this.#isSorting || wanted === this.#sorted) return;
    [this.#isSorting, this.#sorted] = [true, wanted];
    this.#sorter.postMessage({ depthRow });
  }
}
