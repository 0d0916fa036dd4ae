//! What a mask hides has no effect on anything, and what it leaves is as in the reference.

use std::sync::Arc;

use genesplat_core::{
    DensitySignal, Device, Held, Mask, Photo, ScreenFilter, StatisticsRequest, TrainStep, View,
};

use super::{backend_with, compare, compare_gradients, flat};
use crate::cpu::CpuBackend;
use crate::fixtures::{cloud, individual_of, masked_view, settings, step, view};
use genesplat_reference::{self as reference, Cloud64, Cutoff, Statistics64};

/// All that a backend can tell after some steps on `view`.
fn everything(view: View) -> String {
    let mut backend = CpuBackend::new();
    backend.set_views(&[view]).unwrap();
    backend.upload(cloud(300).into()).unwrap();
    let settings = settings(2, ScreenFilter::Classic);
    for number in 1..=5 {
        backend.train_step(&step(number, settings)).unwrap();
    }
    let individuals = [individual_of(&cloud(300), 1), individual_of(&cloud(300), 2)];
    let scores = backend.score(&individuals, &[0], &settings).unwrap();
    let measured = backend.measure(Held::Cloud, &[0], &settings).unwrap();
    let (state, report) = (backend.state().unwrap(), backend.report().unwrap());
    // Shortest texts that read back as the same number.
    format!("{state:?} {report:?} {scores:?} {measured:?}")
}

#[test]
fn what_is_behind_a_mask_changes_no_bit() {
    let masked = everything(masked_view(0));
    assert!(masked == everything(masked_view(255)) && !masked.contains("NaN"));
    assert!(masked != everything(view()), "the mask has an effect");
    let mut changed = masked_view(0);
    let mut photo = Photo::clone(&changed.photo.read().unwrap());
    photo.rgb[0] = !photo.rgb[0];
    changed.photo = photo.into();
    assert!(masked != everything(changed), "one value that counts is enough");
}

#[test]
fn masked_losses_gradients_and_statistics_match_the_reference() {
    let (cloud, settings, view) = (cloud(400), settings(2, ScreenFilter::Classic), masked_view(90));
    let (loss, expected) = reference::gradients(&Cloud64::from(&cloud), &view, &settings, Cutoff::Hard);
    for signal in [DensitySignal::Signed, DensitySignal::PixelWeighted { depth_threshold: 2.0 }] {
        let mut backend = backend_with(&cloud);
        backend.set_views(std::slice::from_ref(&view)).unwrap();
        let request = StatisticsRequest { density: Some(signal), genes: true };
        backend.train_step(&TrainStep { statistics: request, ..step(1, settings) }).unwrap();
        assert!((f64::from(backend.report().unwrap().loss) / loss - 1.0).abs() < 1e-5);
        let mut sums = Statistics64::zeros(400);
        sums.accumulate(&expected, &request);
        let actual = backend.statistics().unwrap();
        let of = |values: &[f32]| values.iter().map(|&value| f64::from(value)).collect::<Vec<_>>();
        assert_eq!(of(&actual.weight_sum), sums.weight_sum, "{signal:?}");
        compare("density", of(&actual.gradient_sum), sums.gradient_sum).unwrap();
        compare(
            "genes",
            flat(&actual.gene_gradient_sum),
            sums.gene_gradient_sum.as_flattened().iter().copied(),
        )
        .unwrap();
        // After one step, the first moments are a tenth of the gradients.
        let mut gradients = backend.state().unwrap().moments.first;
        scale(&mut gradients);
        compare_gradients(&gradients, &expected.cloud).unwrap();
    }
    let unmasked = reference::gradients(&Cloud64::from(&cloud), &super::view(), &settings, Cutoff::Hard).1;
    let seen = |radii: &[u32]| radii.iter().filter(|radius| **radius > 0).count();
    assert!(seen(&expected.radius_px) < seen(&unmasked.radius_px), "some lie behind the mask alone");
}

/// Pixel-GS weights each view by the pixels that say something of a Gaussian.
#[test]
fn a_pixel_counts_for_one_of_a_mask_and_its_opposite() {
    let pixels = |view: &View| {
        let (cloud, settings) = (Cloud64::from(&cloud(400)), settings(2, ScreenFilter::Classic));
        reference::gradients(&cloud, view, &settings, Cutoff::Hard).1.pixels
    };
    let masked = masked_view(90);
    let opposite =
        Mask { counts: masked.mask.as_ref().unwrap().counts.iter().map(|counts| !counts).collect() };
    let opposite = View { mask: Some(Arc::new(opposite)), ..view() };
    let [all, of_mask, of_opposite] = [view(), masked, opposite].map(|view| pixels(&view));
    assert!(all.iter().zip(of_mask.iter().zip(&of_opposite)).all(|(all, (a, b))| *all == a + b));
    assert!(of_mask.iter().sum::<u32>() > 100 && of_opposite.iter().sum::<u32>() > 100);
}

fn scale(gradients: &mut genesplat_core::Gaussians) {
    gradients.positions.as_flattened_mut().iter_mut().for_each(|value| *value *= 10.0);
    gradients.log_scales.as_flattened_mut().iter_mut().for_each(|value| *value *= 10.0);
    gradients.rotations.as_flattened_mut().iter_mut().for_each(|value| *value *= 10.0);
    gradients.opacity_logits.iter_mut().for_each(|value| *value *= 10.0);
    gradients.sh.as_flattened_mut().iter_mut().for_each(|value| *value *= 10.0);
}

#[test]
fn masked_scores_and_losses_are_those_of_renders() {
    let (cloud, settings, view) = (cloud(400), settings(2, ScreenFilter::Classic), masked_view(90));
    let mut backend = backend_with(&cloud);
    backend.set_views(std::slice::from_ref(&view)).unwrap();
    let mask = view.mask.clone().unwrap();
    let rendered =
        reference::render(&Cloud64::from(&cloud), &view.camera, &settings, Cutoff::Hard).picture.image;
    let (expected, _) = reference::loss_of_view(&rendered, &view);
    let score = f64::from(backend.score(&[Default::default()], &[0], &settings).unwrap()[0]);
    let measured = backend.measure(Held::Cloud, &[0], &settings).unwrap()[0];
    for value in [score, f64::from(measured.loss)] {
        assert!((value / expected - 1.0).abs() < 1e-5, "{value} instead of {expected}");
    }
    let photo = view.photo.read().unwrap();
    let squared = |(index, value): (usize, &f64)| {
        let (pixel, channel) = (index % mask.counts.len(), index / mask.counts.len());
        let photo = f64::from(photo.rgb[3 * pixel + channel]) / 255.0;
        if mask.counts[pixel] { (value - photo).powi(2) } else { 0.0 }
    };
    let mean = rendered.iter().enumerate().map(squared).sum::<f64>() / (3 * mask.counted()) as f64;
    assert!(
        (f64::from(measured.squared_error) / mean - 1.0).abs() < 1e-4,
        "{} {mean}",
        measured.squared_error
    );
}
