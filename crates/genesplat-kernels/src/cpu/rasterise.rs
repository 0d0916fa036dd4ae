//! Stage `rasterise`: blends the splats of each tile front to back, and the same again for the gradients.
//!
//! A tile is 16 blocks of 4x4 pixels and a block is one vector, so a splat costs only the blocks that its ellipse
//! reaches. Each block keeps transmittance and colour in registers while it walks its own list.
//!
//! **Backward** (facts.md section 5) walks the lists front to back once more: with the final image known, the light
//! behind a splat is what remains of it, so neither alphas nor transmittances are stored. Per pixel it finds
//! `p = o·G · dL/dα` and `w = α·T`. All gradients of a splat are sums of `p` times `1, x, y, x², xy, y²` and of `w`
//! times `dL/dpixel`: a product of a 16-vector with two constant matrices, added to one row per splat and tile. No
//! two tasks write the same row, so there are no atomics and the result does not depend on the number of threads.

use fearless_simd::{Level, Simd, dispatch, f32x4, f32x8, mask32x16, prelude::*};
use genesplat_core::Image;
use genesplat_core::constants::{ALPHA_MAX, TRANSMITTANCE_MIN};
use rayon::prelude::*;

use super::bin::{BLOCK, BLOCKS_ACROSS, Bins, LOG2_255, TileSplat};
use super::project::{Pinhole, Splat, Splats, TILE};
use super::simd::{LANES, V, array, exp2};

/// Blocks of a tile.
pub const BLOCKS: usize = BLOCKS_ACROSS * BLOCKS_ACROSS;

/// What the forward pass leaves of one tile.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub struct TileImage {
    /// Red, green, blue (without background) and transmittance of each block, row-major within it.
    pub blocks: [[[f32; LANES]; 4]; BLOCKS],
    /// How many entries of its list each block consumed before all of its pixels were finished.
    pub consumed: [u32; BLOCKS],
}

impl Default for TileImage {
    fn default() -> Self {
        Self { blocks: [[[0.0; LANES]; 4]; BLOCKS], consumed: [0; BLOCKS] }
    }
}

/// Gradient row of one splat in one tile; see the constants for its columns.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
pub struct GradientRow(pub [f32; LANES]);

/// Columns of a [`GradientRow`]: sums of `p` times powers of the offset `pixel − mean`.
pub mod column {
    /// Σ p
    pub const ONE: usize = 0;
    /// Σ p·dx
    pub const X: usize = 1;
    /// Σ p·dy
    pub const Y: usize = 2;
    /// Σ p·dx²
    pub const XX: usize = 3;
    /// Σ p·dx·dy
    pub const XY: usize = 4;
    /// Σ p·dy²
    pub const YY: usize = 5;
    /// Σ |∂L/∂u|, by pixel ([`super::Extra::Absolute`] only)
    pub const ABS_X: usize = 6;
    /// Σ |∂L/∂v|, by pixel ([`super::Extra::Absolute`] only)
    pub const ABS_Y: usize = 7;
    /// dL/drgb
    pub const RED: usize = 8;
    /// Number of pixels blended ([`super::Extra::Pixels`] only)
    pub const PIXELS: usize = 11;
}

/// What the backward pass sums besides the gradients.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extra {
    /// Nothing.
    None,
    /// Absolute screen gradients (gsplat's "absgrad").
    Absolute,
    /// Pixels blended (Pixel-GS).
    Pixels,
}

/// One tile's splats, copied together, and which of them reach each block; reused from tile to tile.
///
/// The copy costs a cache line a splat and pays for itself: the blocks read each splat several times, and the reads of
/// the copy loop do not wait for one another.
#[derive(Clone, Debug, Default)]
struct TileLists {
    splats: Vec<Splat>,
    /// Room for every entry in each block's list.
    lists: [Vec<u32>; BLOCKS],
    lengths: [usize; BLOCKS],
}

impl TileLists {
    fn fill(&mut self, entries: &[TileSplat], splats: &Splats) {
        self.splats.clear();
        self.splats.extend(entries.iter().map(|entry| *splats.get(entry.splat)));
        for (block, (list, length)) in self.lists.iter_mut().zip(&mut self.lengths).enumerate() {
            list.resize(list.len().max(entries.len() + 1), 0);
            // Every index is written; those of other blocks are overwritten by the next one. No branch to mispredict.
            *length = 0;
            for (index, entry) in entries.iter().enumerate() {
                list[*length] = index as u32;
                *length += (entry.blocks >> block & 1) as usize;
            }
        }
    }

    /// Indices of the splats that reach a block, front to back.
    fn list(&self, block: usize) -> &[u32] {
        &self.lists[block][..self.lengths[block]]
    }
}

/// Forward pass of all tiles.
pub fn forward(level: Level, splats: &Splats, bins: &Bins, camera: &Pinhole, tiles: &mut Vec<TileImage>) {
    let grid = camera.grid();
    tiles.resize_with(grid[0] * grid[1], TileImage::default);
    tiles.par_iter_mut().enumerate().for_each_init(TileLists::default, |lists, (tile, out)| {
        let origin = [tile % grid[0] * TILE, tile / grid[0] * TILE];
        lists.fill(bins.tile(tile), splats);
        dispatch!(level, simd => forward_tile(simd, lists, origin, camera.size, out));
    });
}

#[inline(always)]
fn forward_tile<S: Simd>(
    simd: S,
    lists: &TileLists,
    origin: [usize; 2],
    size: [u32; 2],
    out: &mut TileImage,
) {
    for block in 0..BLOCKS {
        let pixels = BlockPixels::new(simd, origin, block, size);
        let list = lists.list(block).iter().map(|&index| &lists.splats[index as usize]);
        let (state, consumed) = blend(simd, list, &pixels);
        for channel in 0..3 {
            out.blocks[block][channel] = *state.rgb[channel];
        }
        out.blocks[block][3] = *state.transmittance;
        out.consumed[block] = consumed;
    }
}

/// Pixel coordinates of a block, and which of them lie in the image.
pub struct BlockPixels<S: Simd> {
    x: V<S>,
    y: V<S>,
    inside: mask32x16<S>,
}

impl<S: Simd> BlockPixels<S> {
    /// Block `block` of the tile at `origin`.
    #[inline(always)]
    pub fn new(simd: S, origin: [usize; 2], block: usize, size: [u32; 2]) -> Self {
        let left = (origin[0] + block % BLOCKS_ACROSS * BLOCK) as f32;
        let top = (origin[1] + block / BLOCKS_ACROSS * BLOCK) as f32;
        let x = V::from_fn(
            simd,
            #[inline(always)]
            |lane| left + (lane % BLOCK) as f32,
        );
        let y = V::from_fn(
            simd,
            #[inline(always)]
            |lane| top + (lane / BLOCK) as f32,
        );
        let inside = x.simd_lt(size[0] as f32) & y.simd_lt(size[1] as f32);
        Self { x, y, inside }
    }
}

/// Colour so far and transmittance of 16 pixels.
pub struct Blend<S: Simd> {
    pub rgb: [V<S>; 3],
    pub transmittance: V<S>,
}

/// Front-to-back blending of one block; also returns how many splats it looked at.
#[inline(always)]
pub fn blend<'a, S: Simd>(
    simd: S,
    splats: impl Iterator<Item = &'a Splat>,
    pixels: &BlockPixels<S>,
) -> (Blend<S>, u32) {
    let zero = V::splat(simd, 0.0);
    let mut alive = pixels.inside;
    let mut state = Blend { rgb: [zero; 3], transmittance: V::splat(simd, 1.0) };
    let mut consumed = 0;
    for splat in splats {
        consumed += 1;
        let exponent = exponent(splat, pixels);
        let hit = exponent.simd_ge(-LOG2_255) & alive;
        let alpha = hit.select(exp2(exponent.max(-9.0)).min(ALPHA_MAX), zero);
        let mut weight = state.transmittance * alpha;
        let mut next = state.transmittance - weight;
        let stops = next.simd_lt(TRANSMITTANCE_MIN);
        if stops.any_true() {
            // The splat that would end a pixel is not blended into it.
            weight = stops.select(zero, weight);
            next = stops.select(state.transmittance, next);
            alive &= !stops;
            if alive.all_false() {
                break;
            }
        }
        for channel in 0..3 {
            state.rgb[channel] = weight.mul_add(V::splat(simd, splat.rgb[channel]), state.rgb[channel]);
        }
        state.transmittance = next;
    }
    (state, consumed)
}

/// `log2(o·G)` at each pixel.
#[inline(always)]
fn exponent<S: Simd>(splat: &Splat, pixels: &BlockPixels<S>) -> V<S> {
    let simd = pixels.x.simd;
    let [a, b, c] = splat.conic_log2;
    let dx = pixels.x - splat.mean[0];
    let dy = pixels.y - splat.mean[1];
    let slope = dx.mul_add(V::splat(simd, a), dy * b);
    let constant = (dy * c).mul_add(dy, V::splat(simd, splat.log2_opacity));
    slope.mul_add(dx, constant)
}

/// Composes the tiles on `background` into a planar image.
pub fn compose(tiles: &[TileImage], camera: &Pinhole, background: [f32; 3], image: &mut Image) {
    let [width, height] = camera.size.map(|v| v as usize);
    (image.width, image.height) = (camera.size[0], camera.size[1]);
    image.planes.resize(3 * width * height, 0.0);
    let across = camera.grid()[0];
    image.planes.par_chunks_mut(width * height).enumerate().for_each(|(channel, plane)| {
        plane.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            let tiles = &tiles[y / TILE * across..][..across];
            let block_row = y % TILE / BLOCK * BLOCKS_ACROSS;
            let lane = y % BLOCK * BLOCK;
            for (column, values) in row.chunks_mut(BLOCK).enumerate() {
                let block = &tiles[column / BLOCKS_ACROSS].blocks[block_row + column % BLOCKS_ACROSS];
                for (x, value) in values.iter_mut().enumerate() {
                    *value = block[channel][lane + x] + background[channel] * block[3][lane + x];
                }
            }
        });
    });
}

/// Everything the backward pass reads besides the lists.
pub struct Backward<'a> {
    /// Splats of the view.
    pub splats: &'a Splats,
    /// What the forward pass left.
    pub tiles: &'a [TileImage],
    /// The composed image `[3, H, W]`.
    pub image: &'a Image,
    /// `dL/dimage` `[3, H, W]`.
    pub gradient: &'a [f32],
    /// What to sum besides.
    pub extra: Extra,
}

/// Backward pass of all tiles: fills one row per entry of `bins.entries`.
pub fn backward(level: Level, bins: &Bins, camera: &Pinhole, inputs: &Backward, rows: &mut Vec<GradientRow>) {
    let grid = camera.grid();
    rows.resize(bins.entries.len(), GradientRow::default());
    let mut rest = rows.as_mut_slice();
    let mut by_tile = Vec::with_capacity(grid[0] * grid[1]);
    for tile in 0..grid[0] * grid[1] {
        let (own, others) = rest.split_at_mut(bins.tile(tile).len());
        by_tile.push(own);
        rest = others;
    }
    by_tile.into_par_iter().enumerate().for_each_init(Workspace::default, |work, (tile, rows)| {
        work.lists.fill(bins.tile(tile), inputs.splats);
        let task =
            TileTask { origin: [tile % grid[0] * TILE, tile / grid[0] * TILE], size: camera.size, inputs };
        dispatch!(level, simd => match inputs.extra {
            Extra::None => backward_tile::<NONE, _>(simd, &task, tile, work, rows),
            Extra::Absolute => backward_tile::<ABSOLUTE, _>(simd, &task, tile, work, rows),
            Extra::Pixels => backward_tile::<PIXELS, _>(simd, &task, tile, work, rows),
        });
    });
}

const NONE: u8 = 0;
const ABSOLUTE: u8 = 1;
const PIXELS: u8 = 2;

struct TileTask<'a> {
    origin: [usize; 2],
    size: [u32; 2],
    inputs: &'a Backward<'a>,
}

/// One thread's working memory.
#[derive(Default)]
struct Workspace {
    lists: TileLists,
    shares: Vec<Share>,
}

/// What one splat does to the 16 pixels of a block: `p` and `w` of the module's documentation.
#[derive(Clone, Copy, Default)]
#[repr(C, align(64))]
struct Share {
    p: [f32; LANES],
    w: [f32; LANES],
}

/// Coordinates of moments within a tile are taken from its centre: small numbers, exact in f32.
const TILE_CENTRE: f32 = (TILE - 1) as f32 / 2.0;

#[inline(always)]
fn backward_tile<const EXTRA: u8, S: Simd>(
    simd: S,
    task: &TileTask,
    tile: usize,
    work: &mut Workspace,
    rows: &mut [GradientRow],
) {
    rows.fill(GradientRow::default());
    let Workspace { lists, shares } = work;
    for block in 0..BLOCKS {
        let list = &lists.list(block)[..task.inputs.tiles[tile].consumed[block] as usize];
        if list.is_empty() {
            continue;
        }
        let gradient = load_block(simd, task.inputs.gradient, task, block);
        replay::<EXTRA, S>(simd, task, block, list, &lists.splats, &gradient, shares, rows);
        accumulate(simd, block, list, &gradient, shares, rows);
    }
    // From moments about the tile's centre to moments about each splat's mean.
    for (row, splat) in rows.iter_mut().zip(&lists.splats) {
        let offset = array(
            #[inline(always)]
            |axis| splat.mean[axis] - task.origin[axis] as f32 - TILE_CENTRE,
        );
        shift_moments(&mut row.0, offset);
    }
}

#[inline(always)]
fn shift_moments(row: &mut [f32; LANES], [ox, oy]: [f32; 2]) {
    let [one, x, y, xx, xy, yy] = [row[0], row[1], row[2], row[3], row[4], row[5]];
    row[column::X] = x - ox * one;
    row[column::Y] = y - oy * one;
    row[column::XX] = xx - 2.0 * ox * x + ox * ox * one;
    row[column::XY] = xy - ox * y - oy * x + ox * oy * one;
    row[column::YY] = yy - 2.0 * oy * y + oy * oy * one;
}

/// Walks a block's list front to back and writes each splat's share.
#[inline(always)]
fn replay<const EXTRA: u8, S: Simd>(
    simd: S,
    task: &TileTask,
    block: usize,
    list: &[u32],
    splats: &[Splat],
    gradient: &[V<S>; 3],
    shares: &mut Vec<Share>,
    rows: &mut [GradientRow],
) {
    // 1. The light that all splats and the background send along the gradient.
    let pixels = BlockPixels::new(simd, task.origin, block, task.size);
    let image = load_block(simd, &task.inputs.image.planes, task, block);
    let mut remaining = image[0] * gradient[0] + image[1] * gradient[1] + image[2] * gradient[2];

    let (zero, one) = (V::splat(simd, 0.0), V::splat(simd, 1.0));
    let mut alive = pixels.inside;
    let mut transmittance = one;
    shares.resize(list.len(), Share::default());
    for (&index, share) in list.iter().zip(shares.iter_mut()) {
        let splat = &splats[index as usize];

        // 2. Alpha, as in the forward pass.
        let exponent = exponent(splat, &pixels);
        let mut hit = exponent.simd_ge(-LOG2_255) & alive;
        let unclamped = exp2(exponent.max(-9.0));
        let mut alpha = hit.select(unclamped.min(ALPHA_MAX), zero);
        let mut weight = transmittance * alpha;
        let mut next = transmittance - weight;
        let stops = next.simd_lt(TRANSMITTANCE_MIN);
        if stops.any_true() {
            alive &= !stops;
            hit &= !stops;
            alpha = stops.select(zero, alpha);
            weight = stops.select(zero, weight);
            next = stops.select(transmittance, next);
        }

        // 3. dL/dα: what the splat adds itself, less what it takes from everything behind it. The clamp at 0.99 is
        // ignored, as published (straight-through).
        let own = gradient[0] * splat.rgb[0] + gradient[1] * splat.rgb[1] + gradient[2] * splat.rgb[2];
        remaining -= weight * own;
        let alpha_gradient = transmittance * own - remaining * reciprocal(one - alpha);
        let p = hit.select(unclamped * alpha_gradient, zero);
        transmittance = next;
        p.store_slice(&mut share.p);
        weight.store_slice(&mut share.w);

        if EXTRA == PIXELS {
            rows[index as usize].0[column::PIXELS] += hit.to_bitmask().count_ones() as f32;
        }
        if EXTRA == ABSOLUTE {
            let absolute = absolute_gradient(splat, &pixels, p);
            rows[index as usize].0[column::ABS_X] += absolute[0];
            rows[index as usize].0[column::ABS_Y] += absolute[1];
        }
    }
}

/// Splats that [`accumulate`] takes at once: each constant is loaded once for all of them.
const GROUP: usize = 4;

/// Adds the block's shares to the splats' rows: two products of a `[n, 16]` matrix with a constant one.
#[inline(always)]
fn accumulate<S: Simd>(
    simd: S,
    block: usize,
    list: &[u32],
    gradient: &[V<S>; 3],
    shares: &[Share],
    rows: &mut [GradientRow],
) {
    let powers = powers(block);
    let mut colours = [[0.0f32; 4]; LANES];
    for lane in 0..LANES {
        colours[lane] = [gradient[0][lane], gradient[1][lane], gradient[2][lane], 0.0];
    }
    for (group, shares) in list.chunks(GROUP).zip(shares.chunks(GROUP)) {
        let mut moments = [f32x8::splat(simd, 0.0); GROUP];
        let mut rgb = [f32x4::splat(simd, 0.0); GROUP];
        for lane in 0..LANES {
            let power = f32x8::simd_from(simd, powers[lane]);
            let colour = f32x4::simd_from(simd, colours[lane]);
            for k in 0..GROUP {
                let share = &shares[k.min(shares.len() - 1)];
                moments[k] = power.mul_add(f32x8::splat(simd, share.p[lane]), moments[k]);
                rgb[k] = colour.mul_add(f32x4::splat(simd, share.w[lane]), rgb[k]);
            }
        }
        for (k, &index) in group.iter().enumerate() {
            let (first, second) = rows[index as usize].0.split_at_mut(8);
            (f32x8::from_slice(simd, first) + moments[k]).store_slice(first);
            (f32x4::from_slice(simd, &second[..4]) + rgb[k]).store_slice(&mut second[..4]);
        }
    }
}

/// `1/x` for `x` in `[0.01, 1]`: the machine's estimate and two Newton steps, cheaper than a division. The relative error
/// is that of f32 where the estimate has 12 bits, and 2e-9 beyond rounding where it has only 8.
#[inline(always)]
fn reciprocal<S: Simd>(x: V<S>) -> V<S> {
    let two = V::splat(x.simd, 2.0);
    let mut estimate = x.approximate_recip();
    for _ in 0..2 {
        estimate *= (-x).mul_add(estimate, two);
    }
    estimate
}

/// Sums over the block of `|∂L/∂u|` and `|∂L/∂v|`: `∂L/∂mean = p · Σ'⁻¹ (pixel − mean)`.
#[inline(always)]
fn absolute_gradient<S: Simd>(splat: &Splat, pixels: &BlockPixels<S>, p: V<S>) -> [f32; 2] {
    let [a, b, c] = splat.conic_log2.map(|v| v * -std::f32::consts::LN_2);
    let (dx, dy) = (pixels.x - splat.mean[0], pixels.y - splat.mean[1]);
    let [x, y] = [(p * (dx * (2.0 * a) + dy * b)).abs(), (p * (dx * b + dy * (2.0 * c))).abs()];
    [x.iter().sum(), y.iter().sum()]
}

/// `1, x, y, x², xy, y²` of a block's pixels, from the tile's centre.
#[inline(always)]
fn powers(block: usize) -> [[f32; 8]; LANES] {
    array(
        #[inline(always)]
        |lane| {
            let x = (block % BLOCKS_ACROSS * BLOCK + lane % BLOCK) as f32 - TILE_CENTRE;
            let y = (block / BLOCKS_ACROSS * BLOCK + lane / BLOCK) as f32 - TILE_CENTRE;
            [1.0, x, y, x * x, x * y, y * y, 0.0, 0.0]
        },
    )
}

/// The three channels of a block of a planar image; 0 outside of it.
#[inline(always)]
fn load_block<S: Simd>(simd: S, planes: &[f32], task: &TileTask, block: usize) -> [V<S>; 3] {
    let [width, height] = task.size.map(|v| v as usize);
    let left = width.min(task.origin[0] + block % BLOCKS_ACROSS * BLOCK);
    let top = task.origin[1] + block / BLOCKS_ACROSS * BLOCK;
    let columns = BLOCK.min(width - left);
    array(
        #[inline(always)]
        |channel| {
            let mut values = [0.0; LANES];
            for row in 0..BLOCK.min(height.saturating_sub(top)) {
                let start = channel * width * height + (top + row) * width + left;
                let pixels = &planes[start..start + columns];
                let lanes = &mut values[row * BLOCK..][..BLOCK];
                // A copy of known length is one instruction, not a call.
                match pixels.first_chunk::<BLOCK>() {
                    Some(pixels) => lanes.copy_from_slice(pixels),
                    None => lanes[..columns].copy_from_slice(pixels),
                }
            }
            V::simd_from(simd, values)
        },
    )
}
