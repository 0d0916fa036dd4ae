//! Lists that no scene has, in the order that a plain sort gives them.

use super::*;
use crate::layout::{Counters, GRID_WIDTH, HALT_LONG_LIST, HALT_OVERFLOW, TALLIES};
use crate::tests::engine;

const BLOCK: usize = LIST_BLOCK as usize;

/// What splats leave for the sort: of every intersection its tile and its splat, in the order of their
/// numbers, and the depth of every splat, by its bits.
struct Emitted {
    tiles: [u32; 2],
    intersections: Vec<[u32; 2]>,
    depths: Vec<u32>,
}

/// Some bits that differ from number to number.
fn scattered(number: usize) -> u32 {
    (number as u32).wrapping_mul(0x9e37_79b9) >> 4
}

impl Emitted {
    /// Lists of these lengths, one a tile: splats in scattered order, each in one list, of so many depths.
    fn of_lengths(lengths: &[usize], depths: u32) -> Self {
        let tile = |(tile, &length): (usize, &usize)| std::iter::repeat_n(tile as u32, length);
        let mut intersections: Vec<[u32; 2]> =
            lengths.iter().enumerate().flat_map(tile).zip(0..).map(|(tile, row)| [tile, row]).collect();
        intersections.sort_by_key(|&[_, row]| scattered(row as usize));
        let depths = (0..intersections.len()).map(|row| scattered(row / 2) % depths).collect();
        Self { tiles: [lengths.len() as u32, 1], intersections, depths }
    }

    /// The list of each tile, by depth, row and number.
    fn expected(&self) -> Vec<Vec<u32>> {
        let mut lists = vec![Vec::new(); (self.tiles[0] * self.tiles[1]) as usize];
        for (number, &[tile, row]) in self.intersections.iter().enumerate() {
            let depth = self.depths.get(row as usize).copied().unwrap_or(u32::MAX);
            lists[tile as usize].push((depth, row, number as u32));
        }
        lists.iter_mut().for_each(|list| list.sort_unstable());
        lists.into_iter().map(|list| list.into_iter().map(|(_, _, number)| number).collect()).collect()
    }

    fn view(&self) -> ViewPass {
        let [tiles_x, tiles_y] = self.tiles;
        let intersection_capacity = self.intersections.len() as u32;
        ViewPass {
            rows: self.depths.len() as u32,
            tiles_x,
            tiles_y,
            intersection_capacity,
            ..Default::default()
        }
    }

    /// Writes all of it where the splats would. Places in a list are given from the last intersection to the
    /// first: any order will do.
    fn write(&self, engine: &Engine, lists: &Lists) {
        let view = self.view();
        let mut tallies = vec![0; TALLIES as usize + view.tiles() as usize];
        tallies[..2].copy_from_slice(&[view.rows, self.intersections.len() as u32]);
        let mut places = vec![0; self.intersections.len()];
        for (place, &[tile, _]) in places.iter_mut().zip(&self.intersections).rev() {
            let length = &mut tallies[(TALLIES + tile) as usize];
            *place = *length;
            *length += 1;
        }
        let column = |which: usize| -> Vec<u32> { self.intersections.iter().map(|at| at[which]).collect() };
        lists.begin(engine, &view, None);
        engine.write(&lists.tallies, 0, &tallies);
        engine.write(lists.order.emitted()[0], 0, &column(0));
        engine.write(lists.order.emitted()[1], 0, &places);
        engine.write(&lists.intersection_splats, 0, &column(1));
        engine.write(&lists.depths, 0, &self.depths);
    }

    /// The lists as the device makes them, and what it counted.
    fn lists_of(&self, engine: &Engine, lists: &mut Lists) -> (Vec<Vec<u32>>, Counters) {
        let view = self.view();
        lists.reserve(engine, &view).unwrap();
        self.write(engine, lists);
        let mut recorder = Recorder::new(engine, None);
        lists.record_order(&mut recorder, &view);
        recorder.submit();
        let numbers: Vec<u32> = engine.read_values(&lists.intersections, lists.capacity).unwrap();
        let ranges: Vec<[u32; 2]> = engine.read_values(&lists.ranges, view.tiles()).unwrap();
        let list = |&[begin, end]: &[u32; 2]| numbers[begin as usize..end as usize].to_vec();
        let counters = lists.take_counters::<u32>(engine, None).unwrap().0;
        (ranges.iter().map(list).collect(), counters)
    }
}

/// What the plan of 400 lists is, of which one is long, and once too long: what is counted, ranges and grids.
pub(crate) fn planned(engine: &Engine) -> Vec<u32> {
    let mut found = Vec::new();
    for longest in [5_000, 40_000] {
        let view = ViewPass { rows: 9, tiles_x: 400, tiles_y: 1, ..Default::default() };
        let mut lists = lists_for(engine, 60_000);
        lists.reserve(engine, &view).unwrap();
        lists.begin(engine, &view, None);
        let mut lengths: Vec<u32> = (0..400).map(|tile| scattered(tile) % 9).collect();
        lengths[310] = longest;
        engine.write(&lists.tallies, 0, &[9, lengths.iter().sum(), 0]);
        engine.write(&lists.tallies, 4 * u64::from(TALLIES), &lengths);
        let mut recorder = Recorder::new(engine, None);
        lists.record_plan(&mut recorder);
        recorder.submit();
        let counters = lists.take_counters::<u32>(engine, None).unwrap().0;
        found.extend([counters.halted, counters.visible, counters.intersections, counters.wanted]);
        found.extend(engine.read_values::<u32>(&lists.ranges, 800).unwrap());
        found.extend(engine.read_values::<u32>(&lists.grids, 9).unwrap());
    }
    found
}

#[test]
fn a_plan_says_where_lists_lie_and_how_large_grids_are() {
    let Some(engine) = engine() else { return };
    let found = planned(&engine);
    let (fits, too_long) = found.split_at(found.len() / 2);
    let sum: u32 = (0..400).filter(|&tile| tile != 310).map(|tile| scattered(tile) % 9).sum();
    assert_eq!(fits[..4], [0, 9, sum + 5_000, sum + 5_000]);
    assert_eq!(too_long[..4], [HALT_LONG_LIST, 9, 0, sum + 40_000]);
    assert_eq!(fits[4 + 799], sum + 5_000, "the last list ends where all do");
    let groups =
        |grids: &[u32]| -> Vec<u32> { grids.chunks(3).map(|grid| grid[0] * grid[1] * grid[2]).collect() };
    let grids = groups(&fits[804..]);
    let wanted = [(sum + 5_000).div_ceil(256), 400 + 5, 5];
    let covers = |(&groups, wanted): (&u32, u32)| (wanted..wanted + GRID_WIDTH).contains(&groups);
    assert!(grids.iter().zip(wanted).all(covers), "{grids:?}, not {wanted:?}");
    assert_eq!(groups(&too_long[804..]), [0, 0, 0]);
}

/// Buffers for exactly so many intersections.
fn lists_for(engine: &Engine, intersections: usize) -> Lists {
    let mut lists = Lists::new(engine, 4).unwrap();
    lists.wanted_capacity = Some(intersections as u64);
    lists
}

fn are_in_order(engine: &Engine, emitted: &Emitted) {
    let mut lists = lists_for(engine, emitted.intersections.len());
    let (found, counters) = emitted.lists_of(engine, &mut lists);
    assert_eq!((counters.halted, counters.visible), (0, emitted.depths.len() as u32));
    assert_eq!(counters.intersections as usize, emitted.intersections.len());
    assert!(found == emitted.expected(), "{:?} tiles", emitted.tiles);
}

#[test]
fn lists_of_every_length_around_a_block_are_in_order() {
    let Some(engine) = engine() else { return };
    for lengths in [
        vec![0],
        vec![1],
        vec![0, 2, 0, 3, 1],
        (0..70).collect(),
        vec![255, 256, 257, 511, 512, 513],
        vec![BLOCK - 1, BLOCK, BLOCK + 1, 2 * BLOCK, 2 * BLOCK + 1],
        vec![0, 5 * BLOCK + 7, 0, 3, 33 * BLOCK - BLOCK - 1, BLOCK],
    ] {
        // All depths differ, few do, none does.
        for depths in [u32::MAX, 5, 1] {
            are_in_order(&engine, &Emitted::of_lengths(&lengths, depths));
        }
    }
}

/// More tiles than the plan takes in one round, most of them empty or short.
#[test]
fn lists_of_many_tiles_are_in_order() {
    let Some(engine) = engine() else { return };
    let lengths: Vec<usize> = (0..9_000).map(|tile| scattered(tile) as usize % 7).collect();
    let mut emitted = Emitted::of_lengths(&lengths, 50);
    are_in_order(&engine, &emitted);
    emitted.tiles = [90, 100];
    are_in_order(&engine, &emitted);
}

/// What was counted in vain is listed as the splat that reaches nothing, once or often.
#[test]
fn splats_that_reach_nothing_come_last() {
    let Some(engine) = engine() else { return };
    let mut emitted = Emitted::of_lengths(&[20, BLOCK + 30], 4);
    emitted.intersections.iter_mut().step_by(9).for_each(|entry| entry[1] = u32::MAX);
    are_in_order(&engine, &emitted);
}

/// Lists of one tile beyond what one merge reaches, and beyond two: the device says so, and after that they
/// are sorted.
#[test]
fn a_list_that_no_merge_reaches_is_sorted_the_next_time() {
    let Some(engine) = engine() else { return };
    for (length, merges) in [(32 * BLOCK, 1), (32 * BLOCK + 1, 2), ((1 << 20) + 9, 3)] {
        let emitted = Emitted::of_lengths(&[3, length, 0, 2 * BLOCK], u32::MAX >> 8);
        let mut lists = lists_for(&engine, emitted.intersections.len());
        for _ in 1..merges {
            let (found, counters) = emitted.lists_of(&engine, &mut lists);
            assert_eq!((counters.halted, counters.intersections), (HALT_LONG_LIST, 0));
            assert!(found.iter().all(Vec::is_empty), "nothing is listed");
            assert!(lists.grow(&engine, &counters).unwrap());
        }
        let (found, counters) = emitted.lists_of(&engine, &mut lists);
        assert_eq!((counters.halted, lists.merges()), (0, merges));
        assert!(!lists.grow(&engine, &counters).unwrap());
        assert!(found == emitted.expected(), "{length} entries");
    }
}

/// In as many pieces as there are tile rows, and in a few.
#[test]
fn no_order_depends_on_how_work_is_split() {
    for most in [1, 20_000_000] {
        let Some(engine) = engine() else { return };
        let engine = engine.with_instructions(most);
        let lengths: Vec<usize> = (0..39).map(|tile| tile * tile).chain([35 * BLOCK]).collect();
        let emitted = Emitted { tiles: [2, 20], ..Emitted::of_lengths(&lengths, 999) };
        let mut lists = lists_for(&engine, emitted.intersections.len());
        lists.merges = 2;
        assert!(emitted.lists_of(&engine, &mut lists).0 == emitted.expected(), "{most} instructions");
        let submissions = engine.submissions.get();
        assert!(submissions > if most == 1 { 60 } else { 5 }, "{submissions} submissions");
    }
}

#[test]
fn pieces_are_as_few_as_they_may_be() {
    assert_eq!([pieces_of(0, 100, 5), pieces_of(100, 100, 5), pieces_of(101, 100, 5)], [1, 1, 2]);
    assert_eq!([pieces_of(u64::MAX, 1, 68), pieces_of(1000, 1, 1), pieces_of(7, 0, 0)], [68, 1, 1]);
}

#[test]
fn what_does_not_fit_is_not_listed_but_counted() {
    let Some(engine) = engine() else { return };
    let emitted = Emitted::of_lengths(&[10, 2000, 0, 30], 7);
    let mut lists = lists_for(&engine, 2040);
    // Exactly enough; one too few; more than 32 bits count.
    assert_eq!(emitted.lists_of(&engine, &mut lists).1.halted, 0);
    for (wanted, carry, expected) in [(2041, 0, 2041), (5, 1, u32::MAX)] {
        emitted.write(&engine, &lists);
        engine.write(&lists.tallies, 4, &[wanted, carry]);
        let mut recorder = Recorder::new(&engine, None);
        lists.record_order(&mut recorder, &emitted.view());
        recorder.submit();
        let counters = lists.take_counters::<u32>(&engine, None).unwrap().0;
        assert_eq!((counters.halted, counters.wanted), (HALT_OVERFLOW, expected));
        let ranges: Vec<[u32; 2]> = engine.read_values(&lists.ranges, 4).unwrap();
        assert_eq!(ranges, [[0; 2]; 4]);
    }
}

#[test]
fn merges_are_as_many_as_the_longest_list_needs() {
    assert_eq!([0, 1, 1024, 1025, 32_768, 32_769].map(merges_for), [0, 0, 0, 1, 1, 2]);
    assert_eq!([1 << 20, (1 << 20) + 1, 1 << 30, u64::MAX].map(merges_for), [2, 3, 4, 4]);
}
