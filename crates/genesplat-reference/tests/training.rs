//! The reference's loss, statistics and optimiser against values computed by hand.

mod support;

use genesplat_core::backend::McmcStep;
use genesplat_core::{
    Camera, DensitySignal, LearningRates, Photo, RenderSettings, Rng, StatisticsRequest, Stream, Update,
};
use genesplat_reference::{
    Cloud64, Cutoff, Gradients, Moments64, Statistics64, adam, backward, loss, render,
};
use support::*;

fn planes(photo: &Photo) -> Vec<f64> {
    (0..3).flat_map(|c| photo.rgb.iter().skip(c).step_by(3).map(|v| f64::from(*v) / 255.0)).collect()
}

#[test]
fn identical_images_cost_nothing() {
    let photo = random_photo(19, 13, 1);
    let image = planes(&photo);
    let (value, gradient) = loss(&image, &photo);
    assert!(value.abs() < 1e-12, "{value}");
    assert!(gradient.iter().all(|g| g.abs() < 1e-12));
    let (ssim, _) = loss::ssim(&image, &image, [19, 13]);
    assert!((ssim - 1.0).abs() < 1e-12);
}

/// One pixel: the window's other taps see zeros, so the moments are w0² times the values, w0² the centre
/// tap's weight.
#[test]
fn the_loss_of_one_pixel_by_hand() {
    let photo = Photo { width: 1, height: 1, rgb: vec![102; 3] };
    let (x, y) = (0.9f64, 0.4f64);
    let weights: f64 = (-5..=5).map(|offset: i32| (-f64::from(offset * offset) / 4.5).exp()).sum();
    let w = 1.0 / (weights * weights);
    let (mu_x, mu_y) = (w * x, w * y);
    let covariance = w * x * y - mu_x * mu_y;
    let variances = w * (x * x + y * y) - mu_x * mu_x - mu_y * mu_y;
    let ssim = (2.0 * mu_x * mu_y + 1e-4) * (2.0 * covariance + 9e-4)
        / ((mu_x * mu_x + mu_y * mu_y + 1e-4) * (variances + 9e-4));
    let (value, _) = loss(&[x; 3], &photo);
    assert!((value - (0.8 * 0.5 + 0.2 * (1.0 - ssim))).abs() < 1e-7, "{value}");
}

/// Ten pixels from every border, two constant images differ in luminance only: a pixel's gradient is the
/// slope of the luminance term, whose share in its neighbours' windows adds up to one.
#[test]
fn ssim_of_constant_images_in_the_interior() {
    let (side, at) = (41usize, 20 * 41 + 20);
    let (a, b) = (0.6f64, 0.4f64);
    let (_, gradient) = loss::ssim(&vec![a; 3 * side * side], &vec![b; 3 * side * side], [41, 41]);
    let luminance = |a: f64| (2.0 * a * b + 1e-4) / (a * a + b * b + 1e-4);
    let slope = (luminance(a + 1e-6) - luminance(a - 1e-6)) / 2e-6;
    let expected = slope / (3 * side * side) as f64;
    assert!((gradient[at] - expected).abs() < 1e-6 * expected.abs(), "{} vs {expected}", gradient[at]);
}

#[test]
fn the_subgradient_at_zero_is_zero() {
    let (value, gradient) = loss::l1(&[0.5, 0.7, 0.1], &[0.5, 0.4, 0.2]);
    assert!((value - 0.4 / 3.0).abs() < 1e-15);
    assert_eq!(gradient, [0.0, 1.0 / 3.0, -1.0 / 3.0]);
}

/// Three round splats of known size: one alone, one behind an almost opaque wall, one off the screen.
fn three_splats() -> Cloud64 {
    let mut cloud = Cloud64::default();
    push(&mut cloud, [0.0, 0.0, 2.0], 0.1, 0.9, [0.9, 0.1, 0.1]);
    push(&mut cloud, [0.0, 0.0, 4.0], 0.2, 0.9, [0.1, 0.9, 0.1]);
    push(&mut cloud, [50.0, 0.0, 2.0], 0.1, 0.9, [0.1, 0.1, 0.9]);
    cloud
}

fn gradients_of(cloud: &Cloud64, image_gradient: f64) -> Gradients {
    let (camera, settings) = (straight_camera(), RenderSettings::default());
    let rendered = render(cloud, &camera, &settings, Cutoff::Hard);
    let by_image = vec![image_gradient; rendered.picture.image.len()];
    backward(cloud, &camera, &settings, Cutoff::Hard, &rendered, &by_image)
}

/// Both visible splats are 1 px wide on the screen (20 · 0.1 / 2 = 20 · 0.2 / 4), variance 1.3 px². They
/// touch the lattice points within r² = 2 · 1.3 · ln(0.9 · 255) = 14.14, i.e. r = 3.76: 45 of them.
#[test]
fn pixel_counts_by_hand() {
    let gradients = gradients_of(&three_splats(), 0.01);
    let lattice =
        (-4..=4i32).flat_map(|x| (-4..=4i32).map(move |y| x * x + y * y)).filter(|r2| *r2 <= 14).count();
    assert_eq!(lattice, 45);
    assert_eq!(gradients.pixels, [45, 45, 0]);
    assert_eq!(gradients.depth[..2], [2.0, 4.0]);
    assert!(gradients.radius_px[0] > 0 && gradients.radius_px[1] > 0 && gradients.radius_px[2] == 0);
    assert!(gradients.cloud.positions[2].iter().all(|g| *g == 0.0));
}

/// The splat that would finish a pixel is not counted there.
#[test]
fn hidden_pixels_do_not_count() {
    let mut cloud = Cloud64::default();
    for z in [2.0, 2.1, 2.2] {
        push(&mut cloud, [0.0, 0.0, z], 0.05 * z, 0.98, [0.5; 3]);
    }
    // All three 1 px wide: 0.02³ < 1e-4 at the centre. One pixel off, alpha is 0.98 exp(-1/2.6) = 0.667 each,
    // and
    // 0.333³ > 1e-4: only the centre is lost.
    let counts = gradients_of(&cloud, 0.01).pixels;
    assert_eq!(counts[0], counts[1]);
    assert_eq!(counts[2], counts[0] - 1);
}

/// One pixel under a splat of opacity 0.995: alpha is 0.99, but the gradient is that of 0.995.
#[test]
fn the_clamp_of_alpha_passes_gradients_straight_through() {
    let camera = Camera { width: 1, height: 1, principal_px: [0.5, 0.5], ..straight_camera() };
    let mut cloud = Cloud64::default();
    push(&mut cloud, [0.0, 0.0, 2.0], 0.1, 0.995, [0.75; 3]);
    let settings = RenderSettings { background: [0.25; 3], ..RenderSettings::default() };
    let rendered = render(&cloud, &camera, &settings, Cutoff::Hard);
    assert!((rendered.picture.transmittance[0] - 0.01).abs() < 1e-7);
    let gradients = backward(&cloud, &camera, &settings, Cutoff::Hard, &rendered, &[1.0, 0.0, 0.0]);
    assert!((gradients.cloud.opacity_logits[0] - 0.5 * 0.995 * 0.005).abs() < 1e-12);
}

#[test]
fn density_signals_by_hand() {
    let mut gradients = gradients_of(&three_splats(), 0.01);
    gradients.mean2d_ndc = vec![[3.0, -4.0], [0.0, 2.0], [9.0, 9.0]];
    gradients.mean2d_abs_ndc = vec![[5.0, 12.0], [0.0, 3.0], [9.0, 9.0]];
    let sums = |density| {
        let mut statistics = Statistics64::zeros(3);
        let request = StatisticsRequest { density: Some(density), genes: false };
        statistics.accumulate(&gradients, &request);
        statistics.accumulate(&gradients, &request);
        assert!(statistics.gene_views.iter().all(|views| *views == 0));
        (statistics.gradient_sum, statistics.weight_sum)
    };
    // The third splat is off the screen: no view counts for it, whatever its gradient.
    assert_eq!(sums(DensitySignal::Signed), (vec![10.0, 4.0, 0.0], vec![2.0, 2.0, 0.0]));
    assert_eq!(sums(DensitySignal::Absolute), (vec![26.0, 6.0, 0.0], vec![2.0, 2.0, 0.0]));
    // Depth 2 is half the threshold: a quarter of the signal; depth 4 is at it. 45 pixels each.
    let (gradient, weight) = sums(DensitySignal::PixelWeighted { depth_threshold: 4.0 });
    assert_eq!(gradient, [2.0 * 45.0 * 5.0 / 4.0, 2.0 * 45.0 * 2.0, 0.0]);
    assert_eq!(weight, [90.0, 90.0, 0.0]);
}

#[test]
fn gene_gradients_are_summed_with_their_sign() {
    let mut gradients = gradients_of(&three_splats(), 0.02);
    let mut statistics = Statistics64::zeros(3);
    let request = StatisticsRequest { density: None, genes: true };
    statistics.accumulate(&gradients, &request);
    assert_eq!(statistics.gene_views, [1, 1, 0]);
    let first = statistics.gene_gradient_sum[0];
    assert_eq!(first[..3], gradients.cloud.positions[0]);
    assert_eq!(first[3..6], gradients.cloud.log_scales[0]);
    assert_eq!(first[6], gradients.cloud.opacity_logits[0]);
    assert!(first[6] != 0.0);
    gradients.cloud.opacity_logits[0] *= -1.0;
    statistics.accumulate(&gradients, &request);
    assert_eq!(statistics.gene_gradient_sum[0][6], 0.0);
    assert!(statistics.weight_sum.iter().all(|weight| *weight == 0.0));
}

const RATES: LearningRates = LearningRates {
    position: 0.1,
    position_reach: None,
    sh_dc: 0.2,
    sh_rest: 0.3,
    opacity: 0.4,
    scale: 0.5,
    rotation: 0.6,
};

fn update(step: u32, opacity_step: u32) -> Update {
    Update { rates: RATES, step, opacity_step, mcmc: None }
}

/// A first step has m̂ = g and v̂ = g²: every parameter moves by its own rate against its gradient, however
/// small.
#[test]
fn the_first_step_is_the_learning_rate() {
    let mut cloud = Cloud64::zeros(2);
    let mut gradient = Cloud64::zeros(2);
    groups(&mut gradient).into_iter().for_each(|(_, values)| values.fill(-1e-9));
    gradient.positions[1] = [2.0, 0.0, -3.0];
    adam(&mut cloud, &mut Moments64::zeros(2), &gradient, &update(1, 1));
    // ε = 1e-15 is a millionth of the gradient; the rates are f32.
    let close = |actual: f64, expected: f64| (actual - expected).abs() < 2e-6;
    assert!((0..3).all(|axis| close(cloud.positions[0][axis], 0.1)));
    assert!(
        close(cloud.positions[1][0], -0.1)
            && cloud.positions[1][1] == 0.0
            && close(cloud.positions[1][2], 0.1)
    );
    assert!(close(cloud.opacity_logits[1], 0.4) && close(cloud.log_scales[0][2], 0.5));
    assert!(close(cloud.rotations[1][3], 0.6));
    for (index, value) in cloud.sh[1].iter().enumerate() {
        assert!(close(*value, if index < 3 { 0.2 } else { 0.3 }), "{index}");
    }
}

/// Gradients 1 and then 0: m = 0.1·0.9, v = 0.001·0.999 after the second step.
#[test]
fn a_row_without_gradient_keeps_moving() {
    let (mut cloud, mut moments) = (Cloud64::zeros(1), Moments64::zeros(1));
    let mut gradient = Cloud64::zeros(1);
    gradient.opacity_logits[0] = 1.0;
    adam(&mut cloud, &mut moments, &gradient, &update(1, 1));
    let after_first = cloud.opacity_logits[0];
    adam(&mut cloud, &mut moments, &Cloud64::zeros(1), &update(2, 2));
    let first: f64 = 0.09 / (1.0 - 0.81);
    let second: f64 = 0.000_999 / (1.0 - 0.998_001);
    let expected = -0.4 * first / second.sqrt();
    assert!((cloud.opacity_logits[0] - after_first - expected).abs() < 1e-5);
    assert!((moments.first.opacity_logits[0] - 0.09).abs() < 1e-7);
    assert!((moments.second.opacity_logits[0] - 0.000_999).abs() < 1e-7);
}

/// Along an axis of which a step of the rate is a fifth, the whole step is halved; elsewhere nothing is.
#[test]
fn a_step_moves_no_gaussian_farther_than_its_reach() {
    let mut cloud = Cloud64::default();
    let half_turn = std::f64::consts::FRAC_1_SQRT_2;
    for scales in [[0.5f64, 5.0, 50.0], [5.0, 0.5, 50.0], [2.0; 3]] {
        push(&mut cloud, [0.0; 3], 1.0, 0.5, [0.5; 3]);
        let row = cloud.positions.len() - 1;
        cloud.log_scales[row] = scales.map(f64::ln);
        // The own x axis is the world's y axis.
        cloud.rotations[row] = [half_turn, 0.0, 0.0, half_turn];
    }
    let mut gradient = Cloud64::zeros(3);
    gradient.positions.fill([0.0, -3.0, 0.0]);
    let limited = Update { rates: LearningRates { position_reach: Some(0.1), ..RATES }, ..update(1, 1) };
    adam(&mut cloud, &mut Moments64::zeros(3), &gradient, &limited);
    let moved: Vec<f64> = cloud.positions.iter().map(|position| position[1]).collect();
    assert!((moved[0] - 0.05).abs() < 1e-6 && (moved[1] - 0.1).abs() < 1e-6, "{moved:?}");
    assert!((moved[2] - 0.1).abs() < 1e-6, "{moved:?}");
}

#[test]
fn the_opacity_group_can_sit_a_step_out() {
    let (mut cloud, mut moments) = (Cloud64::zeros(1), Moments64::zeros(1));
    let mut gradient = Cloud64::zeros(1);
    gradient.opacity_logits[0] = 1.0;
    gradient.log_scales[0] = [1.0; 3];
    adam(&mut cloud, &mut moments, &gradient, &update(5, 0));
    assert_eq!((cloud.opacity_logits[0], moments.first.opacity_logits[0]), (0.0, 0.0));
    assert!(cloud.log_scales[0][0] < 0.0);
}

/// MCMC on a cloud whose gradients are zero: the regularisers alone drive Adam, and the noise moves faint
/// rows only.
#[test]
fn mcmc_regularises_and_moves_means_at_random() {
    let mut cloud = Cloud64::default();
    push(&mut cloud, [0.0; 3], 0.5, 0.001, [0.5; 3]);
    push(&mut cloud, [0.0; 3], 0.5, 0.9, [0.5; 3]);
    let before = cloud.clone();
    let mut moments = Moments64::zeros(2);
    let mcmc =
        McmcStep { noise_scale: 0.1, opacity_weight: 0.01, scale_weight: 0.02, rng: Rng::new(3), counter: 7 };
    let update = Update {
        rates: LearningRates { scale: 0.0, opacity: 0.0, ..RATES },
        mcmc: Some(mcmc),
        ..update(1, 1)
    };
    adam(&mut cloud, &mut moments, &Cloud64::zeros(2), &update);
    // First moments are a tenth of the gradient.
    assert!((moments.first.opacity_logits[1] - 0.1 * 0.01 / 2.0 * 0.9 * 0.1).abs() < 1e-9);
    assert!((moments.first.log_scales[0][1] - 0.1 * 0.02 / 6.0 * 0.5).abs() < 1e-9);
    assert_eq!(cloud.log_scales, before.log_scales);
    let draw = Rng::new(3).at(Stream::SgldNoise, 7, 0, 0);
    let xi = [draw.normals(0)[0], draw.normals(0)[1], draw.normals(1)[0]].map(f64::from);
    let faintness = 1.0 / (1.0 + (100.0f64 * (0.001 - 0.005)).exp());
    for axis in 0..3 {
        let expected = 0.25 * xi[axis] * 0.1 * faintness;
        assert!((cloud.positions[0][axis] - expected).abs() < 1e-8);
        assert!(cloud.positions[1][axis].abs() < 1e-12, "an opaque Gaussian stays put");
    }
}

/// The whole chain does what it is for: a hundred steps on one photo bring the loss down.
#[test]
fn training_lowers_the_loss() {
    let (camera, settings) = (straight_camera(), RenderSettings::default());
    let target = render(&three_splats(), &camera, &settings, Cutoff::Hard).picture.image;
    let pixels = (WIDTH * HEIGHT) as usize;
    let rgb = (0..pixels).flat_map(|p| (0..3).map(move |c| c * pixels + p));
    let photo =
        Photo { width: WIDTH, height: HEIGHT, rgb: rgb.map(|i| (target[i] * 255.0 + 0.5) as u8).collect() };

    let mut cloud = Cloud64::default();
    push(&mut cloud, [0.15, -0.1, 2.5], 0.2, 0.5, [0.5; 3]);
    push(&mut cloud, [-0.2, 0.1, 3.0], 0.2, 0.5, [0.5; 3]);
    let mut moments = Moments64::zeros(2);
    let rates = LearningRates {
        position: 0.01,
        position_reach: None,
        sh_dc: 0.05,
        sh_rest: 0.002,
        opacity: 0.05,
        scale: 0.02,
        rotation: 0.01,
    };
    let mut losses = Vec::new();
    for step in 1..=100 {
        let rendered = render(&cloud, &camera, &settings, Cutoff::Hard);
        let (value, by_image) = loss(&rendered.picture.image, &photo);
        losses.push(value);
        let gradients = backward(&cloud, &camera, &settings, Cutoff::Hard, &rendered, &by_image);
        let update = Update { rates, step, opacity_step: step, mcmc: None };
        adam(&mut cloud, &mut moments, &gradients.cloud, &update);
    }
    assert!(losses[99] < 0.2 * losses[0], "{} -> {}", losses[0], losses[99]);
}
