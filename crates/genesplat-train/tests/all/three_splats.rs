//! Pixel-GS's statistics and Mip-Splatting's filters of three splats, computed by hand, in the reference and
//! on the CPU.

use genesplat_core::gaussians::{logit, sigmoid};
use genesplat_core::spherical_harmonics::dc_from_rgb;
use genesplat_core::{
    Camera, DensitySignal, Device, Edit, Gaussians, Photo, RenderSettings, Renderer, ScreenFilter,
    StatisticsRequest, TrainStep, View,
};
use genesplat_kernels::cpu::CpuBackend;
use genesplat_reference::{self as reference, Cloud64, Cutoff, Statistics64};
use genesplat_train::scene::filter_3d::filter_3d;
use glam::DVec3;

/// A round splat: position, standard deviation, opacity, grey.
type Round = ([f32; 3], f32, f32, f32);

fn cloud(splats: [Round; 3]) -> Gaussians {
    let mut cloud = Gaussians::zeros(3);
    for (row, (position, scale, opacity, grey)) in splats.into_iter().enumerate() {
        cloud.positions[row] = position;
        cloud.log_scales[row] = [scale.ln(); 3];
        cloud.opacity_logits[row] = logit(opacity);
        cloud.sh[row][..3].fill(dc_from_rgb(grey));
    }
    cloud
}

/// Looks along +z from `(0, 0, z)`, with the principal point on the centre of a pixel.
fn camera([width, height]: [u32; 2], centre_px: [u32; 2], focal_px: f64, z: f64) -> Camera {
    Camera {
        principal_px: centre_px.map(|pixel| f64::from(pixel) + 0.5),
        camera_from_world_translation: DVec3::new(0.0, 0.0, -z),
        ..Camera::at_origin(width, height, focal_px)
    }
}

/// What one white photo adds to Pixel-GS's sums: `(gradients, weights)` of the reference, then of the CPU.
fn pixel_gs(cloud: &Gaussians, camera: Camera, depth_threshold: f32) -> [(Vec<f64>, Vec<f64>); 2] {
    let (width, height) = (camera.width, camera.height);
    let photo = Photo { width, height, rgb: vec![255; 3 * (width * height) as usize] }.into();
    let view = View { name: "white".into(), camera, photo, mask: None, depth: None };
    let settings = RenderSettings::default();
    let density = Some(DensitySignal::PixelWeighted { depth_threshold });
    let request = StatisticsRequest { density, genes: false };

    let (_, gradients) = reference::gradients(&Cloud64::from(cloud), &view, &settings, Cutoff::Hard);
    let mut exact = Statistics64::zeros(3);
    exact.accumulate(&gradients, &request);

    let mut backend = CpuBackend::new();
    backend.set_views(&[view]).unwrap();
    backend.upload(cloud.clone().into()).unwrap();
    let step = TrainStep {
        view: 0,
        settings,
        update: None,
        keeps_gradients: false,
        depth_weight: 0.0,
        statistics: request,
    };
    backend.train_step(&step).unwrap();
    let found = backend.statistics().unwrap();
    let widen = |values: Vec<f32>| values.into_iter().map(f64::from).collect();
    [(exact.gradient_sum, exact.weight_sum), (widen(found.gradient_sum), widen(found.weight_sum))]
}

/// A picture of 24 x 20 pixels at focal length 20: the first two splats are 1 px wide (20 · 0.1 / 2 = 20 ·
/// 0.2 / 4),
/// 1.3 px² with the screen filter, and touch the pixels within r² = 2 · 1.3 · ln(0.9 · 255) = 14.14, of which
/// there are 45; the first covers the second almost, but not quite. The third is off the screen.
#[test]
fn pixel_gs_counts_pixels() {
    let splats = [
        ([0.0, 0.0, 2.0], 0.1, 0.9, 0.9),
        ([0.0, 0.0, 4.0], 0.2, 0.9, 0.5),
        ([50.0, 0.0, 2.0], 0.1, 0.9, 0.1),
    ];
    for (gradients, weights) in pixel_gs(&cloud(splats), camera([24, 20], [10, 8], 20.0, 0.0), 4.0) {
        assert_eq!(weights, [45.0, 45.0, 0.0]);
        assert_eq!(gradients[2], 0.0);
    }
}

/// One white pixel, three grey splats half a pixel off its centre, one behind the other; focal length 20.
///
/// Each is 1 px wide where it is off-centre (20 · 0.1 / 2 and so on): variance 1 + 0.025² + 0.3 = 1.300625
/// px² along its offset (the slope 0.5/20 = 0.025 tilts the Jacobian). So alpha = 0.5 · exp(−0.5 · 0.25 /
/// 1.300625) = 0.4541831, and
///
/// | splat | transmittance T | grey c | behind it b | T (c − b) |
/// |---|---|---|---|---|
/// | 1 | 1 | 0.8 | 0.4541831 · 0.4 + 0.5458169 · 0.4541831 · 0.2 = 0.2312534 | 0.5687466 |
/// | 2 | 0.5458169 | 0.4 | 0.4541831 · 0.2 = 0.0908366 | 0.1687467 |
/// | 3 | 0.2979161 | 0.2 | 0 | 0.0595832 |
///
/// The pixel is C = 0.8 · 0.4541831 + 0.4 · 0.2478973 + 0.2 · 0.1353085 = 0.4895685 of 1. The loss falls by
/// 0.8 as C rises by 1 (L1), and by 0.2 · 1.5441563 for SSIM, whose window keeps only its centre tap, w =
/// 0.2660117² = 0.0707622: with s = w − w², SSIM(C) = (2 w² C + 1e-4)(2 s C + 9e-4) / ((w² (C² + 1) + 1e-4)(s
/// (C² + 1) + 9e-4)) = 0.6282870, of slope
/// 1.5441563. Together dL/dC = −1.1088313.
///
/// Alpha changes by alpha · 0.5 / 1.300625 = 0.1746005 a pixel of movement, and half the image's width is
/// 0.5:
/// |g| = 0.5 · 1.1088313 · 0.1746005 · T (c − b) = 0.0968011 · T (c − b) = 0.0550558, 0.0163350, 0.0057678.
/// One pixel each; at depth 2, half the threshold of 4, a quarter counts; at 4 and 8 all of it.
#[test]
fn pixel_gs_weights_by_hand() {
    let splats = [
        ([0.05, 0.0, 2.0], 0.1, 0.5, 0.8),
        ([0.0, -0.1, 4.0], 0.2, 0.5, 0.4),
        ([-0.2, 0.0, 8.0], 0.4, 0.5, 0.2),
    ];
    for (gradients, weights) in pixel_gs(&cloud(splats), camera([1, 1], [0, 0], 20.0, 0.0), 4.0) {
        assert_eq!(weights, [1.0; 3]);
        for (found, expected) in gradients.iter().zip([0.013_763_95, 0.016_335_01, 0.005_767_775]) {
            assert!((found / expected - 1.0).abs() < 1e-5, "{gradients:?}");
        }
    }
}

/// Two cameras see the first two splats: one at the origin of focal length 20, one 2 units behind it of 40.
/// So depths are those of the first, 2 and 4, the focal length that of the second, and the filters' variances
/// 0.2 · (z / 40)² = 0.0005 and 0.002. Nobody sees the third, behind both, which gets the wider of these.
///
/// | | splat 1 | splat 2 |
/// |---|---|---|
/// | variance s², filter f² | 0.0004, 0.0005 | 0.002, 0.002 |
/// | 3D filter dims by (s² / (s² + f²))^1.5 | (4/9)^1.5 = 8/27 | (1/2)^1.5 = 0.3535534 |
/// | on the screen, px² | 10² · 0.0009 = 0.09 both ways | 5² · 0.004 = 0.1, and 1.09 times that along x (slope 0.3) |
/// | determinants without and with 0.1 px² | 0.0081, 0.0361 | 0.0109, 0.0418 |
/// | 2D filter dims by sqrt(det0 / (det1 + 1e-6) + 1e-6) | 0.4736787 | 0.5106470 |
/// | alpha at the centre, of opacity 0.8 and 0.9 | 0.1122794 | 0.1624869 |
#[test]
fn mip_filters_by_hand() {
    let mut cloud = cloud([
        ([0.0, 0.0, 2.0], 0.02, 0.8, 1.0),
        ([1.2, 0.0, 4.0], 0.002f32.sqrt(), 0.9, 1.0),
        ([0.0, 0.0, -5.0], 0.1, 0.9, 1.0),
    ]);
    let (near, far) = (camera([24, 20], [10, 8], 20.0, 0.0), camera([24, 20], [10, 8], 40.0, -2.0));
    let filter = filter_3d(&cloud.positions, [&near, &far].into_iter());
    for (found, variance) in filter.iter().zip([0.0005f32, 0.002, 0.002]) {
        assert!((found * found / variance - 1.0).abs() < 1e-5, "{filter:?}");
    }
    cloud.filter_3d = Some(filter);

    let settings = RenderSettings { filter: ScreenFilter::Mip, ..RenderSettings::default() };
    let exact = reference::render(&Cloud64::from(&cloud), &near, &settings, Cutoff::Hard).picture.image;
    let mut backend = CpuBackend::new();
    backend.upload(cloud.into()).unwrap();
    let found = backend.render(&near, &settings).unwrap();
    let mut fused = CpuBackend::new();
    fused.upload(backend.download().unwrap().fused().into()).unwrap();
    let fused = fused.render(&near, &settings).unwrap();
    // White on black: the first channel is alpha. The second splat is at 20 · 1.2 / 4 = 6 px to the right.
    for (x, alpha) in [(10, 0.112_279_4), (16, 0.162_486_9)] {
        let by_reference = exact[8 * 24 + x];
        assert!((by_reference / alpha - 1.0).abs() < 1e-5, "reference: {by_reference} at {x}");
        let by_cpu = f64::from(found.pixel(x as u32, 8)[0]);
        assert!((by_cpu / alpha - 1.0).abs() < 1e-5, "CPU: {by_cpu} at {x}");
        let by_fused = f64::from(fused.pixel(x as u32, 8)[0]);
        assert!((by_fused / alpha - 1.0).abs() < 1e-5, "filter baked in: {by_fused} at {x}");
    }

    // A reset limits the filtered opacity: 0.8 · 8/27 = 0.237 falls to 0.01, the raw one to 0.01 · 27/8 =
    // 0.03375.
    backend.edit(Edit::OpacityCeiling(0.01)).unwrap();
    let raw = sigmoid(backend.download().unwrap().opacity_logits[0]);
    assert!((raw / 0.033_75 - 1.0).abs() < 1e-5, "{raw}");
}
