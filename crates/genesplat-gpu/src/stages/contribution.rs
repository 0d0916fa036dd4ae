//! Stage `contribution`: how much each Gaussian contributes to views, and the error where it is seen. As on the CPU,
//! the backward blending sums them, with ones and errors, or a map, in the place of the image's gradient.
//!
//! Views follow each other without a wait, and the host reads all sums at once.

use bytemuck::Pod;
use genesplat_core::{Contribution, Held, RenderSettings};

use crate::Result;
use crate::backend::GpuBackend;
use crate::device::{Grid, Memory, Part, Recorder, shaders};
use crate::queue::ListsOf;
use crate::stages::pixels::Needs;
use crate::stages::tiles::TileKernel;
use crate::state::layout::CONTRIBUTION_FLOATS;
use crate::state::{RowWindow, WINDOW_STEP};

/// Where the sums of a view go: so many floats a row, from a float on that kernels can be bound at.
struct Sums<'a> {
    memory: &'a Memory,
    first: u64,
    floats: u32,
}

impl Sums<'_> {
    fn at(&self, window: &RowWindow) -> Part<'_> {
        let floats = u64::from(self.floats);
        self.memory.part(4 * (self.first + floats * window.first), 4 * floats * window.count)
    }
}

impl GpuBackend {
    /// Contributions to views `[N]`.
    pub(crate) fn contributions_to(&mut self, views: &[usize], settings: &RenderSettings) -> Result<Vec<Contribution>> {
        let rows = self.state.trained.rows();
        let values: Vec<[f32; CONTRIBUTION_FLOATS as usize]> = self.sums_of("contributions", rows, |gpu, memory| {
            let sums = Sums { memory, first: 0, floats: CONTRIBUTION_FLOATS };
            views.iter().enumerate().try_for_each(|(place, &view)| {
                gpu.engine.pace(place)?;
                gpu.submit_sums(view, settings, &sums, |gpu, recorder| {
                    let pass = gpu.pass_of(view, settings);
                    recorder.stage("contribution_pixels");
                    let Self { lists, pixels, .. } = gpu;
                    let parts = [&lists.view, &pixels.image, &gpu.views[view].photo, &pixels.gradient];
                    lists.run_tiles(recorder, &pass, TileKernel::new(&shaders::CONTRIBUTION_PIXELS), &parts);
                })
            })
        })?;
        Ok(values.into_iter().map(|[weight, error]| Contribution { weight, error }).collect())
    }

    /// Blending weights times the map of each view, summed over that view `[V][N]`. Maps are made while the device works on
    /// the views before.
    pub(crate) fn weigh_by(
        &mut self,
        views: &[usize],
        map_of: &dyn Fn(usize) -> Result<Vec<f32>>,
        settings: &RenderSettings,
    ) -> Result<Vec<Vec<f32>>> {
        let rows = self.state.trained.rows();
        let (rows, pitch) = (rows as usize, rows.next_multiple_of(WINDOW_STEP));
        let count = views.len() as u64 * pitch;
        let values: Vec<f32> = self.sums_of("weights of views", count, |gpu, memory| {
            let mut waiting = 0;
            for (place, &view) in views.iter().enumerate() {
                gpu.engine.pace(place)?;
                let map = map_of(view)?;
                waiting += size_of_val(&map[..]);
                if waiting > gpu.engine.usage.written_bytes_max {
                    // Until the device has them, maps lie in the host's memory once more.
                    gpu.engine.wait()?;
                    waiting = size_of_val(&map[..]);
                }
                let sums = Sums { memory, first: place as u64 * pitch, floats: 1 };
                // Where contributions have ones. Whatever lies where they have errors is not summed.
                gpu.submit_sums(view, settings, &sums, |gpu, _| gpu.engine.write(&gpu.pixels.gradient, 0, &map))?;
            }
            Ok(())
        })?;
        Ok((0..views.len()).map(|place| values[place * pitch as usize..][..rows].to_vec()).collect())
    }

    /// What views add to sums, so many values that begin with zeros; submitted anew until all lists fit.
    fn sums_of<T: Pod>(
        &mut self,
        purpose: &'static str,
        count: u64,
        submit: impl Fn(&mut Self, &Memory) -> Result<()>,
    ) -> Result<Vec<T>> {
        let sums = self.engine.allocate(purpose, size_of::<T>() as u64 * count)?;
        self.until_lists_fit(ListsOf::Cloud, Some((&sums, count)), |gpu| {
            // An attempt before may have added some of the views.
            let mut recorder = Recorder::new(&gpu.engine, None);
            recorder.clear(&sums, sums.bytes);
            recorder.submit();
            submit(gpu, &sums)
        })
    }

    /// One view; `fill` puts what is summed where the image's gradient would be.
    fn submit_sums(
        &mut self,
        view: usize,
        settings: &RenderSettings,
        sums: &Sums,
        fill: impl FnOnce(&Self, &mut Recorder),
    ) -> Result<()> {
        let pass = self.pass_of(view, settings);
        let needs = Needs { loss: false, gradient: true };
        self.submit_view(&pass, None, needs, Held::Cloud, |gpu, recorder| {
            fill(gpu, recorder);
            let Self { lists, pixels, .. } = gpu;
            pixels.record_backward(recorder, lists, &pass);
            recorder.stage("contribution_sum");
            for window in gpu.state.trained.windows() {
                let [counters, tile_counts, first, gradients] =
                    [&lists.counters, &lists.tile_counts, &lists.first_intersections, &pixels.intersection_gradients]
                        .map(Memory::all);
                let parts = [window.uniform.all(), counters, tile_counts, first, gradients, sums.at(window)];
                let overrides = [("COLUMNS", sums.floats)];
                recorder.run_with(&shaders::CONTRIBUTION_SUM, &overrides, &parts, Grid::Items(window.count));
            }
        })
    }
}
