//! The reference's pictures: values computed by hand, the order of splats, and inputs that must not poison a
//! pixel.

mod support;

use genesplat_core::{Camera, RenderSettings, ScreenFilter};
use genesplat_reference::{Cloud64, Cutoff, Rendered, Splat, Symmetric2, rasterise, render};
use proptest::prelude::*;
use support::*;

const RED: [f64; 3] = [1.0, 0.0, 0.0];
const GREEN: [f64; 3] = [0.0, 1.0, 0.0];

fn picture(cloud: &Cloud64, settings: &RenderSettings) -> Rendered {
    render(cloud, &straight_camera(), settings, Cutoff::Hard)
}

/// RGB of pixel (x, y).
fn pixel(rendered: &Rendered, x: u32, y: u32) -> [f64; 3] {
    let plane = (WIDTH * HEIGHT) as usize;
    std::array::from_fn(|channel| rendered.picture.image[channel * plane + (y * WIDTH + x) as usize])
}

fn close(actual: f64, expected: f64) -> bool {
    // The constants of the contract are f32, so hand-computed values agree to 1e-7 or so.
    (actual - expected).abs() < 1e-6
}

/// A round Gaussian on the optical axis at depth 2 with scale 0.2: 20 px · 0.2 / 2 = 2 px wide.
fn one_splat(opacity: f64) -> Cloud64 {
    let mut cloud = Cloud64::default();
    push(&mut cloud, [0.0, 0.0, 2.0], 0.2, opacity, [0.9, 0.6, 0.3]);
    cloud
}

#[test]
fn one_splat_by_hand() {
    let settings = RenderSettings { background: [0.0, 0.5, 1.0], ..RenderSettings::default() };
    let rendered = picture(&one_splat(0.7), &settings);
    let splat = &rendered.splats[0];
    assert_eq!((splat.row, splat.depth), (0, 2.0));
    assert!(close(splat.mean_px[0], 10.0) && close(splat.mean_px[1], 8.0));
    // 2² plus the dilation.
    assert!(close(splat.covariance_px.xx, 4.3) && close(splat.covariance_px.yy, 4.3));
    assert!(close(splat.conic.xx, 1.0 / 4.3) && splat.covariance_px.xy.abs() < 1e-15);
    // 3 sqrt(4.3 + sqrt(0.1)) = 6.45.
    assert_eq!(splat.radius_px, 7);
    assert!(close(splat.extent_px[0], (2.0 * (0.7f64 * 255.0).ln() * 4.3).sqrt()));

    for ((x, y), alpha) in [((10, 8), 0.7), ((12, 7), 0.7 * (-0.5f64 * 5.0 / 4.3).exp())] {
        let [r, g, b] = pixel(&rendered, x, y);
        assert!(close(r, 0.9 * alpha), "({x}, {y})");
        assert!(close(g, 0.6 * alpha + 0.5 * (1.0 - alpha)));
        assert!(close(b, 0.3 * alpha + (1.0 - alpha)));
        assert!(close(rendered.picture.transmittance[(y * WIDTH + x) as usize], 1.0 - alpha));
    }
    assert_eq!(pixel(&rendered, 23, 19), [0.0, 0.5, 1.0], "the corner is out of reach");
}

/// A tilted needle, so that a transposed rotation or a swapped axis shows: long along (1, 1)/√2 in x and y.
#[test]
fn a_tilted_splat_by_hand() {
    let mut cloud = one_splat(0.5);
    let half_turn = std::f64::consts::FRAC_PI_8;
    cloud.rotations[0] = [2.0 * half_turn.cos(), 0.0, 0.0, 2.0 * half_turn.sin()];
    cloud.log_scales[0] = [0.4f64.ln(), 0.1f64.ln(), 0.1f64.ln()];
    let splat = picture(&cloud, &RenderSettings::default()).splats[0];
    // Variances 16 and 1 px² along the diagonals: (16 + 1)/2 on the diagonal, (16 − 1)/2 off it.
    assert!(close(splat.covariance_px.xx, 8.8) && close(splat.covariance_px.yy, 8.8));
    assert!(close(splat.covariance_px.xy, 7.5));
}

/// Far to the side the Jacobian is taken at 1.3 times the half field of view, the mean where it is.
#[test]
fn the_limit_of_the_jacobian_by_hand() {
    let mut cloud = one_splat(0.7);
    cloud.positions[0] = [1.9, -1.8, 2.0];
    let splat = picture(&cloud, &RenderSettings::default()).splats[0];
    assert!(close(splat.mean_px[0], 10.0 + 19.0) && close(splat.mean_px[1], 8.0 - 18.0));
    // Slopes 0.95 and -0.9 are clamped to 1.3 · 12/20 and -1.3 · 10/20; Σ' = (2 px)² (I + slope slopeᵀ).
    let [a, b] = [0.78, -0.65];
    assert!(close(splat.covariance_px.xx, 4.0 * (1.0 + a * a) + 0.3));
    assert!(close(splat.covariance_px.yy, 4.0 * (1.0 + b * b) + 0.3));
    assert!(close(splat.covariance_px.xy, 4.0 * a * b));
}

#[test]
fn screen_filters_by_hand() {
    let opacity_with = |filter| {
        let settings = RenderSettings { filter, ..RenderSettings::default() };
        picture(&one_splat(0.7), &settings).splats[0].opacity
    };
    assert!(close(opacity_with(ScreenFilter::Classic), 0.7));
    assert!(close(opacity_with(ScreenFilter::Antialiased), 0.7 * 4.0 / 4.3));
    assert!(close(opacity_with(ScreenFilter::Mip), 0.7 * (16.0f64 / (4.1 * 4.1 + 1e-6) + 1e-6).sqrt()));
}

#[test]
fn the_3d_filter_by_hand() {
    let mut cloud = one_splat(0.7);
    cloud.filter_3d = Some(vec![0.15]);
    let settings = RenderSettings { filter: ScreenFilter::Mip, ..RenderSettings::default() };
    let splat = picture(&cloud, &settings).splats[0];
    // Scale sqrt(0.2² + 0.15²) = 0.25, so 2.5 px, and opacity times (0.2 / 0.25)³.
    assert!(close(splat.covariance_px.xx, 6.25 + 0.1));
    let compensation = (6.25f64.powi(2) / (6.35f64.powi(2) + 1e-6) + 1e-6).sqrt();
    assert!(close(splat.opacity, 0.7 * 0.512 * compensation));
}

#[test]
fn nearer_splats_hide_farther_ones_whatever_their_rows() {
    for near_first in [true, false] {
        let mut cloud = Cloud64::default();
        let (near, far) = ([0.0, 0.0, 2.0], [0.0, 0.0, 3.0]);
        let planes = if near_first { [(near, RED), (far, GREEN)] } else { [(far, GREEN), (near, RED)] };
        planes.into_iter().for_each(|(mean, rgb)| push(&mut cloud, mean, 0.3, 0.8, rgb));
        let [r, g, b] = pixel(&picture(&cloud, &RenderSettings::default()), 10, 8);
        assert!(close(r, 0.8) && close(g, 0.2 * 0.8) && close(b, 0.0));
    }
}

#[test]
fn equal_depths_keep_the_order_of_their_rows() {
    let mut cloud = Cloud64::default();
    for row in 0..64 {
        push(&mut cloud, [0.0, 0.0, if row % 2 == 0 { 3.0 } else { 2.0 }], 0.3, 0.8, GREEN);
    }
    let rows: Vec<usize> =
        picture(&cloud, &RenderSettings::default()).splats.iter().map(|splat| splat.row).collect();
    let expected: Vec<usize> = (1..64).step_by(2).chain((0..64).step_by(2)).collect();
    assert_eq!(rows, expected);
}

/// Three splats of alpha 0.98 leave 0.02³ = 8e-6 < 1e-4, so the third is not blended at all.
#[test]
fn a_pixel_ends_before_the_splat_that_would_finish_it() {
    let mut cloud = Cloud64::default();
    for (z, rgb) in [(2.0, RED), (2.5, RED), (3.0, GREEN)] {
        push(&mut cloud, [0.0, 0.0, z], 0.3, 0.98, rgb);
    }
    let rendered =
        picture(&cloud, &RenderSettings { background: [0.0, 0.0, 1.0], ..RenderSettings::default() });
    let [r, g, b] = pixel(&rendered, 10, 8);
    assert!(close(r, 1.0 - 0.0004) && g == 0.0 && close(b, 0.0004));
}

/// However many splats there are: transmittance stays in [1e-4, 1], and colours mix within the range of their
/// own.
#[test]
fn a_crowd_of_splats_stays_in_range() {
    let cloud = random_cloud(300, 23);
    let settings = RenderSettings { background: [0.5; 3], ..RenderSettings::default() };
    let rendered = render(&cloud, &tilted_camera(), &settings, Cutoff::Hard);
    let darkest = rendered.picture.transmittance.iter().copied().fold(1.0, f64::min);
    assert!((1e-4 * (1.0 - 1e-7)..1e-2).contains(&darkest), "{darkest}");
    let brightest = rendered.splats.iter().flat_map(|splat| splat.colour).fold(0.5, f64::max);
    assert!(rendered.picture.image.iter().all(|value| (0.0..=brightest).contains(value)));
}

#[test]
fn alpha_is_clamped_below_one() {
    let mut cloud = one_splat(0.5);
    cloud.opacity_logits[0] = 40.0;
    assert!(close(
        picture(&cloud, &RenderSettings::default()).picture.transmittance[8 * WIDTH as usize + 10],
        0.01
    ));
}

/// Every pixel with alpha ≥ 1/255 lies in the box, none outside; and the box is no larger than it must be.
#[test]
fn the_extent_is_exact() {
    let wide = Camera { width: 240, height: 200, principal_px: [120.3, 101.1], ..tilted_camera() };
    for filter in [ScreenFilter::Classic, ScreenFilter::Antialiased, ScreenFilter::Mip] {
        let settings = RenderSettings { filter, ..RenderSettings::default() };
        for splat in render(&random_cloud(12, 21), &wide, &settings, Cutoff::Hard).splats {
            let mut reach = [0.0f64; 2];
            // Finer than the pixels: a lattice of 1/4 px.
            for (x, y) in
                (0..960).flat_map(|x| (0..800).map(move |y| (0.25 * f64::from(x), 0.25 * f64::from(y))))
            {
                let [dx, dy] = [splat.mean_px[0] - x, splat.mean_px[1] - y];
                let form =
                    splat.conic.xx * dx * dx + 2.0 * splat.conic.xy * dx * dy + splat.conic.yy * dy * dy;
                if splat.opacity * (-0.5 * form).exp() >= f64::from(1.0f32 / 255.0) {
                    reach = [reach[0].max(dx.abs()), reach[1].max(dy.abs())];
                }
            }
            for axis in 0..2 {
                assert!(reach[axis] <= splat.extent_px[axis], "{reach:?} of {:?}", splat.extent_px);
                assert!(reach[axis] >= splat.extent_px[axis] - 0.5, "{reach:?} of {:?}", splat.extent_px);
            }
        }
    }
}

#[test]
fn the_published_radius_decides_visibility() {
    let mut cloud = Cloud64::default();
    // Scale 0.2 at depth 2 has radius 7: off the left edge by 5 px, by 10 px, and below the bottom edge.
    for [u, v] in [[-5.0, 8.0], [-10.0, 8.0], [10.0, 60.0]] {
        push(&mut cloud, [(u - 10.0) / 10.0, (v - 8.0) / 10.0, 2.0], 0.2, 0.7, RED);
    }
    let rendered = picture(&cloud, &RenderSettings::default());
    assert!(close(rendered.splats[0].mean_px[0], -5.0) && close(rendered.splats[2].mean_px[1], 60.0));
    // The Jacobian's clamp does not act on the first; its radius grows with the slope in x.
    assert!(rendered.splats[0].radius_px >= 7);
    // Tiles are 16 px: a square that ends at -10 + 9 + 15 = 14 px meets none of them.
    assert_eq!((rendered.splats[1].radius_px, rendered.splats[2].radius_px), (0, 0));
}

#[test]
fn nothing_behind_the_near_plane_is_drawn() {
    for z in [0.2, 0.1, 0.0, -2.0] {
        let mut cloud = one_splat(0.7);
        cloud.positions[0][2] = z;
        let rendered = picture(&cloud, &RenderSettings::default());
        assert!(
            rendered.splats.is_empty() && rendered.picture.transmittance.iter().all(|t| *t == 1.0),
            "{z}"
        );
    }
}

/// A Gaussian of no size at all still shows: the screen filter gives it the dilation; Mip-Splatting drops it.
#[test]
fn zero_scales() {
    let mut cloud = one_splat(0.7);
    cloud.log_scales[0] = [f64::NEG_INFINITY; 3];
    let centre =
        |filter| pixel(&picture(&cloud, &RenderSettings { filter, ..RenderSettings::default() }), 10, 8)[0];
    assert!(close(centre(ScreenFilter::Classic), 0.9 * 0.7));
    assert_eq!(centre(ScreenFilter::Antialiased), 0.0, "0.005 of 0.7 is below 1/255");
    assert_eq!(centre(ScreenFilter::Mip), 0.0);
    cloud.rotations[0] = [0.0; 4];
    assert!(close(pixel(&picture(&cloud, &RenderSettings::default()), 10, 8)[0], 0.9 * 0.7));
}

/// Every parameter in turn holds a value that is not finite (or overflows): the picture is the one without
/// that row.
#[test]
fn poison_is_culled_not_spread() {
    let clean = random_cloud(6, 22);
    let settings = RenderSettings::default();
    let drawn = |cloud: &Cloud64| render(cloud, &tilted_camera(), &settings, Cutoff::Hard);
    let mut without = clean.clone();
    without.positions[2] = [0.0, 0.0, -1e6];
    let expected = drawn(&without).picture;
    assert_ne!(expected, drawn(&clean).picture, "row 2 must show for the test to mean anything");
    for poison in [f64::NAN, f64::INFINITY, 1e300] {
        for group in 0..5 {
            let mut cloud = clean.clone();
            let columns = groups(&mut cloud);
            let (name, values) = columns.into_iter().nth(group).expect("one of five groups");
            let stride = values.len() / 6;
            values[2 * stride] = poison;
            let harmless = (name == "opacity" || name == "colour" || name == "rotation")
                && poison.is_finite()
                || name == "opacity" && poison == f64::INFINITY;
            let rendered = drawn(&cloud);
            assert!(rendered.picture.image.iter().all(|value| value.is_finite()), "{name} = {poison}");
            if !harmless {
                assert_eq!(rendered.picture, expected, "{name} = {poison}");
            }
        }
    }
}

/// Needles so long that rounding eats their width: whatever is drawn has an ellipse, and some must be culled.
#[test]
fn needles_without_an_ellipse_are_culled() {
    let (mut drawn, lengths) = (0, 60);
    for length in 0..lengths {
        let mut cloud = one_splat(0.7);
        cloud.log_scales[0] = [f64::from(length), -9.0, -9.0];
        cloud.rotations[0] = [1.0, 0.1, 0.2, 0.3 + 0.01 * f64::from(length)];
        let rendered = picture(&cloud, &RenderSettings::default());
        assert!(rendered.splats.iter().all(|splat| splat.covariance_px.determinant() > 0.0));
        assert!(rendered.picture.image.iter().all(|value| (0.0..=0.9).contains(value)));
        drawn += rendered.splats.len();
    }
    assert!((10..lengths as usize).contains(&drawn), "{drawn} of {lengths}");
}

#[test]
fn an_empty_cloud_and_a_picture_of_one_pixel() {
    let settings = RenderSettings { background: [0.25, 0.5, 0.75], ..RenderSettings::default() };
    let camera = Camera { width: 1, height: 1, principal_px: [0.5, 0.5], ..straight_camera() };
    let empty = render(&Cloud64::default(), &camera, &settings, Cutoff::Hard);
    assert_eq!(empty.picture.image, [0.25, 0.5, 0.75]);
    let one = render(&one_splat(0.7), &camera, &settings, Cutoff::Hard);
    assert!(close(one.picture.transmittance[0], 0.3));
}

/// A round splat of any opacity, somewhere on or beside an image of 8x8 px.
fn any_splat() -> impl Strategy<Value = Splat> {
    let place = || -2.0f64..10.0;
    (place(), place(), 0.3f64..6.0, 0.0f64..=1.0, [0.0f64..2.0, 0.0f64..2.0, 0.0f64..2.0]).prop_map(
        |(x, y, sigma, opacity, colour)| {
            let round = |value| Symmetric2 { xx: value, xy: 0.0, yy: value };
            Splat {
                row: 0,
                mean_px: [x, y],
                depth: 1.0,
                covariance_px: round(sigma * sigma),
                conic: round(1.0 / (sigma * sigma)),
                opacity,
                colour,
                // Everything: which pixels are left out is for other tests to ask.
                extent_px: [100.0; 2],
                radius_px: 1,
            }
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    /// Splat behind splat, under both rules: transmittance starts at one, never rises, is never below zero,
    /// and falls by a fraction that is an alpha; and no colour comes from nowhere.
    #[test]
    fn alphas_are_fractions_and_transmittance_never_rises(
        splats in prop::collection::vec(any_splat(), 0..40),
        background in [0.0f64..1.0, 0.0f64..1.0, 0.0f64..1.0],
    ) {
        for cutoff in [Cutoff::Hard, Cutoff::Smooth] {
            let mut before = vec![1.0; 64];
            for count in 0..=splats.len() {
                let picture = rasterise::rasterise(&splats[..count], [8, 8], background, cutoff);
                for (&after, before) in picture.transmittance.iter().zip(&before) {
                    let alpha = 1.0 - after / before;
                    let largest = f64::from(genesplat_core::constants::ALPHA_MAX) + 1e-12;
                    prop_assert!((0.0..=largest).contains(&alpha), "{cutoff:?}: an alpha of {alpha}");
                    prop_assert!(after <= *before && after >= 0.0);
                }
                let in_range = |value: &f64| (0.0..=2.0 + 1e-9).contains(value);
                prop_assert!(picture.image.iter().all(in_range), "{cutoff:?}: weights that are no fractions");
                before = picture.transmittance;
            }
        }
    }
}
