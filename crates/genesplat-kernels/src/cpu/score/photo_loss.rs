//! The loss of a picture against one photo, forward only, for many pictures of one view.
//!
//! The photo's own blurred moments are kept; `E[x]`, `E[x²]` and `E[xy]` are left. Pictures and photo have
//! rows of whole vectors with zeros around them, so that every load is a whole vector. A channel is walked in
//! columns of 144 px from top to bottom: what the last 11 rows leave stays in the first-level cache.

use fearless_simd::{Level, Simd, dispatch, prelude::*};
use genesplat_core::PhotoLost;
use genesplat_core::constants::{SSIM_C1, SSIM_C2, SSIM_RADIUS, ssim_window};

use crate::cpu::bytes_of;
use crate::cpu::loss::blur::{MARGIN, Ring, TAPS, blur_rows, by_slot, load_bytes, mask_tail};
use crate::cpu::loss::{PhotoRows, Target, combine};
use crate::cpu::simd::{LANES, V, array};

/// Most vectors across a column of the walk.
const COLUMN_VECTORS: usize = 9;
/// Rows whose sums are added in f32 before they are added in f64.
const ROWS_PER_SUM: usize = 8;

/// Where the values of a padded picture lie: planes of rows of whole vectors, zeros before and after each
/// row.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Layout {
    pub size: [usize; 2],
}

impl Layout {
    fn vectors(&self) -> usize {
        self.size[0].div_ceil(LANES)
    }

    /// From a pixel to the one below it. The zeros after a row are those before the next one.
    pub(crate) fn stride(&self) -> usize {
        self.vectors() * LANES + MARGIN
    }

    /// From a pixel to the same of the next channel.
    pub(crate) fn plane(&self) -> usize {
        self.size[1] * self.stride()
    }

    /// Place of the first pixel of a row of the first channel.
    pub(crate) fn row(&self, y: usize) -> usize {
        MARGIN + y * self.stride()
    }

    pub(crate) fn len(&self) -> usize {
        3 * self.plane() + MARGIN
    }

    /// The walk's columns: channel, first vector and count of each, as even as can be.
    fn columns(&self) -> impl Iterator<Item = (usize, usize, usize)> + use<> {
        let vectors = self.vectors();
        let each = vectors.div_ceil(vectors.div_ceil(COLUMN_VECTORS).max(1)).max(1);
        let column = move |channel, first| (channel, first, each.min(vectors - first));
        (0..3).flat_map(move |channel| (0..vectors).step_by(each).map(move |first| column(channel, first)))
    }
}

/// A photo and what SSIM needs of it, in the [`Layout`] of the pictures that are compared with it.
#[derive(Debug)]
pub(crate) struct PhotoLoss {
    pub layout: Layout,
    photo: Vec<u8>,
    /// Pixels that do not count, by their place in the first channel.
    hidden: Vec<u32>,
    /// `E[y]` and `E[y²] − E[y]² + C2` of each vector, in the order of the walk.
    blurred: Vec<[[f32; LANES]; 2]>,
}

/// The working memory of one walk: the last 11 rows of `K` quantities, blurred along the row, and one row
/// unblurred.
pub(crate) struct Walk<const K: usize> {
    ring: Ring<K>,
    rows: [Vec<f32>; K],
}

impl<const K: usize> Default for Walk<K> {
    fn default() -> Self {
        let row = || vec![0.0; COLUMN_VECTORS * LANES + 2 * MARGIN];
        Self { ring: Ring::new(0), rows: std::array::from_fn(|_| row()) }
    }
}

impl PhotoLoss {
    pub(crate) fn bytes(&self) -> usize {
        bytes_of(&self.photo) + bytes_of(&self.blurred) + bytes_of(&self.hidden)
    }

    pub(crate) fn new(level: Level, target: &Target) -> Result<Self, PhotoLost> {
        let photo = PhotoRows::whole(target)?;
        let layout = Layout { size: [target.width, target.height] };
        let blurred = Vec::with_capacity(3 * layout.vectors() * target.height);
        let mut photo_loss =
            Self { layout, photo: padded(&photo, layout), hidden: hidden(target, layout), blurred };
        dispatch!(level, simd => photo_loss.blur_photo(simd));
        Ok(photo_loss)
    }

    #[inline(always)]
    fn blur_photo<S: Simd>(&mut self, simd: S) {
        let Self { layout, photo, blurred, .. } = self;
        let mut walk = Walk::<2>::default();
        for column in layout.columns() {
            walk.down(
                simd,
                *layout,
                column,
                #[inline(always)]
                |at| {
                    let y = load_bytes(simd, &photo[at..at + LANES]);
                    [y, y * y]
                },
                #[inline(always)]
                |_, _, [y, yy]| blurred.push([*y, *(yy - y * y + SSIM_C2)]),
            );
        }
    }

    /// Makes a picture equal to the photo where nothing counts.
    pub(crate) fn hide(&self, picture: &mut [f32]) {
        for channel in 0..3 {
            self.hidden
                .iter()
                .for_each(|&place| picture[channel * self.layout.plane() + place as usize] = 0.0);
        }
    }

    #[inline(always)]
    pub(crate) fn loss<S: Simd>(&self, simd: S, picture: &[f32], walk: &mut Walk<3>) -> f32 {
        // A loop: what is passed to an iterator's methods is not always inlined.
        let (mut sums, mut blurred) = ([0.0; 2], self.blurred.iter());
        for column in self.layout.columns() {
            let [l1, ssim] = self.column_sums(simd, picture, column, &mut blurred, walk);
            sums = [sums[0] + l1, sums[1] + ssim];
        }
        let [width, height] = self.layout.size;
        combine([sums].into_iter(), 3 * width * height)
    }

    /// Sums of `|x − y|` and of SSIM over one column of one channel.
    #[inline(always)]
    fn column_sums<S: Simd>(
        &self,
        simd: S,
        picture: &[f32],
        column: (usize, usize, usize),
        blurred: &mut std::slice::Iter<'_, [[f32; LANES]; 2]>,
        walk: &mut Walk<3>,
    ) -> [f64; 2] {
        let zero = V::splat(simd, 0.0);
        let (mut near, mut sums) = ([zero; 2], [0.0f64; 2]);
        let mut left = ROWS_PER_SUM * column.2;
        let last = self.layout.vectors() - 1;
        let tail = self.layout.size[0] - last * LANES;
        walk.down(
            simd,
            self.layout,
            column,
            #[inline(always)]
            |at| {
                let x = V::from_slice(simd, &picture[at..at + LANES]);
                [x, x * x, x * load_bytes(simd, &self.photo[at..at + LANES])]
            },
            #[inline(always)]
            |at, vector, moments| {
                let x = V::from_slice(simd, &picture[at..at + LANES]);
                // Beyond the row both are zero.
                near[0] += (x - load_bytes(simd, &self.photo[at..at + LANES])).abs();
                let Some(&[mean, spread]) = blurred.next() else { unreachable!("one for each vector") };
                let of_photo = [V::simd_from(simd, mean), V::simd_from(simd, spread)];
                let ssim = ssim(of_photo, moments);
                near[1] += if vector == last { mask_tail(simd, ssim, tail) } else { ssim };
                left -= 1;
                if left == 0 {
                    add(&mut sums, &near);
                    (near, left) = ([zero; 2], ROWS_PER_SUM * column.2);
                }
            },
        );
        add(&mut sums, &near);
        sums
    }
}

/// SSIM from the photo's mean and spread and the blurred moments of a picture.
#[inline(always)]
fn ssim<S: Simd>([mean, spread]: [V<S>; 2], [x, xx, xy]: [V<S>; 3]) -> V<S> {
    let (product, square) = (x * mean, x * x);
    let numerator = (product * 2.0 + SSIM_C1) * ((xy - product) * 2.0 + SSIM_C2);
    let denominator = (mean.mul_add(mean, square) + SSIM_C1) * (xx - square + spread);
    numerator / denominator
}

#[inline(always)]
fn add<S: Simd>(sums: &mut [f64; 2], near: &[V<S>; 2]) {
    for (sum, near) in sums.iter_mut().zip(near) {
        *sum += near.iter().map(|&v| f64::from(v)).sum::<f64>();
    }
}

fn hidden(target: &Target, layout: Layout) -> Vec<u32> {
    let counts = target.mask.iter().flat_map(|mask| &mask.counts).enumerate();
    let place = |index: usize| layout.row(index / target.width) + index % target.width;
    counts.filter(|(_, counts)| !**counts).map(|(index, _)| place(index) as u32).collect()
}

fn padded(photo: &PhotoRows, layout: Layout) -> Vec<u8> {
    let mut out = vec![0; layout.len()];
    let [width, height] = layout.size;
    for channel in 0..3 {
        for (y, row) in photo.plane(channel, &(0..height)).chunks_exact(width).enumerate() {
            let at = channel * layout.plane() + layout.row(y);
            out[at..at + width].copy_from_slice(row);
        }
    }
    out
}

impl<const K: usize> Walk<K> {
    /// Walks down a column `(channel, first vector, vectors)`: calls `visit(place, vector, blurred
    /// quantities)` for each of its vectors, row by row; `load(place)` gives the quantities.
    #[inline(always)]
    fn down<S: Simd>(
        &mut self,
        simd: S,
        layout: Layout,
        (channel, first, count): (usize, usize, usize),
        mut load: impl FnMut(usize) -> [V<S>; K],
        mut visit: impl FnMut(usize, usize, [V<S>; K]),
    ) {
        let window = ssim_window().map(|v| v as f32);
        let weights: [[f32; TAPS]; TAPS] = array!(y => by_slot(&window, y as isize));
        let Self { ring, rows } = self;
        // Rows above the picture are zero.
        ring.columns.clear();
        ring.columns.resize(count, [[[0.0; LANES]; TAPS]; K]);
        let origin = channel * layout.plane() + first * LANES;
        let height = layout.size[1];
        for y in 0..height + SSIM_RADIUS {
            // 1. The quantities of row y, blurred along the row; those beside the column are needed, too.
            if y < height {
                let from = origin + layout.row(y) - MARGIN;
                for vector in 0..count + 2 {
                    let quantities = load(from + vector * LANES);
                    for k in 0..K {
                        quantities[k].store_slice(&mut rows[k][vector * LANES..][..LANES]);
                    }
                }
                blur_rows(simd, &window, rows, ring, y as isize);
            } else {
                ring.clear_row(y as isize);
            }
            // 2. The row whose window is now complete.
            let Some(centre) = y.checked_sub(SSIM_RADIUS) else { continue };
            let at = origin + layout.row(centre);
            for vector in 0..count {
                let blurred = ring.blur(simd, &weights[centre % TAPS], vector);
                visit(at + vector * LANES, first + vector, blurred);
            }
        }
    }
}
