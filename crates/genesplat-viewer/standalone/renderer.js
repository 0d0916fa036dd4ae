// Draws Gaussians by WebGL2: a quad for each, as large as its ellipse, blended from back to front.

import { FRAGMENT_SHADER, vertexShader } from "./shaders.js";

const GEOMETRY_TEXELS = 3;
// Width of the textures, where the graphics card allows it; wider ones hold more Gaussians.
const ROW_MAX = 8192;
const COMPENSATIONS = { classic: 0, antialiased: 1, mip: 2 };
// Of the half field of view; beyond that the projection is not linearised anew.
const SLOPE_LIMIT = 1.3;

export class Renderer {
  #gl;
  #canvas;
  // Of uniforms, by name.
  #places;
  #count = 0;

  constructor(canvas, splat, { background, dilation, filter, near }) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false, powerPreference: "high-performance" });
    if (!gl) throw new Error("This browser has no WebGL2, which draws the splat.");
    const row = Math.min(gl.getParameter(gl.MAX_TEXTURE_SIZE), ROW_MAX);
    const program = link(gl, vertexShader(row));
    [this.#gl, this.#canvas] = [gl, canvas];
    this.#places = uniformsOf(gl, program);
    gl.useProgram(program);
    upload(gl, 0, row, geometryTexels(splat, row), gl.RGBA32F, gl.FLOAT);
    upload(gl, 1, row, harmonicTexels(splat, row), gl.RGBA8, gl.UNSIGNED_BYTE);
    gl.uniform1i(this.#places.geometry, 0);
    gl.uniform1i(this.#places.harmonics, 1);
    gl.uniform1i(this.#places.terms, splat.terms);
    gl.uniform1i(this.#places.compensation, COMPENSATIONS[filter]);
    gl.uniform1f(this.#places.dilation, dilation);
    gl.uniform1f(this.#places.near, near);
    attributes(gl, program);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.clearColor(...background, 1);
  }

  // Indices of Gaussians, farthest first.
  setOrder(order) {
    this.#gl.bufferData(this.#gl.ARRAY_BUFFER, order, this.#gl.DYNAMIC_DRAW);
    this.#count = order.length;
  }

  // rotation: rows of camera_from_world; focal and principal in px of the canvas
  draw({ rotation, translation, eye, focal, principal }) {
    const gl = this.#gl;
    const { width, height } = this.#canvas;
    const at = this.#places;
    gl.viewport(0, 0, width, height);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.uniformMatrix3fv(at.viewRotation, true, rotation);
    gl.uniform3fv(at.viewTranslation, translation);
    gl.uniform3fv(at.eye, eye);
    gl.uniform2fv(at.focal, focal);
    gl.uniform2fv(at.principal, principal);
    gl.uniform2f(at.size, width, height);
    gl.uniform2f(at.slopeMax, (SLOPE_LIMIT * width) / (2 * focal[0]), (SLOPE_LIMIT * height) / (2 * focal[1]));
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.#count);
  }
}

function link(gl, vertex) {
  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, FRAGMENT_SHADER]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  return program;
}

function uniformsOf(gl, program) {
  const count = gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS);
  const names = Array.from({ length: count }, (_, i) => gl.getActiveUniform(program, i).name);
  return Object.fromEntries(names.map((name) => [name, gl.getUniformLocation(program, name)]));
}

// The corners of the quad, and the order of the Gaussians, whose buffer stays bound.
function attributes(gl, program) {
  const corner = gl.getAttribLocation(program, "corner");
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), gl.STATIC_DRAW);
  gl.enableVertexAttribArray(corner);
  gl.vertexAttribPointer(corner, 2, gl.FLOAT, false, 0, 0);
  const index = gl.getAttribLocation(program, "index");
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.enableVertexAttribArray(index);
  gl.vertexAttribIPointer(index, 1, gl.UNSIGNED_INT, 0, 0);
  gl.vertexAttribDivisor(index, 1);
}

// A texture of whole rows; what is beyond the texels is 0.
function upload(gl, unit, row, texels, format, kind) {
  gl.activeTexture(gl.TEXTURE0 + unit);
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  const height = texels.length / (4 * row);
  if (height > gl.getParameter(gl.MAX_TEXTURE_SIZE)) throw new Error("This splat has more Gaussians than this graphics card can hold.");
  gl.texImage2D(gl.TEXTURE_2D, 0, format, row, height, 0, gl.RGBA, kind, texels);
}

const wholeRows = (texels, row) => 4 * row * Math.max(1, Math.ceil(texels / row));

function geometryTexels({ count, positions, covariances, opacities, base }, row) {
  const texels = new Float32Array(wholeRows(GEOMETRY_TEXELS * count, row));
  const words = new Uint32Array(texels.buffer);
  for (let i = 0; i < count; i++) {
    const at = 4 * GEOMETRY_TEXELS * i;
    for (let k = 0; k < 3; k++) texels[at + k] = positions[3 * i + k];
    texels[at + 3] = opacities[i] / 255;
    for (let k = 0; k < 6; k++) texels[at + 4 + k] = covariances[6 * i + k];
    // The upper byte keeps it an ordinary float, which no graphics card alters.
    words[at + 10] = 0x40000000 | (base[3 * i + 2] << 16) | (base[3 * i + 1] << 8) | base[3 * i];
  }
  return texels;
}

function harmonicTexels({ count, terms, harmonics }, row) {
  const texels = new Uint8Array(wholeRows(terms * count, row));
  for (let i = 0; i < terms * count; i++) {
    for (let k = 0; k < 3; k++) texels[4 * i + k] = harmonics[3 * i + k];
  }
  return texels;
}
