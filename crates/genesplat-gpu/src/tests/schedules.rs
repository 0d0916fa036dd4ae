//! No result depends on the order in which the invocations of a workgroup run: else there is a race.
//!
//! A software driver runs a few invocations together up to the next barrier, then the next few. So what a
//! barrier should separate is read too early, or overwritten too early, by those who come first. The roles of
//! invocations are dealt out in other orders here, and results must be the same to the bit. Barriers are left
//! out one by one: that must be noticed.
//!
//! Kernels have their loops here, which compile sooner. This driver waits for all invocations where a loop
//! with a barrier ends, so what shows nothing is tried once more with its loops written out, as devices get
//! it.

use std::collections::HashMap;

use genesplat_core::{BackendError, Held};

use super::differentiable::{pattern, projected};
use super::evolution::map_of;
use super::*;
use crate::device::adapter::WORKGROUP_BYTES;
use crate::device::engine::Rewrite;
use crate::device::shaders::{Abilities, kernel_texts};
use crate::device::unroll::unrolled;
use crate::stages::order::tests::planned;

const PLAIN: Abilities = Abilities { workgroup_bytes: WORKGROUP_BYTES };

const BARRIER: &str = "workgroupBarrier();";

/// Roles are dealt out by the number of an invocation with some bits flipped: as they are; the other way
/// round; in another order within vectors and among them.
const ORDERS: [u32; 3] = [0, 255, 0b0101_0110];

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
        "bin/plan_lists" => planned(&gpu.engine),
        "blend/weight_sum" => bits(&gpu.blending_weights(&[0], &|_| map_of(&small_view()), &settings)?[0]),
        "blend/splat_sums" => {
            let camera = small_view().camera;
            let (_, splats) = projected(crowd_with_wide_splats(), &camera, settings.filter);
            let size = [camera.width, camera.height];
            let [by_image, by_left] = pattern(size.iter().product::<u32>() as usize);
            let sums = gpu.splats_backward(&splats, size, &by_image, &by_left)?;
            sums.iter().flat_map(|sums| bits(&[&sums.moments[..], &sums.rgb].concat())).collect()
        }
        "loss/depth_loss" => {
            gpu.train_step(&depth_step(1, settings))?;
            vec![gpu.report()?.loss.to_bits()]
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
            let report = gpu.report()?;
            let mut found = vec![report.loss.to_bits(), report.visible as u32, report.intersections as u32];
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
    let mut gpu = GpuBackend::on(engine()?).unwrap();
    gpu.set_views(&[small_view(), depth_view()]).unwrap();
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
    assert!(unnoticed.is_empty(), "{unnoticed:?}");
}
