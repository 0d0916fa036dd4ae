//! Stages `project` and `bin`: a cloud becomes splats, and splats become tile lists, without the host knowing
//! how many.
//!
//! The device counts splats and intersections, and later dispatches take their sizes from there. Buffers of
//! intersections are sized by what earlier views needed; a view that needs more is submitted once more. The
//! order is that of the CPU: splats are sorted by depth once (ties by row), emit their intersections in that
//! order, and a stable sort by tile keeps it.

use std::cell::Cell;

use bytemuck::Pod;
use genesplat_core::Held;

use crate::Result;
use crate::device::{BUFFER_BYTES_STEP, Engine, Grid, Memory, Part, Recorder, shaders};
use crate::layout::{
    Counters, GRID_DEPTH_SORT, GRID_INTERSECTIONS, GRID_TILE_SORT, GRID_VISIBLE, GRID_VISIBLE_SCAN,
    LENGTH_INTERSECTIONS, LENGTH_ROWS, LENGTH_VISIBLE, Optimiser, SCAN_BLOCK, SPLAT_FLOATS, ViewPass,
};
use crate::stages::sort::{DIGIT_BITS, Sort, Sorter};
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
    /// Rows that the device has been told of.
    told_rows: Cell<Option<u32>>,
    sorter: Sorter,
    pub(crate) splats: Memory,
    /// Camera z of each splat, as bits `[N]`.
    pub(crate) depths: Memory,
    /// Tiles that each row reaches, and whether it is seen `[N]`.
    pub(crate) tile_counts: Memory,
    /// 1 for each row that has a splat; later tile counts, nearest splat first `[N]`.
    pub(crate) flags: Memory,
    /// Sums of what comes before in `flags` `[N]`.
    offsets: Memory,
    pub(crate) intersection_splats: Memory,
    /// First intersection of each splat `[N]`.
    pub(crate) first_intersections: Memory,
    /// Begin and end of each tile's intersections `[tiles]`.
    pub(crate) ranges: Memory,
    rows: u64,
    pub(crate) capacity: u64,
    pub(crate) wanted_capacity: Option<u64>,
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
            told_rows: Cell::new(None),
            sorter: Sorter::new(engine)?,
            splats: empty("splats")?,
            depths: empty("depths")?,
            tile_counts: empty("tile counts")?,
            flags: empty("flags")?,
            offsets: empty("offsets")?,
            intersection_splats: empty("splats of intersections")?,
            first_intersections: empty("first intersections")?,
            ranges: empty("tile ranges")?,
            rows: 0,
            capacity: 0,
            wanted_capacity: None,
            intersection_bytes,
        })
    }

    pub(crate) fn release(&mut self) {
        (self.rows, self.capacity) = (0, 0);
        self.sorter.release();
        let Self { splats, depths, tile_counts, flags, offsets, .. } = self;
        let of_rows = [splats, depths, tile_counts, flags, offsets];
        let others = [&mut self.intersection_splats, &mut self.first_intersections, &mut self.ranges];
        of_rows.into_iter().chain(others).for_each(Memory::release);
    }

    /// Memory for the rows and tiles of a view, and for as many intersections as were needed so far.
    pub(crate) fn reserve(&mut self, engine: &Engine, view: &ViewPass) -> Result<()> {
        let rows = u64::from(view.rows);
        let guess = (FIRST_INTERSECTIONS_PER_ROW * rows).max(INTERSECTIONS_MIN);
        let capacity = self.wanted_capacity.unwrap_or(guess).min(self.capacity_max(engine));
        engine.reserve(&mut self.ranges, 8 * view.tiles())?;
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
        let Self { depths, tile_counts, flags, offsets, first_intersections, .. } = self;
        for memory in [depths, tile_counts, flags, offsets, first_intersections] {
            engine.reserve(memory, 4 * rows)?;
        }
        engine.reserve(&mut self.intersection_splats, 4 * capacity)?;
        self.sorter.reserve(engine, rows, rows.max(capacity))?;
        (self.rows, self.capacity) = (rows, capacity);
        Ok(())
    }

    /// From the next view on, memory for the intersections that the device wanted, and a quarter more.
    pub(crate) fn grow(&mut self, engine: &Engine, wanted: u32) -> Result<()> {
        let (wanted, most) = (u64::from(wanted), self.capacity_max(engine));
        if wanted > most {
            let bytes = self.intersection_bytes * wanted;
            return Err(engine.out_of_memory("the tile lists of one view", bytes));
        }
        self.wanted_capacity = Some((wanted + wanted / 4).min(most));
        Ok(())
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
        if self.told_rows.replace(Some(view.rows)) != Some(view.rows) {
            engine.write(&self.sorter.lengths, 4 * u64::from(LENGTH_ROWS), &[view.rows]);
        }
    }

    pub(crate) fn optimiser(&self) -> Part<'_> {
        self.view.part(OPTIMISER_AT as u64, size_of::<Optimiser>() as u64)
    }

    /// Empty tiles keep these ranges. Comes before all stages, where it ends no pass.
    pub(crate) fn clear_ranges(&self, recorder: &mut Recorder, view: &ViewPass) {
        recorder.clear(&self.ranges, 8 * view.tiles());
    }

    /// Stages `project` and `bin` of a whole cloud, or of the mean. Colours that are shown make the steps
    /// that they have yet to make.
    pub(crate) fn record(&self, recorder: &mut Recorder, state: &State, held: Held, view: &ViewPass) {
        recorder.stage("project");
        let outputs = [&self.splats, &self.depths, &self.tile_counts, &self.flags].map(Memory::all);
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
        let parts = [&self.view, &self.splats, &self.tile_counts, &self.flags].map(Memory::all);
        let rows = u64::from(view.rows);
        recorder.run_long(&shaders::COUNT_TILES, &[], &parts, Grid::Items(rows), SPLAT_INSTRUCTIONS * rows);
        self.record_bin(recorder, view);
    }

    /// Stage `bin`, from splats to tile lists.
    pub(crate) fn record_bin(&self, recorder: &mut Recorder, view: &ViewPass) {
        recorder.stage("bin");
        self.record_depth_order(recorder, view.rows.into());
        self.record_tile_lists(recorder, view);
    }

    /// Steps 1 and 2: splats without gaps, nearest first; rows are left in `values[0]`.
    fn record_depth_order(&self, recorder: &mut Recorder, rows: u64) {
        let Self { sorter, flags, offsets, .. } = self;
        let blocks = Grid::Groups(rows.div_ceil(SCAN_BLOCK.into()));
        sorter.scan(recorder, LENGTH_ROWS, blocks, flags, offsets);
        let parts = [&sorter.lengths, &sorter.sums, &sorter.grids, &self.counters];
        recorder.run(&shaders::PLAN_VISIBLE, &parts.map(Memory::all), Grid::Groups(1));
        let [keys, values] = [&sorter.keys[0], &sorter.values[0]];
        let parts = [&sorter.lengths, flags, offsets, &self.depths, keys, values];
        recorder.run(&shaders::COMPACT, &parts.map(Memory::all), Grid::Items(rows));
        let grid = GRID_DEPTH_SORT;
        sorter.sort(
            recorder,
            &Sort { length: LENGTH_VISIBLE, grid, most: rows, bits: 32, first: 0, count_up: false },
        );
    }

    /// Steps 3 and 4: intersections in depth order, sorted by tile ([`Self::sorted_intersections`]).
    fn record_tile_lists(&self, recorder: &mut Recorder, view: &ViewPass) {
        let Self { sorter, flags: counts, offsets, splats, ranges, .. } = self;
        let (lengths, order) = (&sorter.lengths, &sorter.values[0]);
        let visible = Grid::Device(&sorter.grids, GRID_VISIBLE);
        let parts = [lengths, order, &self.tile_counts, counts];
        recorder.run(&shaders::TILE_COUNTS_BY_DEPTH, &parts.map(Memory::all), visible);
        let blocks = Grid::Device(&sorter.grids, GRID_VISIBLE_SCAN);
        sorter.scan(recorder, LENGTH_VISIBLE, blocks, counts, offsets);
        let parts = [&self.view, lengths, &sorter.sums, &sorter.grids, &self.counters];
        recorder.run(&shaders::PLAN_INTERSECTIONS, &parts.map(Memory::all), Grid::Groups(1));
        let outputs = [&sorter.keys[1], &self.intersection_splats, &self.first_intersections];
        let parts = [&[&self.view, lengths, order, counts, offsets, splats][..], &outputs].concat();
        let parts: Vec<_> = parts.into_iter().map(Memory::all).collect();
        let instructions =
            SPLAT_INSTRUCTIONS * u64::from(view.rows) + INTERSECTION_INSTRUCTIONS * self.capacity;
        recorder.run_long(&shaders::EMIT, &[], &parts, visible, instructions);

        let bits = tile_bits(view.tiles());
        let (length, grid, most) = (LENGTH_INTERSECTIONS, GRID_TILE_SORT, self.capacity);
        let sorted = sorter.sort(recorder, &Sort { length, grid, most, bits, first: 1, count_up: true });
        let parts = [lengths, &sorter.keys[sorted], ranges];
        let grid = Grid::Device(&sorter.grids, GRID_INTERSECTIONS);
        recorder.run(&shaders::TILE_RANGES, &parts.map(Memory::all), grid);
    }

    /// Numbers of the intersections, tile after tile, nearest first `[I]`.
    pub(crate) fn sorted_intersections(&self, view: &ViewPass) -> &Memory {
        &self.sorter.values[(1 + tile_bits(view.tiles()).div_ceil(DIGIT_BITS) as usize) % 2]
    }
}

/// Bits of the largest number of so many tiles; at least one, so that intersections are numbered.
pub(crate) fn tile_bits(tiles: u64) -> u32 {
    (64 - tiles.saturating_sub(1).leading_zeros()).max(1)
}
