//! Stage `blending_weights`: how much of each pixel every Gaussian is, times a map. As on the CPU, the
//! backward blending sums it, with the map in the place of the gradient of the image's red.
//!
//! Views follow each other without a wait, and the host reads all sums at once.

use genesplat_core::{Held, RenderSettings};

use super::held::{GpuBackend, ListsOf};
use crate::Result;
use crate::device::{Grid, Memory, Part, Recorder, shaders};
use crate::stages::pixels::Needs;
use crate::state::{RowWindow, WINDOW_STEP};

/// Where the sums of a view go: one a row, from one on that kernels can be bound at.
struct Sums<'a> {
    memory: &'a Memory,
    first: u64,
}

impl Sums<'_> {
    fn at(&self, window: &RowWindow) -> Part<'_> {
        self.memory.part(4 * (self.first + window.first), 4 * window.count)
    }
}

impl GpuBackend {
    /// Blending weights times the map of each view, summed over that view `[V][N]`. Maps are made while the
    /// device works on the views before.
    pub(crate) fn weights_by(
        &mut self,
        views: &[usize],
        map_of: &dyn Fn(usize) -> Result<Vec<f32>>,
        settings: &RenderSettings,
    ) -> Result<Vec<Vec<f32>>> {
        let rows = self.state.trained.rows();
        let (rows, pitch) = (rows as usize, rows.next_multiple_of(WINDOW_STEP));
        let count = views.len() as u64 * pitch;
        let sums = self.engine.allocate("weights of views", 4 * count)?;
        let values: Vec<f32> = self.until_lists_fit(ListsOf::Cloud, Some((&sums, count)), |gpu| {
            // An attempt before may have summed some of the views.
            let mut recorder = Recorder::new(&gpu.engine, None);
            recorder.clear(&sums, sums.bytes);
            recorder.submit();
            gpu.submit_maps(views, map_of, settings, |place| Sums {
                memory: &sums,
                first: place as u64 * pitch,
            })
        })?;
        Ok((0..views.len()).map(|place| values[place * pitch as usize..][..rows].to_vec()).collect())
    }

    /// All views, each with its map; the sums of one go to `place_of` its place.
    fn submit_maps<'a>(
        &mut self,
        views: &[usize],
        map_of: &dyn Fn(usize) -> Result<Vec<f32>>,
        settings: &RenderSettings,
        place_of: impl Fn(usize) -> Sums<'a>,
    ) -> Result<()> {
        let mut waiting = 0;
        for (place, &view) in views.iter().enumerate() {
            self.engine.pace(place)?;
            let map = map_of(view)?;
            waiting += size_of_val(&map[..]);
            if waiting > self.engine.usage.written_bytes_max {
                // Until the device has them, maps lie in the host's memory once more.
                self.engine.wait()?;
                waiting = size_of_val(&map[..]);
            }
            self.submit_map(view, &map, settings, &place_of(place))?;
        }
        Ok(())
    }

    /// One view. Whatever lies where the gradients of green and blue would be has no part in what is summed.
    fn submit_map(&mut self, view: usize, map: &[f32], settings: &RenderSettings, sums: &Sums) -> Result<()> {
        let pass = self.pass_of(view, settings);
        let needs = Needs { gradient: true, ..Needs::default() };
        self.submit_view(&pass, None, needs, Held::Cloud, |gpu, recorder| {
            let Self { lists, pixels, .. } = gpu;
            gpu.engine.write(&pixels.gradient, 0, map);
            pixels.record_backward(recorder, lists, &pass, needs);
            recorder.stage("weight_sum");
            for window in gpu.state.trained.windows() {
                let [counters, tile_counts, first, gradients] = [
                    &lists.counters,
                    &lists.tile_counts,
                    &lists.first_intersections,
                    &pixels.intersection_gradients,
                ]
                .map(Memory::all);
                let parts = [window.uniform.all(), counters, tile_counts, first, gradients, sums.at(window)];
                recorder.run(&shaders::WEIGHT_SUM, &parts, Grid::Items(window.count));
            }
        })
    }
}
