//! Stages `project` and `bin`: a cloud becomes splats, and splats become tile lists, without the host knowing how many.
//!
//! How many splats are visible and how many entries the lists have is counted on the device; later dispatches take
//! their sizes from there. The entries' buffers are sized by what earlier views needed. Where a view needs more, the
//! device sets a flag and lists nothing, and the host makes room and repeats (see [`crate::backend`]).
//!
//! The order is that of the CPU: splats are sorted by depth once (ties by row), emit their entries in that order, and a
//! stable sort by tile keeps it.

use bytemuck::Pod;
use genesplat_core::BackendError;

use crate::cloud::{Parameters, RowWindow};
use crate::engine::{BUFFER_BYTES_STEP, Engine, Memory};
use crate::layout::{
    Counters, DIGITS, Frame, GRID_DEPTH_SORT, GRID_ENTRIES, GRID_TILE_SORT, GRID_VISIBLE, GRID_VISIBLE_SCAN,
    GRIDS, LENGTH_ENTRIES, LENGTH_ROWS, LENGTH_VISIBLE, LENGTHS, SCAN_BLOCK, SORT_BLOCK, SPLAT_FLOATS,
};
use crate::recorder::{Grid, Recorder};
use crate::shaders;

/// Tile entries that there is room for at first, a row (a cloud in training has 2 to 4).
const FIRST_ENTRIES: u64 = 4;
/// At least so many, for clouds of few and large Gaussians.
const ENTRIES_MIN: u64 = 1 << 16;

/// Bits that one pass of the radix sort sorts by.
pub(crate) const DIGIT_BITS: u32 = DIGITS.ilog2();

/// Buffers of the splats and the tile lists of one view, reused from view to view.
pub struct Lists {
    /// A [`Frame`].
    pub(crate) frame: Memory,
    /// [`Counters`].
    pub(crate) counters: Memory,
    pub(crate) lengths: Memory,
    grids: Memory,
    /// `[N]` splats.
    pub(crate) splats: Memory,
    /// Camera z of each splat, as bits `[N]`.
    pub(crate) depths: Memory,
    /// Tiles that each row reaches, and whether it is seen `[N]`.
    pub(crate) tile_counts: Memory,
    /// 1 for each row that has a splat `[N]`.
    pub(crate) marks: Memory,
    ranks: Memory,
    sums: Memory,
    keys: [Memory; 2],
    values: [Memory; 2],
    /// Of each block, then where these begin `[256, blocks]`.
    digit_counts: Memory,
    /// `[256]`
    digit_totals: Memory,
    /// Splat of each entry `[E]`.
    pub(crate) entry_splats: Memory,
    /// First entry of each splat `[N]`.
    pub(crate) first_entries: Memory,
    /// Begin and end of each tile's entries `[tiles]`.
    pub(crate) ranges: Memory,
    /// Rows of the cloud that there is room for.
    rows: u64,
    /// Entries that there is room for.
    pub(crate) entries: u64,
    /// Room for entries that was found to be needed.
    pub(crate) room: Option<u64>,
    /// Bytes of an entry in the widest buffer that a kernel sees all of.
    entry_bytes: u64,
}

impl Lists {
    /// Room for nothing yet, and later for as many entries as a kernel can see if each takes so many bytes somewhere.
    pub(crate) fn new(engine: &Engine, entry_bytes: u64) -> Result<Self, BackendError> {
        let small = |purpose| engine.allocate(purpose, 0);
        Ok(Self {
            frame: engine.allocate("the frame", size_of::<Frame>() as u64)?,
            counters: engine.allocate("counters", size_of::<Counters>() as u64)?,
            lengths: engine.allocate("lengths", 4 * u64::from(LENGTHS))?,
            grids: engine.allocate("grids", 12 * u64::from(GRIDS))?,
            splats: small("splats")?,
            depths: small("depths")?,
            tile_counts: small("tile counts")?,
            marks: small("marks")?,
            ranks: small("ranks")?,
            sums: small("sums of a prefix sum")?,
            keys: [small("sort keys")?, small("sort keys")?],
            values: [small("sort values")?, small("sort values")?],
            digit_counts: small("digit counts")?,
            digit_totals: engine.allocate("digit totals", 4 * u64::from(DIGITS))?,
            entry_splats: small("splats of tile entries")?,
            first_entries: small("first tile entries")?,
            ranges: small("tile ranges")?,
            rows: 0,
            entries: 0,
            room: None,
            entry_bytes,
        })
    }

    /// Gives back all that grows until it is reserved anew.
    pub(crate) fn release(&mut self) {
        (self.rows, self.entries) = (0, 0);
        let single = [
            &mut self.splats,
            &mut self.depths,
            &mut self.tile_counts,
            &mut self.marks,
            &mut self.ranks,
            &mut self.sums,
            &mut self.digit_counts,
            &mut self.entry_splats,
            &mut self.first_entries,
            &mut self.ranges,
        ];
        single.into_iter().chain(&mut self.keys).chain(&mut self.values).for_each(Memory::release);
    }

    /// Makes room for the rows and tiles of a frame, and for as many entries as were needed so far.
    pub(crate) fn reserve(&mut self, engine: &Engine, frame: &Frame) -> Result<(), BackendError> {
        let rows = u64::from(frame.rows);
        let guess = (FIRST_ENTRIES * rows).max(ENTRIES_MIN);
        let entries = self.room.unwrap_or(guess).min(self.entries_max(engine));
        engine.reserve(&mut self.ranges, 8 * tiles_of(frame))?;
        if rows > self.rows || entries > self.entries || self.splats.bytes == 0 {
            self.enlarge(engine, rows.max(self.rows), entries.max(self.entries))?;
        }
        Ok(())
    }

    fn enlarge(&mut self, engine: &Engine, rows: u64, entries: u64) -> Result<(), BackendError> {
        // Until all of it is there, nothing is.
        (self.rows, self.entries) = (0, 0);
        let sorted = rows.max(entries);
        let sort_blocks = sorted.div_ceil(SORT_BLOCK.into());
        engine.reserve(&mut self.splats, 4 * u64::from(SPLAT_FLOATS) * rows)?;
        for memory in [
            &mut self.depths,
            &mut self.tile_counts,
            &mut self.marks,
            &mut self.ranks,
            &mut self.first_entries,
        ] {
            engine.reserve(memory, 4 * rows)?;
        }
        for memory in self.keys.iter_mut().chain(&mut self.values) {
            engine.reserve(memory, 4 * sorted)?;
        }
        engine.reserve(&mut self.entry_splats, 4 * entries)?;
        engine.reserve(&mut self.digit_counts, 4 * u64::from(DIGITS) * sort_blocks)?;
        // One more, for the total.
        engine.reserve(&mut self.sums, 4 * (rows.div_ceil(SCAN_BLOCK.into()) + 1))?;
        (self.rows, self.entries) = (rows, entries);
        Ok(())
    }

    /// Makes room for the entries that the device wanted, and a quarter more.
    pub(crate) fn grow(&mut self, engine: &Engine, wanted: u32) -> Result<(), BackendError> {
        let (wanted, most) = (u64::from(wanted), self.entries_max(engine));
        if wanted > most {
            return Err(engine.out_of_memory("the tile lists of one view", self.entry_bytes * wanted));
        }
        self.room = Some((wanted + wanted / 4).min(most));
        Ok(())
    }

    fn entries_max(&self, engine: &Engine) -> u64 {
        engine.binding_bytes / BUFFER_BYTES_STEP * BUFFER_BYTES_STEP / self.entry_bytes
    }

    /// What the device has counted since this was last asked.
    pub(crate) fn take_counters(&self, engine: &Engine) -> Result<Counters, BackendError> {
        Ok(self.take_counters_and::<u32>(engine, None)?.0)
    }

    /// The same, and the first values of a buffer, if one is named: with one wait for both.
    pub(crate) fn take_counters_and<T: Pod>(
        &self,
        engine: &Engine,
        values_of: Option<(&Memory, u64)>,
    ) -> Result<(Counters, Vec<T>), BackendError> {
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

    /// Tells the device what the next frame is.
    pub(crate) fn begin(&self, engine: &Engine, frame: &Frame) {
        engine.write(&self.frame, 0, &[Frame { entry_capacity: self.entries as u32, ..*frame }]);
        engine.write(&self.lengths, 0, &[frame.rows]);
    }

    /// Stages `project` and `bin` of a whole cloud.
    pub(crate) fn record(
        &self,
        recorder: &mut Recorder,
        cloud: &Parameters,
        windows: &[RowWindow],
        frame: &Frame,
    ) {
        recorder.stage("project");
        for window in windows {
            let parts = [
                self.frame.all(),
                window.uniform.all(),
                cloud.geometry.at(window),
                cloud.sh.at(window),
                self.splats.all(),
                self.depths.all(),
                self.tile_counts.all(),
                self.marks.all(),
            ];
            recorder.run(&shaders::PROJECT, &parts, Grid::Items(window.count));
        }
        self.record_bin(recorder, frame);
    }

    /// Stage `bin`, from splats to tile lists.
    pub(crate) fn record_bin(&self, recorder: &mut Recorder, frame: &Frame) {
        recorder.stage("bin");
        self.record_depth_order(recorder, frame);
        self.record_tile_lists(recorder, frame);
    }

    /// Steps 1 and 2: splats without gaps, nearest first; rows are left in `values[0]`.
    fn record_depth_order(&self, recorder: &mut Recorder, frame: &Frame) {
        let rows = u64::from(frame.rows);
        self.scan(
            recorder,
            LENGTH_ROWS,
            Grid::Groups(rows.div_ceil(SCAN_BLOCK.into())),
            &self.marks,
            &self.ranks,
        );
        let parts = [self.lengths.all(), self.sums.all(), self.grids.all(), self.counters.all()];
        recorder.run(&shaders::PLAN_VISIBLE, &parts, Grid::Groups(1));
        let [lengths, marks, ranks, depths] =
            [&self.lengths, &self.marks, &self.ranks, &self.depths].map(Memory::all);
        let parts = [lengths, marks, ranks, depths, self.keys[0].all(), self.values[0].all()];
        recorder.run(&shaders::COMPACT, &parts, Grid::Items(rows));
        self.sort(recorder, LENGTH_VISIBLE, GRID_DEPTH_SORT, 32, 0, false);
    }

    /// Steps 3 and 4: entries in depth order, sorted by tile; their numbers are left in [`Self::entry_numbers`].
    fn record_tile_lists(&self, recorder: &mut Recorder, frame: &Frame) {
        let visible = Grid::Device(&self.grids, GRID_VISIBLE);
        let (lengths, order, counts) = (self.lengths.all(), self.values[0].all(), &self.marks);
        recorder.run(&shaders::RANK_COUNTS, &[lengths, order, self.tile_counts.all(), counts.all()], visible);
        let grid = Grid::Device(&self.grids, GRID_VISIBLE_SCAN);
        self.scan(recorder, LENGTH_VISIBLE, grid, counts, &self.ranks);
        let [frame_part, sums, grids, counters] =
            [&self.frame, &self.sums, &self.grids, &self.counters].map(Memory::all);
        recorder.run(&shaders::PLAN_ENTRIES, &[frame_part, lengths, sums, grids, counters], Grid::Groups(1));
        let [starts, splats, keys, entry_splats, first_entries] =
            [&self.ranks, &self.splats, &self.keys[1], &self.entry_splats, &self.first_entries]
                .map(Memory::all);
        let parts =
            [frame_part, lengths, order, counts.all(), starts, splats, keys, entry_splats, first_entries];
        recorder.run(&shaders::EMIT, &parts, visible);

        let sorted = self.sort(recorder, LENGTH_ENTRIES, GRID_TILE_SORT, tile_bits(tiles_of(frame)), 1, true);
        recorder.clear(&self.ranges, 8 * tiles_of(frame));
        let parts = [lengths, self.keys[sorted].all(), self.ranges.all()];
        recorder.run(&shaders::TILE_RANGES, &parts, Grid::Device(&self.grids, GRID_ENTRIES));
    }

    /// Numbers of the entries, tile after tile, nearest first `[E]`.
    pub(crate) fn entry_numbers(&self, frame: &Frame) -> &Memory {
        &self.values[(1 + tile_bits(tiles_of(frame)).div_ceil(DIGIT_BITS) as usize) % 2]
    }

    /// Exclusive prefix sum; the total is left after the last block in `sums`.
    fn scan(&self, recorder: &mut Recorder, length: u32, grid: Grid, input: &Memory, output: &Memory) {
        let overrides = [("LENGTH", length)];
        let (lengths, sums) = (self.lengths.all(), self.sums.all());
        recorder.run_with(&shaders::SCAN_SUMS, &overrides, &[lengths, input.all(), sums], grid);
        recorder.run_with(&shaders::SCAN_BLOCKS, &overrides, &[lengths, sums], Grid::Groups(1));
        recorder.run_with(
            &shaders::SCAN_APPLY,
            &overrides,
            &[lengths, input.all(), sums, output.all()],
            grid,
        );
    }

    /// Stable radix sort of `keys[first]` and `values[first]` by the lowest `bits`; returns where the result is. With
    /// `count_up`, the values are the places that keys had before.
    fn sort(
        &self,
        recorder: &mut Recorder,
        length: u32,
        blocks: u32,
        bits: u32,
        first: usize,
        count_up: bool,
    ) -> usize {
        let mut from = first;
        for pass in 0..bits.div_ceil(DIGIT_BITS) {
            let (to, grid) = (1 - from, Grid::Device(&self.grids, blocks));
            let [length, shift] = [("LENGTH", length), ("SHIFT", pass * DIGIT_BITS)];
            let count_up = ("COUNT_UP", u32::from(count_up && pass == 0));
            let [lengths, digit_counts, digit_totals, keys] =
                [&self.lengths, &self.digit_counts, &self.digit_totals, &self.keys[from]].map(Memory::all);
            let [values, keys_out, values_out] =
                [&self.values[from], &self.keys[to], &self.values[to]].map(Memory::all);
            let parts = [lengths, keys, digit_counts];
            recorder.run_with(&shaders::RADIX_COUNT, &[length, shift], &parts, grid);
            let parts = [lengths, digit_counts, digit_totals];
            recorder.run_with(&shaders::DIGIT_SCAN, &[length], &parts, Grid::Exact([DIGITS, 1, 1]));
            let parts = [lengths, digit_counts, digit_totals, keys, values, keys_out, values_out];
            recorder.run_with(&shaders::RADIX_SCATTER, &[length, shift, count_up], &parts, grid);
            from = to;
        }
        from
    }
}

/// Tiles of a view.
pub(crate) fn tiles_of(frame: &Frame) -> u64 {
    u64::from(frame.tiles_x) * u64::from(frame.tiles_y)
}

/// Bits of the largest number of so many tiles; at least one, so that entries are numbered.
pub(crate) fn tile_bits(tiles: u64) -> u32 {
    (64 - tiles.saturating_sub(1).leading_zeros()).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::GRID_WIDTH;
    use crate::tests::engines;

    /// Room for so many rows.
    fn lists_of(engine: &Engine, rows: u64) -> Lists {
        let mut lists = Lists::new(engine, 4).unwrap();
        lists.reserve(engine, &Frame { rows: rows as u32, ..Frame::default() }).unwrap();
        lists
    }

    /// Sum of `counts` by the device's prefix sum.
    fn total(engine: &Engine, counts: &[u32]) -> u32 {
        let rows = counts.len() as u64;
        let lists = lists_of(engine, rows);
        engine.write(&lists.marks, 0, counts);
        engine.write(&lists.lengths, 0, &[counts.len() as u32]);
        let mut recorder = Recorder::new(engine, None);
        let blocks = rows.div_ceil(SCAN_BLOCK.into());
        lists.scan(&mut recorder, LENGTH_ROWS, Grid::Groups(blocks), &lists.marks, &lists.ranks);
        recorder.submit();
        let sums: Vec<u32> = engine.read_values(&lists.sums, blocks + 1).unwrap();
        sums[blocks as usize]
    }

    /// Within a group, within a block, and over many blocks.
    #[test]
    fn a_total_beyond_32_bits_is_the_largest_number() {
        for engine in engines() {
            assert_eq!(total(&engine, &[]), 0);
            assert_eq!(total(&engine, &[1 << 31, (1 << 31) - 2]), u32::MAX - 1);
            assert_eq!(total(&engine, &[1 << 30; 4]), u32::MAX);
            assert_eq!(total(&engine, &[1 << 22; SCAN_BLOCK as usize]), u32::MAX);
            let many = 600 * SCAN_BLOCK as usize - 5;
            assert_eq!(total(&engine, &vec![3; many]), 3 * many as u32);
            assert_eq!(total(&engine, &vec![5_000; many]), u32::MAX);
        }
    }

    /// Keys and values after a sort by the lowest `bits`.
    fn sorted(engine: &Engine, keys: &[u32], bits: u32, count_up: bool) -> (Vec<u32>, Vec<u32>) {
        let count = keys.len() as u64;
        let lists = lists_of(engine, count);
        engine.write(&lists.keys[0], 0, keys);
        let values: Vec<u32> = (0..keys.len() as u32).map(|place| 7 * place).collect();
        engine.write(&lists.values[0], 0, &values);
        engine.write(&lists.lengths, 4 * u64::from(LENGTH_VISIBLE), &[keys.len() as u32]);
        let blocks = count.div_ceil(SORT_BLOCK.into()) as u32;
        let grid = [blocks.min(GRID_WIDTH), blocks.div_ceil(GRID_WIDTH), 1];
        engine.write(&lists.grids, 12 * u64::from(GRID_DEPTH_SORT), &grid);
        let mut recorder = Recorder::new(engine, None);
        let at = lists.sort(&mut recorder, LENGTH_VISIBLE, GRID_DEPTH_SORT, bits, 0, count_up);
        recorder.submit();
        let read = |memory| engine.read_values(memory, count).unwrap();
        (read(&lists.keys[at]), read(&lists.values[at]))
    }

    /// From none to more blocks than a workgroup has invocations, the last of them short.
    #[test]
    fn a_sort_is_stable_for_any_number_of_keys() {
        let engines = engines();
        let block = SORT_BLOCK as usize;
        for count in [0, 1, block, block + 1, 260 * block + 17] {
            for (bits, count_up) in [(32, false), (13, true), (3, true)] {
                // Many are equal, and all digits occur.
                let key = |place: u32| (place / 3).wrapping_mul(0x9e37_79b9) >> (32 - bits);
                let keys: Vec<u32> = (0..count as u32).rev().map(key).collect();
                let mut places: Vec<u32> = (0..count as u32).collect();
                places.sort_by_key(|&place| keys[place as usize]);
                let expected: Vec<u32> = places.iter().map(|&place| keys[place as usize]).collect();
                let value = if count_up { 1 } else { 7 };
                let values: Vec<u32> = places.iter().map(|place| value * place).collect();
                for engine in &engines {
                    let (sorted_keys, sorted_values) = sorted(engine, &keys, bits, count_up);
                    assert!(sorted_keys == expected && sorted_values == values, "{count}, {bits} bits");
                }
            }
        }
    }
}
