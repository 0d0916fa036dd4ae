//! Scores against the loss of the changed cloud, rendered in full. Both compute in f32, in different orders:
//! a loss may be off by 1e-6 of itself (seen: 4e-7), which is what a handful of roundings in the sums comes
//! to.

use fearless_simd::{Level, dispatch};
use genesplat_core::{
    Camera, Device, Edit, Gaussians, Image, Photo, RenderSettings, Renderer, ScreenFilter, SparseDelta, View,
};
use glam::DVec3;

use super::photo_loss::{PhotoLoss, Walk};
use super::pool;
use crate::cpu::loss::{PhotoRows, Target};
use crate::cpu::{CpuBackend, loss};
use crate::fixtures::{camera, change_rows, cloud, filters, individual_of, settings, uniform};

const TOLERANCE: f32 = 1e-6;

/// Loss of a picture that is not padded yet.
pub(crate) fn loss_of_image(level: Level, image: &Image, target: &Target) -> f32 {
    let photo_loss = PhotoLoss::new(level, target).unwrap();
    let layout = photo_loss.layout;
    let mut picture = vec![0.0; layout.len()];
    for (index, row) in image.planes.chunks_exact(target.width).enumerate() {
        let at = index / target.height * layout.plane() + layout.row(index % target.height);
        picture[at..at + target.width].copy_from_slice(row);
    }
    dispatch!(level, simd => photo_loss.loss(simd, &picture, &mut Walk::default()))
}

/// Two views of other sizes: neither is a multiple of a tile, a block or a vector.
fn views_of(sizes: [[u32; 2]; 2]) -> Vec<View> {
    let view = |(index, [width, height]): (usize, [u32; 2])| {
        let rgb = (0..3 * width * height).map(|i| (uniform(index + 9, i as usize) * 255.0) as u8).collect();
        let shift = DVec3::new(0.3, -0.2, 0.4) * index as f64;
        let camera = camera().resized(width, height);
        let camera_from_world_translation = camera.camera_from_world_translation + shift;
        let camera = Camera { camera_from_world_translation, ..camera };
        View {
            name: "test".into(),
            camera,
            photo: Photo { width, height, rgb }.into(),
            mask: None,
            depth: None,
        }
    };
    sizes.into_iter().enumerate().map(view).collect()
}

/// Scores the population, and compares with the plain way.
fn check(base: &Gaussians, population: &[SparseDelta], views: &[View], settings: &RenderSettings) {
    let mut backend = CpuBackend::new();
    backend.set_views(views).unwrap();
    backend.upload(base.clone().into()).unwrap();
    let numbers: Vec<usize> = (0..views.len()).rev().collect();
    let scores = backend.score(population, &numbers, settings).unwrap();
    for (individual, scores) in population.iter().zip(scores.chunks(views.len())) {
        let mut changed = CpuBackend::new();
        changed.upload(base.clone().into()).unwrap();
        changed.edit(Edit::Genes(individual)).unwrap();
        for (&view, &score) in numbers.iter().zip(scores) {
            let image = changed.render(&views[view].camera, settings).unwrap();
            let photo = PhotoRows::whole(&Target::from(&views[view])).unwrap();
            let plain = loss::loss(Level::new(), &image, &photo, None);
            assert!((score / plain - 1.0).abs() < TOLERANCE, "{score} instead of {plain}, view {view}");
        }
    }
    let first = scores.chunks(views.len()).map(|scores| scores[0]);
    assert!(first.collect::<Vec<_>>().windows(2).any(|pair| pair[0] != pair[1]), "individuals differ");
}

/// Opacities from faint (as after a reset: no pixel is finished) to opaque (most are).
fn cloud_of(n: usize, logit: f32) -> Gaussians {
    let mut cloud = cloud(n);
    cloud.opacity_logits.iter_mut().for_each(|value| *value = 0.3 * *value + logit);
    cloud
}

#[test]
fn scoring_equals_rendering_the_changed_cloud() {
    for filter in filters() {
        for logit in [-3.0, 0.0, 7.0] {
            let mut base = cloud_of(1500, logit);
            base.filter_3d = (filter == ScreenFilter::Mip).then(|| vec![0.02; 1500]);
            let population: Vec<SparseDelta> =
                (0..6).map(|individual| individual_of(&base, individual)).collect();
            check(&base, &population, &views_of([[75, 53], [310, 37]]), &settings(3, filter));
        }
    }
}

#[test]
fn every_size_and_background_is_scored() {
    let base = cloud_of(300, -2.0);
    let population: Vec<SparseDelta> = (0..4).map(|individual| individual_of(&base, individual)).collect();
    for (size, background) in
        [([1, 1], 0.0), ([5, 3], 1.0), ([16, 130], 0.5), ([64, 48], 0.0), ([161, 17], 1.0)]
    {
        let settings =
            RenderSettings { background: [background, 0.2, 0.7], ..settings(1, ScreenFilter::Classic) };
        check(&base, &population, &views_of([size, [33, 20]]), &settings);
    }
}

/// One change an individual: the nearest splats, the farthest, and some between.
#[test]
fn single_changes_are_scored_wherever_they_are() {
    for logit in [-4.0, 1.0] {
        let base = cloud_of(200, logit);
        let depth = |row: &usize| (1e6 * f64::from(base.positions[*row][2])) as i64;
        let mut rows: Vec<usize> = (0..base.len()).collect();
        rows.sort_by_key(depth);
        let some: Vec<usize> = rows[..70].iter().chain(&rows[180..]).copied().collect();
        let population: Vec<SparseDelta> = some
            .iter()
            .map(|&row| {
                change_rows(&base, [row].into_iter(), |row, genes| match row % 4 {
                    0 => genes[6] = 6.0,
                    1 => genes[6] = -9.0,
                    2 => genes[2] += 0.8,
                    _ => genes[3] += 0.5,
                })
            })
            .collect();
        check(&base, &population, &views_of([[75, 53], [33, 20]]), &settings(2, ScreenFilter::Classic));
    }
}

/// Narrow splats finish a few pixels and let the light of all others pass; what an individual puts behind
/// them is seen.
#[test]
fn what_comes_behind_a_block_that_is_finished_in_part_is_scored() {
    let mut base = Gaussians::zeros(5);
    for row in 0..5 {
        base.positions[row] = [0.0, 0.0, 2.0 + row as f32];
        base.log_scales[row] = [0.08f32.ln(); 3];
        base.rotations[row] = [1.0, 0.0, 0.0, 0.0];
        base.opacity_logits[row] = 12.0;
        base.sh[row][0] = 1.0;
    }
    base.positions[4][0] = 100.0;
    let wide = change_rows(&base, 4..5, |_, genes| {
        genes[0] = 0.0;
        genes[3..6].fill(0.5f32.ln());
    });
    check(
        &base,
        &[SparseDelta::default(), wide],
        &views_of([[75, 53], [33, 20]]),
        &settings(0, ScreenFilter::Classic),
    );
}

/// All rows change, their depth order is turned round, and splats that nobody saw appear.
#[test]
fn large_changes_are_scored() {
    let mut base = cloud_of(250, -1.0);
    base.opacity_logits.iter_mut().step_by(5).for_each(|logit| *logit = -9.0);
    let everything =
        |change: &dyn Fn(usize, &mut genesplat_core::Genes)| change_rows(&base, 0..base.len(), change);
    let population = [
        everything(&|_, genes| genes[2] = 4.0 - genes[2]),
        everything(&|_, genes| genes[6] = 0.5),
        everything(&|_, genes| genes[6] = -9.0),
        everything(&|_, genes| genes[6] = 9.0),
        everything(&|_, genes| (0..3).for_each(|k| genes[3 + k] += 1.0)),
        everything(&|row, genes| genes[0] += if row % 2 == 0 { 30.0 } else { 0.1 }),
    ];
    check(&base, &population, &views_of([[75, 53], [33, 20]]), &settings(3, ScreenFilter::Classic));
}

/// More individuals than share a pool, and than their pictures have room for.
#[test]
fn populations_of_several_pools_are_scored() {
    let base = cloud_of(60, -2.0);
    let population: Vec<SparseDelta> = (0..140)
        .map(|individual| {
            change_rows(&base, 0..60, |row, genes| genes[6] += (row * individual % 7) as f32 * 0.1)
        })
        .collect();
    check(&base, &population, &views_of([[33, 20], [20, 33]]), &settings(0, ScreenFilter::Classic));
    assert_eq!(pool::Pool::capacity(6), 128);
    assert_eq!(pool::Pool::capacity(10_000), 8);
    assert_eq!(pool::Pool::capacity(usize::MAX >> 20), 1);
}

#[test]
fn memory_grows_with_individuals_views_and_gaussians() {
    let bytes = |gaussians: usize, individuals: usize, views: usize| {
        let base = cloud_of(gaussians, -2.0);
        let population: Vec<SparseDelta> =
            (0..individuals).map(|individual| individual_of(&base, individual)).collect();
        let mut backend = CpuBackend::new();
        backend.set_views(&views_of([[75, 53], [64, 48]])).unwrap();
        backend.upload(base.into()).unwrap();
        assert_eq!(backend.scoring_bytes(), 0);
        backend.score(&population, &[0, 1][..views], &settings(1, ScreenFilter::Classic)).unwrap();
        backend.scoring_bytes()
    };
    let most = bytes(4000, 8, 2);
    assert!(most > bytes(2000, 8, 2) && most > bytes(4000, 4, 2) && most > bytes(4000, 8, 1));
}
