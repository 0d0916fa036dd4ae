//! [`EvolutionBackend`] for the CPU.

use genesplat_core::{
    BackendError, Blend, Contribution, EvolutionBackend, Image, RenderSettings, SparseDelta, ViewLoss, WindowAverages,
    backend::MomentPolicy,
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
        self.ensure_scores(population, views)?;
        let of_view = |view: usize| (self.views[view].camera, &self.views[view].target);
        Ok(self.scorer.score(self.level, &self.cloud, population, views, of_view, settings))
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
            // The cloud itself needs no copy.
            let blended;
            let measured = if *blend == Blend::default() {
                &self.cloud
            } else {
                blended = self.averages.blended(&self.cloud, blend);
                &blended
            };
            for &view in views {
                let TrainView { camera, target } = &self.views[view];
                self.buffers.render(self.level, measured, camera, settings);
                target.hide(&mut self.buffers.image.planes);
                let loss = loss(self.level, &self.buffers.image, target, None);
                losses.push(ViewLoss { loss, squared_error: squared_error(&self.buffers.image, target) });
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

/// Mean of `(I − P)²` over all values that count, summed row by row of a channel: the order does not depend on the machine.
fn squared_error(image: &Image, target: &Target) -> f32 {
    let rows = image.planes.chunks(target.width).zip(target.planes.chunks(target.width));
    let of_row = |(image, photo): (&[f32], &[u8])| {
        let square = |(&value, &level): (&f32, &u8)| (value - f32::from(level) * (1.0 / 255.0)).powi(2);
        f64::from(image.iter().zip(photo).map(square).sum::<f32>())
    };
    (rows.map(of_row).sum::<f64>() / (3 * target.counted()) as f64) as f32
}
