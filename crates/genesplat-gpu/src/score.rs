//! Stage `score`: Eq. 5 of a whole population over a set of views, forward only.
//!
//! Individuals are uploaded as what they change. The base's projection, colours, order and tile lists are made once a view.
//! A batch of individuals then costs the projection and the lists of the changed Gaussians, all individuals at once (each
//! has a layer of tiles of its own, so that one sort serves all); the tiles that they change; and the losses, which are
//! reduced on the device. The host waits once, for all losses.

use std::ops::Range;

use genesplat_core::{BackendError, RenderSettings, SparseDelta};

use crate::backend::GpuBackend;
use crate::cloud::{pack_gene, window_uniform};
use crate::engine::{Engine, Memory};
use crate::frame::frame_of;
use crate::layout::{Counters, Frame};
use crate::lists::{Lists, tiles_of};
use crate::pixels::{image_bytes, loss_sum_bytes, tile_grid};
use crate::recorder::{Grid, Recorder};
use crate::shaders;

/// Bytes of the pictures of a batch: enough to keep a device busy, and small against the cloud itself.
const PICTURE_BYTES: u64 = 512 << 20;
/// Changed Gaussians of a batch.
const ITEMS: usize = 2 << 20;
/// Individuals of a batch.
const LAYERS: usize = 256;
/// Tile entries that there is room for at first, a changed Gaussian.
const FIRST_ENTRIES: u64 = 6;

/// Buffers of a batch of individuals, kept from call to call.
pub struct Scratch {
    /// Tile lists of the changed Gaussians, one set of tiles a layer.
    added: Lists,
    /// A bit a row of the base `[layers, words]`.
    removed: Memory,
    /// Tiles that an individual changes `[layers, tiles]`.
    dirty: Memory,
    /// Pictures `[layers, 3, H, W]`.
    images: Memory,
    /// Sums of the loss `[layers, 3, tiles, 4]`.
    sums: Memory,
    /// Bound where the loss would leave its derivatives.
    unused: Memory,
    /// Room for tile entries that was found to be needed.
    entry_room: u64,
}

impl Scratch {
    pub(crate) fn new(engine: &Engine) -> Result<Self, BackendError> {
        Ok(Self {
            added: Lists::new(engine)?,
            removed: engine.allocate("rows that individuals change", 0)?,
            dirty: engine.allocate("tiles that individuals change", 0)?,
            images: engine.allocate("pictures of individuals", 0)?,
            sums: engine.allocate("the sums of the losses", 0)?,
            unused: engine.allocate("nothing", 0)?,
            entry_room: 0,
        })
    }

    /// Gives everything back until it is reserved anew.
    pub(crate) fn release(&mut self) {
        self.added.release();
        let Self { removed, dirty, images, sums, .. } = self;
        [removed, dirty, images, sums].into_iter().for_each(Memory::release);
    }

    fn reserve(
        &mut self,
        engine: &Engine,
        base_rows: u64,
        items: u64,
        frame: &Frame,
    ) -> Result<(), BackendError> {
        let layers = u64::from(frame.layers);
        let entries = self.entry_room.max(FIRST_ENTRIES * items);
        self.added.reserve(engine, items, entries, tiles_of(frame))?;
        engine.reserve(&mut self.removed, removed_bytes(base_rows, layers))?;
        engine.reserve(&mut self.dirty, 4 * tiles_of(frame))?;
        engine.reserve(&mut self.images, layers * image_bytes(frame))?;
        engine.reserve(&mut self.sums, loss_sum_bytes(frame))
    }
}

fn removed_bytes(base_rows: u64, layers: u64) -> u64 {
    4 * base_rows.div_ceil(32) * layers
}

/// Some individuals that are rendered at once.
struct Batch {
    individuals: Range<usize>,
    items: Range<usize>,
}

/// A population on the device.
struct Population {
    /// Row and layer of each changed Gaussian.
    items: Memory,
    /// Its genes: position, opacity logit; log-scales, nothing.
    genes: Memory,
    batches: Vec<Batch>,
    individuals: usize,
}

impl Population {
    fn upload(engine: &Engine, population: &[SparseDelta], layers: usize) -> Result<Self, BackendError> {
        let batches = batches(population, layers);
        let mut items: Vec<[u32; 2]> = Vec::new();
        let mut genes = Vec::new();
        for batch in &batches {
            for (layer, individual) in (0..).zip(&population[batch.individuals.clone()]) {
                items.extend(individual.rows.iter().map(|&row| [row, layer]));
                genes.extend(individual.genes.iter().map(pack_gene));
            }
        }
        let genes = engine.upload("genes of a population", &genes)?;
        Ok(Self {
            items: engine.upload("rows of a population", &items)?,
            genes,
            batches,
            individuals: population.len(),
        })
    }
}

/// Cuts a population in batches of at most `layers` individuals and about [`ITEMS`] changed Gaussians.
fn batches(population: &[SparseDelta], layers: usize) -> Vec<Batch> {
    let mut batches: Vec<Batch> = Vec::new();
    for (index, individual) in population.iter().enumerate() {
        let changed = individual.rows.len();
        match batches.last_mut() {
            Some(batch) if batch.individuals.len() < layers && batch.items.len() + changed <= ITEMS => {
                batch.individuals.end = index + 1;
                batch.items.end += changed;
            }
            last => {
                let first = last.map_or(0, |batch| batch.items.end);
                batches.push(Batch { individuals: index..index + 1, items: first..first + changed });
            }
        }
    }
    batches
}

impl GpuBackend {
    /// Losses `[P, V]`.
    pub(crate) fn score_population(
        &mut self,
        population: &[SparseDelta],
        views: &[usize],
        settings: &RenderSettings,
    ) -> Result<Vec<f32>, BackendError> {
        let largest =
            views.iter().map(|&view| image_bytes(&self.frame_of_view(view, settings))).max().unwrap_or(1);
        let fitting = PICTURE_BYTES.min(self.engine.binding_bytes) / largest.max(1);
        let population = Population::upload(&self.engine, population, (fitting as usize).clamp(1, LAYERS))?;
        let mut judgements = vec![[0f32; 2]; population.individuals * views.len()];
        let losses = self.engine.allocate("losses", 8 * judgements.len() as u64)?;
        loop {
            for (index, &view) in views.iter().enumerate() {
                let base = self.frame_of_view(view, settings);
                self.submit_image(&base)?;
                for batch in &population.batches {
                    self.submit_batch(&population, batch, &base, view, [index, views.len()], &losses)?;
                }
            }
            let [mut base, mut added] = [Counters::default(); 2];
            self.engine.read([
                (&losses, bytemuck::cast_slice_mut(&mut judgements)),
                (&self.lists.counters, bytemuck::bytes_of_mut(&mut base)),
                (&self.scratch.added.counters, bytemuck::bytes_of_mut(&mut added)),
            ])?;
            self.clear_counters();
            self.engine.write(&self.scratch.added.counters, 0, &[Counters::default()]);
            if base.halted == 0 && added.halted == 0 {
                return Ok(judgements.into_iter().map(|[loss, _]| loss).collect());
            }
            if base.halted != 0 {
                self.grow(base.wanted)?;
            }
            let wanted = u64::from(added.wanted);
            self.scratch.entry_room = self.scratch.entry_room.max(wanted + wanted / 4);
        }
    }

    fn frame_of_view(&self, view: usize, settings: &RenderSettings) -> Frame {
        frame_of(&self.views[view].camera, settings, self.state.rows)
    }

    /// Losses of a batch of individuals on one view.
    fn submit_batch(
        &mut self,
        population: &Population,
        batch: &Batch,
        base: &Frame,
        view: usize,
        [view_index, views]: [usize; 2],
        losses: &Memory,
    ) -> Result<(), BackendError> {
        let (items, layers) = (batch.items.len(), batch.individuals.len() as u32);
        let frame = Frame { rows: items as u32, layers, ..*base };
        self.scratch.reserve(&self.engine, self.state.rows, items as u64, &frame)?;
        let (engine, state, scratch) = (&self.engine, &self.state, &self.scratch);
        let (added, item_range) = (&scratch.added, [batch.items.start as u32, items as u32]);
        added.begin(engine, &frame);

        let mut recorder = Recorder::new(engine, self.timestamps.as_mut());
        recorder.clear(&scratch.removed, removed_bytes(state.rows, layers.into()));
        recorder.clear(&scratch.dirty, 4 * tiles_of(&frame));
        recorder.stage("score_project");
        for window in &state.windows {
            let uniform = window_uniform(engine, window.range(), item_range)?;
            let parts = [
                added.frame.all(),
                uniform.all(),
                state.cloud.geometry.at(window),
                state.cloud.sh.at(window),
                population.items.all(),
                population.genes.all(),
                added.splats.all(),
                added.depths.all(),
                added.tile_counts.all(),
                added.marks.all(),
            ];
            recorder.run(&shaders::SCORE_PROJECT, &parts, Grid::Items(items as u64));
        }
        let uniform_of_all = window_uniform(engine, [0, state.rows as u32], item_range)?;
        let parts = [
            &added.frame,
            &uniform_of_all,
            &population.items,
            &self.lists.tile_counts,
            &self.lists.splats,
            &added.tile_counts,
            &added.splats,
            &scratch.removed,
            &scratch.dirty,
        ];
        recorder.run(&shaders::SCORE_MARK, &parts.map(Memory::all), Grid::Items(items as u64));
        added.record_bin(&mut recorder, &frame);

        recorder.stage("score_rasterise");
        let parts = [
            &added.frame,
            &uniform_of_all,
            &population.items,
            &self.lists.ranges,
            self.lists.entry_numbers(base),
            &self.lists.entry_splats,
            &self.lists.splats,
            &self.lists.depths,
            &added.ranges,
            added.entry_numbers(&frame),
            &added.entry_splats,
            &added.splats,
            &added.depths,
            &scratch.removed,
            &scratch.dirty,
            &self.pixels.image,
            &scratch.images,
        ];
        recorder.run(&shaders::SCORE_RASTERISE, &parts.map(Memory::all), tile_grid(&frame, layers));

        recorder.stage("score_loss");
        let photo = &self.views[view].photo;
        let parts = [&added.frame, &scratch.images, photo, &scratch.unused, &scratch.sums].map(Memory::all);
        recorder.run_with(&shaders::LOSS, &[("FORWARD_ONLY", 1)], &parts, tile_grid(&frame, 3 * layers));
        let (first, of_views) = (batch.individuals.start as u32, [view_index as u32, views as u32]);
        let place = window_uniform(engine, [first, layers], of_views)?;
        let parts = [&added.frame, &place, &scratch.sums, losses].map(Memory::all);
        recorder.run(&shaders::SCORE_SUM, &parts, Grid::Groups(layers.into()));
        recorder.submit();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn batches_cover_the_population_in_order() {
        let changing = |rows: usize| SparseDelta { rows: vec![0; rows], genes: vec![[0.0; 7]; rows] };
        let population = [changing(3), changing(0), changing(2), changing(ITEMS), changing(1)];
        let cut: Vec<_> = batches(&population, 2).into_iter().map(|b| (b.individuals, b.items)).collect();
        assert_eq!(
            cut,
            [(0..2, 0..3), (2..3, 3..5), (3..4, 5..5 + ITEMS), (4..5, 5 + ITEMS..6 + ITEMS)],
            "at most two individuals, and not too many changes"
        );
        assert!(batches(&[], 2).is_empty());
    }
}
