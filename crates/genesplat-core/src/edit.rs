//! A change of the rows of a cloud, which the backend applies to parameters and moments.

use std::ops::Range;

use crate::covariance::world_offset;
use crate::gaussians::{Gaussians, Moments, logit, sigmoid};
use crate::rng::{Rng, Stream};
use crate::spherical_harmonics::SH_STRIDE;

/// How a new row is made from an old one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Origin {
    /// The same Gaussian; its moments are kept.
    Kept,
    /// An exact copy with fresh moments, as in the code released with 3DGS (its paper moves clones).
    Clone,
    /// One of two children, drawn from the parent's distribution, scales divided by 1.6, fresh moments.
    SplitChild {
        /// 0 or 1.
        child: u8,
    },
    /// Improved-GS: one of two that part along the longest axis and share it ([`LONG_AXIS_OFFSET`] and what
    /// follows it). Fresh moments.
    LongAxisChild {
        /// 0 or 1.
        child: u8,
    },
    /// MCMC: one of several copies that together render like the source; fresh moments unless `keep_moments`.
    Relocated {
        /// New opacity logit.
        opacity_logit: f32,
        /// Added to all three log-scales.
        log_scale_shift: f32,
        /// Keep the moments of the source row.
        keep_moments: bool,
    },
}

/// A list of new rows, each made from an old one.
#[derive(Clone, Debug, PartialEq)]
pub struct RowEdit {
    /// Old row of each new row.
    pub sources: Vec<u32>,
    /// How each new row is made.
    pub origins: Vec<Origin>,
    /// Streams of the run, which split children are drawn from.
    pub rng: Rng,
    /// Counter of that stream: the iteration.
    pub iteration: u32,
}

impl RowEdit {
    /// An empty plan of iteration `iteration`.
    pub fn new(rng: Rng, iteration: u32) -> Self {
        Self { sources: Vec::new(), origins: Vec::new(), rng, iteration }
    }

    /// Keeps `rows` and drops all others; nothing is drawn.
    pub fn keep(rows: Vec<u32>) -> Self {
        let origins = vec![Origin::Kept; rows.len()];
        Self { sources: rows, origins, rng: Rng::new(0), iteration: 0 }
    }

    /// True when the edit would change nothing in a cloud of `n` rows.
    pub fn is_identity(&self, n: usize) -> bool {
        self.sources.len() == n
            && self.origins.iter().all(|origin| *origin == Origin::Kept)
            && self.sources.iter().enumerate().all(|(row, &source)| row as u32 == source)
    }

    /// Appends a new row.
    pub fn push(&mut self, source: u32, origin: Origin) {
        self.sources.push(source);
        self.origins.push(origin);
    }

    /// The host's implementation, column by column, so that at most one exists twice.
    pub fn apply(&self, cloud: &mut Gaussians, moments: &mut Moments) {
        self.apply_to_cloud(cloud, |row| row as u32);
        let Moments { first, second, pending } = moments;
        for moment in [first, second, pending] {
            self.apply_to_moment(moment);
        }
    }

    /// `numbers` are those of the rows of `cloud` in the whole cloud.
    fn apply_to_cloud(&self, cloud: &mut Gaussians, numbers: impl Fn(usize) -> u32) {
        cloud.positions =
            self.rows().map(|(row, origin)| self.position(cloud, row, numbers(row), origin)).collect();
        cloud.log_scales =
            self.rows().map(|(row, origin)| new_log_scale(cloud.log_scales[row], origin)).collect();
        cloud.opacity_logits =
            self.rows().map(|(row, origin)| new_opacity(cloud.opacity_logits[row], origin)).collect();
        cloud.rotations = self.gather(&cloud.rotations);
        cloud.sh = self.gather(&cloud.sh);
        cloud.filter_3d = cloud.filter_3d.as_ref().map(|filter| self.gather(filter));
    }

    /// Of a moment, or of gradients that wait: nothing, or something of every row.
    fn apply_to_moment(&self, moment: &mut Gaussians) {
        if moment.is_empty() {
            return;
        }
        moment.positions = self.gather_kept(&moment.positions, [0.0; 3]);
        moment.log_scales = self.gather_kept(&moment.log_scales, [0.0; 3]);
        moment.opacity_logits = self.gather_kept(&moment.opacity_logits, 0.0);
        moment.rotations = self.gather_kept(&moment.rotations, [0.0; 4]);
        moment.sh = self.gather_kept(&moment.sh, [0.0; SH_STRIDE]);
    }

    /// What it takes to make some of the new rows.
    pub fn part(&self, new_rows: Range<usize>) -> EditPart {
        let sources = &self.sources[new_rows.clone()];
        let mut rows = sources.to_vec();
        rows.sort_unstable();
        rows.dedup();
        let place = |source: &u32| rows.partition_point(|row| row < source) as u32;
        let sources = sources.iter().map(place).collect();
        EditPart { edit: Self { sources, origins: self.origins[new_rows].to_vec(), ..*self }, rows }
    }

    /// A column whose new rows are copies of the old ones.
    pub fn gather<T: Copy>(&self, column: &[T]) -> Vec<T> {
        self.sources.iter().map(|&source| column[source as usize]).collect()
    }

    /// A column of moments: kept rows keep theirs, new rows start from `fresh`.
    fn gather_kept<T: Copy>(&self, column: &[T], fresh: T) -> Vec<T> {
        self.rows().map(|(row, origin)| if keeps_moments(origin) { column[row] } else { fresh }).collect()
    }

    fn rows(&self) -> impl Iterator<Item = (usize, Origin)> {
        self.sources.iter().zip(&self.origins).map(|(&source, &origin)| (source as usize, origin))
    }

    fn position(&self, cloud: &Gaussians, row: usize, number: u32, origin: Origin) -> [f32; 3] {
        let mean = cloud.positions[row];
        let offset_sigmas = match origin {
            Origin::SplitChild { child } => {
                let draw = self.rng.at(Stream::SplitOffset, self.iteration, number, u32::from(child));
                let ([a, b], [c, _]) = (draw.normals(0), draw.normals(1));
                [a, b, c]
            }
            Origin::LongAxisChild { child } => along_longest(cloud.log_scales[row], LONG_AXIS_OFFSET, child),
            _ => return mean,
        };
        let offset = world_offset(cloud.rotations[row], cloud.log_scales[row], offset_sigmas);
        std::array::from_fn(|axis| mean[axis] + offset[axis])
    }
}

/// A part of an edit, over the few old rows that it needs.
#[derive(Clone, Debug, PartialEq)]
pub struct EditPart {
    /// Numbers of these rows in the whole cloud, ascending.
    pub rows: Vec<u32>,
    edit: RowEdit,
}

impl EditPart {
    /// From a cloud of the old rows needed to one of the new rows.
    pub fn apply_to_cloud(&self, cloud: &mut Gaussians) {
        self.edit.apply_to_cloud(cloud, |row| self.rows[row]);
    }

    /// The same of a moment, or of gradients that wait, if there are any.
    pub fn apply_to_moment(&self, moment: &mut Gaussians) {
        self.edit.apply_to_moment(moment);
    }

    /// The same of a column whose new rows are copies of the old ones.
    pub fn gather<T: Copy>(&self, column: &[T]) -> Vec<T> {
        self.edit.gather(column)
    }
}

fn keeps_moments(origin: Origin) -> bool {
    matches!(origin, Origin::Kept | Origin::Relocated { keep_moments: true, .. })
}

/// Children are 1.6 times smaller (3DGS: `s / (0.8 · 2)`).
pub const SPLIT_SHRINK: f32 = 1.6;

/// How far the centre of a long-axis child is from its parent's, in standard deviations: 0.45 of three.
pub const LONG_AXIS_OFFSET: f32 = 0.45 * 3.0;

/// Factor on the axis that a long-axis split cuts.
pub const LONG_AXIS_SHRINK: f32 = 0.55;

/// Factor on the other two: `sqrt(1 − 0.45²)`, the width of the parent's ellipsoid where the children's
/// centres are.
pub const LONG_AXIS_WIDTH: f32 = 0.893_028_55;

/// Factor on the opacity.
pub const LONG_AXIS_OPACITY: f32 = 0.6;

/// What the opacity of a parent is taken to be at least, so that its children's have a logit.
pub const LONG_AXIS_OPACITY_MIN: f32 = 1e-30;

/// The longest axis, the first of equal ones.
fn longest(log_scale: [f32; 3]) -> usize {
    (1..3).fold(0, |best, axis| if log_scale[axis] > log_scale[best] { axis } else { best })
}

/// Along the longest axis; the two children go opposite ways.
fn along_longest(log_scale: [f32; 3], offset: f32, child: u8) -> [f32; 3] {
    let mut offsets = [0.0; 3];
    offsets[longest(log_scale)] = if child == 0 { offset } else { -offset };
    offsets
}

fn long_axis_scale(log_scale: [f32; 3]) -> [f32; 3] {
    let mut child = log_scale.map(|value| value + LONG_AXIS_WIDTH.ln());
    let cut = longest(log_scale);
    child[cut] = log_scale[cut] + LONG_AXIS_SHRINK.ln();
    child
}

fn long_axis_opacity(opacity_logit: f32) -> f32 {
    // A clamp, which keeps what is not a number.
    logit(LONG_AXIS_OPACITY * sigmoid(opacity_logit).clamp(LONG_AXIS_OPACITY_MIN, 1.0))
}

/// The log-scale that a new row gets from a row with this one.
pub fn new_log_scale(log_scale: [f32; 3], origin: Origin) -> [f32; 3] {
    match origin {
        Origin::SplitChild { .. } => log_scale.map(|value| (value.exp() / SPLIT_SHRINK).ln()),
        Origin::Relocated { log_scale_shift, .. } => log_scale.map(|value| value + log_scale_shift),
        Origin::LongAxisChild { .. } => long_axis_scale(log_scale),
        Origin::Kept | Origin::Clone => log_scale,
    }
}

fn new_opacity(opacity_logit: f32, origin: Origin) -> f32 {
    match origin {
        Origin::Relocated { opacity_logit, .. } => opacity_logit,
        Origin::LongAxisChild { .. } => long_axis_opacity(opacity_logit),
        _ => opacity_logit,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cloud() -> Gaussians {
        let mut cloud = Gaussians::zeros(3);
        for row in 0..3 {
            cloud.positions[row] = [row as f32, 0.0, 0.0];
            cloud.opacity_logits[row] = row as f32;
            cloud.sh[row][0] = row as f32;
        }
        cloud
    }

    #[test]
    fn kept_rows_keep_moments_and_new_rows_start_fresh() {
        let mut edit = RowEdit::new(Rng::new(1), 600);
        edit.push(2, Origin::Kept);
        edit.push(2, Origin::Clone);
        edit.push(0, Origin::SplitChild { child: 0 });
        edit.push(0, Origin::SplitChild { child: 1 });
        let (mut cloud, mut moments) = (cloud(), Moments::zeros(3));
        moments.first.opacity_logits = vec![1.0, 2.0, 3.0];
        edit.apply(&mut cloud, &mut moments);
        assert!(cloud.is_consistent());
        assert_eq!(cloud.opacity_logits, [2.0, 2.0, 0.0, 0.0]);
        assert_eq!(cloud.positions[1], cloud.positions[0], "a clone is not displaced");
        assert_ne!(cloud.positions[2], cloud.positions[3], "children are drawn independently");
        assert!((cloud.log_scales[2][0].exp() - 1.0 / 1.6).abs() < 1e-6);
        assert_eq!(moments.first.opacity_logits, [3.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn split_children_follow_the_parents_distribution() {
        let mut parent = Gaussians::zeros(1);
        parent.log_scales[0] = [2f32.ln(), 1f32.ln(), 0.5f32.ln()];
        let n = 4000u32;
        let (mut sums, mut products) = ([0.0f64; 3], [0.0f64; 3]);
        for iteration in 0..n {
            let mut edit = RowEdit::new(Rng::new(5), iteration);
            edit.push(0, Origin::SplitChild { child: 0 });
            let mut child = parent.clone();
            edit.apply(&mut child, &mut Moments::zeros(1));
            for axis in 0..3 {
                let [here, next] = [axis, (axis + 1) % 3].map(|axis| f64::from(child.positions[0][axis]));
                sums[axis] += here * here / f64::from(n);
                products[axis] += here * next / f64::from(n);
            }
        }
        for (axis, expected) in [4.0, 1.0, 0.25].into_iter().enumerate() {
            // Four standard errors of a variance estimate: 4 · sqrt(2/n) = 9 %.
            assert!((sums[axis] / expected - 1.0).abs() < 0.09, "axis {axis}: {}", sums[axis]);
        }
        for (axis, expected) in [2.0, 0.5, 1.0].into_iter().enumerate() {
            assert!((products[axis] / expected).abs() < 0.07, "axis {axis} and the next: {}", products[axis]);
        }
    }

    /// By hand: half the opacity becomes 0.3; of axes 1, 4, 2 the middle one is cut, 1.35 x 4 to both sides.
    #[test]
    fn a_long_axis_split_parts_its_children_along_the_axis_that_it_cuts() {
        let mut cloud = Gaussians::zeros(1);
        (cloud.positions[0], cloud.log_scales[0]) = ([1.0, 2.0, 3.0], [1f32, 4.0, 2.0].map(f32::ln));
        // A quarter turn about z: y of the Gaussian is -x of the world.
        cloud.rotations[0] = [std::f32::consts::FRAC_1_SQRT_2, 0.0, 0.0, std::f32::consts::FRAC_1_SQRT_2];
        cloud.sh[0][7] = 0.25;
        let parent = cloud.clone();
        let mut edit = RowEdit::new(Rng::new(1), 0);
        (0..2).for_each(|child| edit.push(0, Origin::LongAxisChild { child }));
        let mut moments = Moments::zeros(1);
        moments.first.opacity_logits[0] = 1.0;
        moments.pending = parent.clone();
        edit.apply(&mut cloud, &mut moments);
        let close = |a: f32, b: f32| (a - b).abs() < 1e-5;
        for (row, x) in [(0, 1.0 - 5.4), (1, 1.0 + 5.4)] {
            assert!(
                close(cloud.positions[row][0], x) && close(cloud.positions[row][1], 2.0),
                "{:?}",
                cloud.positions
            );
            let scale = cloud.log_scales[row].map(f32::exp);
            assert!(
                [0.893_028_6, 2.2, 1.786_057_1].iter().zip(scale).all(|(&a, b)| close(a, b)),
                "{scale:?}"
            );
            assert!(close(sigmoid(cloud.opacity_logits[row]), 0.3));
            assert_eq!((cloud.rotations[row], cloud.sh[row]), (parent.rotations[0], parent.sh[0]));
        }
        assert_eq!(
            (moments.first.opacity_logits, moments.pending.sh),
            (vec![0.0; 2], vec![[0.0; SH_STRIDE]; 2])
        );
        assert!((LONG_AXIS_WIDTH - (1.0 - 0.45f32.powi(2)).sqrt()).abs() < 1e-7);
        for opacity_logit in [-200.0, -20.0, 200.0] {
            assert!(long_axis_opacity(opacity_logit).is_finite(), "{opacity_logit}");
        }
    }

    #[test]
    fn parts_make_the_rows_of_the_whole() {
        let mut edit = RowEdit::new(Rng::new(3), 700);
        edit.push(2, Origin::Kept);
        edit.push(2, Origin::SplitChild { child: 1 });
        edit.push(0, Origin::SplitChild { child: 0 });
        edit.push(1, Origin::LongAxisChild { child: 1 });
        let (mut whole, mut moments) = (cloud(), Moments::zeros(3));
        moments.first = cloud();
        edit.apply(&mut whole, &mut moments);
        let mut joined = [Gaussians::default(), Gaussians::default()];
        for range in [0..2, 2..2, 2..4] {
            let part = edit.part(range);
            let mut of_part = [cloud().gather(&part.rows), cloud().gather(&part.rows)];
            part.apply_to_cloud(&mut of_part[0]);
            part.apply_to_moment(&mut of_part[1]);
            joined.iter_mut().zip(of_part).for_each(|(joined, part)| joined.append(part));
        }
        assert_eq!(joined, [whole, moments.first]);
    }

    #[test]
    fn pending_gradients_go_with_the_rows_that_are_kept() {
        let (mut cloud, mut moments) = (cloud(), Moments::zeros(3));
        RowEdit::keep(vec![2, 0]).apply(&mut cloud, &mut moments);
        assert!(moments.pending.is_empty(), "none there, none made");
        moments.pending = cloud.clone();
        let mut edit = RowEdit::keep(vec![1, 0]);
        edit.push(0, Origin::Clone);
        edit.apply(&mut cloud, &mut moments);
        assert_eq!(moments.pending.opacity_logits, [0.0, 2.0, 0.0]);
    }

    #[test]
    fn identity_is_recognised() {
        assert!(RowEdit::keep(vec![0, 1, 2]).is_identity(3));
        assert!(!RowEdit::keep(vec![0, 2, 1]).is_identity(3));
        assert!(!RowEdit::keep(vec![0, 1]).is_identity(3));
    }
}
