//! `genesplat devices --test`: does a graphics device find what the CPU finds? Every verb of training, on a
//! bundled scene, with the bounds that tests on the software driver have.

use std::sync::atomic::AtomicBool;
use std::time::Instant;

use anyhow::{Result, ensure};
use genesplat::core::{
    BackendError, DensitySignal, DeviceState, Edit, Gaussians, Held, LearningRates, RenderSettings,
    SparseDelta, StatisticsRequest, TrainStep, Update,
};
use genesplat::gallery::{self, GalleryOptions};
use genesplat::io::{HoldOut, Scene};
use genesplat::kernels::cpu::CpuBackend;
use genesplat::run::device::{self, Device, DeviceChoice};
use genesplat::terminal::output;
use genesplat::train::{MethodName, Silent, Start, TrainConfig, train};

const GALLERY: GalleryOptions = GalleryOptions { width: 128, height: 96, views: 8, points: 1500, seed: 3 };
/// Steps of the CPU that make Gaussians of all shapes from the points.
const STEPS_BEFORE: u32 = 200;
/// Steps that both make side by side.
const STEPS: u32 = 32;
const SETTINGS: RenderSettings = RenderSettings {
    sh_degree: 3,
    background: [0.1, 0.2, 0.3],
    filter: genesplat::core::ScreenFilter::Classic,
    channels: genesplat::core::Channels::Rgb,
};

/// What both are asked for, and the largest relative L2 distance of their answers. They round differently,
/// and 32 steps make more of that (1.6e-4 seen).
const VERBS: [(&str, &str, f64, Verb); 9] = [
    ("pictures", "project, bin, rasterise", 1e-4, pictures),
    ("losses", "loss", 1e-5, losses),
    ("gradients", "rasterise_backward, project_backward", 1e-3, gradients),
    ("statistics", "of growth and of the search", 1e-3, statistics),
    ("steps", "Adam", 1e-2, steps),
    ("scores", "individuals of the search", 1e-5, scores),
    ("weights", "of each Gaussian in a photo", 1e-4, weights),
    ("edits", "a reset of opacities", 1e-4, edits),
    ("average", "of states", 1e-2, average),
];

type Verb = fn(&mut Device, &Scene) -> Result<Vec<f32>, BackendError>;

/// Tests the device that `choice` means, and says what each comparison came to.
pub(crate) fn run(choice: DeviceChoice) -> Result<()> {
    let clock = Instant::now();
    let mut tested = device::open(choice)?;
    let mut cpu: Device = Box::new(CpuBackend::new());
    output::print(&format!("testing {} against the CPU:", tested.describe()))?;
    let scene = gallery::generate(&GALLERY).into_scene(HoldOut::EveryEighth);
    let cloud = trained_cloud(&scene)?;
    let wrong = compare_all(&mut tested, &mut cpu, &scene, &cloud)?;
    let seconds = clock.elapsed().as_secs_f64();
    ensure!(
        wrong == 0,
        "{} is wrong in {wrong} of {} comparisons: train with --device cpu, and please report the lines above with the version of \
         the driver (genesplat devices)",
        tested.describe(),
        VERBS.len() + 1
    );
    output::print(&format!("all is well, after {seconds:.0} s: {} can be trusted", tested.describe()))
}

fn trained_cloud(scene: &Scene) -> Result<Gaussians> {
    let config = TrainConfig { iterations: STEPS_BEFORE, ..TrainConfig::of(MethodName::ThreeDgs) };
    let start = Start::Points(scene.points.iter().map(|point| (point.position, point.rgb)).collect());
    let stop = AtomicBool::new(false);
    let outcome = train(&mut CpuBackend::new(), &scene.train, start, &config.resolve()?, &mut Silent, &stop)?;
    Ok(outcome.cloud)
}

/// How many comparisons failed.
fn compare_all(tested: &mut Device, cpu: &mut Device, scene: &Scene, cloud: &Gaussians) -> Result<usize> {
    let mut wrong = 0;
    for (what, stages, bound, verb) in VERBS {
        let [found, expected] = [&mut *tested, &mut *cpu].map(|device| answer(device, scene, cloud, verb));
        let distance = distance(&found?, &expected?);
        wrong += usize::from(!is_within(distance, bound));
        output::print(&line(what, stages, distance, bound))?;
    }
    let [once, again] = [(); 2].map(|()| answer(tested, scene, cloud, steps));
    let repeats = once?.iter().map(|value| value.to_bits()).eq(again?.iter().map(|value| value.to_bits()));
    output::print(&format!(
        "  {:<11} {}",
        "repeats",
        if repeats { "the same bits twice" } else { "WRONG: other bits" }
    ))?;
    Ok(wrong + usize::from(!repeats))
}

fn answer(
    device: &mut Device,
    scene: &Scene,
    cloud: &Gaussians,
    verb: Verb,
) -> Result<Vec<f32>, BackendError> {
    device.set_views(&scene.train)?;
    device.upload(DeviceState::from(cloud.clone()).into())?;
    verb(device, scene)
}

fn line(what: &str, stages: &str, distance: f64, bound: f64) -> String {
    let verdict = if is_within(distance, bound) { "as the CPU" } else { "WRONG" };
    format!("  {what:<11} {verdict}: {distance:.1e} away, at most {bound:.0e} is rounding ({stages})")
}

/// A distance that is no number is not within anything.
fn is_within(distance: f64, bound: f64) -> bool {
    distance <= bound
}

/// Relative L2 distance; infinite where the lengths differ.
fn distance(found: &[f32], expected: &[f32]) -> f64 {
    if found.len() != expected.len() {
        return f64::INFINITY;
    }
    let square = |value: f64| value * value;
    let apart = found.iter().zip(expected).map(|(&a, &b)| square(f64::from(a) - f64::from(b)));
    let length: f64 = expected.iter().map(|&value| square(f64::from(value))).sum();
    (apart.sum::<f64>() / length.max(f64::MIN_POSITIVE)).sqrt()
}

fn flat(cloud: &Gaussians) -> Vec<f32> {
    [
        cloud.positions.as_flattened(),
        cloud.log_scales.as_flattened(),
        cloud.rotations.as_flattened(),
        &cloud.opacity_logits,
        cloud.sh.as_flattened(),
    ]
    .concat()
}

fn pictures(device: &mut Device, scene: &Scene) -> Result<Vec<f32>, BackendError> {
    let mut values = Vec::new();
    for view in &scene.test {
        values.extend(device.render(&view.camera, &SETTINGS)?.planes);
    }
    Ok(values)
}

fn losses(device: &mut Device, _: &Scene) -> Result<Vec<f32>, BackendError> {
    let losses = device.measure(Held::Cloud, &[0, 1, 2], &SETTINGS)?;
    Ok(losses.iter().flat_map(|view| [view.loss, view.squared_error]).collect())
}

/// A step that changes nothing, and keeps its gradients.
fn looking(view: usize) -> TrainStep {
    let statistics = StatisticsRequest { density: Some(DensitySignal::Absolute), genes: true };
    TrainStep { view, settings: SETTINGS, depth_weight: 0.0, update: None, keeps_gradients: true, statistics }
}

fn gradients(device: &mut Device, _: &Scene) -> Result<Vec<f32>, BackendError> {
    device.train_step(&looking(1))?;
    Ok(flat(&device.state()?.moments.pending))
}

fn statistics(device: &mut Device, _: &Scene) -> Result<Vec<f32>, BackendError> {
    device.train_step(&looking(1))?;
    let sums = device.statistics()?;
    Ok([&*sums.gradient_sum, &*sums.weight_sum, sums.gene_gradient_sum.as_flattened()].concat())
}

/// Rates of 3DGS for a scene of extent one.
fn step(step: u32, views: usize) -> TrainStep {
    let rates = LearningRates {
        position: 1.6e-4,
        position_reach: Some(0.1),
        sh_dc: 2.5e-3,
        sh_rest: 1.25e-4,
        opacity: 0.025,
        scale: 5e-3,
        rotation: 1e-3,
    };
    let update = Some(Update { rates, step, opacity_step: step, mcmc: None });
    TrainStep { update, keeps_gradients: false, ..looking(step as usize % views) }
}

/// How far every parameter is moved.
fn steps(device: &mut Device, _: &Scene) -> Result<Vec<f32>, BackendError> {
    moved(device, |device| (1..=STEPS).try_for_each(|number| device.train_step(&step(number, 4))))
}

/// What `change` adds to every parameter.
fn moved(
    device: &mut Device,
    change: impl FnOnce(&mut Device) -> Result<(), BackendError>,
) -> Result<Vec<f32>, BackendError> {
    let before = flat(&device.state()?.cloud);
    change(device)?;
    let after = flat(&device.state()?.cloud);
    Ok(after.iter().zip(&before).map(|(after, before)| after - before).collect())
}

fn scores(device: &mut Device, _: &Scene) -> Result<Vec<f32>, BackendError> {
    let genes = device.genes()?;
    let individual = |every: usize| {
        let rows: Vec<u32> = (0..genes.len()).step_by(every).map(|row| row as u32).collect();
        let moved = rows.iter().map(|&row| genes[row as usize].map(|gene| gene + 0.05)).collect();
        SparseDelta { rows, genes: moved }
    };
    device.score(&[SparseDelta::default(), individual(3), individual(7)], &[0, 2], &SETTINGS)
}

fn weights(device: &mut Device, _: &Scene) -> Result<Vec<f32>, BackendError> {
    let pixels = (GALLERY.width * GALLERY.height) as usize;
    Ok(device.blending_weights(&[0, 3], &|_| Ok(vec![1.0; pixels]), &SETTINGS)?.concat())
}

fn edits(device: &mut Device, scene: &Scene) -> Result<Vec<f32>, BackendError> {
    device.edit(Edit::OpacityCeiling(0.1))?;
    pictures(device, scene)
}

fn average(device: &mut Device, _: &Scene) -> Result<Vec<f32>, BackendError> {
    moved(device, |device| {
        for number in 1..=STEPS {
            device.train_step(&step(number, 4))?;
            device.add_to_mean()?;
        }
        device.take_mean()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn twin() -> Device {
        Box::new(CpuBackend::new())
    }

    #[test]
    fn a_device_that_is_right_passes_and_another_cloud_fails_in_every_line() {
        let scene = gallery::generate(&GALLERY).into_scene(HoldOut::EveryEighth);
        let cloud = trained_cloud(&scene).unwrap();
        assert_eq!(compare_all(&mut twin(), &mut twin(), &scene, &cloud).unwrap(), 0);
        let mut other = cloud.clone();
        other.positions.iter_mut().for_each(|position| position[0] += 0.01);
        for (what, _, bound, verb) in VERBS {
            let [found, expected] =
                [&other, &cloud].map(|cloud| answer(&mut twin(), &scene, cloud, verb).unwrap());
            assert!(!is_within(distance(&found, &expected), bound), "{what} does not notice");
        }
    }

    #[test]
    fn what_is_no_number_is_wrong() {
        assert!(is_within(distance(&[1.0, 2.0], &[1.0, 2.0]), 0.0));
        for found in [&[1.0, f32::NAN][..], &[1.0], &[1.0, 2.1]] {
            assert!(!is_within(distance(found, &[1.0, 2.0]), 1e-3), "{found:?}");
        }
        assert!(line("pictures", "project", f64::NAN, 1e-3).contains("WRONG"));
    }
}
