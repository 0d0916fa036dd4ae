//! What must hold for any input: no thread, no poison and no order of calls changes a result.

use std::io;
use std::sync::Arc;

use genesplat_core::device::copy_of;
use genesplat_core::{
    BackendError, Device, DeviceState, Edit, Gaussians, Held, PhotoStore, Renderer, RowEdit, ScreenFilter,
    SparseDelta, StatisticsRequest, StoredPhoto, TrainStep, View,
};

use super::{backend_with, classic_step, flat, mcmc_step};
use crate::cpu::CpuBackend;
use crate::fixtures::{
    camera, cloud, far_needles, filters, individual_of, masked_view, poisoned_cloud, settings, small_view,
    step, tall_view, view,
};

/// Photos that are not in memory, as far as a backend knows.
#[derive(Debug)]
struct Shelf(Vec<u8>);

impl PhotoStore for Shelf {
    fn read(&self, at: u64, out: &mut [u8]) -> io::Result<()> {
        let bytes = self.0.get(at as usize..at as usize + out.len());
        out.copy_from_slice(bytes.ok_or(io::ErrorKind::UnexpectedEof)?);
        Ok(())
    }
}

/// All that reads photos.
fn readings(views: &[View]) -> Result<String, BackendError> {
    let base = cloud(700);
    let (mut backend, settings) = (backend_with(&base), classic_step(1).settings);
    backend.set_views(views)?;
    backend.train_step(&classic_step(1))?;
    let scores = backend.score(&[individual_of(&base, 0)], &[0, 1], &settings)?;
    let measured = backend.measure(Held::Cloud, &[1, 0], &settings)?;
    Ok(format!("{:?} {scores:?} {measured:?}", backend.state()?))
}

#[test]
fn where_photos_are_changes_no_bit_and_one_that_is_lost_is_an_error() {
    let views = [masked_view(70), tall_view()];
    let on_a_shelf = |spare: usize| {
        let shelved = views.clone().map(|view| {
            let photo = view.photo.read().unwrap();
            let shelf = Shelf([vec![1; 5], photo.rgb[..photo.rgb.len() - spare].to_vec()].concat());
            View { photo: StoredPhoto::in_store(Arc::new(shelf), 5, photo.width, photo.height), ..view }
        });
        readings(&shelved)
    };
    assert!(on_a_shelf(0).unwrap() == readings(&views).unwrap());
    let sentence = on_a_shelf(1).unwrap_err().to_string();
    assert!(sentence.contains("cannot be read again"), "{sentence}");
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            // Several tasks of every stage: rows in chunks, ranks, tiles, strips of pixels.
            let mut backend = backend_with(&cloud(5000));
            backend.set_views(&[tall_view()]).unwrap();
            for number in 1..=5 {
                let mut step = classic_step(number);
                step.update.as_mut().unwrap().mcmc = (number % 2 == 0).then(|| mcmc_step(number));
                backend.train_step(&step).unwrap();
            }
            let mut edit = RowEdit::keep((0..650).collect());
            edit.push(3, genesplat_core::Origin::SplitChild { child: 0 });
            backend.edit(Edit::Rows(&edit)).unwrap();
            backend.train_step(&classic_step(6)).unwrap();
            let cloud = copy_of(&mut backend).unwrap();
            (cloud, backend.statistics().unwrap())
        })
    };
    let one = run(1);
    assert!(one == run(2) && one == run(7));
}

/// More views than some have threads, and more rows than a task looks through.
#[test]
fn what_evolution_asks_does_not_depend_on_the_number_of_threads() {
    let base = cloud(5000);
    let population: Vec<SparseDelta> = (0..4).map(|index| individual_of(&base, index)).collect();
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut backend = backend_with(&base);
            backend.set_views(&[view(), tall_view(), small_view()]).unwrap();
            backend.add_to_mean().unwrap();
            backend.train_step(&classic_step(1)).unwrap();
            let (views, settings) = ([0, 1, 2], classic_step(1).settings);
            let scores = backend.score(&population, &views, &settings).unwrap();
            let map_of =
                |index: usize| Ok(vec![0.5; [view(), tall_view(), small_view()][index].counted_pixels()]);
            let weights = backend.blending_weights(&views, &map_of, &settings).unwrap();
            let measured =
                [Held::Cloud, Held::Mean].map(|held| backend.measure(held, &views, &settings).unwrap());
            (scores, weights, measured)
        })
    };
    let one = run(1);
    assert!(one == run(2) && one == run(7));
}

#[test]
fn poison_never_reaches_a_pixel() {
    let cloud = poisoned_cloud();
    for filter in filters() {
        let mut backend = backend_with(&cloud);
        let image = backend.render(&camera(), &settings(3, filter)).unwrap();
        assert!(image.planes.iter().all(|v| v.is_finite()), "{filter:?}");
    }
}

/// Where a Gaussian exceeds its opacity, by rounding, it counts as its opacity.
#[test]
fn far_needles_leave_everything_finite() {
    let needles = far_needles();
    for filter in filters() {
        let mut backend = backend_with(&needles);
        let image = backend.render(&camera(), &settings(0, filter)).unwrap();
        assert!(image.planes.iter().all(|v| (0.0..10.0).contains(v)), "{filter:?}: the picture");
        backend.train_step(&step(1, settings(0, filter))).unwrap();
        let report = backend.report().unwrap();
        assert!(report.intersections > 100, "{filter:?}: few needles reach the picture");
        assert!(report.loss.is_finite(), "{filter:?}: the loss");
        let stepped = backend.download().unwrap();
        assert!(flat(&stepped.positions).all(f64::is_finite), "{filter:?}: positions");
        assert!(flat(&stepped.log_scales).all(f64::is_finite), "{filter:?}: scales");
        assert!(flat(&stepped.rotations).all(f64::is_finite), "{filter:?}: rotations");
        assert!(stepped.opacity_logits.iter().all(|v| v.is_finite()), "{filter:?}: opacities");
    }
}

/// One NaN anywhere in a row, and it is as if the row were not there.
#[test]
fn a_gaussian_with_a_nan_is_none() {
    let clean = cloud(60);
    let drawn =
        |cloud: &Gaussians, filter| backend_with(cloud).render(&camera(), &settings(3, filter)).unwrap();
    for filter in filters() {
        let mut shown = 0;
        for parameter in 0..12 {
            let row = 3 * parameter + 2;
            let (mut poisoned, mut without) = (clean.clone(), clean.clone());
            without.positions[row] = [0.0, 0.0, -1e6];
            match parameter {
                0..3 => poisoned.positions[row][parameter] = f32::NAN,
                3..6 => poisoned.log_scales[row][parameter - 3] = f32::NAN,
                6..10 => poisoned.rotations[row][parameter - 6] = f32::NAN,
                10 => poisoned.opacity_logits[row] = f32::NAN,
                _ => poisoned.sh[row][7] = f32::NAN,
            }
            let expected = drawn(&without, filter);
            assert_eq!(drawn(&poisoned, filter), expected, "{filter:?}, parameter {parameter}");
            shown += usize::from(expected != drawn(&clean, filter));
        }
        assert!(shown > 4, "{filter:?}: rows must show for this to mean anything");
    }
}

#[test]
fn an_empty_cloud_and_a_single_pixel_are_rendered() {
    let mut backend = CpuBackend::new();
    backend.upload(DeviceState::default().into()).unwrap();
    let settings = settings(0, ScreenFilter::Classic);
    let image = backend.render(&camera(), &settings).unwrap();
    assert_eq!(image.pixel(3, 4), settings.background);
    let tiny = camera().resized(1, 1);
    backend.upload(cloud(50).into()).unwrap();
    assert_eq!(backend.render(&tiny, &settings).unwrap().planes.len(), 3);
}

/// As a run does that was saved and is resumed: parameters, moments, sums and the mean.
#[test]
fn a_state_that_is_uploaded_goes_on_as_the_one_it_was_taken_from() {
    let mut first = backend_with(&cloud(300));
    first.train_step(&classic_step(1)).unwrap();
    first.add_to_mean().unwrap();
    first.train_step(&classic_step(2)).unwrap();
    let statistics = StatisticsRequest::default();
    first
        .train_step(&TrainStep { update: None, keeps_gradients: true, statistics, ..classic_step(3) })
        .unwrap();
    let saved = first.state().unwrap();
    assert!(
        saved.moments.pending.opacity_logits.iter().any(|&sum| sum != 0.0),
        "gradients wait for the next step"
    );
    assert!(saved.mean.states() == 1 && saved.statistics.gene_views.contains(&2));
    let mut second = backend_with(&cloud(10));
    second.upload(saved.clone().into()).unwrap();
    assert_eq!(second.state().unwrap(), saved);
    for backend in [&mut first, &mut second] {
        backend.train_step(&classic_step(3)).unwrap();
    }
    assert!(second.state().unwrap() == first.state().unwrap());

    second.edit(Edit::ForgetGeneGradients).unwrap();
    let (before, after) = (first.statistics().unwrap(), second.statistics().unwrap());
    assert!(after.gene_gradient_sum.is_empty() && after.gene_views.is_empty());
    assert_eq!((after.gradient_sum, after.weight_sum), (before.gradient_sum, before.weight_sum));
}

/// Moments are those of a new cloud then, and the mean is empty; the cloud and its sums stay.
#[test]
fn a_cloud_whose_training_has_ended_is_a_new_one() {
    let mut backend = stepped();
    backend.add_to_mean().unwrap();
    let before = backend.state().unwrap();
    backend.end_training().unwrap();
    let new = DeviceState { statistics: before.statistics, ..before.cloud.into() };
    let mut uploaded = backend_with(&cloud(10));
    uploaded.upload(new.into()).unwrap();
    assert_eq!(backend.state().unwrap(), uploaded.state().unwrap());
}

/// The mean goes with the rows and opacities that it is of.
#[test]
fn edits_and_resets_empty_the_mean() {
    let mut backend = backend_with(&cloud(20));
    let changes: [fn(&mut CpuBackend); 4] = [
        |backend| backend.drop_mean(),
        |backend| backend.edit(Edit::Rows(&RowEdit::keep(vec![1, 5, 7]))).unwrap(),
        |backend| backend.edit(Edit::OpacityCeiling(0.01)).unwrap(),
        |backend| backend.take_mean().unwrap(),
    ];
    for change in changes {
        backend.add_to_mean().unwrap();
        assert_eq!(backend.state().unwrap().mean.states(), 1);
        change(&mut backend);
        assert_eq!(backend.state().unwrap().mean.states(), 0);
    }
}

/// After three steps, so that every moment is there.
fn stepped() -> CpuBackend {
    let mut backend = backend_with(&cloud(40));
    (1..=3).for_each(|number| backend.train_step(&classic_step(number)).unwrap());
    backend
}

/// Adam would push opacities on in the direction that the reset has just taken back.
#[test]
fn a_reset_zeroes_the_moments_of_opacities_and_no_others() {
    let mut backend = stepped();
    let before = backend.state().unwrap().moments;
    backend.edit(Edit::OpacityCeiling(0.01)).unwrap();
    let after = backend.state().unwrap();
    assert!(after.cloud.opacity_logits.iter().all(|&logit| logit <= (0.01f32 / 0.99).ln() + 1e-5));
    for (before, after) in [(before.first, after.moments.first), (before.second, after.moments.second)] {
        assert!(before.opacity_logits.iter().any(|&moment| moment != 0.0), "there was something to zero");
        let expected = Gaussians { opacity_logits: vec![0.0; before.len()], ..before };
        assert_eq!(after, expected);
    }
}

#[test]
fn changed_genes_keep_their_moments_and_the_mean() {
    let mut backend = stepped();
    backend.add_to_mean().unwrap();
    let before = backend.state().unwrap();
    let delta = SparseDelta { rows: vec![3, 8], genes: vec![[0.5; 7]; 2] };
    backend.edit(Edit::Genes(&delta)).unwrap();
    let after = backend.state().unwrap();
    assert_eq!([3, 8].map(|row| after.cloud.genes(row)), [[0.5; 7]; 2]);
    assert_eq!((after.moments, after.mean), (before.moments, before.mean));
}
