//! [`EvolutionBackend`] for the CPU.

use std::borrow::Cow;

use genesplat_core::{
    BackendError, Blend, Contribution, EvolutionBackend, Gaussians, Image, RenderSettings, SparseDelta, ViewLoss,
    WindowAverages, backend::MomentPolicy,
};

use super::backend::{CpuBackend, TrainView};
use super::blend::contribution::{contribution, weigh};
use super::loss::{Target, loss};

impl EvolutionBackend for CpuBackend {
    fn score(
        &mut self,
        population: &[SparseDelta],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<f32>, BackendError> {
        self.ensure_scores(self.cloud.len(), population, views)?;
        let of_view = |view: usize| (self.views[view].camera, &self.views[view].target);
        Ok(self.scorer.score(self.level, &self.cloud, population, (views, views), of_view, settings))
    }

    fn apply(&mut self, delta: &SparseDelta, moments: MomentPolicy) -> Result<(), BackendError> {
        self.cloud.apply(delta);
        if moments == MomentPolicy::Zero {
            for moment in [&mut self.moments.first, &mut self.moments.second] {
                for &row in &delta.rows {
                    moment.set_genes(row as usize, &[0.0; 7]);
                }
            }
        }
        Ok(())
    }

    fn weigh(&mut self, view: usize, map: &[f32], settings: &RenderSettings) -> Result<Vec<f32>, BackendError> {
        self.ensure_contributions(&[view])?;
        let camera = &self.views[view].camera;
        Ok(weigh(self.level, &mut self.buffers, &self.cloud, camera, map, settings))
    }

    fn contributions(&mut self, views: &[usize], settings: &RenderSettings) -> Result<Vec<Contribution>, BackendError> {
        self.ensure_contributions(views)?;
        let mut contributions = vec![Contribution::default(); self.cloud.len()];
        for &view in views {
            let TrainView { camera, target } = &self.views[view];
            let view = (camera, target);
            contribution(self.level, &mut self.buffers, &self.cloud, view, settings, &mut contributions);
        }
        Ok(contributions)
    }

    fn average(&mut self, half: usize) -> Result<(), BackendError> {
        self.ensure_cloud("an average")?;
        self.averages.add(half, &self.cloud);
        Ok(())
    }

    fn measure(
        &mut self,
        blends: &[Blend],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<ViewLoss>, BackendError> {
        self.ensure_views(views)?;
        self.ensure_cloud("a blend")?;
        let mut losses = Vec::with_capacity(blends.len() * views.len());
        for blend in blends {
            let measured = blended(&self.averages, &self.cloud, blend);
            for &view in views {
                let TrainView { camera, target } = &self.views[view];
                self.buffers.render(self.level, &measured, camera, settings);
                target.hide(&mut self.buffers.image.planes);
                let loss = loss(self.level, &self.buffers.image, target, None);
                let errors = squared_errors(&self.buffers.image, target, 0);
                losses.push(ViewLoss { loss, squared_error: mean_squared_error(&errors, target) });
            }
        }
        Ok(losses)
    }

    fn blend(&mut self, blend: &Blend) -> Result<(), BackendError> {
        if *blend != Blend::default() {
            self.ensure_cloud("a blend")?;
            self.cloud = self.averages.blended(&self.cloud, blend);
        }
        self.averages = WindowAverages::default();
        Ok(())
    }
}

/// What `blend` makes of `cloud`; the cloud itself needs no copy.
pub(super) fn blended<'a>(averages: &WindowAverages, cloud: &'a Gaussians, blend: &Blend) -> Cow<'a, Gaussians> {
    match *blend == Blend::default() {
        true => Cow::Borrowed(cloud),
        false => Cow::Owned(averages.blended(cloud, blend)),
    }
}

/// Sums of `(I − P)²` of each row `[3, rows]`; `image` has the rows from `first` on.
pub fn squared_errors(image: &Image, target: &Target, first: usize) -> Vec<f64> {
    let (width, rows) = (target.width, image.height as usize);
    let photo =
        target.planes.chunks(width * target.height).flat_map(|plane| plane.chunks(width).skip(first).take(rows));
    let of_row = |(image, photo): (&[f32], &[u8])| {
        let square = |(&value, &level): (&f32, &u8)| (value - f32::from(level) * (1.0 / 255.0)).powi(2);
        f64::from(image.iter().zip(photo).map(square).sum::<f32>())
    };
    image.planes.chunks(width).zip(photo).map(of_row).collect()
}

/// Mean over all values that count, from the sums of all rows: their order does not depend on the machine.
pub fn mean_squared_error(errors: &[f64], target: &Target) -> f32 {
    (errors.iter().sum::<f64>() / (3 * target.counted()) as f64) as f32
}
