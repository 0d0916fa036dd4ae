//! Stage `bin`, from entries in any order to sorted lists: where each tile's list lies, its entries, and
//! their order, by depth and then by row, as on the CPU.
//!
//! A workgroup sorts a list in its own memory. A longer one is sorted block by block, and merged 32 runs at a
//! time. Most views have no such list, so one merge is recorded, which reaches 32,768 entries; where the
//! device finds a longer list, it halts as if the lists did not fit, and from then on there is a merge more.

use crate::Result;
use crate::device::shaders::{self, Shader};
use crate::device::{Engine, Grid, Memory, Part, Recorder};
use crate::layout::{GRID_BLOCKS, GRID_INTERSECTIONS, GRID_LISTS, LIST_BLOCK, RUNS, ViewPass};
use crate::stages::lists::Lists;

/// Merges of the longest list that any binding holds.
const MERGES_MAX: u32 = 4;

/// Instructions that sorting and merging take for an entry, roughly.
const SORT_INSTRUCTIONS: u64 = 800;
const MERGE_INSTRUCTIONS: u64 = 2_000;

/// Lists on their way to their order.
pub(super) struct Order {
    /// Depths of the entries, and numbers of their intersections: what one merge reads, and where it writes.
    /// Before the sort, the second have the tile of each intersection and its place there.
    depths: [Memory; 2],
    numbers: [Memory; 2],
    /// The number of blocks of long lists, then tile and place of each.
    blocks: Memory,
}

impl Order {
    pub(super) fn new(engine: &Engine) -> Result<Self> {
        let empty = |purpose| engine.allocate(purpose, 0);
        Ok(Self {
            depths: [empty("depths of list entries")?, empty("depths of list entries")?],
            numbers: [empty("numbers of list entries")?, empty("numbers of list entries")?],
            blocks: empty("blocks of long lists")?,
        })
    }

    pub(super) fn release(&mut self) {
        self.blocks.release();
        self.depths.iter_mut().chain(&mut self.numbers).for_each(Memory::release);
    }

    /// Memory for so many entries.
    pub(super) fn reserve(&mut self, engine: &Engine, entries: u64) -> Result<()> {
        for memory in self.depths.iter_mut().chain(&mut self.numbers) {
            engine.reserve(memory, 4 * entries)?;
        }
        engine.reserve(&mut self.blocks, 8 * (1 + blocks_of(entries)))
    }

    /// Where splats leave the tile of each intersection, and its place there `[I]`.
    pub(super) fn emitted(&self) -> [&Memory; 2] {
        [&self.depths[1], &self.numbers[1]]
    }
}

/// Blocks that long lists of so many entries can have: those of a list that is hardly longer than a block are
/// half empty.
fn blocks_of(entries: u64) -> u64 {
    2 * entries / u64::from(LIST_BLOCK)
}

/// Merges that a list of so many entries needs.
pub(super) fn merges_for(entries: u64) -> u32 {
    (0..MERGES_MAX).find(|&merges| entries <= run_after(merges)).unwrap_or(MERGES_MAX)
}

/// Entries of a sorted run after so many merges.
fn run_after(merges: u32) -> u64 {
    u64::from(LIST_BLOCK) * u64::from(RUNS).pow(merges)
}

impl Lists {
    /// From what the splats have left to lists in order.
    pub(super) fn record_order(&self, recorder: &mut Recorder, view: &ViewPass) {
        self.record_plan(recorder);
        self.record_filling(recorder);
        self.record_sort(recorder, view);
        (0..self.merges()).for_each(|merge| self.record_merge(recorder, view, merge));
    }

    fn record_plan(&self, recorder: &mut Recorder) {
        let Self { view, tallies, counters, ranges, grids, .. } = self;
        let parts = [view, tallies, counters, ranges, &self.order.blocks, grids].map(Memory::all);
        let longest = [("LIST_MAX", run_after(self.merges()) as u32)];
        recorder.run_with(&shaders::PLAN_LISTS, &longest, &parts, Grid::Groups(1));
    }

    fn record_filling(&self, recorder: &mut Recorder) {
        let Order { depths, numbers, .. } = &self.order;
        let [tiles, places] = self.order.emitted();
        let Self { counters, ranges, intersection_splats, .. } = self;
        let outputs = [&depths[0], &numbers[0]];
        let parts = [counters, ranges, tiles, places, intersection_splats, &self.depths];
        let parts: Vec<_> = parts.into_iter().chain(outputs).map(Memory::all).collect();
        let grid = Grid::Device(&self.grids, GRID_INTERSECTIONS);
        recorder.run(&shaders::FILL_LISTS, &parts, grid);
    }

    fn record_sort(&self, recorder: &mut Recorder, view: &ViewPass) {
        let Order { depths, numbers, blocks } = &self.order;
        let Self { ranges, intersection_splats, intersections, .. } = self;
        let parts = [&self.view, ranges, blocks, intersection_splats, &depths[0], &numbers[0], intersections];
        let work = Work {
            groups: view.tiles() + blocks_of(self.capacity),
            instructions: SORT_INSTRUCTIONS * self.capacity,
            slot: GRID_LISTS,
        };
        self.run_pieces(recorder, view, &shaders::SORT_LISTS, &[], &parts, work);
    }

    fn record_merge(&self, recorder: &mut Recorder, view: &ViewPass, merge: u32) {
        let (from, to) = ((merge % 2) as usize, ((merge + 1) % 2) as usize);
        let Order { depths, numbers, blocks } = &self.order;
        let Self { ranges, intersection_splats, intersections, .. } = self;
        let runs = [&depths[from], &numbers[from], &depths[to], &numbers[to]];
        let parts = [&[ranges, blocks, intersection_splats][..], &runs, &[intersections]].concat();
        let work = Work {
            groups: blocks_of(self.capacity),
            instructions: MERGE_INSTRUCTIONS * self.capacity,
            slot: GRID_BLOCKS,
        };
        let run = [("RUN", run_after(merge) as u32)];
        self.run_pieces(recorder, view, &shaders::MERGE_LISTS, &run, &parts, work);
    }

    /// Runs a kernel in pieces that no device takes long for; to its bindings the number of the piece is
    /// added. A single piece is as large as the device says; of several, groups that are not there do
    /// nothing.
    fn run_pieces(
        &self,
        recorder: &mut Recorder,
        view: &ViewPass,
        shader: &'static Shader,
        overrides: &[(&'static str, u32)],
        parts: &[&Memory],
        Work { groups, instructions, slot }: Work,
    ) {
        let pieces = pieces_of(instructions, recorder.instructions_max(), view.tiles_y);
        let each = groups.div_ceil(pieces);
        let groups_each = [("GROUPS_EACH", if pieces == 1 { 0 } else { each as u32 })];
        let overrides = [overrides, &groups_each].concat();
        let parts: Vec<Part> = parts.iter().map(|memory| memory.all()).collect();
        for piece in 0..pieces {
            let several = Grid::Groups(each.min(groups.saturating_sub(piece * each)));
            let grid = if pieces == 1 { Grid::Device(&self.grids, slot) } else { several };
            let parts = [&parts[..], &[self.number(piece as u32)]].concat();
            recorder.run_long(shader, &overrides, &parts, grid, instructions / pieces);
        }
    }
}

/// A kernel over tiles or blocks: its workgroups at most, instructions of all of them, and where the device
/// says how many there are.
struct Work {
    groups: u64,
    instructions: u64,
    slot: u32,
}

/// Dispatches that take at most so many instructions each, if all are alike: as many as there are numbers
/// for.
fn pieces_of(instructions: u64, most: u64, numbers: u32) -> u64 {
    instructions.div_ceil(most.max(1)).clamp(1, u64::from(numbers.max(1)))
}

#[cfg(test)]
pub(crate) mod tests;
