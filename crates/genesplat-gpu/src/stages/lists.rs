//! Stages `project` and `bin`: a cloud becomes splats, and splats become tile lists, without the host knowing
//! how many.
//!
//! Splats count themselves into the lists of their tiles in any order, and every list is sorted by itself
//! ([`super::order`]). The device counts splats and intersections, and later dispatches take their sizes from
//! there. Buffers of intersections are sized by what earlier views needed; a view that needs more is
//! submitted once more.

use bytemuck::Pod;
use genesplat_core::Held;

use crate::Result;
use crate::device::memory::Reading;
use crate::device::{BUFFER_BYTES_STEP, Engine, Grid, Memory, Part, Recorder, shaders};
use crate::layout::{
    Counters, GRIDS, HALT_LONG_LIST, HALT_OVERFLOW, Optimiser, SPLAT_FLOATS, TALLIES, ViewPass,
};
use crate::stages::order::{Order, merges_for};
use crate::stages::tiles::reserve_first_rows;
use crate::state::{LateColours, ROW_INSTRUCTIONS, State};

/// Where an optimiser lies behind a view, bytes: a multiple of what every device can bind at.
const OPTIMISER_AT: usize = 256;

/// Intersections a row that buffers hold at first (a cloud in training has 2 to 4).
const FIRST_INTERSECTIONS_PER_ROW: u64 = 4;
/// At least so many, for clouds of few and large Gaussians.
const INTERSECTIONS_MIN: u64 = 1 << 16;

/// Instructions that emitting takes, for each splat and for each of its intersections, roughly.
const SPLAT_INSTRUCTIONS: u64 = 1_000;
const INTERSECTION_INSTRUCTIONS: u64 = 100;

/// Buffers of the splats and the tile lists of one view, reused from view to view. N rows, I intersections.
pub(crate) struct Lists {
    /// A [`ViewPass`], and where a step has one, its [`Optimiser`]: one write.
    pub(crate) view: Memory,
    pub(crate) counters: Memory,
    /// Numbers of tile rows, for stages that take some of them at once.
    pub(super) first_tile_rows: Memory,
    pub(crate) splats: Memory,
    /// Camera z of each splat, as bits `[N]`.
    pub(crate) depths: Memory,
    /// Tiles that each row reaches, and whether it is seen `[N]`.
    pub(crate) tile_counts: Memory,
    /// `TALLY_` slots, then the length of each tile's list `[tiles]`.
    pub(super) tallies: Memory,
    /// Grids that only the device knows: a slot for each `GRID_` constant.
    pub(super) grids: Memory,
    pub(crate) intersection_splats: Memory,
    /// First intersection of each splat `[N]`.
    pub(crate) first_intersections: Memory,
    /// Begin and end of each tile's intersections `[tiles]`.
    pub(crate) ranges: Memory,
    /// Numbers of the intersections, tile after tile, nearest first `[I]`.
    pub(crate) intersections: Memory,
    pub(super) order: Order,
    rows: u64,
    pub(crate) capacity: u64,
    pub(crate) wanted_capacity: Option<u64>,
    /// Merges of long lists that views needed so far.
    pub(super) merges: u32,
    /// Bytes of an intersection in the widest buffer that a kernel sees all of.
    intersection_bytes: u64,
}

impl Lists {
    /// Empty buffers; later for as many intersections as a kernel can see if each takes so many bytes
    /// somewhere.
    pub(crate) fn new(engine: &Engine, intersection_bytes: u64) -> Result<Self> {
        let empty = |purpose| engine.allocate(purpose, 0);
        Ok(Self {
            view: engine.allocate("the view", OPTIMISER_AT as u64 + size_of::<Optimiser>() as u64)?,
            counters: engine.allocate("counters", size_of::<Counters>() as u64)?,
            first_tile_rows: empty("numbers of tile rows")?,
            splats: empty("splats")?,
            depths: empty("depths")?,
            tile_counts: empty("tile counts")?,
            tallies: empty("lengths of tile lists")?,
            grids: engine.allocate("grids", 12 * u64::from(GRIDS))?,
            intersection_splats: empty("splats of intersections")?,
            first_intersections: empty("first intersections")?,
            ranges: empty("tile ranges")?,
            intersections: empty("tile lists")?,
            order: Order::new(engine)?,
            rows: 0,
            capacity: 0,
            wanted_capacity: None,
            merges: 1,
            intersection_bytes,
        })
    }

    pub(crate) fn release(&mut self) {
        (self.rows, self.capacity) = (0, 0);
        self.order.release();
        let Self { splats, depths, tile_counts, first_intersections, .. } = self;
        let of_rows = [splats, depths, tile_counts, first_intersections];
        let of_tiles = [&mut self.tallies, &mut self.ranges];
        let of_intersections = [&mut self.intersection_splats, &mut self.intersections];
        of_rows.into_iter().chain(of_tiles).chain(of_intersections).for_each(Memory::release);
    }

    /// Memory for the rows and tiles of a view, and for as many intersections as were needed so far.
    pub(crate) fn reserve(&mut self, engine: &Engine, view: &ViewPass) -> Result<()> {
        let rows = u64::from(view.rows);
        let guess = (FIRST_INTERSECTIONS_PER_ROW * rows).max(INTERSECTIONS_MIN);
        let capacity = self.wanted_capacity.unwrap_or(guess).min(self.capacity_max(engine));
        engine.reserve(&mut self.ranges, 8 * view.tiles())?;
        engine.reserve(&mut self.tallies, tally_bytes(view))?;
        reserve_first_rows(engine, &mut self.first_tile_rows, view)?;
        if rows > self.rows || capacity > self.capacity || self.splats.bytes == 0 {
            self.enlarge(engine, rows.max(self.rows), capacity.max(self.capacity))?;
        }
        Ok(())
    }

    fn enlarge(&mut self, engine: &Engine, rows: u64, capacity: u64) -> Result<()> {
        // Until all of it is there, nothing is.
        (self.rows, self.capacity) = (0, 0);
        engine.reserve(&mut self.splats, 4 * u64::from(SPLAT_FLOATS) * rows)?;
        for memory in [&mut self.depths, &mut self.tile_counts, &mut self.first_intersections] {
            engine.reserve(memory, 4 * rows)?;
        }
        for memory in [&mut self.intersection_splats, &mut self.intersections] {
            engine.reserve(memory, 4 * capacity)?;
        }
        self.order.reserve(engine, capacity)?;
        (self.rows, self.capacity) = (rows, capacity);
        Ok(())
    }

    /// From the next view on, what the device lacked: memory for the intersections that it wanted, and a
    /// quarter more; merges for longer lists. False where it lacked nothing.
    pub(crate) fn grow(&mut self, engine: &Engine, counters: &Counters) -> Result<bool> {
        let (wanted, most) = (u64::from(counters.wanted), self.capacity_max(engine));
        if counters.halted & HALT_OVERFLOW != 0 {
            if wanted > most {
                let bytes = self.intersection_bytes * wanted;
                return Err(engine.out_of_memory("the tile lists of one view", bytes));
            }
            self.wanted_capacity = Some((wanted + wanted / 4).min(most));
        }
        if counters.halted & HALT_LONG_LIST != 0 {
            self.merges += 1;
        }
        Ok(counters.halted & (HALT_OVERFLOW | HALT_LONG_LIST) != 0)
    }

    /// Merges after the sort: no more than the longest list that has room can need.
    pub(super) fn merges(&self) -> u32 {
        self.merges.min(merges_for(self.capacity))
    }

    fn capacity_max(&self, engine: &Engine) -> u64 {
        engine.binding_bytes / BUFFER_BYTES_STEP * BUFFER_BYTES_STEP / self.intersection_bytes
    }

    /// What the device has counted since this was last asked, and the first values of a buffer, if one is
    /// named.
    pub(crate) fn take_counters<T: Pod>(
        &self,
        engine: &Engine,
        values_of: Option<(&Memory, u64)>,
    ) -> Result<(Counters, Vec<T>)> {
        let (memory, count) = values_of.unwrap_or((&self.counters, 0));
        let mut counters = Counters::default();
        let mut values = bytemuck::zeroed_vec(count as usize);
        engine.read([
            (&self.counters, bytemuck::bytes_of_mut(&mut counters)),
            (memory, bytemuck::cast_slice_mut(&mut values)),
        ])?;
        self.clear_counters(engine);
        Ok((counters, values))
    }

    /// Asks for what the device has counted since this was last asked. A halt goes on until it is
    /// [taken](Self::take_counters).
    pub(crate) fn ask_for_counters(&self, engine: &Engine) -> Result<Reading> {
        let reading = engine.begin_reading(&self.counters, size_of::<Counters>() as u64)?;
        engine.write(&self.counters, std::mem::offset_of!(Counters, completed) as u64, &[0u32]);
        Ok(reading)
    }

    pub(crate) fn clear_counters(&self, engine: &Engine) {
        engine.write(&self.counters, 0, &[Counters::default()]);
    }

    /// Tells the device of a view, and of an optimiser's step if there is one.
    pub(crate) fn begin(&self, engine: &Engine, view: &ViewPass, optimiser: Option<&Optimiser>) {
        let view = ViewPass { intersection_capacity: self.capacity as u32, ..*view };
        let mut bytes = [0; OPTIMISER_AT + size_of::<Optimiser>()];
        bytes[..size_of::<ViewPass>()].copy_from_slice(bytemuck::bytes_of(&view));
        let optimiser = optimiser.copied().unwrap_or_default();
        bytes[OPTIMISER_AT..].copy_from_slice(bytemuck::bytes_of(&optimiser));
        engine.write(&self.view, 0, &bytes);
    }

    pub(crate) fn optimiser(&self) -> Part<'_> {
        self.view.part(OPTIMISER_AT as u64, size_of::<Optimiser>() as u64)
    }

    /// Nothing is listed yet. Comes before all stages, where it ends no pass.
    pub(crate) fn clear_tallies(&self, recorder: &mut Recorder, view: &ViewPass) {
        recorder.clear(&self.tallies, tally_bytes(view));
    }

    /// Stages `project` and `bin` of a whole cloud, or of the mean. Colours that are shown make the steps
    /// that they have yet to make.
    pub(crate) fn record(&self, recorder: &mut Recorder, state: &State, held: Held, view: &ViewPass) {
        recorder.stage("project");
        let outputs = [&self.splats, &self.depths, &self.tile_counts].map(Memory::all);
        for window in state.trained.windows() {
            let (geometry, LateColours { values, made, steps }) = state.held_at(held, window);
            let (view, uniform) = (self.view.all(), window.uniform.all());
            let parts = [&[view, uniform, geometry][..], &outputs].concat();
            recorder.run(&shaders::PROJECT, &parts, Grid::Items(window.count));
            let inputs = [&[view, uniform, self.tile_counts.all(), geometry][..], &values].concat();
            let parts = [&inputs[..], &[steps, made, self.splats.all()]].concat();
            let instructions = ROW_INSTRUCTIONS * window.count;
            recorder.run_long(&shaders::SPLAT_COLOUR, &[], &parts, Grid::Items(window.count), instructions);
        }
        self.record_bin(recorder, view);
    }

    /// Stage `bin` of splats that the host has written.
    pub(crate) fn record_bin_of_given(&self, recorder: &mut Recorder, view: &ViewPass) {
        recorder.stage("bin");
        let parts = [&self.view, &self.splats, &self.tile_counts].map(Memory::all);
        let rows = u64::from(view.rows);
        recorder.run_long(&shaders::COUNT_TILES, &[], &parts, Grid::Items(rows), SPLAT_INSTRUCTIONS * rows);
        self.record_bin(recorder, view);
    }

    /// Stage `bin`, from splats to tile lists.
    pub(crate) fn record_bin(&self, recorder: &mut Recorder, view: &ViewPass) {
        recorder.stage("bin");
        let outputs = [&self.tallies, &self.first_intersections, &self.intersection_splats];
        let [tiles, places] = self.order.emitted();
        let parts = [&[&self.view, &self.tile_counts, &self.splats][..], &outputs, &[tiles, places]].concat();
        let parts: Vec<_> = parts.into_iter().map(Memory::all).collect();
        let rows = u64::from(view.rows);
        let instructions = SPLAT_INSTRUCTIONS * rows + INTERSECTION_INSTRUCTIONS * self.capacity;
        recorder.run_long(&shaders::EMIT, &[], &parts, Grid::Items(rows), instructions);
        self.record_order(recorder, view);
    }
}

fn tally_bytes(view: &ViewPass) -> u64 {
    4 * (u64::from(TALLIES) + view.tiles())
}
