//! 3DGS-MCMC's density control: dead Gaussians move to living ones, and a few more are added, up to a cap.
//!
//! A Gaussian that is *relocated* becomes a copy of a living one, drawn in proportion to opacity; one that is
//! *added* likewise. All `n` copies that then share a place get an opacity and a scale at which together they
//! render (nearly) like the one before. No gradient is looked at.
//! Reference: Kheradmand et al., "3D Gaussian Splatting as Markov Chain Monte Carlo", NeurIPS 2024, Eq. 9 and
//! appendix; constants of gsplat.

use genesplat_core::gaussians::sigmoid;
use genesplat_core::genes::opacity_logit;
use genesplat_core::rng::Draw;
use genesplat_core::{Genes, Origin, Rng, RowEdit, Stream};

use super::Plan;

/// At most this many copies are accounted for where they share a place (the authors' kernel has a table of
/// this size).
const SHARERS_MAX: u32 = 51;

/// Opacities stay this far below 1, where the logit would be infinite (f32's epsilon).
const OPAQUE_MARGIN: f64 = f32::EPSILON as f64;

/// What [`Stream::Relocation`] draws for.
const FOR_RELOCATION: u32 = 0;
const FOR_GROWTH: u32 = 1;

/// Thresholds of one event.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rules {
    /// Gaussians not more opaque than this are dead.
    pub(crate) min_opacity: f32,
    /// Fraction of the Gaussians that is added.
    pub(crate) growth: f64,
    /// Growth ends at this many; more that are there already stay.
    pub(crate) cap: usize,
}

/// A new row in the making.
#[derive(Clone, Copy)]
struct Row {
    source: u32,
    opacity: f64,
    log_scale_shift: f64,
    keeps_moments: bool,
    changed: bool,
}

/// Decides one event from the opacities in `genes` `[N, 7]`; `iteration` addresses the random draws.
///
/// Copies lie beside the row that they are of. Relocated Gaussians and their targets lose their moments;
/// added ones have none, and their targets keep theirs.
pub(crate) fn plan(genes: &[Genes], rules: &Rules, rng: Rng, iteration: u32) -> Plan {
    let mut rows: Vec<Row> =
        genes.iter().zip(0..).map(|(genes, row)| Row::kept(row, opacity_logit(genes))).collect();
    let relocated = relocate(&mut rows, rules, &rng, iteration);
    let cloned = grow(&mut rows, rules, &rng, iteration);
    rows.sort_by_key(|row| row.source);
    let mut edit = RowEdit::new(rng, iteration);
    rows.iter().for_each(|row| edit.push(row.source, row.origin()));
    Plan { relocated, cloned, ..Plan::of(edit) }
}

/// Moves dead rows to living ones; returns how many there were.
fn relocate(rows: &mut [Row], rules: &Rules, rng: &Rng, iteration: u32) -> usize {
    let is_dead = |row: &Row| row.opacity <= f64::from(rules.min_opacity);
    let dead: Vec<usize> = (0..rows.len()).filter(|&row| is_dead(&rows[row])).collect();
    let lottery = Lottery::new(rows.iter().map(|row| if is_dead(row) { 0.0 } else { row.opacity }));
    let targets =
        lottery.draw(dead.len(), |draw| rng.at(Stream::Relocation, iteration, draw, FOR_RELOCATION));
    share_places(rows, &targets, rules);
    for (&dead, &target) in dead.iter().zip(&targets) {
        rows[target].keeps_moments = false;
        rows[dead] = Row { changed: true, ..rows[target] };
    }
    targets.len()
}

/// Appends copies of rows; returns how many.
fn grow(rows: &mut Vec<Row>, rules: &Rules, rng: &Rng, iteration: u32) -> usize {
    let wanted = rows.len().saturating_add((rules.growth * rows.len() as f64) as usize);
    let added = wanted.min(rules.cap).saturating_sub(rows.len());
    let lottery = Lottery::new(rows.iter().map(|row| row.opacity));
    let targets = lottery.draw(added, |draw| rng.at(Stream::Relocation, iteration, draw, FOR_GROWTH));
    share_places(rows, &targets, rules);
    for &target in &targets {
        rows.push(Row { keeps_moments: false, ..rows[target] });
    }
    targets.len()
}

/// Every row that occurs `n` times among `targets` is to share its place with `n` others.
fn share_places(rows: &mut [Row], targets: &[usize], rules: &Rules) {
    let mut sharers = vec![1u32; rows.len()];
    targets.iter().for_each(|&target| sharers[target] += 1);
    for (row, sharers) in rows.iter_mut().zip(sharers).filter(|(_, sharers)| *sharers > 1) {
        let (opacity, scale) = shared(row.opacity, sharers.min(SHARERS_MAX));
        row.opacity = opacity.clamp(rules.min_opacity.into(), 1.0 - OPAQUE_MARGIN);
        row.log_scale_shift += scale.ln();
        row.changed = true;
    }
}

/// Opacity of each of `n` Gaussians at one place that together have the given one at their centre, and the
/// factor on their scales at which the sum along any line through the centre is that of the one they replace.
///
/// `o' = 1 − (1 − o)^(1/n)`, `s'/s = o / Σ_{j=1..n} C(n, j) (−1)^(j+1) o'^j / sqrt(j)`: the paper's double
/// sum over `i ≤ n` and `k < i`, whose binomials add up along `i`.
fn shared(opacity: f64, n: u32) -> (f64, f64) {
    let opacity = opacity.min(1.0 - OPAQUE_MARGIN);
    let each = 1.0 - (1.0 - opacity).powf(1.0 / f64::from(n));
    let (mut term, mut sum) = (-1.0, 0.0);
    for j in 1..=n {
        // C(n, j) (−1)^(j+1) o'^j, from that of j − 1.
        term *= -each * f64::from(n + 1 - j) / f64::from(j);
        sum += term / f64::from(j).sqrt();
    }
    (each, opacity / sum)
}

impl Row {
    fn kept(row: u32, opacity_logit: f32) -> Self {
        let opacity = f64::from(sigmoid(opacity_logit));
        Self { source: row, opacity, log_scale_shift: 0.0, keeps_moments: true, changed: false }
    }

    fn origin(&self) -> Origin {
        if !self.changed {
            return Origin::Kept;
        }
        Origin::Relocated {
            opacity_logit: (self.opacity / (1.0 - self.opacity)).ln() as f32,
            log_scale_shift: self.log_scale_shift as f32,
            keep_moments: self.keeps_moments,
        }
    }
}

/// Draws rows in proportion to their weights, with replacement.
struct Lottery {
    /// Sums of the weights up to and including each row.
    cumulative: Vec<f64>,
}

impl Lottery {
    fn new(weights: impl Iterator<Item = f64>) -> Self {
        let sums = weights.scan(0.0, |sum, weight| {
            *sum += weight;
            Some(*sum)
        });
        Self { cumulative: sums.collect() }
    }

    /// `count` rows; none where all weights are zero.
    fn draw(&self, count: usize, random: impl Fn(u32) -> Draw) -> Vec<usize> {
        let total = self.cumulative.last().copied().unwrap_or(0.0);
        if total <= 0.0 {
            return Vec::new();
        }
        (0..count as u32)
            .map(|index| {
                let ticket = f64::from(random(index).0[0]) / 4_294_967_296.0 * total;
                // The first row whose sum exceeds the ticket: never one of weight zero.
                self.cumulative.partition_point(|&sum| sum <= ticket)
            })
            .collect()
    }
}

#[cfg(test)]
mod tests;
