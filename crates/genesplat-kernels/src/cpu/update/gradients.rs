//! Where the gradient rows of a view are.

use genesplat_core::SplatSums;

use super::super::bin::Bins;
use super::super::blend::gradient_row::GradientRow;
use super::super::view::Splats;
use crate::cpu::simd::prefetch;

/// The gradient rows of the splats of a view, by index.
pub trait SplatGradients: Sync {
    /// Asks the machine to bring those of a splat near.
    fn prefetch(&self, splat: usize);

    /// Their sum, tile after tile.
    fn sum(&self, splat: usize) -> GradientRow;
}

/// As the backward blending leaves them: one row for each intersection.
pub(crate) struct ByTile<'a> {
    pub bins: &'a Bins,
    pub rows: &'a [GradientRow],
}

impl SplatGradients for ByTile<'_> {
    #[inline(always)]
    fn prefetch(&self, splat: usize) {
        for &place in self.bins.places_of(splat) {
            prefetch(&self.rows[place as usize]);
        }
    }

    #[inline(always)]
    fn sum(&self, splat: usize) -> GradientRow {
        let mut sum = GradientRow::default();
        for &place in self.bins.places_of(splat) {
            sum.add(&self.rows[place as usize]);
        }
        sum
    }
}

/// As another device leaves them: summed, by index.
pub(crate) struct BySplat(Vec<GradientRow>);

impl BySplat {
    /// Of splats in their order.
    pub(crate) fn new(splats: &Splats, sums: &[SplatSums]) -> Self {
        let mut rows = vec![GradientRow::default(); splats.capacity()];
        splats.iter().zip(sums).for_each(|((index, _), sums)| rows[index as usize] = sums.into());
        Self(rows)
    }
}

impl SplatGradients for BySplat {
    fn prefetch(&self, _: usize) {}

    #[inline(always)]
    fn sum(&self, splat: usize) -> GradientRow {
        self.0[splat]
    }
}
