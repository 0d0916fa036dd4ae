// Unpacks .spz of version 3: one gzip stream of positions, opacities, colours, scales, rotations and harmonics.

const MAGIC = 0x5053474e;
const HEADER_BYTES = 16;
const COMPONENT_MAX = 511;

async function gunzip(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// The rotation matrix, row by row, of a packed quaternion: which component is the largest in 2 bits, sign and magnitude of
// each other one in 10.
function rotationOf(word) {
  const largest = word >>> 30;
  const q = [0, 0, 0, 0];
  let squares = 0;
  for (let i = 3; i >= 0; i--) {
    if (i === largest) continue;
    const magnitude = (Math.SQRT1_2 * (word & COMPONENT_MAX)) / COMPONENT_MAX;
    q[i] = word & 512 ? -magnitude : magnitude;
    squares += magnitude * magnitude;
    word >>>= 10;
  }
  q[largest] = Math.sqrt(Math.max(0, 1 - squares));
  const [x, y, z, w] = q;
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
    2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
    2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
  ];
}

// Variances along the axes of a Gaussian, by the level of its log-scale.
const VARIANCES = Float64Array.from({ length: 256 }, (_, level) => Math.exp(2 * (level / 16 - 10)));

// Writes the upper triangle of R diag(s²) Rᵀ.
function covariance(r, levels, row, out) {
  const [a, b, c] = [VARIANCES[levels[3 * row]], VARIANCES[levels[3 * row + 1]], VARIANCES[levels[3 * row + 2]]];
  const entry = (i, j) => r[3 * i] * a * r[3 * j] + r[3 * i + 1] * b * r[3 * j + 1] + r[3 * i + 2] * c * r[3 * j + 2];
  out[6 * row] = entry(0, 0);
  out[6 * row + 1] = entry(0, 1);
  out[6 * row + 2] = entry(0, 2);
  out[6 * row + 3] = entry(1, 1);
  out[6 * row + 4] = entry(1, 2);
  out[6 * row + 5] = entry(2, 2);
}

// Fixed point of 24 bits with a sign; shifted to the upper bytes of 32, so that the sign comes back along.
function fixedPoint(bytes, count, step) {
  const values = new Float32Array(count);
  for (let i = 0; i < count; i++) {
    values[i] = (((bytes[3 * i] << 8) | (bytes[3 * i + 1] << 16) | (bytes[3 * i + 2] << 24)) >> 8) * step;
  }
  return values;
}

// positions [3N], covariances [6N] (upper triangles), opacities [N] (bytes), base [3N] (bytes), harmonics [N, terms, 3] (bytes)
export async function unpack(bytes) {
  const data = await gunzip(bytes);
  const view = new DataView(data.buffer);
  if (view.getUint32(0, true) !== MAGIC || view.getUint32(4, true) !== 3) throw new Error("The splat in this page is damaged.");
  const count = view.getUint32(8, true);
  const terms = (view.getUint8(12) + 1) ** 2 - 1;
  const step = 2 ** -view.getUint8(13);
  let at = HEADER_BYTES;
  const part = (size) => data.subarray(at, (at += size * count));
  const [places, opacities, base, scales, rotations, harmonics] = [9, 1, 3, 3, 4, 3 * terms].map(part);
  if (at > data.length) throw new Error("The splat in this page is cut off.");
  const words = new DataView(rotations.buffer, rotations.byteOffset);
  const covariances = new Float32Array(6 * count);
  for (let row = 0; row < count; row++) covariance(rotationOf(words.getUint32(4 * row, true)), scales, row, covariances);
  return { count, terms, positions: fixedPoint(places, 3 * count, step), covariances, opacities, base, harmonics };
}
