// The picture: asks for what is seen now, small while it moves and sharp when it rests, and shows the newest answer with
// the photo and the error beside it.

import { add, conjugate, rotate, subtract } from "./vector.js";

const REST_MS = 220;
const RESEND_MS = 120;
const PIXELS_MAX = 2_400_000;
const QUALITY = { moving: 68, still: 90 };
const FACTOR = { least: 0.25, most: 1 };
const FRUSTUM_SIZE = 0.045;
const CLICK_RADIUS_PX = 16;
// A picture that takes longer is said to be on its way.
const SLOW_MS = 250;
// The server draws no wider views.
const FOV_Y_MAX = 2.8;

// Whether a picture of these sides has another shape than the box that it is shown in, by more than its sides are rounded.
export function isApart([width, height], [boxWidth, boxHeight]) {
  const expected = (width * boxHeight) / boxWidth;
  return Math.abs(height - expected) > 1.5 * Math.max(1, boxHeight / boxWidth);
}

export class Stage {
  renderMode = "colour";
  // A card of the scene's cameras to look through, or null for a free view.
  camera = null;
  comparison = 1;
  showsFrusta = false;
  // Milliseconds that a small picture should take.
  target = 40;
  #element;
  #frame;
  #layers;
  #cards = [];
  #sceneDistance = 1;
  #factor = 0.6;
  #movedAt = 0;
  #isDirty = true;
  #isSharp = false;
  #sequence = 0;
  // The number of the last look at rest.
  #lastStill = 0;
  // When the look was sent that has no picture yet.
  #sentAt = -Infinity;
  // When the first look was sent since the last picture.
  #awaitedSince = null;
  #shown = { picture: 0, error: 0 };
  #arrivals = [];
  #pose;
  #send;
  #onPicture;

  constructor(element, send, onPicture) {
    this.#element = element;
    this.#send = send;
    this.#onPicture = onPicture;
    this.#frame = element.querySelector("#frame");
    const layer = (name) => element.querySelector(`#${name}`);
    this.#layers = { picture: layer("picture"), error: layer("error"), photo: layer("photo"), overlay: layer("overlay"), divider: layer("divider"), rendering: layer("rendering") };
    new ResizeObserver(() => this.moved(this.#pose)).observe(element);
  }

  setScene(cards, distance) {
    this.#cards = cards;
    this.#sceneDistance = distance;
  }

  // Makes the view free; the vertical field of view that shows all at the size that it has, radians.
  leaveCamera(fov_y) {
    this.camera = null;
    const part = this.#element.clientHeight / this.#frame.getBoundingClientRect().height || 1;
    return Math.min(FOV_Y_MAX, 2 * Math.atan(part * Math.tan(fov_y / 2)));
  }

  // What is seen has changed.
  moved(pose) {
    this.#pose = pose;
    this.#movedAt = performance.now();
    this.#isDirty = true;
    this.#layOut();
    this.#drawFrusta();
  }

  // The same place shall be seen anew, and sharp at once.
  refresh() {
    this.#isDirty = true;
    this.#isSharp = false;
    this.#movedAt = 0;
    this.#drawFrusta();
  }

  // A new connection knows nothing of what the old one was asked for.
  reconnect() {
    this.#sentAt = -Infinity;
    this.#awaitedSince = null;
    this.refresh();
  }

  // Called before each repaint.
  tick(now) {
    if (!this.#pose) return;
    const isLate = this.#awaitedSince !== null && now - this.#awaitedSince > SLOW_MS;
    const badge = this.#layers.rendering;
    if (badge.hidden === isLate) badge.hidden = !isLate;
    const isMoving = now - this.#movedAt < REST_MS;
    const isFree = now - this.#sentAt > RESEND_MS;
    const wants = this.#isDirty || (!isMoving && !this.#isSharp);
    if (wants && isFree) this.#ask(now, isMoving);
  }

  #ask(now, isMoving) {
    const [width, height] = this.#size(isMoving);
    const { position, rotation, fov_y } = this.#pose;
    this.#sequence += 1;
    if (!isMoving) this.#lastStill = this.#sequence;
    this.#sentAt = now;
    this.#awaitedSince ??= now;
    this.#isDirty = false;
    this.#isSharp = !isMoving;
    this.#send({
      type: "look",
      sequence: this.#sequence,
      pose: { position, rotation, fov_y },
      camera: this.camera?.index ?? null,
      width,
      height,
      render_mode: this.renderMode,
      quality: isMoving ? QUALITY.moving : QUALITY.still,
      error: this.comparison > 1 && this.camera !== null,
    });
  }

  #size(isMoving) {
    const box = this.#frame.getBoundingClientRect();
    const density = Math.min(devicePixelRatio, 2) * (isMoving ? this.#factor : 1);
    const fit = Math.min(1, Math.sqrt(PIXELS_MAX / (box.width * box.height * density * density)));
    const side = (length) => Math.max(16, Math.min(4096, Math.round(length * density * fit)));
    return [side(box.width), side(box.height)];
  }

  async show(header, blob) {
    // A picture that is slow answers a look that newer ones have followed. One that was asked for at rest is large.
    if (!header.error && header.sequence > this.#lastStill) this.#adapt(header.milliseconds);
    if (!header.error) this.#awaitedSince = header.sequence === this.#sequence ? null : performance.now();
    if (!header.error && header.sequence === this.#sequence) this.#sentAt = -Infinity;
    const image = await createImageBitmap(blob);
    const kind = header.error ? "error" : "picture";
    if (header.sequence < this.#shown[kind]) return;
    this.#shown[kind] = header.sequence;
    const canvas = this.#layers[kind];
    [canvas.width, canvas.height] = [image.width, image.height];
    canvas.getContext("2d").drawImage(image, 0, 0);
    this.#fit();
    if (header.error) return;
    const now = performance.now();
    this.#arrivals = [...this.#arrivals.filter((at) => now - at < 2000), now];
    this.#element.dataset.pictures = Number(this.#element.dataset.pictures ?? 0) + 1;
    this.#onPicture(header, image.width, image.height);
  }

  // Pictures of the last two seconds, a second.
  get rate() {
    const now = performance.now();
    this.#arrivals = this.#arrivals.filter((at) => now - at < 2000);
    return this.#arrivals.length / 2;
  }

  #adapt(milliseconds) {
    const change = Math.sqrt(this.target / Math.max(milliseconds, 1));
    const wanted = this.#factor * Math.max(0.8, Math.min(1.15, change));
    this.#factor = Math.max(FACTOR.least, Math.min(FACTOR.most, wanted));
  }

  // A free view fills the stage; that of a camera keeps its shape.
  #layOut() {
    const { clientWidth: width, clientHeight: height } = this.#element;
    const shape = this.camera ? this.camera.width / this.camera.height : width / height;
    const fitted = Math.min(width, height * shape);
    const style = this.#frame.style;
    style.width = `${fitted}px`;
    style.height = `${fitted / shape}px`;
    style.left = `${(width - fitted) / 2}px`;
    style.top = `${(height - fitted / shape) / 2}px`;
    this.#fit();
  }

  // No picture is stretched.
  #fit() {
    const { picture, error, photo } = this.#layers;
    const { width, height } = this.#frame.getBoundingClientRect();
    const sides = (layer) => (layer === photo ? [photo.naturalWidth, photo.naturalHeight] : [layer.width, layer.height]);
    for (const layer of [picture, error, photo]) {
      if (sides(layer)[0] > 0) layer.classList.toggle("apart", isApart(sides(layer), [width, height]));
    }
  }

  // 0 is the photo, 1 the render, 2 the error; between them, the right one grows from the left.
  compare(value) {
    const needsError = value > 1 && this.comparison <= 1;
    this.comparison = value;
    const { photo, error, divider } = this.#layers;
    const isOn = this.camera !== null;
    const place = 100 * (value <= 1 ? value : value - 1);
    photo.hidden = !isOn || value >= 1;
    error.hidden = !isOn || value <= 1;
    photo.style.clipPath = `inset(0 0 0 ${place}%)`;
    error.style.clipPath = `inset(0 ${100 - place}% 0 0)`;
    divider.hidden = !isOn || place <= 0 || place >= 100;
    divider.style.left = `${place}%`;
    if (needsError) this.refresh();
  }

  // The camera whose frustum is at this place of the window.
  cameraAt({ clientX, clientY }) {
    if (!this.showsFrusta || this.camera) return null;
    const box = this.#frame.getBoundingClientRect();
    const place = [clientX - box.left, clientY - box.top];
    const distance = (card) => {
      const at = this.#project(card.position);
      return at ? Math.hypot(at[0] - place[0], at[1] - place[1]) : Infinity;
    };
    const nearest = this.#cards.map((card) => [distance(card), card]).sort((a, b) => a[0] - b[0])[0];
    return nearest && nearest[0] < CLICK_RADIUS_PX ? nearest[1] : null;
  }

  #project(point) {
    const { clientWidth: width, clientHeight: height } = this.#frame;
    const [x, y, z] = rotate(conjugate(this.#pose.rotation), subtract(point, this.#pose.position));
    if (z < 0.02 * this.#sceneDistance) return null;
    const focal = height / 2 / Math.tan(this.#pose.fov_y / 2);
    return [width / 2 + (focal * x) / z, height / 2 + (focal * y) / z];
  }

  #drawFrusta() {
    const { overlay } = this.#layers;
    overlay.hidden = !this.showsFrusta || this.camera !== null || !this.#pose;
    if (overlay.hidden) return;
    const density = Math.min(devicePixelRatio, 2);
    [overlay.width, overlay.height] = [this.#frame.clientWidth * density, this.#frame.clientHeight * density];
    const context = overlay.getContext("2d");
    context.scale(density, density);
    const colours = getComputedStyle(document.documentElement);
    for (const card of this.#cards) {
      context.strokeStyle = card.split === "test" ? colours.getPropertyValue("--accent") : "rgb(255 255 255 / 0.85)";
      context.lineWidth = 1.25;
      context.shadowColor = "rgb(0 0 0 / 0.7)";
      context.shadowBlur = 2;
      this.#drawFrustum(context, card);
    }
  }

  #drawFrustum(context, card) {
    const size = FRUSTUM_SIZE * this.#sceneDistance;
    const half = size * Math.tan(card.fov_y / 2);
    const wide = (half * card.width) / card.height;
    const corner = (x, y) => add(card.position, rotate(card.rotation, [x * wide, y * half, size]));
    const corners = [corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)].map((point) => this.#project(point));
    const centre = this.#project(card.position);
    if (!centre || corners.includes(null)) return;
    context.beginPath();
    context.moveTo(...corners[3]);
    corners.forEach((place) => context.lineTo(...place));
    corners.forEach((place) => { context.moveTo(...centre); context.lineTo(...place); });
    context.stroke();
  }
}
