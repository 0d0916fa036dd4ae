//! A hundred individuals over a million Gaussians in less than half a gigabyte beyond the scene, both
//! generations alive during breeding included. Bytes are counted by the allocator, not only by the search
//! itself.

#![allow(unsafe_code, reason = "a counting allocator cannot be written without")]
#![allow(clippy::print_stdout, reason = "the measured bytes are worth reading")]

mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use common::{deltas, normal_base, small};
use genesplat_core::{Genes, Rng};
use genesplat_evolve::{GeneGradients, GeneticAlgorithm, GeneticConfig, Magnitude};

struct Counting;

static LIVE: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call is passed on unchanged; only sizes are counted. `realloc` and `alloc_zeroed` keep their
// defaults, which call these two.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let live = LIVE.fetch_add(layout.size(), Relaxed) + layout.size();
        PEAK.fetch_max(live, Relaxed);
        // SAFETY: the caller's contract is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        LIVE.fetch_sub(layout.size(), Relaxed);
        // SAFETY: the caller's contract is passed on.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// One test measures at a time.
static ALONE: Mutex<()> = Mutex::new(());

/// Most bytes alive at once during `work`, beyond those alive before.
fn peak_of<T>(work: impl FnOnce() -> T) -> (T, usize) {
    let before = LIVE.load(Relaxed);
    PEAK.store(before, Relaxed);
    let result = work();
    (result, PEAK.load(Relaxed) - before)
}

const HALF_A_GIGABYTE: usize = 500_000_000;

#[test]
fn a_hundred_individuals_over_a_million_gaussians() {
    let _alone = ALONE.lock();
    let n = 1_000_000usize;
    // Nearly seven times the paper's early rate, so that the few generations of this test hold what dozens of
    // the paper's would.
    let config = GeneticConfig { generations: 4, mutation_rates: [1.0; 3], ..GeneticConfig::default() };
    let (search, peak) = peak_of(|| {
        let base: Vec<Genes> = normal_base(1000).into_iter().cycle().take(n).collect();
        let gradients = GeneGradients { sum: base.clone(), views: vec![3; n] };
        let mut search =
            GeneticAlgorithm::new(config, base, Some(gradients), 1.0, Rng::new(1)).expect("valid settings");
        while !search.is_finished() {
            // Later generations are better, so that none descends from an elite; only a few individuals are
            // looked at.
            let looked_at: usize = deltas(&search, 0..3).iter().map(|delta| delta.rows.len()).sum();
            let losses: Vec<f64> = (0..search.ask()).map(|index| dummy(search.generation(), index)).collect();
            search.tell(&losses).expect("one loss each");
            println!(
                "generation {}: {:.0} MB at most, {} rows changed an individual",
                search.generation(),
                search.peak_population_bytes() as f64 / 1e6,
                looked_at / 3,
            );
        }
        search
    });
    println!("{:.0} MB at most by the allocator's count", peak as f64 / 1e6);
    assert!(peak < HALF_A_GIGABYTE, "{peak} bytes");
    assert!(search.peak_population_bytes() <= peak, "the search must not hide what it holds, nor invent it");
    // What the search's own count lacks: genomes in the making, and the deltas that were looked at.
    assert!(peak < search.peak_population_bytes() + 100_000_000, "{peak} {}", search.peak_population_bytes());
}

/// Losses that fall with the generation: the longest lines of descent, and so the densest individuals, that
/// there can be.
fn dummy(generation: u32, index: usize) -> f64 {
    0.9 - f64::from(generation) * 1e-3 + (index * 37 % 101) as f64 * 1e-6
}

/// All hundred generations of the paper, on a cloud small enough for a test; bytes are per Gaussian.
#[test]
fn a_whole_search_of_the_paper_stays_below_600_bytes_a_gaussian() {
    let _alone = ALONE.lock();
    let n = 8192;
    let config = GeneticConfig { magnitude: Magnitude::Unit, ..small(100, 100) };
    let (search, peak) = peak_of(|| {
        let base = normal_base(n);
        let mut search = GeneticAlgorithm::new(config, base, None, 1.0, Rng::new(1)).expect("valid settings");
        while !search.is_finished() {
            let losses: Vec<f64> = (0..search.ask()).map(|index| dummy(search.generation(), index)).collect();
            search.tell(&losses).expect("one loss each");
        }
        search
    });
    let (own, counted) = (search.peak_population_bytes() / n as usize, peak / n as usize);
    let changed = search.best().map_or(0.0, |best| best.rows.len() as f64 / f64::from(n));
    println!(
        "{own} bytes a Gaussian at most, {counted} by the allocator's count; {changed:.2} of the rows changed"
    );
    assert!(counted < 600, "{counted} bytes a Gaussian");
    // Every generation leaves a row as it is with probability 1 - f + f (1 - m)^3.
    let untouched = |rate: f64| 0.9 + 0.1 * (1.0 - rate).powi(3);
    let rates = [(0.03, 1), (0.15, 30), (0.05, 40), (0.02, 30)];
    let expected = 1.0 - rates.map(|(rate, times)| untouched(rate).powi(times)).iter().product::<f64>();
    assert!((expected - 0.856).abs() < 0.001, "{expected}");
    // Four and a half standard errors.
    let bound = 4.5 * (expected * (1.0 - expected) / f64::from(n)).sqrt();
    assert!((changed - expected).abs() < bound, "{changed}");
}
