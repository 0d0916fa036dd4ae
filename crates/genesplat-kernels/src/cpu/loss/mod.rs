//! Stage `loss`: `0.8 · mean |I − P| + 0.2 · (1 − mean SSIM)` and its gradient, fused.
//!
//! SSIM's 11x11 window is separable, so everything is a sum over 11 rows of horizontally blurred rows
//! ([`blur`]). A task walks down one strip of one channel and keeps only the last 11 rows of moments and
//! partial derivatives.
//!
//! With raw moments `E[x], E[y], E[x²], E[y²], E[xy]` (x the render, y the photo) SSIM is
//! `S = (2 μx μy + C1)(2 σxy + C2) / ((μx² + μy² + C1)(σx² + σy² + C2))`, variances as `E[x²] − μ²`. The two
//! variances only enter as their sum, so `E[x² + y²]` is one moment. The gradient of S is, as the window is
//! symmetric, `blur(∂S/∂E[x]) + 2x · blur(∂S/∂E[x²]) + y · blur(∂S/∂E[xy])`.
//!
//! A picture of inverse depth has another loss ([`depth`]).
//!
//! Under a mask, render and photo are made equal before the loss, and the gradient zero after it
//! ([`Target::hide`]). Means stay those over all pixels, so that a pixel weighs the same in every photo.

pub(crate) mod blur;
mod depth;
pub(crate) mod squared_error;

use std::ops::Range;
use std::sync::Arc;

use fearless_simd::{Level, Simd, dispatch, prelude::*};
use genesplat_core::constants::{LAMBDA_DSSIM, SSIM_C1, SSIM_C2, SSIM_RADIUS, ssim_window};
use genesplat_core::{Channels, Image, Mask, PhotoLost, StoredPhoto, TrainStep, View};
use rayon::prelude::*;

use super::bytes_of;
use super::simd::{LANES, V};
use blur::{MARGIN, Ring, TAPS, blur_rows, by_slot, load_bytes, load_part, mask_tail};

/// Rows of a strip. A constant, so that the order of summation does not depend on the number of threads.
const STRIP: usize = 64;

/// What a view is to look like.
#[derive(Clone, Debug)]
pub struct Target {
    /// Width, px.
    pub width: usize,
    /// Height, px.
    pub height: usize,
    photo: StoredPhoto,
    /// `None` where all pixels count.
    pub mask: Option<Arc<Mask>>,
}

/// Rows of a photo as the loss reads them: 8-bit planes.
#[derive(Clone, Debug, Default)]
pub struct PhotoRows {
    /// Width and height of the whole photo, px.
    size: [usize; 2],
    rows: Range<usize>,
    /// Values `[3, rows, W]`; zeros where nothing counts.
    planes: Vec<u8>,
    /// The same rows as a file has them.
    interleaved: Vec<u8>,
}

/// Rows that one task takes apart, at least.
const ROWS_OF_TASK: usize = 64;

impl PhotoRows {
    /// All rows.
    pub(crate) fn whole(target: &Target) -> Result<Self, PhotoLost> {
        let mut photo = Self::default();
        photo.read(target, 0..target.height)?;
        Ok(photo)
    }

    /// Takes the place of what was read before.
    pub fn read(&mut self, target: &Target, rows: Range<usize>) -> Result<(), PhotoLost> {
        let Self { size, rows: held, planes, interleaved } = self;
        (*size, *held) = ([target.width, target.height], rows);
        let (width, pixels) = (target.width, target.width * held.len());
        planes.resize(3 * pixels, 0);
        let values = target.photo.rows(held, interleaved)?;
        let (red, others) = planes.split_at_mut(pixels);
        let (green, blue) = others.split_at_mut(pixels);
        let [red, green, blue] = [red, green, blue].map(|plane| plane.par_chunks_mut(width));
        let by_row = red.zip(green).zip(blue).zip(values.par_chunks(3 * width)).with_min_len(ROWS_OF_TASK);
        by_row.for_each(|(((red, green), blue), values)| {
            for (at, rgb) in values.as_chunks::<3>().0.iter().enumerate() {
                [red[at], green[at], blue[at]] = *rgb;
            }
        });
        if let Some(mask) = &target.mask {
            mask.hide_part(planes, held.start * width..held.end * width);
        }
        Ok(())
    }

    /// The values of some of the rows in one channel.
    pub(crate) fn plane(&self, channel: usize, rows: &Range<usize>) -> &[u8] {
        let (width, held) = (self.size[0], self.rows.len());
        &self.planes[(channel * held + rows.start - self.rows.start) * width..][..rows.len() * width]
    }

    pub(crate) fn bytes(&self) -> usize {
        bytes_of(&self.planes) + bytes_of(&self.interleaved)
    }
}

impl Target {
    /// Makes planes `[.., H, W]` equal to the photo where nothing counts: neither L1 nor a window of SSIM
    /// sees a difference there. Of the gradient, zeros remain.
    pub(crate) fn hide(&self, planes: &mut [f32]) {
        self.hide_rows(planes, &(0..self.height));
    }

    /// The same in planes that hold some rows.
    pub fn hide_rows(&self, planes: &mut [f32], rows: &Range<usize>) {
        if let Some(mask) = &self.mask {
            mask.hide_part(planes, rows.start * self.width..rows.end * self.width);
        }
    }

    /// Width and height, px.
    pub fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// Pixels that count.
    pub(crate) fn counted(&self) -> usize {
        self.mask.as_ref().map_or(self.width * self.height, |mask| mask.counted())
    }
}

impl From<&View> for Target {
    fn from(view: &View) -> Self {
        let View { photo, mask, .. } = view;
        let (width, height) = (photo.width() as usize, photo.height() as usize);
        Self { width, height, photo: photo.clone(), mask: mask.clone() }
    }
}

/// A gradient that is wanted.
pub struct Wanted<'a> {
    /// Where it goes `[3, H, W]`; what was there is overwritten.
    pub gradient: &'a mut Vec<f32>,
    /// The picture is of inverse depth, and the photo holds codes: the weight of the step.
    pub depth_weight: Option<f32>,
}

impl<'a> Wanted<'a> {
    /// That of a step.
    pub fn of(step: &TrainStep, gradient: &'a mut Vec<f32>) -> Self {
        let depth_weight = match step.settings.channels {
            Channels::Rgb => None,
            Channels::InverseDepth { .. } => Some(step.depth_weight),
        };
        Self { gradient, depth_weight }
    }
}

/// Loss of `image` against a whole photo.
pub(crate) fn loss(level: Level, image: &Image, photo: &PhotoRows, gradient: Option<Wanted>) -> f32 {
    let (mut sums, [width, height]) = (Vec::new(), photo.size);
    loss_of_rows(level, (image, 0), photo, 0..height, gradient, &mut sums);
    loss_of_sums(&sums, [width, height])
}

/// Rows beside some rows of a picture that their loss and its gradient depend on.
pub const LOSS_REACH: usize = 2 * SSIM_RADIUS;

/// Sums of `|I − P|` and of SSIM of each of `rows` `[3, rows]`, and the gradient of the whole picture's loss
/// by them `[3, rows, W]`, when wanted. Of the picture, `image` has the rows from `first` on: `rows` and all
/// within [`LOSS_REACH`]. Of the photo, the same are wanted.
pub fn loss_of_rows(
    level: Level,
    (image, first): (&Image, usize),
    photo: &PhotoRows,
    rows: Range<usize>,
    gradient: Option<Wanted>,
    sums: &mut Vec<[f64; 2]>,
) {
    let ([width, height], held) = (photo.size, image.planes.len() / 3);
    sums.clear();
    sums.resize(3 * rows.len(), [0.0; 2]);
    if rows.is_empty() {
        return;
    }
    if let Some(Wanted { gradient, depth_weight: Some(weight), .. }) = gradient {
        return depth::loss_of_rows((image, first), photo, rows, weight, gradient, sums);
    }
    let strips = rows.len().div_ceil(STRIP);
    let slope = L1Slope::new(3 * width * height);
    let task = |index: usize, sums: &mut [[f64; 2]], out: Option<&mut [f32]>| {
        let channel = index / strips;
        let picture = Channel {
            size: [width, height],
            plane: &image.planes[channel * held..][..held],
            first,
            photo: photo.plane(channel, &photo.rows),
            first_of_photo: photo.rows.start,
        };
        let top = rows.start + index % strips * STRIP;
        dispatch!(level, simd => walk_strip(simd, &picture, top..top + sums.len(), sums, out.map(|out| (out, slope))));
    };
    let sums = sums.chunks_mut(rows.len()).flat_map(|channel| channel.chunks_mut(STRIP));
    match gradient {
        None => {
            let sums: Vec<_> = sums.collect();
            sums.into_par_iter().enumerate().for_each(|(index, sums)| task(index, sums, None));
        }
        Some(Wanted { gradient, .. }) => {
            gradient.resize(3 * rows.len() * width, 0.0);
            let out =
                gradient.chunks_mut(rows.len() * width).flat_map(|plane| plane.chunks_mut(STRIP * width));
            let strips: Vec<_> = sums.zip(out).collect();
            strips.into_par_iter().enumerate().for_each(|(index, (sums, out))| task(index, sums, Some(out)));
        }
    }
}

/// The loss from the sums of all rows `[3, H]` of a picture of `width` x `height` px, which are added strip
/// by strip.
pub fn loss_of_sums(sums: &[[f64; 2]], [width, height]: [usize; 2]) -> f32 {
    let strips = sums.chunks(height).flat_map(|channel| channel.chunks(STRIP));
    combine(strips.map(|strip| strip.iter().fold([0.0; 2], add)), 3 * width * height)
}

fn add(a: [f64; 2], b: &[f64; 2]) -> [f64; 2] {
    [a[0] + b[0], a[1] + b[1]]
}

/// The loss from sums of `|I − P|` and of SSIM over `values` values.
pub(crate) fn combine(sums: impl Iterator<Item = [f64; 2]>, values: usize) -> f32 {
    let [l1, ssim] = sums.fold([0.0; 2], |a, b| add(a, &b));
    let lambda = f64::from(LAMBDA_DSSIM);
    ((1.0 - lambda) * l1 / values as f64 + lambda * (1.0 - ssim / values as f64)) as f32
}

/// One channel of a picture, of which not all rows need be there, and its photo.
struct Channel<'a> {
    size: [usize; 2],
    plane: &'a [f32],
    /// First row of the plane.
    first: usize,
    photo: &'a [u8],
    /// First row of the photo's plane.
    first_of_photo: usize,
}

impl Channel<'_> {
    /// A row of the picture and of the photo.
    #[inline(always)]
    fn row(&self, y: usize) -> (&[f32], &[u8]) {
        let width = self.size[0];
        let plane = &self.plane[(y - self.first) * width..][..width];
        (plane, &self.photo[(y - self.first_of_photo) * width..][..width])
    }
}

/// Sums of `|I − P|` and of SSIM of each row of the strip; writes the strip's gradient when asked.
#[inline(always)]
fn walk_strip<S: Simd>(
    simd: S,
    channel: &Channel,
    strip: Range<usize>,
    sums: &mut [[f64; 2]],
    mut gradient: Option<(&mut [f32], L1Slope)>,
) {
    let window = ssim_window().map(|v| v as f32);
    let width = channel.size[0];
    let stride = width.next_multiple_of(LANES);
    let radius = SSIM_RADIUS as isize;
    let (first, end, height) = (strip.start as isize, strip.end as isize, channel.size[1] as isize);
    // Rows whose SSIM is needed: the strip's own, and those whose windows reach into it.
    let reach = if gradient.is_some() { radius } else { 0 };
    let mut moments = Ring::<4>::new(width);
    let mut partials = Ring::<3>::new(width);
    let mut scratch = Rows::new(stride);

    for y in first - reach - radius..end + reach + radius {
        // 1. Moments of row y, blurred horizontally.
        if (0..height).contains(&y) {
            scratch.load(simd, channel.row(y as usize));
            blur_rows(simd, &window, &scratch.inputs, &mut moments, y);
        } else {
            moments.clear_row(y);
        }
        // 2. SSIM and its partial derivatives at the row whose window is now complete.
        let centre = y - radius;
        if centre < first - reach {
            continue;
        }
        if (0..height).contains(&centre) && centre < end + reach {
            let row_sum = ssim_row(simd, &window, &moments, centre, width, &mut scratch.partial);
            if (first..end).contains(&centre) {
                let (render, photo) = channel.row(centre as usize);
                sums[(centre - first) as usize] = [l1_row(simd, render, photo), row_sum];
            }
            if gradient.is_some() {
                blur_rows(simd, &window, &scratch.partial, &mut partials, centre);
            }
        } else {
            partials.clear_row(centre);
        }
        // 3. The gradient of the row whose partial derivatives are now complete.
        let target = centre - radius;
        if let Some((out, slope)) = &mut gradient
            && (first..end).contains(&target)
        {
            let out = &mut out[(target - first) as usize * width..][..width];
            let values = channel.row(target as usize);
            gradient_row(simd, &window, &partials, target, values, *slope, out);
        }
    }
}

/// What a difference weighs in the gradient.
#[derive(Clone, Copy)]
struct L1Slope {
    /// Of each value.
    l1: f32,
    ssim: f32,
}

impl L1Slope {
    fn new(values: usize) -> Self {
        Self { l1: (1.0 - LAMBDA_DSSIM) / values as f32, ssim: -LAMBDA_DSSIM / values as f32 }
    }

    #[inline(always)]
    fn at<S: Simd>(self, simd: S, difference: V<S>) -> V<S> {
        let (most, least) = (V::splat(simd, self.l1), V::splat(simd, -self.l1));
        // The subgradient of |x| at 0 is 0.
        let negative = difference.simd_lt(0.0).select(least, V::splat(simd, 0.0));
        difference.simd_gt(0.0).select(most, negative)
    }
}

struct Rows {
    /// `x`, `y`, `x² + y²` and `xy`.
    inputs: [Vec<f32>; 4],
    partial: [Vec<f32>; 3],
}

impl Rows {
    fn new(stride: usize) -> Self {
        let row = |_| vec![0.0; stride + 2 * MARGIN];
        Self { inputs: std::array::from_fn(row), partial: std::array::from_fn(row) }
    }

    #[inline(always)]
    fn load<S: Simd>(&mut self, simd: S, (render, photo): (&[f32], &[u8])) {
        let width = render.len();
        let [x_row, y_row, squares, product] = &mut self.inputs;
        x_row[MARGIN..][..width].copy_from_slice(render);
        for first in (0..width).step_by(LANES) {
            let (at, count) = (MARGIN + first, LANES.min(width - first));
            let x = load_part(simd, &x_row[at..at + count]);
            let target = load_bytes(simd, &photo[first..first + count]);
            target.store_slice(&mut y_row[at..at + LANES]);
            x.mul_add(x, target * target).store_slice(&mut squares[at..at + LANES]);
            (x * target).store_slice(&mut product[at..at + LANES]);
        }
    }
}

/// Sum of SSIM over a row; writes `∂S/∂E[x]`, `∂S/∂E[x²]`, `∂S/∂E[xy]` into padded rows.
#[inline(always)]
fn ssim_row<S: Simd>(
    simd: S,
    window: &[f32; TAPS],
    moments: &Ring<4>,
    y: isize,
    width: usize,
    partial: &mut [Vec<f32>; 3],
) -> f64 {
    let weights = by_slot(window, y);
    let mut sum = V::splat(simd, 0.0);
    for first in (0..width).step_by(LANES) {
        let [mx, my, squares, product] = moments.blur(simd, &weights, first / LANES);
        let ssim = Ssim::new(mx, my, squares, product);
        let count = LANES.min(width - first);
        sum += mask_tail(simd, ssim.value, count);
        for (row, value) in partial.iter_mut().zip(ssim.partials(mx, my)) {
            row[MARGIN + first..][..LANES].copy_from_slice(mask_tail(simd, value, count).as_slice());
        }
    }
    sum.iter().map(|&v| f64::from(v)).sum()
}

/// SSIM at 16 pixels and the factors that its derivatives share.
struct Ssim<S: Simd> {
    value: V<S>,
    numerator: [V<S>; 2],
    denominator: [V<S>; 2],
}

impl<S: Simd> Ssim<S> {
    #[inline(always)]
    fn new(mx: V<S>, my: V<S>, squares: V<S>, product: V<S>) -> Self {
        let (mxx, myy, mxy) = (mx * mx, my * my, mx * my);
        let numerator = [mxy * 2.0 + SSIM_C1, (product - mxy) * 2.0 + SSIM_C2];
        let denominator = [mxx + myy + SSIM_C1, (squares - (mxx + myy)) + SSIM_C2];
        let value = (numerator[0] * numerator[1]) / (denominator[0] * denominator[1]);
        Self { value, numerator, denominator }
    }

    /// By the raw moments `E[x]`, `E[x²]`, `E[xy]`.
    #[inline(always)]
    fn partials(&self, mx: V<S>, my: V<S>) -> [V<S>; 3] {
        let one = V::splat(mx.simd, 1.0);
        let inverse = one / (self.denominator[0] * self.denominator[1]);
        let by_variance = -(self.value / self.denominator[1]);
        let by_covariance = self.numerator[0] * inverse * 2.0;
        let direct = (my * self.numerator[1] * inverse - mx * self.value / self.denominator[0]) * 2.0;
        [direct - mx * by_variance * 2.0 - my * by_covariance, by_variance, by_covariance]
    }
}

#[inline(always)]
fn l1_row<S: Simd>(simd: S, x: &[f32], y: &[u8]) -> f64 {
    let mut sum = V::splat(simd, 0.0);
    for (x, y) in x.chunks(LANES).zip(y.chunks(LANES)) {
        sum += (load_part(simd, x) - load_bytes(simd, y)).abs();
    }
    sum.iter().map(|&v| f64::from(v)).sum()
}

#[inline(always)]
fn gradient_row<S: Simd>(
    simd: S,
    window: &[f32; TAPS],
    partials: &Ring<3>,
    y: isize,
    (render, photo): (&[f32], &[u8]),
    slope: L1Slope,
    out: &mut [f32],
) {
    let weights = by_slot(window, y);
    for first in (0..render.len()).step_by(LANES) {
        let [by_mean, by_square, by_product] = partials.blur(simd, &weights, first / LANES);
        let count = LANES.min(render.len() - first);
        let x = load_part(simd, &render[first..first + count]);
        let target = load_bytes(simd, &photo[first..first + count]);
        let structure = by_mean + x * by_square * 2.0 + target * by_product;
        let total = structure.mul_add(V::splat(simd, slope.ssim), slope.at(simd, x - target));
        out[first..first + count].copy_from_slice(&total.as_slice()[..count]);
    }
}
