// Vectors as [x, y, z], rotations as quaternions [w, x, y, z] that turn camera axes (x right, y down, z forward) into the world's.

export const add = (a, b) => a.map((value, axis) => value + b[axis]);
export const subtract = (a, b) => a.map((value, axis) => value - b[axis]);
export const scale = (a, factor) => a.map((value) => value * factor);
export const dot = (a, b) => a.reduce((sum, value, axis) => sum + value * b[axis], 0);
export const length = (a) => Math.hypot(...a);
export const normalise = (a) => scale(a, 1 / (length(a) || 1));
export const cross = ([a, b, c], [x, y, z]) => [b * z - c * y, c * x - a * z, a * y - b * x];

export function multiply([aw, ax, ay, az], [bw, bx, by, bz]) {
  return [
    aw * bw - ax * bx - ay * by - az * bz,
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
  ];
}

export const conjugate = ([w, x, y, z]) => [w, -x, -y, -z];

export function rotate(rotation, vector) {
  const [, x, y, z] = multiply(multiply(rotation, [0, ...vector]), conjugate(rotation));
  return [x, y, z];
}

// A turn by `angle` about a unit axis.
export function turn(axis, angle) {
  return [Math.cos(angle / 2), ...scale(axis, Math.sin(angle / 2))];
}

export const right = (rotation) => rotate(rotation, [1, 0, 0]);
export const down = (rotation) => rotate(rotation, [0, 1, 0]);
export const forward = (rotation) => rotate(rotation, [0, 0, 1]);

// The rotation of an upright camera that looks along `direction`.
export function lookAlong(direction, up) {
  const z = normalise(direction);
  let x = cross(z, up);
  if (length(x) < 1e-6) x = cross(z, [up[1], up[2], up[0]]);
  x = normalise(x);
  return fromAxes(x, cross(z, x), z);
}

// The quaternion of a matrix with these columns.
function fromAxes([a, d, g], [b, e, h], [c, f, i]) {
  const trace = a + e + i;
  let q;
  if (trace > 0) q = [trace + 1, h - f, c - g, d - b];
  else if (a > e && a > i) q = [h - f, 1 + a - e - i, b + d, c + g];
  else if (e > i) q = [c - g, b + d, 1 + e - a - i, f + h];
  else q = [d - b, c + g, f + h, 1 + i - a - e];
  return normalise(q);
}
