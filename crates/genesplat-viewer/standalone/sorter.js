// A worker that sorts Gaussians by depth, farthest first. It is sent the positions once, and then for each picture the row
// of the view matrix that gives depths; it answers with the order of rows.
//
// Bits of floats that are not negative are in the order of the floats, so two passes of a radix sort, 16 bits each, sort
// exactly. Equal depths stay in the order of rows, nearer row in front, as in genesplat's own renderer.

const DIGITS = 1 << 16;
const starts = new Uint32Array(DIGITS);
let positions, keys, half, depths;

function load(sent) {
  positions = sent;
  depths = new Float32Array(positions.length / 3);
  keys = new Uint32Array(depths.buffer);
  half = new Uint32Array(depths.length);
}

// Where each digit begins, with digits in ascending order.
function count(shift) {
  starts.fill(0);
  for (let i = 0; i < keys.length; i++) starts[(keys[i] >>> shift) & 0xffff]++;
  let sum = 0;
  for (let digit = 0; digit < DIGITS; digit++) {
    const here = starts[digit];
    starts[digit] = sum;
    sum += here;
  }
}

function sort([x, y, z, w]) {
  for (let i = 0; i < depths.length; i++) {
    // What is behind the camera is not drawn, in whatever order.
    depths[i] = Math.max(0, x * positions[3 * i] + y * positions[3 * i + 1] + z * positions[3 * i + 2] + w);
  }
  count(0);
  for (let i = 0; i < keys.length; i++) half[starts[keys[i] & 0xffff]++] = i;
  count(16);
  const order = new Uint32Array(keys.length);
  const last = keys.length - 1;
  for (const row of half) order[last - starts[keys[row] >>> 16]++] = row;
  return order;
}

onmessage = ({ data }) => {
  if (data.positions) return load(data.positions);
  const order = sort(data.depthRow);
  postMessage(order, [order.buffer]);
};
