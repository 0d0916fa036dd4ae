// A box and an eraser: what they look like over the picture, how they are moved, and what the server is asked to remove.

import { add, conjugate, cross, dot, lookAlong, multiply, rotate, scale, subtract, turn } from "./vector.js";

const POINTS_MAX = 256;
const HANDLE_PX = 14;
const AXES = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
const SIGNS = [-1, 1];
const TOUCHED = "rgb(255 80 60 / 0.45)";

// Where a point is on a picture of this size, and how far ahead.
export function project({ pose, width, height }, point) {
  const [x, y, z] = rotate(conjugate(pose.rotation), subtract(point, pose.position));
  const focal = height / 2 / Math.tan(pose.fov_y / 2);
  return [width / 2 + (focal * x) / z, height / 2 + (focal * y) / z, z];
}

// The ends of a line on the picture, of which only what is farther ahead than `near` is seen; null where that is nothing.
export function lineOnPicture(view, a, b, near) {
  const ahead = (point) => project(view, point)[2];
  const [da, db] = [ahead(a), ahead(b)];
  if (da <= near && db <= near) return null;
  const cut = (from, to, dFrom, dTo) => (dFrom > near ? from : add(from, scale(subtract(to, from), (near - dFrom) / (dTo - dFrom))));
  return [cut(a, b, da, db), cut(b, a, db, da)].map((point) => project(view, point).slice(0, 2));
}

// How far a point has to go along an axis to follow a pointer, world units.
export function along(view, point, axis, [dx, dy]) {
  const step = 1e-3 * Math.max(project(view, point)[2], 1e-9);
  const [x, y] = subtract(project(view, add(point, scale(axis, step))), project(view, point));
  const length = x * x + y * y;
  // An axis that points at the viewer moves nothing.
  return length < 1e-8 ? 0 : (step * (x * dx + y * dy)) / length;
}

// No more points than the server takes, the ends among them.
export function thinned(path) {
  let points = path;
  while (points.length > POINTS_MAX) points = points.filter((_, index) => index % 2 === 0 || index === points.length - 1);
  return points;
}

// A box whose y points down in the scene, turned about that by an angle.
export class Box {
  constructor(centre, halfSizes, up) {
    this.centre = centre;
    this.halfSizes = halfSizes;
    this.angle = 0;
    const level = [...AXES].sort((a, b) => Math.abs(dot(a, up)) - Math.abs(dot(b, up)))[0];
    this.upright = lookAlong(cross(up, level), up);
    this.up = up;
  }

  get rotation() {
    return multiply(turn(this.up, this.angle), this.upright);
  }

  axis(index) {
    return rotate(this.rotation, AXES[index]);
  }

  at(...shares) {
    return shares.reduce((point, share, index) => add(point, scale(this.axis(index), share * this.halfSizes[index])), this.centre);
  }

  edges() {
    const pairs = SIGNS.flatMap((a) => SIGNS.map((b) => [a, b]));
    return AXES.flatMap((_, index) => pairs.map((pair) => [-1, 1].map((end) => this.at(...pair.toSpliced(index, 0, end)))));
  }

  // The middle, and that of each face.
  handles() {
    const faces = AXES.flatMap((_, index) => SIGNS.map((sign) => ({ index, sign, at: this.at(...[0, 0].toSpliced(index, 0, sign)) })));
    return [{ index: null, at: this.centre }, ...faces];
  }

  // A face goes out or in, and the one across from it stays.
  moveFace({ index, sign }, distance) {
    const half = Math.max(this.halfSizes[index] + distance / 2, 1e-4 * Math.max(...this.halfSizes));
    this.centre = add(this.centre, scale(this.axis(index), sign * (half - this.halfSizes[index])));
    this.halfSizes = this.halfSizes.with(index, half);
  }

  message(removes) {
    return { type: "crop", centre: this.centre, rotation: this.rotation, half_sizes: this.halfSizes, removes };
  }
}

export class Editor {
  tool = "look";
  box = null;
  #at = (id) => document.getElementById(id);
  #stage;
  #frame;
  #navigator;
  #camera;
  #send;
  #scene = { up: [0, -1, 0], distance: 1 };
  #dragged = null;
  #path = [];
  #pointer = null;

  // `camera` gives the card of the scene's camera that is looked through, or null.
  constructor(stage, navigator, camera, send) {
    [this.#stage, this.#frame] = [stage, stage.querySelector("#frame")];
    [this.#navigator, this.#camera, this.#send] = [navigator, camera, send];
    // Before the navigator hears them.
    const first = { capture: true };
    stage.addEventListener("pointerdown", (event) => this.#press(event), first);
    stage.addEventListener("pointermove", (event) => this.#move(event), first);
    for (const type of ["pointerup", "pointercancel"]) stage.addEventListener(type, (event) => this.#release(event), first);
    stage.addEventListener("pointerleave", () => { this.#pointer = null; });
    this.#listen();
  }

  #listen() {
    this.#at("tool").addEventListener("change", (event) => this.choose(event.target.value));
    this.#at("box-tool").addEventListener("input", () => this.#readNumbers());
    this.#at("keep-inside").addEventListener("click", () => this.#send(this.box.message("outside")));
    this.#at("remove-inside").addEventListener("click", () => this.#send(this.box.message("inside")));
    this.#at("undo").addEventListener("click", () => this.#send({ type: "undo" }));
    this.#at("save-edited").addEventListener("click", () => this.#send({ type: "save" }));
    addEventListener("keydown", (event) => {
      const isUndo = (event.ctrlKey || event.metaKey) && !event.shiftKey && event.key.toLowerCase() === "z";
      if (!isUndo || this.#at("undo").disabled || event.target.closest?.("dialog, input[type=number]")) return;
      event.preventDefault();
      this.#send({ type: "undo" });
    });
  }

  setScene({ up, distance }) {
    this.#scene = { up, distance };
  }

  // What the server says of edits.
  show({ can_edit = false, edits = 0, removed = 0 }) {
    if (!can_edit && this.tool !== "look") this.choose("look");
    this.#at("edit-waits").hidden = can_edit;
    this.#at("edit-tools").hidden = !can_edit;
    this.#at("undo").disabled = edits === 0;
    this.#at("save-edited").disabled = edits === 0;
    this.#at("edit-count").hidden = edits === 0;
    this.#at("edit-count").textContent = `${removed.toLocaleString("en")} Gaussians removed by ${edits} ${edits === 1 ? "edit" : "edits"}`;
  }

  choose(tool) {
    this.tool = tool;
    for (const input of this.#at("tool").querySelectorAll("input")) input.checked = input.value === tool;
    this.#at("box-tool").hidden = tool !== "box";
    this.#at("eraser-tool").hidden = tool !== "eraser";
    this.#stage.dataset.tool = tool;
    if (tool === "box" && !this.box) {
      const half = 0.25 * this.#scene.distance;
      this.box = new Box([...this.#navigator.target], [half, half, half], this.#scene.up);
      this.#writeNumbers();
    }
    this.draw();
  }

  get #view() {
    return { pose: this.#navigator.pose, width: this.#frame.clientWidth, height: this.#frame.clientHeight };
  }

  get #near() {
    return 0.01 * this.#scene.distance;
  }

  #place({ clientX, clientY }) {
    const box = this.#frame.getBoundingClientRect();
    return [clientX - box.left, clientY - box.top];
  }

  #press(event) {
    if (event.button !== 0 || event.shiftKey || this.tool === "look") return;
    const place = this.#place(event);
    if (this.tool === "eraser") this.#path = [place];
    else this.#dragged = this.#handleAt(place);
    if (this.tool === "box" && !this.#dragged) return;
    this.#pointer = place;
    event.stopImmediatePropagation();
    this.#stage.focus({ preventScroll: true });
    this.#stage.setPointerCapture(event.pointerId);
  }

  #move(event) {
    const [before, place] = [this.#pointer, this.#place(event)];
    this.#pointer = place;
    if (!this.#dragged && !this.#path.length) return;
    event.stopImmediatePropagation();
    if (this.#dragged) this.#drag(subtract(place, before));
    else if (Math.hypot(...subtract(place, this.#path.at(-1))) >= Math.max(2, 0.3 * this.#radius)) this.#path.push(place);
  }

  #release(event) {
    if (!this.#dragged && !this.#path.length) return;
    event.stopImmediatePropagation();
    if (this.#path.length && event.type === "pointerup") this.#erase();
    [this.#dragged, this.#path] = [null, []];
  }

  #handleAt([x, y]) {
    const distance = ({ at }) => {
      const [px, py, depth] = project(this.#view, at);
      return depth > this.#near ? Math.hypot(px - x, py - y) : Infinity;
    };
    const nearest = this.box.handles().map((handle) => [distance(handle), handle]).sort((a, b) => a[0] - b[0])[0];
    return nearest[0] < HANDLE_PX ? nearest[1] : null;
  }

  // The middle goes where the pointer goes, a face along its own axis.
  #drag([dx, dy]) {
    const { index, sign } = this.#dragged;
    if (index === null) {
      const { pose, height } = this.#view;
      const perPixel = (2 * project(this.#view, this.box.centre)[2] * Math.tan(pose.fov_y / 2)) / height;
      this.box.centre = add(this.box.centre, rotate(pose.rotation, [dx * perPixel, dy * perPixel, 0]));
    } else {
      const { at } = this.box.handles().find((handle) => handle.index === index && handle.sign === sign);
      this.box.moveFace(this.#dragged, along(this.#view, at, scale(this.box.axis(index), sign), [dx, dy]));
    }
    this.#writeNumbers();
  }

  #erase() {
    const { pose, width, height } = this.#view;
    const { position, rotation, fov_y } = pose;
    const round = (value) => Math.round(10 * value) / 10;
    this.#send({
      type: "erase",
      pose: { position, rotation, fov_y },
      camera: this.#camera()?.index ?? null,
      width: Math.round(width),
      height: Math.round(height),
      radius: this.#radius,
      path: thinned(this.#path).map((point) => point.map(round)),
      through: this.#at("through").checked,
    });
  }

  get #radius() {
    return Number(this.#at("radius").value);
  }

  #numbers(name) {
    return ["x", "y", "z"].map((axis) => this.#at(`box-${name}-${axis}`));
  }

  #writeNumbers() {
    const write = (inputs, values) => inputs.forEach((input, axis) => { input.value = Number(values[axis].toPrecision(5)); });
    write(this.#numbers("centre"), this.box.centre);
    write(this.#numbers("size"), scale(this.box.halfSizes, 2));
    this.#at("box-angle").value = Math.round((180 / Math.PI) * this.box.angle);
  }

  // A field that is empty, or a size that is none, changes nothing.
  #readNumbers() {
    const read = (inputs, old, holds) => inputs.map(({ valueAsNumber }, axis) => (holds(valueAsNumber) ? valueAsNumber : old[axis]));
    this.box.centre = read(this.#numbers("centre"), this.box.centre, Number.isFinite);
    const sizes = read(this.#numbers("size"), scale(this.box.halfSizes, 2), (size) => Number.isFinite(size) && size > 0);
    this.box.halfSizes = scale(sizes, 0.5);
    this.box.angle = (Math.PI / 180) * Number(this.#at("box-angle").value);
  }

  // Called before each repaint.
  draw() {
    const canvas = this.#at("edit-overlay");
    const isOff = this.tool === "look";
    if (canvas.hidden !== isOff) canvas.hidden = isOff;
    if (isOff) return;
    const density = Math.min(devicePixelRatio, 2);
    const { width, height } = this.#view;
    [canvas.width, canvas.height] = [width * density, height * density];
    const context = canvas.getContext("2d");
    context.scale(density, density);
    [context.lineWidth, context.shadowColor, context.shadowBlur] = [1.5, "rgb(0 0 0 / 0.7)", 2];
    context.strokeStyle = context.fillStyle = getComputedStyle(document.documentElement).getPropertyValue("--accent");
    if (this.tool === "box") this.#drawBox(context);
    else this.#drawBrush(context);
  }

  #drawBox(context) {
    context.beginPath();
    for (const [a, b] of this.box.edges()) {
      const line = lineOnPicture(this.#view, a, b, this.#near);
      if (!line) continue;
      context.moveTo(...line[0]);
      context.lineTo(...line[1]);
    }
    context.stroke();
    for (const { at, index } of this.box.handles()) {
      const [x, y, depth] = project(this.#view, at);
      if (depth <= this.#near) continue;
      context.beginPath();
      context.arc(x, y, index === null ? 7 : 5, 0, 2 * Math.PI);
      context.fill();
    }
  }

  #drawBrush(context) {
    if (this.#path.length) {
      context.save();
      [context.strokeStyle, context.lineWidth, context.lineCap, context.lineJoin, context.shadowBlur] = [TOUCHED, 2 * this.#radius, "round", "round", 0];
      context.beginPath();
      context.moveTo(...this.#path[0]);
      [...this.#path, this.#pointer ?? this.#path[0]].forEach((point) => context.lineTo(...point));
      context.stroke();
      context.restore();
    }
    if (!this.#pointer) return;
    context.strokeStyle = "#fff";
    context.beginPath();
    context.arc(...this.#pointer, this.#radius, 0, 2 * Math.PI);
    context.stroke();
  }
}
