// Smooth ways from camera to camera.

import { add, scale } from "./vector.js";

const mix = (a, b, t) => add(scale(a, 1 - t), scale(b, t));
const smooth = (t) => t * t * (3 - 2 * t);

// The lens of a camera as parts of its own size, so that lenses of photos of different sizes can be mixed.
export function lensOf({ width, height, focal, principal }) {
  return { aspect: width / height, focal: scale(focal, 1 / height), principal: [principal[0] / width - 0.5, principal[1] / height - 0.5] };
}

// Height of what the camera has seen on a canvas of another shape, px: all of it stays in view.
export const fittedHeight = ({ aspect }, width, height) => Math.min(height, width / aspect);

// Focal lengths and principal point there, px.
export function fit({ aspect, focal, principal }, width, height) {
  const tall = fittedHeight({ aspect }, width, height);
  return {
    focal: scale(focal, tall),
    principal: [0.5 * width + principal[0] * aspect * tall, 0.5 * height + principal[1] * tall],
  };
}

function mixLenses(a, b, t) {
  return { aspect: a.aspect + (b.aspect - a.aspect) * t, focal: mix(a.focal, b.focal, t), principal: mix(a.principal, b.principal, t) };
}

function mixRotations(a, b, t) {
  const sign = a.reduce((sum, value, i) => sum + value * b[i], 0) < 0 ? -1 : 1;
  const mixed = mix(a, scale(b, sign), t);
  return scale(mixed, 1 / Math.hypot(...mixed));
}

export class Journey {
  constructor(from, to, milliseconds) {
    Object.assign(this, { from, to, milliseconds, begin: performance.now() });
  }

  // Pose and lens at a time, and whether they are the last.
  at(now) {
    const { from, to } = this;
    const part = Math.min(1, Math.max(0, (now - this.begin) / this.milliseconds));
    const t = smooth(part);
    if (part === 1) return { ...to, isOver: true };
    const position = mix(from.pose.position, to.pose.position, t);
    const rotation = mixRotations(from.pose.rotation, to.pose.rotation, t);
    return { pose: { ...to.pose, position, rotation }, lens: mixLenses(from.lens, to.lens, t), isOver: false };
  }
}
