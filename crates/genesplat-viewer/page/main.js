// Puts the page together: what is asked for, what is heard, what is shown.

import { CameraPath } from "./path.js";
import { CameraStrip } from "./cameras.js";
import { Charts } from "./charts.js";
import { Connection } from "./connection.js";
import { Editor } from "./edit.js";
import { Navigator, isTaken, shortcutOf } from "./navigation.js";
import { Stage } from "./stage.js";
import { Status } from "./status.js";

const $ = (id) => document.getElementById(id);

const MODE_NOTES = {
  depth: "Mean depth of what is blended; computed on the CPU.",
  count: "Gaussians that reach a pixel with an alpha of 1/255 or more, to within a few percent; computed on the CPU.",
  points: "Centres of the Gaussians above an opacity of 0.05; computed on the CPU.",
  ellipses: "Gaussians above an opacity of 0.05 as opaque ellipsoids at 0.4 of their size, with soft edges; computed on the CPU.",
};
const LEGENDS = { depth: "depth, world units", count: "Gaussians a pixel" };

let cards = [];
let isFirst = true;

const send = (message) => connection.send(message);
const navigator = new Navigator($("stage"), moved, clicked);
const stage = new Stage($("stage"), send, shown);
const editor = new Editor($("stage"), navigator, () => stage.camera, send);
const strip = new CameraStrip($("strip"), chooseCamera);
const charts = new Charts($("charts"));
const status = new Status(send);
const path = new CameraPath(
  { add: $("path-add"), save: $("path-save"), clear: $("path-clear"), count: $("path-count") },
  () => navigator.pose,
);
const connection = new Connection({
  hello,
  state: (state) => { status.show(state); editor.show(state); showPhase(state.phase); },
  curves: (curves) => charts.show(curves),
  notice: ({ text }) => status.notice(text),
  picture: (header, blob) => stage.show(header, blob),
  close: (isOver) => status.setPhase(isOver ? "ended" : "lost"),
});

function hello(message) {
  status.greet(message);
  cards = message.cameras.map((card, index) => ({ ...card, index, thumbnail: `thumbnail/${index}` }));
  strip.fill(cards);
  stage.setScene(cards, message.distance);
  editor.setScene(message);
  $("frusta").closest("label").hidden = cards.length === 0;
  $("legend-scale").style.background = message.scale;
  navigator.frame(message);
  navigator.home = message.centre;
  if (isFirst) reset();
  else {
    // Connected again: the view stays, and turns around what is ahead of it.
    navigator.goTo(navigator.pose);
    strip.mark(stage.camera);
  }
  isFirst = false;
  stage.reconnect();
}

function showPhase(phase) {
  stage.target = phase === "training" ? 25 : 40;
  $("waiting").textContent = phase === "waiting" ? "The run has saved nothing yet; it is shown when it has" : "Waiting for the first picture";
  $("rendering").textContent = phase === "scoring" ? "photos are scored; the picture waits" : "rendering";
}

function reset() {
  if (cards.length) chooseCamera(cards[0]);
  else {
    navigator.goTo(navigator.overview());
    moved();
  }
}

// The user has moved: from here on the view is free.
function moved() {
  if (stage.camera) {
    strip.mark(null);
    // The stage gets the slider's place.
    $("compare").hidden = true;
    navigator.pose.fov_y = stage.leaveCamera(navigator.pose.fov_y);
    stage.compare(stage.comparison);
  }
  stage.moved(navigator.pose);
}

function clicked(event) {
  const card = stage.cameraAt(event);
  if (card) chooseCamera(card);
}

function chooseCamera(card) {
  navigator.goTo(card);
  stage.camera = card;
  $("photo").src = `photo/${card.index}`;
  $("compare").hidden = false;
  strip.mark(card);
  stage.compare(stage.comparison);
  stage.moved(navigator.pose);
  stage.refresh();
}

function shown(header) {
  $("waiting").hidden = true;
  const name = LEGENDS[stage.renderMode];
  $("legend").hidden = !name || !header.range;
  if (!name || !header.range) return;
  const digits = stage.renderMode === "depth" ? 2 : 0;
  // Near is bright.
  const [low, high] = stage.renderMode === "depth" ? [header.range[1], header.range[0]] : header.range;
  $("legend-low").textContent = low.toFixed(digits);
  $("legend-high").textContent = high.toFixed(digits);
  $("legend-name").textContent = name;
}

function setRenderMode(mode) {
  stage.renderMode = mode;
  $("mode-note").hidden = !MODE_NOTES[mode];
  $("mode-note").textContent = MODE_NOTES[mode] ?? "";
  stage.refresh();
}

$("render-mode").addEventListener("change", (event) => setRenderMode(event.target.value));
$("movement").addEventListener("change", (event) => navigator.setMovement(event.target.value));
$("frusta").addEventListener("change", (event) => {
  stage.showsFrusta = event.target.checked;
  stage.refresh();
});
$("reset").addEventListener("click", reset);
$("help").addEventListener("click", () => $("keys-dialog").showModal());
$("panel-toggle").addEventListener("click", () => {
  const isHidden = ($("panel").hidden = !$("panel").hidden);
  $("panel-toggle").setAttribute("aria-expanded", String(!isHidden));
});
$("compare-range").addEventListener("input", (event) => {
  const value = Number(event.target.value);
  stage.compare(value);
  const names = ["photo", "render", "error"];
  const isWhole = Math.abs(value - Math.round(value)) < 0.02;
  const between = `between ${names[Math.floor(value)]} and ${names[Math.min(2, Math.floor(value) + 1)]}`;
  event.target.setAttribute("aria-valuetext", isWhole ? names[Math.round(value)] : between);
});

const neighbour = (step) => {
  if (!cards.length) return;
  const from = stage.camera ? stage.camera.index + step : 0;
  chooseCamera(cards[(from + cards.length) % cards.length]);
};

const SHORTCUTS = {
  " ": () => status.togglePause(send),
  "[": () => neighbour(-1),
  "]": () => neighbour(1),
  "?": () => $("keys-dialog").showModal(),
  Home: reset,
  k: () => path.keep(navigator.pose),
};

addEventListener("keydown", (event) => {
  if (isTaken(event)) return;
  const mode = $("render-mode").querySelectorAll("input")[Number(event.key) - 1];
  if (mode) {
    mode.checked = true;
    setRenderMode(mode.value);
  }
  const shortcut = SHORTCUTS[shortcutOf(event)];
  if (shortcut) {
    event.preventDefault();
    shortcut();
  }
});

let before = performance.now();
function repaint(now) {
  navigator.advance(Math.min((now - before) / 1000, 0.1));
  before = now;
  stage.tick(now);
  editor.draw();
  requestAnimationFrame(repaint);
}
requestAnimationFrame(repaint);

setInterval(() => {
  const canvas = $("picture");
  $("rate").textContent = stage.rate ? `${stage.rate.toFixed(1)} pictures a second, ${canvas.width} × ${canvas.height}` : "at rest";
}, 500);
