//! Prefix sums and the radix sort, over lengths that only the device knows.

use crate::Result;
use crate::device::probe::attempt;
use crate::device::{Engine, Grid, Memory, Recorder, shaders};
use crate::layout::{
    DIGITS, GRID_DEPTH_SORT, GRID_WIDTH, GRIDS, LENGTH_ROWS, LENGTH_VISIBLE, LENGTHS, SCAN_BLOCK, SORT_BLOCK,
    SORT_PIECE,
};

/// Bits that one pass of the radix sort sorts by.
pub(crate) const DIGIT_BITS: u32 = DIGITS.ilog2();

/// Instructions that a pass takes for a key, roughly.
const KEY_INSTRUCTIONS: u64 = 800;

pub(crate) struct Sorter {
    /// How much there is of what only the device counts: a slot for each `LENGTH_` constant.
    pub(super) lengths: Memory,
    /// Grids of these lengths: a slot for each `GRID_` constant.
    pub(super) grids: Memory,
    pub(super) keys: [Memory; 2],
    pub(super) values: [Memory; 2],
    /// Sums of the blocks of a prefix sum, and the total after them.
    pub(super) sums: Memory,
    /// Of each block, then where these begin `[256, blocks]`.
    digit_counts: Memory,
    /// `[256]`
    digit_totals: Memory,
}

impl Sorter {
    pub(super) fn new(engine: &Engine) -> Result<Self> {
        let empty = |purpose| engine.allocate(purpose, 0);
        Ok(Self {
            lengths: engine.allocate("lengths", 4 * u64::from(LENGTHS))?,
            grids: engine.allocate("grids", 12 * u64::from(GRIDS))?,
            keys: [empty("sort keys")?, empty("sort keys")?],
            values: [empty("sort values")?, empty("sort values")?],
            sums: empty("sums of a prefix sum")?,
            digit_counts: empty("digit counts")?,
            digit_totals: engine.allocate("digit totals", 4 * u64::from(DIGITS))?,
        })
    }

    pub(super) fn release(&mut self) {
        let single = [&mut self.sums, &mut self.digit_counts];
        single.into_iter().chain(&mut self.keys).chain(&mut self.values).for_each(Memory::release);
    }

    /// Memory for prefix sums of so many numbers, and for sorting so many keys.
    pub(super) fn reserve(&mut self, engine: &Engine, summed: u64, sorted: u64) -> Result<()> {
        for memory in self.keys.iter_mut().chain(&mut self.values) {
            engine.reserve(memory, 4 * sorted)?;
        }
        let blocks = sorted.div_ceil(SORT_BLOCK.into());
        engine.reserve(&mut self.digit_counts, 4 * u64::from(DIGITS) * blocks)?;
        // One more, for the total.
        engine.reserve(&mut self.sums, 4 * (summed.div_ceil(SCAN_BLOCK.into()) + 1))
    }

    /// Exclusive prefix sum; the total is left after the last block in `sums`.
    pub(super) fn scan(
        &self,
        recorder: &mut Recorder,
        length: u32,
        grid: Grid,
        input: &Memory,
        output: &Memory,
    ) {
        let overrides = [("LENGTH", length)];
        let [lengths, sums, input, output] = [&self.lengths, &self.sums, input, output].map(Memory::all);
        recorder.run_with(&shaders::SCAN_SUMS, &overrides, &[lengths, input, sums], grid);
        recorder.run_with(&shaders::SCAN_BLOCKS, &overrides, &[lengths, sums], Grid::Groups(1));
        recorder.run_with(&shaders::SCAN_APPLY, &overrides, &[lengths, input, sums, output], grid);
    }

    /// Stable radix sort; returns where the result is.
    pub(super) fn sort(&self, recorder: &mut Recorder, sort: &Sort) -> usize {
        (0..sort.bits.div_ceil(DIGIT_BITS)).fold(sort.first, |from, pass| {
            self.record_pass(recorder, sort, pass, from);
            1 - from
        })
    }

    /// One digit, from keys and values `from` to the others.
    fn record_pass(&self, recorder: &mut Recorder, sort: &Sort, pass: u32, from: usize) {
        let [lengths, digit_counts, digit_totals, keys, values, keys_out, values_out] = [
            &self.lengths,
            &self.digit_counts,
            &self.digit_totals,
            &self.keys[from],
            &self.values[from],
            &self.keys[1 - from],
            &self.values[1 - from],
        ]
        .map(Memory::all);
        let [length, shift] = [("LENGTH", sort.length), ("SHIFT", pass * DIGIT_BITS)];
        let count_up = ("COUNT_UP", u32::from(sort.count_up && pass == 0));
        for (first_block, grid, _) in self.pieces(sort) {
            recorder.run_with(
                &shaders::RADIX_COUNT,
                &[length, shift, first_block],
                &[lengths, keys, digit_counts],
                grid,
            );
        }
        let parts = [lengths, digit_counts, digit_totals];
        recorder.run_with(&shaders::DIGIT_SCAN, &[length], &parts, Grid::Exact([DIGITS, 1, 1]));
        let parts = [lengths, digit_counts, digit_totals, keys, values, keys_out, values_out];
        for (first_block, grid, keys) in self.pieces(sort) {
            let overrides = [length, shift, count_up, first_block];
            recorder.run_long(&shaders::RADIX_SCATTER, &overrides, &parts, grid, KEY_INSTRUCTIONS * keys);
        }
    }

    /// Pieces that no device takes long for: the constant that says where each begins, its grid, and the most
    /// keys that it may have. The first is as long as the device says; of others, blocks that are not there
    /// do nothing.
    fn pieces(&self, sort: &Sort) -> impl Iterator<Item = ((&'static str, u32), Grid<'_>, u64)> {
        let (most, piece) = (sort.most, u64::from(SORT_PIECE));
        let first = Grid::Device(&self.grids, sort.grid);
        (0..most.div_ceil(piece).max(1)).map(move |index| {
            let keys = piece.min(most - index * piece);
            let grid = if index == 0 { first } else { Grid::Groups(keys.div_ceil(SORT_BLOCK.into())) };
            (("FIRST_BLOCK", index as u32 * (SORT_PIECE / SORT_BLOCK)), grid, keys)
        })
    }
}

/// What a radix sort sorts.
pub(super) struct Sort {
    /// Where the device says how many keys there are, and how many blocks the first piece of them has.
    pub(super) length: u32,
    pub(super) grid: u32,
    /// Keys that there may be.
    pub(super) most: u64,
    /// The lowest bits, by which they are sorted.
    pub(super) bits: u32,
    /// Which keys and values; the others are room.
    pub(super) first: usize,
    /// The values are the places that keys had before.
    pub(super) count_up: bool,
}

/// Keys that are sorted to try it: more than one block.
const SORTED: u32 = 5_000;

/// Numbers that are summed to try it: in more blocks than the widest subgroup, of 128, has invocations, since
/// sums of blocks are summed by subgroups, too.
const SUMMED: u32 = 130 * SCAN_BLOCK;

/// Whether a device sorts right. Kernels may rely on subgroups, and drivers choose their width kernel by
/// kernel: so it is those of the sort themselves that are tried, and those of a prefix sum.
pub(crate) fn sorts_right(engine: &Engine) -> Result<bool> {
    Ok(attempt(engine, || Ok(sorts_keys_right(engine)? && sums_right(engine)?))? == Some(true))
}

fn sorts_keys_right(engine: &Engine) -> Result<bool> {
    // Few of their highest digits differ, and many are equal.
    let keys: Vec<u32> = (0..SORTED).map(|place| (place / 2).wrapping_mul(0x9e37_79b9) >> 5).collect();
    let values: Vec<u32> = (0..SORTED).collect();
    let mut expected = values.clone();
    expected.sort_by_key(|&place| keys[place as usize]);
    let (sorted, places) = sorted(engine, &keys, &values, 32, false)?;
    Ok(places == expected && sorted.iter().zip(&expected).all(|(&key, &place)| key == keys[place as usize]))
}

fn sums_right(engine: &Engine) -> Result<bool> {
    let counts: Vec<u32> = (0..SUMMED).map(|place| place.wrapping_mul(0x9e37_79b9) >> 20).collect();
    let before = |sum: &mut u32, &count: &u32| Some(std::mem::replace(sum, *sum + count));
    let expected: Vec<u32> = counts.iter().scan(0, before).collect();
    let (offsets, total) = prefix_sums(engine, &counts)?;
    Ok(offsets == expected && total == counts.iter().sum::<u32>())
}

/// Memory for so many numbers or keys.
fn sorter_of(engine: &Engine, count: u64) -> Result<Sorter> {
    let mut sorter = Sorter::new(engine)?;
    sorter.reserve(engine, count, count)?;
    Ok(sorter)
}

/// Keys and values after a sort by the lowest `bits`.
fn sorted(
    engine: &Engine,
    keys: &[u32],
    values: &[u32],
    bits: u32,
    count_up: bool,
) -> Result<(Vec<u32>, Vec<u32>)> {
    let most = keys.len() as u64;
    let sorter = sorter_of(engine, most)?;
    engine.write(&sorter.keys[0], 0, keys);
    engine.write(&sorter.values[0], 0, values);
    engine.write(&sorter.lengths, 4 * u64::from(LENGTH_VISIBLE), &[keys.len() as u32]);
    let blocks = most.min(SORT_PIECE.into()).div_ceil(SORT_BLOCK.into()) as u32;
    let grid = [blocks.min(GRID_WIDTH), blocks.div_ceil(GRID_WIDTH), 1];
    engine.write(&sorter.grids, 12 * u64::from(GRID_DEPTH_SORT), &grid);
    let mut recorder = Recorder::new(engine, None);
    let (length, grid) = (LENGTH_VISIBLE, GRID_DEPTH_SORT);
    let at = sorter.sort(&mut recorder, &Sort { length, grid, most, bits, first: 0, count_up });
    recorder.submit();
    Ok((engine.read_values(&sorter.keys[at], most)?, engine.read_values(&sorter.values[at], most)?))
}

/// Sums of the counts before each, and of all.
fn prefix_sums(engine: &Engine, counts: &[u32]) -> Result<(Vec<u32>, u32)> {
    let count = counts.len() as u64;
    let sorter = sorter_of(engine, count)?;
    let input = engine.upload("counts", counts)?;
    let output = engine.allocate("offsets", 4 * count)?;
    engine.write(&sorter.lengths, 4 * u64::from(LENGTH_ROWS), &[counts.len() as u32]);
    let mut recorder = Recorder::new(engine, None);
    let blocks = count.div_ceil(SCAN_BLOCK.into());
    sorter.scan(&mut recorder, LENGTH_ROWS, Grid::Groups(blocks), &input, &output);
    recorder.submit();
    let sums: Vec<u32> = engine.read_values(&sorter.sums, blocks + 1)?;
    Ok((engine.read_values(&output, count)?, sums[blocks as usize]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::unroll::unrolled;
    use crate::tests::{engine, engines};

    /// Sum of `counts` by the device's prefix sum.
    fn total(engine: &Engine, counts: &[u32]) -> u32 {
        prefix_sums(engine, counts).unwrap().1
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

    /// From none to more blocks than a workgroup has invocations, in three pieces, the last of them short.
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
                let before: Vec<u32> = (0..count as u32).map(|place| 7 * place).collect();
                for engine in &engines {
                    let (sorted_keys, sorted_values) =
                        sorted(engine, &keys, &before, bits, count_up).unwrap();
                    assert!(sorted_keys == expected && sorted_values == values, "{count}, {bits} bits");
                }
            }
        }
    }

    /// Ballots that miss a lane, as translators have made them, and subgroups whose width is taken for
    /// another.
    #[test]
    fn a_wrong_sort_is_found_out() {
        let Some(mut engine) = engine() else { return };
        assert!(sorts_right(&engine).unwrap());
        for (right, wrong) in
            [("subgroupBallot(is_set)", "(subgroupBallot(is_set) & vec4(~2u))"), ("/ width", "/ 2u")]
        {
            assert!(
                engine.abilities.subgroups && SORT_WITH_SUBGROUPS.iter().any(|text| text.contains(right))
            );
            engine.set_rewrite(Box::new(move |_, text| unrolled(&text.replace(right, wrong))));
            assert!(!sorts_right(&engine).unwrap(), "{wrong}");
        }
        for kernel in ["bin/scan_sums", "bin/scan_blocks", "bin/scan_apply"] {
            let is_narrow = move |name: &str, text: String| {
                unrolled(&if name == kernel { text.replace("/ width", "/ 2u") } else { text })
            };
            engine.set_rewrite(Box::new(is_narrow));
            assert!(!sorts_right(&engine).unwrap(), "{kernel}");
        }
        assert!(sorts_right(&engine.without_subgroups()).unwrap());
    }

    /// What kernels of a sort have only with subgroups.
    const SORT_WITH_SUBGROUPS: [&str; 2] = [
        include_str!("../../shader/bin/mark_digit_subgroups.wgsl"),
        include_str!("../../shader/bin/group_scan_subgroups.wgsl"),
    ];
}
