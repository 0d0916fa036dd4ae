//! Stage `score`: Eq. 5 of a whole population over a set of views, forward only.
//!
//! A pool of individuals is uploaded as [row versions](genesplat_core::row_versions): to a view these are the rows of
//! one large cloud, projected, sorted and listed by tile once for all individuals. A workgroup then makes the pictures
//! of sixteen individuals in one tile: an alpha is evaluated once, and blended for those that hold it.

use genesplat_core::row_versions::{Holders, RowVersion, pieces_of, row_versions};
use genesplat_core::{BackendError, RenderSettings, SparseDelta};
use rayon::prelude::*;

use crate::Result;
use crate::backend::GpuBackend;
use crate::device::{Engine, Grid, Memory, Recorder, shaders};
use crate::queue::ListsOf;
use crate::stages::lists::Lists;
use crate::stages::pixels::{Needs, Pixels};
use crate::stages::tiles::rasterise_individuals;
use crate::state::layout::{OWN_GENES, SLOTS, SPLAT_FLOATS, ViewPass};
use crate::state::{RowWindow, Settled, Trained, pack_genes, window_uniform};

/// Bytes of the pictures of a pool: enough to keep a device busy, and small against the cloud itself.
const PICTURE_BYTES: u64 = 512 << 20;

/// Buffers of the views of a pool, kept from call to call.
pub(crate) struct PoolBuffers {
    /// Tile lists of the row versions.
    pub(crate) lists: Lists,
    /// Pictures and sums of the loss, one layer an individual.
    pixels: Pixels,
}

impl PoolBuffers {
    pub(crate) fn new(engine: &Engine) -> Result<Self> {
        Ok(Self { lists: Lists::new(engine, 4)?, pixels: Pixels::new(engine)? })
    }

    /// Frees everything until it is reserved anew, for what may be fewer individuals.
    pub(crate) fn release(&mut self) {
        self.lists.release();
        self.lists.wanted_capacity = None;
        self.pixels.release();
    }
}

struct Pool {
    individuals: u32,
    versions: u32,
    /// Row of each version, and where its genes are `[K, 2]`; row by row.
    places: Memory,
    /// Genes that are not the cloud's: position, opacity logit; log-scales, nothing.
    genes: Memory,
    /// A bit for each individual `[K, 4]`.
    holders: Memory,
    /// For each window of rows: its rows and their versions, as a kernel reads them, and the number of those versions.
    windows: Vec<(Memory, u64)>,
}

impl Pool {
    /// The row versions of `individuals`; nothing where they are more than `most`.
    fn upload(engine: &Engine, cloud: &Trained, individuals: &[SparseDelta], most: u64) -> Result<Option<Self>> {
        let pieces: Vec<_> = pieces_of(cloud.rows() as usize).collect();
        let of_piece = |rows| row_versions(individuals, rows);
        let versions: Vec<_> = pieces.into_par_iter().flat_map_iter(of_piece).collect();
        if versions.len() as u64 > most {
            return Ok(None);
        }
        let mut genes = Vec::new();
        let place = |version: &RowVersion| {
            let at = version.genes.map_or(OWN_GENES, |_| genes.len() as u32);
            genes.extend(version.genes.map(pack_genes));
            [version.row, at]
        };
        let places: Vec<[u32; 2]> = versions.iter().map(place).collect();
        let holders: Vec<Holders> = versions.iter().map(|version| version.holders.to_le()).collect();
        let of_window = |window: &RowWindow| {
            let until = |row: u64| versions.partition_point(|version| u64::from(version.row) < row) as u32;
            let [first, end] = [window.first, window.first + window.count].map(until);
            Ok((window_uniform(engine, window.range(), [first, end - first])?, u64::from(end - first)))
        };
        Ok(Some(Self {
            individuals: individuals.len() as u32,
            versions: versions.len() as u32,
            places: engine.upload("rows of row versions", &places)?,
            genes: engine.upload("genes of row versions", &genes)?,
            holders: engine.upload("holders of row versions", &holders)?,
            windows: cloud.windows().iter().map(of_window).collect::<Result<_>>()?,
        }))
    }

    /// Stage `project` of the row versions.
    fn record_project(&self, recorder: &mut Recorder, trained: &Settled, lists: &Lists) {
        recorder.stage("score_project");
        let outputs = [&lists.splats, &lists.depths, &lists.tile_counts, &lists.flags].map(Memory::all);
        for (window, (uniform, count)) in trained.windows.iter().zip(&self.windows) {
            let cloud = [trained.cloud.geometry.at(window), trained.cloud.sh.at(window)];
            let inputs = [lists.view.all(), uniform.all()];
            let parts = [&inputs[..], &cloud, &[self.places.all(), self.genes.all()], &outputs].concat();
            recorder.run(&shaders::PROJECT_ROW_VERSIONS, &parts, Grid::Items(*count));
        }
    }
}

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

    /// Losses `[P, V]` of some individuals, if their row versions can be seen at once; those of one always can.
    fn losses_of_pool(
        &mut self,
        individuals: &[SparseDelta],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Option<Vec<f32>>> {
        let visible = self.engine.binding_bytes / (4 * u64::from(SPLAT_FLOATS));
        let most = if individuals.len() == 1 { u64::MAX } else { visible };
        let Some(pool) = Pool::upload(&self.engine, &self.state.trained, individuals, most)? else { return Ok(None) };
        let count = u64::from(pool.individuals) * views.len() as u64;
        let losses = self.engine.allocate("losses", 8 * count)?;
        let values: Vec<[f32; 2]> = self.until_lists_fit(ListsOf::RowVersions, Some((&losses, count)), |gpu| {
            views
                .iter()
                .enumerate()
                .try_for_each(|(index, &view)| gpu.submit_pool(&pool, view, settings, [index, views.len()], &losses))
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
        pixels.reserve(&self.engine, &pass, Needs { loss: true, gradient: false }, 0)?;
        let place = window_uniform(&self.engine, [0, layers], [view_index as u32, views as u32])?;
        lists.begin(&self.engine, &pass, None);

        let trained = self.state.trained.settled(&self.engine);
        let mut recorder = Recorder::new(&self.engine, self.timestamps.as_mut());
        lists.clear_ranges(&mut recorder, &pass);
        pool.record_project(&mut recorder, trained, lists);
        lists.record_bin(&mut recorder, &pass);

        recorder.stage("score_rasterise");
        let (intersections, splats) = (lists.sorted_intersections(&pass), &lists.intersection_splats);
        let parts = [&lists.view, &lists.ranges, intersections, splats, &lists.splats, &pool.holders, &pixels.image];
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
