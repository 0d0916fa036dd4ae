// Stage `rasterise_backward`: from dL/dimage to one row of sums per intersection of a splat with a tile.
//
// Walks the lists front to back once more, as the forward pass does: with the final image known, the light
// behind a splat is what remains of it, so neither alphas nor transmittances are stored. Eight splats at a
// time, or four where workgroups have little memory:
// 1. each invocation is a pixel and leaves p = o G dL/dalpha and w = alpha T of each splat in workgroup
//    memory;
// 2. each invocation is one row of eight pixels of its block, and sums these for one splat: along a row,
//    moments by the number of the pixel are sums with constant factors;
// 3. each invocation is one column of a splat's row and sums its 32 parts.
// Blocks that the splat's ellipse misses, and those whose pixels are all finished, are passed over in steps 1
// and 2. Sums have the same order for four as for eight.
//
// So a splat's gradient is reduced once per tile, no two workgroups write the same row, and there are no
// atomics: the result is the same on every run.

@group(0) @binding(0) var<uniform> view: ViewPass;
@group(0) @binding(1) var<storage, read> ranges: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> intersections: array<u32>;
@group(0) @binding(3) var<storage, read> intersection_splats: array<u32>;
@group(0) @binding(4) var<storage, read> splats: array<vec4<f32>>;
// Picture, and the gradient by it; then the same of the transmittance, if the loss is of that, too.
override TRANSMITTANCE: bool = false;
@group(0) @binding(5) var<storage, read> image: array<f32>;
@group(0) @binding(6) var<storage, read> gradient: array<f32>;
// [I, 12]: sums of p times 1, dx, dy, dx^2, dx dy, dy^2, offsets (pixel - mean) in px; dL/drgb; then the sums
// of the absolute values of dL/du and of dL/dv by pixel, and the number of pixels blended that have a
// gradient.
@group(0) @binding(7) var<storage, read_write> intersection_gradients: array<f32>;
// Of those that this dispatch has.
@group(0) @binding(8) var<uniform> first_tile_row: u32;

const COLUMNS: u32 = 12u;
// Those that every signal has.
const PLAIN_COLUMNS: u32 = 9u;
// Pixels of a row of a block, and such rows.
const ROW: u32 = 8u;
const ROWS: u32 = BLOCK_PIXELS / ROW;
// Rows of a tile's blocks: parts of a splat's sum.
const PARTS: u32 = BLOCKS * ROWS;
// Splats that are loaded at once, and groups of them that are reduced at once.
const BATCH: u32 = 64u;
const GROUPS: u32 = BATCH / SPLATS_AT_ONCE;

var<workgroup> range: vec2<u32>;
var<workgroup> batch: array<array<BatchSplat, SPLATS_AT_ONCE>, GROUPS>;
var<workgroup> batch_intersections: array<u32, BATCH>;
// p of each splat, then w [blocks, slots, pixels]; later the parts of the sums (`parts_of`). One number more
// than there are pixels, so that no two invocations ask the same memory bank. In three dimensions, so that
// naga checks numbers that stay the same; constants cost nothing.
const PLANES: u32 = 2u * SPLATS_AT_ONCE;
var<workgroup> exchange: array<array<array<f32, BLOCK_PIXELS + 1u>, PLANES>, BLOCKS>;
// Four pixels of a row [channels, parts, 2].
var<workgroup> row_gradients: array<vec4<f32>, 6u * PARTS>;
var<workgroup> finished_pixels: array<atomic<u32>, BLOCKS>;
var<workgroup> unfinished_blocks: u32;

// One pixel on its way through the list.
struct Pixel {
    at: vec2<f32>,
    gradient: vec3<f32>,
    transmittance: f32,
    // Light that the splats still to come and the background send along the gradient.
    remaining: f32,
    // Splats with a smaller exponent do not reach the pixel; where it is finished, that is all of them.
    exponent_min: f32,
    block: u32,
}

// Above the logarithm of every opacity.
const FINISHED: f32 = 1.0;

// Blends one splat once more; returns p and w.
fn replay(pixel: ptr<function, Pixel>, splat: BatchSplat) -> vec2<f32> {
    let exponent = exponent_at(splat.conic_log2, splat.log2_opacity, splat.mean_px - (*pixel).at);
    if exponent < (*pixel).exponent_min {
        return vec2(0.0);
    }
    let unclamped = exp2(exponent);
    let alpha = min(unclamped, ALPHA_MAX);
    let weight = (*pixel).transmittance * alpha;
    let next = (*pixel).transmittance - weight;
    if next < TRANSMITTANCE_MIN {
        (*pixel).exponent_min = FINISHED;
        atomicAdd(&finished_pixels[(*pixel).block], 1u);
        return vec2(0.0);
    }
    // dL/dalpha: what the splat adds itself, less what it takes from everything behind it. The clamp at 0.99
    // is ignored, as published (straight-through).
    let own = dot((*pixel).gradient, splat.rgb);
    let remaining = (*pixel).remaining - weight * own;
    let alpha_gradient = (*pixel).transmittance * own - remaining / (1.0 - alpha);
    (*pixel).remaining = remaining;
    (*pixel).transmittance = next;
    return vec2(unclamped * alpha_gradient, weight);
}

// A row of pixels, and the splat that an invocation sums there: one for each of eight, so with four some have
// none.
struct RowOfPixels {
    block: u32,
    // Of the block; of all blocks.
    row: u32,
    part: u32,
    slot: u32,
    // Its first pixel, px from the tile's corner.
    first: vec2<f32>,
}

fn row_of(lane: u32) -> RowOfPixels {
    let block = (lane / BLOCK_PIXELS) % BLOCKS;
    let row = lane % ROWS;
    let first = pixel_of(block * BLOCK_PIXELS + row * ROW);
    return RowOfPixels(block, row, block * ROWS + row, (lane / ROWS) % BLOCKS, vec2<f32>(first));
}

// Sums of one splat over the pixels of a row.
fn sum_row(place: RowOfPixels, splat: BatchSplat) -> array<f32, COLUMNS> {
    // 1. Moments of p by the number of the pixel, then by the offset from the mean.
    var p: array<f32, ROW>;
    var moments = vec3(0.0);
    for (var x = 0u; x < ROW; x++) {
        p[x] = exchange[place.block][place.slot][ROW * place.row + x];
        moments.x += p[x];
        if x > 0u {
            moments = vec3(moments.x, moments.yz + p[x] * vec2(f32(x), f32(x * x)));
        }
    }
    let d = place.first - splat.mean_px;
    let by_x = moments.x * d.x + moments.y;
    let by_xx = (by_x + moments.y) * d.x + moments.z;
    let by_y = moments.x * d.y;
    // 2. Colours.
    var rgb: array<f32, 3>;
    var w: array<f32, ROW>;
    for (var x = 0u; x < ROW; x++) {
        w[x] = exchange[place.block][SPLATS_AT_ONCE + place.slot][ROW * place.row + x];
    }
    for (var channel = 0u; channel < 3u; channel++) {
        let at = 2u * (channel * PARTS + place.part);
        rgb[channel] = dot(vec4(w[0], w[1], w[2], w[3]), row_gradients[at])
            + dot(vec4(w[4], w[5], w[6], w[7]), row_gradients[at + 1u]);
    }
    // 3. What only some signals ask for.
    var absolute = vec2(0.0);
    var pixels = 0.0;
    if view.signal >= SIGNAL_ABSOLUTE {
        let a = -LN_2 * splat.conic_log2;
        for (var x = 0u; x < ROW; x++) {
            let at = d + vec2(f32(x), 0.0);
            absolute += abs(p[x] * vec2(2.0 * a.x * at.x + a.y * at.y, a.y * at.x + 2.0 * a.z * at.y));
            // What a mask hides has no gradient.
            pixels += f32(w[x] > 0.0 && has_gradient(place.part, x));
        }
    }
    return array(
        moments.x, by_x, by_y, by_xx, by_x * d.y, by_y * d.y, rgb[0], rgb[1], rgb[2], absolute.x, absolute.y, pixels);
}

fn has_gradient(part: u32, x: u32) -> bool {
    let at = 2u * part + x / 4u;
    return row_gradients[at][x % 4u] != 0.0 || row_gradients[at + 2u * PARTS][x % 4u] != 0.0
        || row_gradients[at + 4u * PARTS][x % 4u] != 0.0;
}

// Where the parts of a splat's column are: four splats have two of eight blocks each, and columns do not fit
// one.
fn parts_of(slot: u32, column: u32) -> vec2<u32> {
    return vec2(BLOCKS / SPLATS_AT_ONCE * slot + column / PLANES, column % PLANES);
}

// Sums the parts of one column; four sums, so that no addition waits for the one before it.
fn sum_column(slot: u32, column: u32) -> f32 {
    let at = parts_of(slot, column);
    var sums = vec4(0.0);
    for (var i = 0u; i < PARTS; i += 4u) {
        sums += vec4(
            exchange[at.x][at.y][i], exchange[at.x][at.y][i + 1u],
            exchange[at.x][at.y][i + 2u], exchange[at.x][at.y][i + 3u]);
    }
    return (sums.x + sums.y) + (sums.z + sums.w);
}

// Leaves the gradients of all pixels in rows.
fn leave_gradients(lane: u32, gradient: vec3<f32>) {
    for (var channel = 0u; channel < 3u; channel++) {
        exchange[(lane / BLOCK_PIXELS) % BLOCKS][channel][lane % BLOCK_PIXELS] = gradient[channel];
    }
    workgroupBarrier();
    if lane < 6u * PARTS {
        let channel = lane / (2u * PARTS);
        let block = lane / (2u * ROWS) % BLOCKS;
        let at = lane % (2u * ROWS) * 4u;
        row_gradients[lane] = vec4(
            exchange[block][channel][at], exchange[block][channel][at + 1u],
            exchange[block][channel][at + 2u], exchange[block][channel][at + 3u]);
    }
}

// Blocks with a pixel that is not finished, for all invocations alike. One that is counted too late only
// costs time.
fn find_unfinished(lane: u32) -> u32 {
    if lane == 0u {
        var blocks = 0u;
        for (var block = 0u; block < BLOCKS; block++) {
            blocks |= u32(atomicLoad(&finished_pixels[block]) < BLOCK_PIXELS) << block;
        }
        unfinished_blocks = blocks;
    }
    return workgroupUniformLoad(&unfinished_blocks);
}

@compute @workgroup_size(TILE, TILE)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let tile = group + vec3(0u, first_tile_row, 0u);
    let local = pixel_of(lane);
    let place = tile.xy * TILE + local;
    if lane == 0u {
        range = ranges[tile.y * view.tiles_x + tile.x];
    }
    if lane < BLOCKS {
        atomicStore(&finished_pixels[lane], 0u);
    }
    let intersection_range = workgroupUniformLoad(&range);

    let row = row_of(lane);
    var pixel = Pixel(vec2<f32>(local), vec3(0.0), 1.0, 0.0, FINISHED, row.block);
    if place.x < view.width && place.y < view.height {
        let pixels = view.width * view.height;
        let at = place.y * view.width + place.x;
        let colour = vec3(image[at], image[pixels + at], image[2u * pixels + at]);
        pixel.gradient = vec3(gradient[at], gradient[pixels + at], gradient[2u * pixels + at]);
        pixel.remaining = dot(colour, pixel.gradient);
        if TRANSMITTANCE {
            pixel.remaining += image[3u * pixels + at] * gradient[3u * pixels + at];
        }
        pixel.exponent_min = -LOG2_255;
    } else {
        atomicAdd(&finished_pixels[row.block], 1u);
    }
    leave_gradients(lane, pixel.gradient);

    let own_block = 1u << row.block;
    var first = intersection_range.x;
    for (; first < intersection_range.y; first += BATCH) {
        let unfinished = find_unfinished(lane);
        if unfinished == 0u {
            break;
        }
        if lane < BATCH {
            var splat = absent_splat();
            if first + lane < intersection_range.y {
                let intersection = intersections[first + lane];
                batch_intersections[lane] = intersection;
                splat = load_batch_splat(intersection_splats[intersection], tile.xy);
                splat.blocks &= unfinished;
            }
            batch[lane / SPLATS_AT_ONCE][lane % SPLATS_AT_ONCE] = splat;
        }
        workgroupBarrier();
        let count = min(BATCH, intersection_range.y - first);
        for (var group = 0u; SPLATS_AT_ONCE * group < count; group++) {
            // 1. Pixels.
            for (var slot = 0u; slot < SPLATS_AT_ONCE; slot++) {
                if (batch[group][slot].blocks & own_block) != 0u {
                    let p_w = replay(&pixel, batch[group][slot]);
                    exchange[row.block][slot][lane % BLOCK_PIXELS] = p_w.x;
                    exchange[row.block][SPLATS_AT_ONCE + slot][lane % BLOCK_PIXELS] = p_w.y;
                }
            }
            workgroupBarrier();
            // 2. Rows of pixels.
            var sums: array<f32, COLUMNS>;
            // With eight all have one, which not every compiler finds out.
            let has_splat = SPLATS_AT_ONCE == BLOCKS || row.slot < SPLATS_AT_ONCE;
            if has_splat && (batch[group][row.slot].blocks & own_block) != 0u {
                sums = sum_row(row, batch[group][row.slot]);
            }
            workgroupBarrier();
            for (var column = 0u; column < COLUMNS; column++) {
                if has_splat && (column < PLAIN_COLUMNS || view.signal >= SIGNAL_ABSOLUTE) {
                    // In an order that differs from splat to splat, for the memory banks' sake.
                    let order = (SPLATS_AT_ONCE * group + row.slot) % BLOCKS;
                    let at = parts_of(row.slot, column);
                    exchange[at.x][at.y][(row.row * BLOCKS + row.block) ^ order] = sums[column];
                }
            }
            workgroupBarrier();
            // 3. Columns of rows.
            let summed = SPLATS_AT_ONCE * group + lane / COLUMNS;
            if lane < SPLATS_AT_ONCE * COLUMNS && summed < count {
                let column = lane % COLUMNS;
                var sum = 0.0;
                if column < PLAIN_COLUMNS || view.signal >= SIGNAL_ABSOLUTE {
                    sum = sum_column(lane / COLUMNS, column);
                }
                intersection_gradients[batch_intersections[summed] * COLUMNS + column] = sum;
            }
            workgroupBarrier();
        }
    }
    // Nothing behind the last pixel's end has a gradient.
    for (var at = first * COLUMNS + lane; at < intersection_range.y * COLUMNS; at += TILE_PIXELS) {
        intersection_gradients[intersections[at / COLUMNS] * COLUMNS + at % COLUMNS] = 0.0;
    }
}
