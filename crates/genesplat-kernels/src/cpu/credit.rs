//! Stage `credit`: which Gaussians the changes that mutants make are owed to ([`genesplat_core::credit`]).
//!
//! The backward blending sums `α·T · dL/dpixel` for every splat and channel, as the gradient of its colour. With a mutant's
//! changes of the error in the place of a channel's gradient it sums what is asked for here, for three mutants at once.

use fearless_simd::Level;
use genesplat_core::{Credits, Gaussians, RenderSettings, SparseDelta};

use super::frame::Frame;
use super::loss::Target;
use super::project::Pinhole;
use super::rasterise_backward::{self, Backward, Extra, column};
use super::weigh::add_errors;

/// Mutants of one backward pass: one a channel.
const AT_ONCE: usize = 3;

/// Where mutants are rendered.
pub struct Mutants<'a> {
    base: &'a Gaussians,
    mutants: &'a [SparseDelta],
    /// The base, but for the time in which a mutant is rendered.
    cloud: Gaussians,
    frame: Frame,
}

impl<'a> Mutants<'a> {
    /// Mutants of `base`.
    pub fn new(base: &'a Gaussians, mutants: &'a [SparseDelta]) -> Self {
        Self { base, mutants, cloud: base.clone(), frame: Frame::default() }
    }

    fn render(&mut self, level: Level, mutant: usize, camera: &Pinhole, settings: &RenderSettings) {
        let mutant = &self.mutants[mutant];
        self.cloud.apply(mutant);
        self.frame.render(level, &self.cloud, camera, settings);
        self.cloud.apply(&self.base.genes_of(&mutant.rows));
    }
}

/// Adds one view to `credits`.
pub fn credit(
    level: Level,
    base: &mut Frame,
    mutants: &mut Mutants,
    (camera, target): (&Pinhole, &Target),
    settings: &RenderSettings,
    credits: &mut Credits,
) {
    // 1. The base, and which Gaussians the view shows.
    base.render(level, mutants.base, camera, settings);
    let Frame { splats, bins, image, gradient, rows, .. } = base;
    let global = |splat: u32| splats.get(splat).global as usize;
    let mut shown = vec![0; credits.views.len()];
    bins.entries.iter().for_each(|entry| shown[global(entry.splat)] = 1);
    credits.views.iter_mut().zip(shown).for_each(|(views, shown)| *views += shown);
    let plane = image.planes.len() / 3;
    let mut minus_base = vec![0.0; plane];
    add_errors(image, target, -1.0, &mut minus_base);
    for (batch, changes) in credits.changes.chunks_mut(AT_ONCE).enumerate() {
        // 2. By how much each mutant's error is above the base's, pixel by pixel, a mutant a channel.
        gradient.clear();
        gradient.resize(3 * plane, 0.0);
        for (channel, change) in gradient.chunks_exact_mut(plane).take(changes.len()).enumerate() {
            mutants.render(level, AT_ONCE * batch + channel, camera, settings);
            change.copy_from_slice(&minus_base);
            add_errors(&mutants.frame.image, target, 1.0, change);
        }
        // 3. Every Gaussian gets its share of it.
        let inputs = Backward { splats, image, gradient, extra: Extra::None };
        rasterise_backward::backward(level, bins, camera, &inputs, rows);
        for (entry, row) in bins.entries.iter().zip(rows.iter()) {
            for (channel, change) in changes.iter_mut().enumerate() {
                change[global(entry.splat)] += row.0[column::RED + channel];
            }
        }
    }
}
