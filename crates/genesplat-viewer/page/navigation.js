// How mouse, touch and keys move the camera: around a point, freely, or upright on a plane.

import { add, dot, down, forward, length, lookAlong, multiply, right, scale, subtract, turn } from "./vector.js";

const TURN_PER_PX = 0.005;
const TURN_PER_SECOND = 1.2;
const ELEVATION_MAX = 1.5;
const CLICK_PX = 4;

const TEXT = "select, textarea, input:not([type=radio], [type=checkbox], [type=range])";
const CHOICE = "input[type=radio], input[type=range]";

// What a key is called among shortcuts: letters are small, whatever Caps Lock says.
export const shortcutOf = ({ key }) => (key.length === 1 ? key.toLowerCase() : key);

// Whether a key is for what has the focus, or for the browser: what is typed, Space on a button, arrows on a choice.
export function isTaken({ key, target, ctrlKey, metaKey, altKey }) {
  const isOn = (selector) => Boolean(target.closest?.(selector));
  // Some keyboards have brackets behind Alt.
  const isCommand = ctrlKey || metaKey || (altKey && key !== "[" && key !== "]");
  if (isCommand || isOn(`dialog, ${TEXT}`)) return true;
  if (key === " ") return isOn("button, input");
  return (key.startsWith("Arrow") || key === "Home") && isOn(CHOICE);
}

export class Navigator {
  pose = { position: [0, 0, -3], rotation: [1, 0, 0, 0], fov_y: 0.9 };
  movement = "orbit";
  #up = [0, -1, 0];
  #target = [0, 0, 0];
  #scene = 1;
  #pointers = new Map();
  #travelled = 0;
  #keys = new Set();
  #element;
  #onMove;
  #onClick;
  #fovHeight;

  // `fovHeight` is the height that the field of view spans, px.
  constructor(element, onMove, onClick, fovHeight = () => element.clientHeight) {
    this.#element = element;
    this.#fovHeight = fovHeight;
    this.#onMove = onMove;
    this.#onClick = onClick;
    element.addEventListener("pointerdown", (event) => this.#press(event));
    element.addEventListener("pointermove", (event) => this.#drag(event));
    for (const type of ["pointerup", "pointercancel"]) element.addEventListener(type, (event) => this.#release(event));
    element.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    element.addEventListener("contextmenu", (event) => event.preventDefault());
    addEventListener("keydown", (event) => this.#keydown(event));
    addEventListener("keyup", (event) => this.#keys.delete(event.code));
    addEventListener("blur", () => this.#keys.clear());
  }

  // The scene's up, and what to turn around.
  frame({ up, centre, distance }) {
    this.#up = up;
    this.#target = centre;
    this.#scene = distance;
  }

  // Where there are no cameras: in front of the scene, a little above it.
  overview() {
    // Scenes with y down lie along z; a sent page is half a turn about x from that.
    const sign = this.#up[1] > 0 ? -1 : 1;
    const ahead = lookAlong([0.25, 0.2 * sign, sign], this.#up);
    const position = subtract(this.#target, scale(forward(ahead), this.#scene));
    return { position, rotation: ahead, fov_y: 0.9 };
  }

  // Goes to `pose`; what is turned around from now on is the scene's centre, or as far ahead as that is.
  goTo(pose) {
    this.pose = { ...pose };
    const ahead = forward(pose.rotation);
    const depth = dot(subtract(this.#home, pose.position), ahead);
    this.#target = add(pose.position, scale(ahead, Math.max(depth, 0.15 * this.#scene)));
  }

  // What is turned around.
  get target() {
    return this.#target;
  }

  set home(centre) {
    this.#home = centre;
  }

  #home = [0, 0, 0];

  setMovement(movement) {
    this.movement = movement;
    if (movement === "walk") {
      this.pose.rotation = lookAlong(forward(this.pose.rotation), this.#up);
      this.#onMove();
    }
    if (movement === "orbit") this.goTo(this.pose);
  }

  // What keys that are held do in so many seconds; true while they do something.
  advance(seconds) {
    const has = (...codes) => codes.some((code) => this.#keys.has(code));
    const axis = (plus, minus) => (has(...plus) ? 1 : 0) - (has(...minus) ? 1 : 0);
    const ahead = axis(["KeyW"], ["KeyS"]) + axis(["Equal", "NumpadAdd"], ["Minus", "NumpadSubtract"]);
    const sideways = axis(["KeyD"], ["KeyA"]);
    const upwards = axis(["KeyE"], ["KeyQ"]);
    const yaw = axis(["ArrowLeft"], ["ArrowRight"]);
    const pitch = axis(["ArrowUp"], ["ArrowDown"]);
    if (!(ahead || sideways || upwards || yaw || pitch)) return false;
    const step = 0.5 * this.#scene * seconds * (has("ShiftLeft", "ShiftRight") ? 3 : 1);
    this.#shift(ahead * step, sideways * step, upwards * step);
    const angle = TURN_PER_SECOND * seconds * (this.movement === "orbit" ? -1 : 1);
    this.#turn(yaw * angle, pitch * angle);
    this.#onMove();
    return true;
  }

  #shift(ahead, sideways, upwards) {
    let direction = forward(this.pose.rotation);
    if (this.movement === "walk") {
      direction = subtract(direction, scale(this.#up, dot(direction, this.#up)));
      direction = scale(direction, 1 / (length(direction) || 1));
      upwards = 0;
    }
    const moved = [scale(direction, ahead), scale(right(this.pose.rotation), sideways), scale(this.#up, upwards)].reduce(add);
    this.pose.position = add(this.pose.position, moved);
    this.#target = add(this.#target, moved);
  }

  // Turns about the scene's up and the camera's right: the camera itself, or with it its place around the target.
  #turn(yaw, pitch) {
    const elevation = Math.asin(Math.max(-1, Math.min(1, dot(forward(this.pose.rotation), this.#up))));
    const allowed = Math.max(-ELEVATION_MAX, Math.min(ELEVATION_MAX, elevation + pitch)) - elevation;
    const both = multiply(turn(this.#up, yaw), turn(right(this.pose.rotation), allowed));
    const distance = length(subtract(this.pose.position, this.#target));
    const ahead = dot(subtract(this.#target, this.pose.position), forward(this.pose.rotation));
    this.pose.rotation = multiply(both, this.pose.rotation);
    if (this.movement === "orbit") {
      const reach = Math.max(ahead, 0.01 * distance);
      this.pose.position = subtract(this.#target, scale(forward(this.pose.rotation), reach));
    }
  }

  #pan(dx, dy) {
    const distance = Math.max(length(subtract(this.#target, this.pose.position)), 0.05 * this.#scene);
    const perPixel = (2 * distance * Math.tan(this.pose.fov_y / 2)) / this.#fovHeight();
    const { rotation } = this.pose;
    const moved = add(scale(right(rotation), -dx * perPixel), scale(down(rotation), -dy * perPixel));
    this.pose.position = add(this.pose.position, moved);
    this.#target = add(this.#target, moved);
  }

  // Towards the target, which is never reached; otherwise ahead.
  #approach(amount) {
    if (this.movement !== "orbit") return this.#shift(0.5 * this.#scene * amount, 0, 0);
    const away = scale(subtract(this.pose.position, this.#target), Math.exp(-amount));
    if (length(away) > 1e-3 * this.#scene) this.pose.position = add(this.#target, away);
  }

  #press(event) {
    this.#element.focus({ preventScroll: true });
    this.#element.setPointerCapture(event.pointerId);
    this.#pointers.set(event.pointerId, [event.clientX, event.clientY]);
    this.#travelled = 0;
  }

  #drag(event) {
    const before = this.#pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    const [dx, dy] = subtract(now, before);
    if (dx === 0 && dy === 0) return;
    this.#travelled += Math.abs(dx) + Math.abs(dy);
    if (this.#travelled < CLICK_PX) return;
    if (this.#pointers.size > 1) this.#pinch(event.pointerId, before, now);
    else if (event.shiftKey || event.buttons & 6) this.#pan(dx, dy);
    else {
      const sign = this.movement === "orbit" ? -TURN_PER_PX : TURN_PER_PX;
      this.#turn(sign * dx, sign * dy);
    }
    this.#pointers.set(event.pointerId, now);
    this.#onMove();
  }

  #pinch(id, before, now) {
    const other = [...this.#pointers].find(([pointer]) => pointer !== id)[1];
    const [apartBefore, apartNow] = [before, now].map((place) => length(subtract(place, other)));
    if (apartBefore > 1 && apartNow > 1) this.#approach(Math.log(apartNow / apartBefore));
    const [dx, dy] = scale(subtract(now, before), 0.5);
    this.#pan(dx, dy);
  }

  #release(event) {
    const wasDown = this.#pointers.delete(event.pointerId);
    if (wasDown && event.type === "pointerup" && this.#travelled < CLICK_PX) this.#onClick(event);
  }

  #wheel(event) {
    event.preventDefault();
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 30 : 1;
    this.#approach(-0.0012 * lines * event.deltaY);
    this.#onMove();
  }

  #keydown(event) {
    if (isTaken(event)) return;
    const isArrow = event.code.startsWith("Arrow");
    if (isArrow || /^(Key[WASDQE]|Equal|Minus|Numpad(Add|Subtract)|Shift(Left|Right))$/.test(event.code)) {
      this.#keys.add(event.code);
      if (isArrow) event.preventDefault();
    }
  }
}
