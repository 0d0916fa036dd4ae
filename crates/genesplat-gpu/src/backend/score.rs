//! Scores of a population: pools of individuals, as large as the device has memory for, on one view after the
//! other.

use genesplat_core::row_versions::Holders;
use genesplat_core::{BackendError, RenderSettings, SparseDelta};

use super::held::{GpuBackend, ListsOf};
use crate::Result;
use crate::device::{Grid, Memory, Recorder, shaders};
use crate::layout::{SLOTS, SPLAT_FLOATS, ViewPass};
use crate::stages::pixels::Needs;
use crate::stages::score::{Pool, PoolBuffers};
use crate::stages::tiles::rasterise_individuals;
use crate::state::window_uniform;

/// Bytes of the pictures of a pool: enough to keep a device busy, and small against the cloud itself.
const PICTURE_BYTES: u64 = 512 << 20;

impl GpuBackend {
    pub(crate) fn score_population(
        &mut self,
        population: &[SparseDelta],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<f32>> {
        let bytes = |&view: &usize| self.pass_of(view, settings).image_bytes();
        let largest = views.iter().map(bytes).max().unwrap_or(1);
        let fitting = PICTURE_BYTES.min(self.engine.binding_bytes) / largest.max(1);
        let each = individuals_of_a_pool(population.len(), fitting as usize);
        let mut losses = Vec::with_capacity(population.len() * views.len());
        for individuals in population.chunks(each) {
            self.score_pool(individuals, views, settings, &mut losses)?;
        }
        Ok(losses)
    }

    /// Appends the losses of some individuals, in two pools where one does not fit.
    fn score_pool(
        &mut self,
        individuals: &[SparseDelta],
        views: &[usize],
        settings: &RenderSettings,
        losses: &mut Vec<f32>,
    ) -> Result<()> {
        let is_full = |error: &BackendError| matches!(error, BackendError::OutOfMemory { .. });
        loop {
            match self.losses_of_pool(individuals, views, settings) {
                Ok(Some(found)) => {
                    losses.extend(found);
                    return Ok(());
                }
                // Steps and blends may hold what a pool needs.
                Err(error) if is_full(&error) && self.release_step_buffers()? => {}
                Err(error) if individuals.len() == 1 || !is_full(&error) => return Err(error),
                _ => break,
            }
        }
        // All that was made for it is larger than what half of it needs.
        self.pool_buffers.release();
        self.engine.wait()?;
        let (first, second) = individuals.split_at(individuals.len() / 2);
        self.score_pool(first, views, settings, losses)?;
        self.score_pool(second, views, settings, losses)
    }

    /// Losses `[P, V]` of some individuals, if their row versions can be seen at once; those of one always
    /// can.
    fn losses_of_pool(
        &mut self,
        individuals: &[SparseDelta],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Option<Vec<f32>>> {
        let visible = self.engine.binding_bytes / (4 * u64::from(SPLAT_FLOATS));
        let most = if individuals.len() == 1 { u64::MAX } else { visible };
        let Some(pool) = Pool::upload(&self.engine, &self.state.trained, individuals, most)? else {
            return Ok(None);
        };
        let count = u64::from(pool.individuals) * views.len() as u64;
        let losses = self.engine.allocate("losses", 8 * count)?;
        let values: Vec<[f32; 2]> =
            self.until_lists_fit(ListsOf::RowVersions, Some((&losses, count)), |gpu| {
                views.iter().enumerate().try_for_each(|(index, &view)| {
                    gpu.submit_pool(&pool, view, settings, [index, views.len()], &losses)
                })
            })?;
        Ok(Some(values.into_iter().map(|[loss, _]| loss).collect()))
    }

    fn submit_pool(
        &mut self,
        pool: &Pool,
        view: usize,
        settings: &RenderSettings,
        [view_index, views]: [usize; 2],
        losses: &Memory,
    ) -> Result<()> {
        let layers = pool.individuals;
        let pass = ViewPass { rows: pool.versions, layers, ..self.pass_of(view, settings) };
        let PoolBuffers { lists, pixels } = &mut self.pool_buffers;
        lists.reserve(&self.engine, &pass)?;
        pixels.reserve(&self.engine, &pass, Needs { loss: true, ..Needs::default() }, 0)?;
        let place = window_uniform(&self.engine, [0, layers], [view_index as u32, views as u32])?;
        lists.begin(&self.engine, &pass, None);

        let trained = self.state.trained.settled(&self.engine);
        let mut recorder = Recorder::new(&self.engine, self.timestamps.as_mut());
        lists.clear_tallies(&mut recorder, &pass);
        pool.record_project(&mut recorder, trained, lists);
        lists.record_bin(&mut recorder, &pass);

        recorder.stage("score_rasterise");
        let (intersections, splats) = (&lists.intersections, &lists.intersection_splats);
        let parts =
            [&lists.view, &lists.ranges, intersections, splats, &lists.splats, &pool.holders, &pixels.image];
        lists.run_tiles(&mut recorder, &pass, rasterise_individuals(layers), &parts);

        recorder.stage("score_loss");
        pixels.record_loss_sums(&mut recorder, lists, &self.views[view].photo, &pass, false);
        let parts = [&lists.view, &place, &pixels.loss_sums, losses].map(Memory::all);
        recorder.run(&shaders::VIEW_LOSSES, &parts, Grid::Exact([layers, 1, 1]));
        recorder.submit();
        Ok(())
    }
}

/// How many of a population share a pool, if the pictures of so many fit: whole workgroups where one fits.
fn individuals_of_a_pool(population: usize, fitting: usize) -> usize {
    let slots = SLOTS as usize;
    let fitting = fitting.clamp(1, Holders::BITS as usize);
    let most = if fitting < slots { fitting } else { fitting / slots * slots };
    let each = population.div_ceil(population.div_ceil(most).max(1)).max(1);
    if most < slots { each } else { each.next_multiple_of(slots) }
}

#[cfg(test)]
mod tests {
    use super::individuals_of_a_pool;

    #[test]
    fn pools_fit_and_fill_workgroups() {
        let each = |population, fitting| individuals_of_a_pool(population, fitting);
        assert_eq!([each(100, 1000), each(100, 50), each(100, 20), each(100, 9)], [112, 48, 16, 9]);
        assert_eq!([each(300, 1000), each(12, 1000), each(20, 9)], [112, 16, 7]);
        assert_eq!([each(100, 0), each(0, 1000)], [1, 16]);
    }
}
