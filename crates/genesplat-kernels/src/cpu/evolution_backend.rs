//! [`EvolutionBackend`] for the CPU.

use std::ops::Range;

use genesplat_core::{
    Backend, BackendError, Contribution, EvolutionBackend, Held, Image, RenderSettings, RowEdit, SparseDelta,
    StateMean, ViewLoss,
    backend::{MomentPolicy, NO_SNAPSHOT},
};

use super::backend::{CpuBackend, TrainView};
use super::blend::contribution::{contribution, weigh};
use super::loss::{PhotoRows, Target, loss};

impl EvolutionBackend for CpuBackend {
    fn score(
        &mut self,
        population: &[SparseDelta],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<f32>, BackendError> {
        self.ensure_scores(self.gaussian_count(), population, views)?;
        let of_view = |view: usize| (self.views[view].camera, &self.views[view].target);
        let cloud = self.trained.cloud(self.level);
        Ok(self.scorer.score(self.level, cloud, population, (views, views), of_view, settings)?)
    }

    fn apply(&mut self, delta: &SparseDelta, moments: MomentPolicy) -> Result<(), BackendError> {
        let (cloud, held) = self.trained.settled(self.level);
        cloud.apply(delta);
        if moments == MomentPolicy::Zero {
            for moment in [&mut held.first, &mut held.second] {
                for &row in &delta.rows {
                    moment.set_genes(row as usize, &[0.0; 7]);
                }
            }
        }
        Ok(())
    }

    fn weigh(
        &mut self,
        views: &[usize],
        map_of: &dyn Fn(usize) -> Result<Vec<f32>, BackendError>,
        settings: &RenderSettings,
    ) -> Result<Vec<Vec<f32>>, BackendError> {
        self.ensure_views(views)?;
        self.ensure_weights(views.len())?;
        let cloud = self.trained.cloud(self.level);
        let of_view = |&view: &usize| {
            let camera = &self.views[view].camera;
            Ok(weigh(self.level, &mut self.buffers, cloud, camera, &map_of(view)?, settings))
        };
        views.iter().map(of_view).collect()
    }

    fn contributions(&mut self, views: &[usize], settings: &RenderSettings) -> Result<Vec<Contribution>, BackendError> {
        self.ensure_contributions(views)?;
        let cloud = self.trained.cloud(self.level);
        let mut contributions = vec![Contribution::default(); cloud.len()];
        for &view in views {
            let TrainView { camera, target } = &self.views[view];
            let view = (camera, target);
            contribution(self.level, &mut self.buffers, cloud, view, settings, &mut contributions)?;
        }
        Ok(contributions)
    }

    fn add_to_mean(&mut self) -> Result<(), BackendError> {
        self.ensure_cloud("a mean")?;
        self.mean.add(self.trained.cloud(self.level));
        Ok(())
    }

    fn measure(
        &mut self,
        held: Held,
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<ViewLoss>, BackendError> {
        self.ensure_views(views)?;
        self.ensure_look(held)?;
        let (cloud, buffers) = (self.mean.look(self.trained.cloud(self.level), held), &mut self.buffers);
        let of_view = |&view: &usize| {
            let TrainView { camera, target } = &self.views[view];
            buffers.render(self.level, &cloud, camera, settings);
            buffers.photo.read(target, 0..target.height)?;
            target.hide(&mut buffers.image.planes);
            let loss = loss(self.level, &buffers.image, &buffers.photo, None);
            let errors = squared_errors(&buffers.image, &buffers.photo, 0..target.height);
            Ok(ViewLoss { loss, squared_error: mean_squared_error(&errors, target) })
        };
        views.iter().map(of_view).collect()
    }

    fn take_mean(&mut self) -> Result<(), BackendError> {
        let (mean, cloud) = (std::mem::take(&mut self.mean), self.trained.cloud(self.level));
        *cloud = mean.in_place_of(std::mem::take(cloud));
        Ok(())
    }

    fn drop_mean(&mut self) {
        self.mean = StateMean::default();
    }

    fn edit_rows_on_trial(&mut self, edit: &RowEdit) -> Result<(), BackendError> {
        self.ensure_snapshot()?;
        let snapshot = self.snapshot();
        self.edit_rows(edit)?;
        self.keep(snapshot);
        Ok(())
    }

    fn roll_back(&mut self) -> Result<(), BackendError> {
        self.ensure_roll_back()?;
        let snapshot = self.snapshot.take().expect(NO_SNAPSHOT);
        self.put_state(snapshot.into());
        Ok(())
    }

    fn drop_snapshot(&mut self) {
        self.snapshot = None;
    }
}

/// Sums of `(I − P)²` of each row `[3, rows]`, which are all that `image` has.
pub fn squared_errors(image: &Image, photo: &PhotoRows, rows: Range<usize>) -> Vec<f64> {
    let width = image.width as usize;
    let photo = (0..3).flat_map(|channel| photo.plane(channel, &rows).chunks(width));
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
