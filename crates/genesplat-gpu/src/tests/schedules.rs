//! No result depends on the order in which the invocations of a workgroup run: else there is a race.
//!
//! A software driver runs a few invocations together up to the next barrier, then the next few. So what a
//! barrier should separate is read too early, or overwritten too early, by those who come first. The roles of
//! invocations are dealt out in other orders here, and results must be the same to the bit. Barriers are left
//! out one by one: that must be noticed.
//!
//! Kernels without subgroups, since those with them need roles to be neighbours; and with their loops, which
//! compile sooner. This driver waits for all invocations where a loop with a barrier ends, so what shows
//! nothing is tried once more with its loops written out, as devices get it.

use std::collections::HashMap;

use genesplat_core::{BackendError, Held};

use super::differentiable::{pattern, projected};
use super::evolution::map_of;
use super::*;
use crate::device::adapter::WORKGROUP_BYTES;
use crate::device::engine::Rewrite;
use crate::device::shaders::{Abilities, DIGIT_SCAN, SCAN_BLOCKS, Shader, kernel_texts};
use crate::device::unroll::unrolled;
use crate::device::{Grid, Recorder};
use crate::layout::{DIGITS, SCAN_BLOCK, SORT_BLOCK};

const PLAIN: Abilities = Abilities { subgroups: false, workgroup_bytes: WORKGROUP_BYTES };

const BARRIER: &str = "workgroupBarrier();";

/// Roles are dealt out by the number of an invocation with some bits flipped: as they are; the other way
/// round; in another order within vectors and among them.
const ORDERS: [u32; 3] = [0, 255, 0b0101_0110];

/// Blocks of a sort or of a prefix sum: more than a workgroup has invocations.
const BLOCKS: u32 = 300;

/// A kernel whose invocations have other roles.
fn reordered(text: &str, flipped: u32) -> String {
    let Some(main) = text.find("fn main(").filter(|_| text.contains("local_invocation_index) lane")) else {
        return text.to_owned();
    };
    let (before, main) = text.split_at(main);
    let (signature, body) = main.split_once('{').expect("main has a body");
    let signature = signature
        .replace("local_invocation_index) lane", "local_invocation_index) invocation")
        .replace("@builtin(local_invocation_id) local: vec3<u32>,", "");
    let place = if main.contains("local_invocation_id)") {
        "let local = vec2(lane % TILE, lane / TILE);"
    } else {
        ""
    };
    format!("{before}{signature}{{ let lane = invocation ^ {flipped}u; {place}{body}")
}

/// A kernel without one of its barriers.
fn without_barrier(text: &str, at: usize) -> String {
    [&text[..at], &text[at + BARRIER.len()..]].concat()
}

/// Barriers that no result here shows, by the kernel and the line before them.
///
/// Those of walks over blocks and tile rows are for the twin with subgroups: there the next sum of a subgroup
/// would overwrite what others have yet to read. Here a sum has a barrier of its own before it writes what
/// others read.
const UNNOTICED: [(&str, &str); 3] = [
    ("bin/scan_blocks", "before = saturating_add(before, group_sum());"),
    ("bin/digit_scan", "before += group_sum();"),
    ("bin/emit", "at += group_sum();"),
];

/// Bytes of text that tell a barrier from others.
const BEFORE: usize = 120;

/// Every barrier by the lines around it: the kernels that have it, and where.
fn barriers() -> HashMap<String, Vec<(&'static str, usize)>> {
    let mut found: HashMap<_, Vec<_>> = HashMap::new();
    for (name, text) in kernel_texts(PLAIN) {
        for (at, _) in text.match_indices(BARRIER) {
            let around = text[at - BEFORE..text.len().min(at + 120)].to_owned();
            found.entry(around).or_default().push((name, at));
        }
    }
    found
}

/// Values that differ from place to place.
fn numbers(count: u32) -> Vec<u32> {
    (0..count).map(|place| place.wrapping_mul(0x9e37_79b9) >> 20).collect()
}

/// What one kernel that walks all blocks makes of some numbers.
fn walked(gpu: &GpuBackend, shader: &'static Shader, block: u32, grid: u32) -> Vec<u32> {
    let engine = &gpu.engine;
    let lengths = engine.upload("lengths", &[BLOCKS * block]).unwrap();
    let values = engine.upload("values", &numbers(grid * (BLOCKS + 1))).unwrap();
    let totals = engine.upload("totals", &[0u32; DIGITS as usize]).unwrap();
    let parts = [lengths.all(), values.all(), totals.all()];
    let parts = if shader.name == DIGIT_SCAN.name { &parts[..] } else { &parts[..2] };
    let mut recorder = Recorder::new(engine, None);
    recorder.run_with(shader, &[("LENGTH", 0)], parts, Grid::Groups(grid.into()));
    recorder.submit();
    [
        engine.read_values(&values, (grid * (BLOCKS + 1)).into()).unwrap(),
        engine.read_values(&totals, 3).unwrap(),
    ]
    .concat()
}

/// Lists of several batches, and splats of many tiles.
fn crowd_with_wide_splats() -> Gaussians {
    let mut cloud = crowd(-1.0);
    for row in (0..CROWD).step_by(7) {
        cloud.log_scales[row] = [-1.5; 3];
    }
    cloud
}

/// The bits of what a kernel, and those that run with it, find. A race may ask for lists that no memory
/// holds.
fn results(gpu: &mut GpuBackend, kernel: &str) -> Result<Vec<u32>, BackendError> {
    let bits = |values: &[f32]| -> Vec<u32> { values.iter().map(|value| value.to_bits()).collect() };
    let settings = settings(3, ScreenFilter::Classic);
    gpu.upload(crowd_with_wide_splats().into())?;
    Ok(match kernel {
        "bin/scan_blocks" => walked(gpu, &SCAN_BLOCKS, SCAN_BLOCK, 1),
        "bin/digit_scan" => walked(gpu, &DIGIT_SCAN, SORT_BLOCK, 3),
        "blend/weight_sum" => bits(&gpu.blending_weights(&[0], &|_| map_of(&small_view()), &settings)?[0]),
        "blend/splat_sums" => {
            let camera = small_view().camera;
            let (_, splats) = projected(crowd_with_wide_splats(), &camera, settings.filter);
            let size = [camera.width, camera.height];
            let [by_image, by_left] = pattern(size.iter().product::<u32>() as usize);
            let sums = gpu.splats_backward(&splats, size, &by_image, &by_left)?;
            sums.iter().flat_map(|sums| bits(&[&sums.moments[..], &sums.rgb].concat())).collect()
        }
        "score/view_losses" => {
            let losses = gpu.measure(Held::Cloud, &[0], &settings)?;
            vec![losses[0].loss.to_bits(), losses[0].squared_error.to_bits()]
        }
        _ if kernel.starts_with("score/") => {
            let population: Vec<_> =
                (0..18).map(|index| individual_of(&crowd_with_wide_splats(), index % 6)).collect();
            bits(&gpu.score(&population, &[0], &settings)?)
        }
        _ => {
            let mut step = step(1, settings);
            step.statistics.density = Some(DensitySignal::Absolute);
            gpu.train_step(&step)?;
            let mut found = vec![gpu.report()?.loss.to_bits()];
            let state = gpu.state()?;
            for cloud in [&state.cloud, &state.moments.first, &state.moments.second] {
                found.extend(cloud.all_genes().as_flattened().iter().map(|value| value.to_bits()));
                found.extend(cloud.sh.as_flattened().iter().map(|value| value.to_bits()));
            }
            found
        }
    })
}

/// What a kernel finds when its roles are dealt out so, and its text is made anew; the others are as they
/// are.
fn results_of(
    gpu: &mut GpuBackend,
    kernel: &'static str,
    flipped: u32,
    renew: impl Fn(&str) -> String + 'static,
) -> Result<Vec<u32>, BackendError> {
    let rewrite: Rewrite =
        Box::new(move |name, text| if name == kernel { reordered(&renew(&text), flipped) } else { text });
    gpu.engine.set_rewrite(rewrite);
    results(gpu, kernel)
}

/// Whether a kernel without one of its barriers finds anything else.
fn is_noticed(gpu: &mut GpuBackend, kernel: &'static str, at: usize, expected: &[u32]) -> bool {
    let with_loops = move |text: &str| without_barrier(text, at);
    let written_out = move |text: &str| unrolled(&without_barrier(text, at));
    let differs = |found: Result<Vec<u32>, BackendError>| found.ok().as_deref() != Some(expected);
    ORDERS.iter().any(|&flipped| differs(results_of(gpu, kernel, flipped, with_loops)))
        || ORDERS.iter().any(|&flipped| differs(results_of(gpu, kernel, flipped, written_out)))
}

fn backend() -> Option<GpuBackend> {
    let mut gpu = GpuBackend::on(engine()?.without_subgroups()).unwrap();
    gpu.set_views(&[small_view()]).unwrap();
    Some(gpu)
}

#[test]
fn no_result_depends_on_the_order_of_invocations() {
    let Some(mut gpu) = backend() else { return };
    for (kernel, _) in kernel_texts(PLAIN).filter(|(_, text)| text.contains(BARRIER)) {
        let [expected, found @ ..] =
            ORDERS.map(|flipped| results_of(&mut gpu, kernel, flipped, str::to_owned).unwrap());
        assert!(found.iter().all(|found| *found == expected), "{kernel}");
    }
}

#[test]
fn every_missing_barrier_is_noticed() {
    let Some(mut gpu) = backend() else { return };
    if !gpu.engine.is_software {
        eprintln!(
            "skipped: a card runs many invocations in lockstep, where a barrier that is left out goes unnoticed"
        );
        return;
    }
    let mut expected = HashMap::new();
    let mut unnoticed = Vec::new();
    for (around, places) in barriers() {
        let is_noticed = places.iter().any(|&(kernel, at)| {
            let expected = expected
                .entry(kernel)
                .or_insert_with(|| results_of(&mut gpu, kernel, 0, str::to_owned).unwrap());
            is_noticed(&mut gpu, kernel, at, expected)
        });
        if !is_noticed {
            let before = &around[..BEFORE];
            let line = before.trim_end().lines().next_back().unwrap_or_default().trim();
            unnoticed.push((places[0].0, line.to_owned()));
        }
    }
    unnoticed.sort();
    let mut known = UNNOTICED.map(|(kernel, line)| (kernel, line.to_owned()));
    known.sort();
    assert_eq!(unnoticed, known);
}
