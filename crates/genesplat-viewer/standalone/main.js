// The page: unpacks the splat that it carries, and shows it from its cameras and from wherever one goes.

import { CameraStrip } from "./cameras.js";
import { Journey, fittedHeight, lensOf } from "./journey.js";
import { Navigator, isTaken, shortcutOf } from "./navigation.js";
import { Renderer } from "./renderer.js";
import { Stage } from "./stage.js";
import { unpack } from "./spz.js";

const $ = (id) => document.getElementById(id);
const scene = JSON.parse($("scene").textContent);
const cards = scene.cameras.map((card, index) => ({ ...card, index }));

const JUMP_MS = 700;
const TOUR_MS = 2600;
const TOUR_REST_MS = 900;
const NO_LENS = { aspect: 1.5, focal: [1.1, 1.1], principal: [0, 0] };

const fovHeight = () => fittedHeight(lens, $("view").clientWidth, $("view").clientHeight);
const navigator = new Navigator($("view"), moved, () => {}, fovHeight);
const strip = new CameraStrip($("strip"), (card) => visit(card, JUMP_MS));
let stage = null;
let lens = NO_LENS;
let current = null;
let journey = null;
let tour = null;

function say(text) {
  $("message").textContent = text;
}

function carriedBytes() {
  const text = atob($("splat").textContent);
  $("splat").remove();
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = text.charCodeAt(i);
  return bytes;
}

// The user has moved: from here on the view is free.
function moved() {
  journey = null;
  setTour(false);
  mark(null);
  stage?.redraw();
}

function mark(card) {
  current = card ?? current;
  strip.mark(card);
  $("view").dataset.camera = card?.name ?? "";
}

function place(pose, newLens) {
  navigator.goTo(pose);
  lens = newLens;
  stage?.redraw();
}

// Goes to a camera, at once or on a smooth way.
function visit(card, milliseconds) {
  mark(card);
  const [pose, to] = [{ position: card.position, rotation: card.rotation, fov_y: card.fov_y }, lensOf(card)];
  const isStill = milliseconds === 0 || matchMedia("(prefers-reduced-motion: reduce)").matches;
  journey = isStill ? null : new Journey({ pose: navigator.pose, lens }, { pose, lens: to }, milliseconds);
  if (isStill) place(pose, to);
}

function reset() {
  setTour(false);
  if (cards.length) return visit(cards[0], stage ? JUMP_MS : 0);
  journey = null;
  place(navigator.overview(), NO_LENS);
}

function neighbour(step, milliseconds) {
  if (!cards.length) return;
  const from = current ? current.index + step : 0;
  visit(cards[(from + cards.length) % cards.length], milliseconds);
}

// From camera to camera until somebody moves.
function setTour(isOn) {
  clearInterval(tour);
  tour = isOn ? setInterval(() => neighbour(1, TOUR_MS), TOUR_MS + TOUR_REST_MS) : null;
  $("tour").setAttribute("aria-pressed", String(isOn));
  if (isOn) neighbour(1, TOUR_MS);
}

function step(by) {
  setTour(false);
  neighbour(by, JUMP_MS);
}

const toggleTour = () => cards.length > 1 && setTour(tour === null);
const toggleBare = () => document.body.classList.toggle("bare");
const toggleFull = () => (document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen());

const SHORTCUTS = {
  " ": toggleTour,
  "[": () => step(-1),
  "]": () => step(1),
  "?": () => $("keys-dialog").showModal(),
  Home: reset,
  h: toggleBare,
  f: toggleFull,
};

addEventListener("keydown", (event) => {
  if (isTaken(event)) return;
  const shortcut = SHORTCUTS[shortcutOf(event)];
  if (!shortcut) return;
  event.preventDefault();
  shortcut();
});

let before = performance.now();
function repaint(now) {
  navigator.advance(Math.min((now - before) / 1000, 0.1));
  before = now;
  if (journey) {
    const here = journey.at(now);
    if (here.isOver) journey = null;
    place(here.pose, here.lens);
  }
  stage.tick(now, { pose: navigator.pose, lens });
  requestAnimationFrame(repaint);
}

function furnish() {
  $("movement").addEventListener("change", (event) => navigator.setMovement(event.target.value));
  $("previous").addEventListener("click", () => step(-1));
  $("next").addEventListener("click", () => step(1));
  $("tour").addEventListener("click", toggleTour);
  $("help").addEventListener("click", () => $("keys-dialog").showModal());
  $("full").addEventListener("click", toggleFull);
  $("full").hidden = !document.fullscreenEnabled;
  $("about").textContent = `${scene.gaussians.toLocaleString("en")} Gaussians`;
  $("steps").hidden = cards.length < 2;
  document.body.classList.add("ready");
}

async function begin() {
  navigator.frame(scene);
  navigator.home = scene.centre;
  strip.fill(cards);
  const asked = new URLSearchParams(location.hash.slice(1)).get("camera");
  const first = cards.find((card) => card.name === asked);
  first ? visit(first, 0) : reset();
  if (!("DecompressionStream" in window)) throw new Error("This browser is too old to unpack the splat.");
  const splat = await unpack(carriedBytes());
  const renderer = new Renderer($("view"), splat, scene);
  stage = new Stage($("view"), renderer, splat.positions, $("sorter").textContent, say);
  $("view").addEventListener("webglcontextlost", () => say("The graphics card has dropped the picture. Load the page again."));
  furnish();
  say("");
  requestAnimationFrame(repaint);
}

begin().catch((error) => say(error.message));
