//! The gradients of the own splats, once every rank has summed those of the tiles that it has drawn.

use genesplat_kernels::cpu::ViewBuffers;
use genesplat_kernels::cpu::stages::{GradientRow, SplatGradients};

/// Where the gradients of each splat are, by its index. Most splats are drawn here and nowhere else: their
/// rows are summed when they are asked for.
#[derive(Debug, Default)]
pub(crate) struct Gradients {
    sources: Vec<Source>,
    sums: Vec<GradientRow>,
}

#[derive(Clone, Copy, Debug)]
enum Source {
    Nowhere,
    /// In the rows of a splat of the own band.
    Band(u32),
    /// Among the sums.
    Sum(u32),
}

impl Gradients {
    /// None yet, of so many splats.
    pub(crate) fn clear(&mut self, splats: usize) {
        self.sources.clear();
        self.sources.resize(splats, Source::Nowhere);
        self.sums.clear();
    }

    /// The next rows of a splat are those of one of the band.
    pub(crate) fn add_drawn(&mut self, splat: u32, drawn: usize, band: &ViewBuffers) {
        match &mut self.sources[splat as usize] {
            source @ Source::Nowhere => *source = Source::Band(drawn as u32),
            _ => {
                let sum = self.sum_mut(splat, band);
                band.gradient_rows_of(drawn).for_each(|row| sum.add(row));
            }
        }
    }

    /// The sum of a splat's rows, to which the next ones are added.
    pub(crate) fn sum_mut(&mut self, splat: u32, band: &ViewBuffers) -> &mut GradientRow {
        let source = &mut self.sources[splat as usize];
        let sum = match *source {
            Source::Sum(sum) => return &mut self.sums[sum as usize],
            Source::Band(drawn) => sum_of(drawn, band),
            Source::Nowhere => GradientRow::default(),
        };
        *source = Source::Sum(self.sums.len() as u32);
        self.sums.push_mut(sum)
    }

    /// All of them; `band` is the own one.
    pub(crate) fn of_splats<'a>(&'a self, band: &'a ViewBuffers) -> impl SplatGradients + 'a {
        OfSplats { gradients: self, band }
    }
}

fn sum_of(drawn: u32, band: &ViewBuffers) -> GradientRow {
    let mut sum = GradientRow::default();
    band.gradient_rows_of(drawn as usize).for_each(|row| sum.add(row));
    sum
}

struct OfSplats<'a> {
    gradients: &'a Gradients,
    band: &'a ViewBuffers,
}

impl SplatGradients for OfSplats<'_> {
    #[inline(always)]
    fn prefetch(&self, splat: usize) {
        if let Source::Band(drawn) = self.gradients.sources[splat] {
            self.band.prefetch_gradient_rows(drawn as usize);
        }
    }

    #[inline(always)]
    fn sum(&self, splat: usize) -> GradientRow {
        match self.gradients.sources[splat] {
            Source::Nowhere => GradientRow::default(),
            Source::Band(drawn) => sum_of(drawn, self.band),
            Source::Sum(sum) => self.gradients.sums[sum as usize],
        }
    }
}
