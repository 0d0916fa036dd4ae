//! The same scene in other units: it trains all the same.

use std::path::Path;

use genesplat::io::colmap::{find_model, read_model, write_model};

use crate::support::{copy_scene, fail, json, number, succeed, train};

/// The scene with all lengths times `factor`.
fn write_scaled(folder: &Path, factor: f64) {
    copy_scene(folder);
    let mut model = read_model(&find_model(folder).unwrap()).unwrap();
    for image in &mut model.images {
        image.translation = image.translation.map(|value| value * factor);
    }
    for point in &mut model.points {
        point.position = point.position.map(|value| value * factor as f32);
    }
    write_model(&folder.join("sparse/0"), &model).unwrap();
}

const SCHEDULE: [&str; 4] = ["--steps-scale", "0.01", "--max-gaussians", "600"];

/// Test PSNR of the scene at ten to the power of `exponent`; both are in folders of that name.
fn psnr_at(place: &Path, exponent: i32, more: &[&str]) -> f64 {
    let [scene, out] = ["scene", "run"].map(|name| place.join(format!("{name}{exponent}{}", more.concat())));
    write_scaled(&scene, 10f64.powi(exponent));
    succeed(train(&scene, &out, &[&SCHEDULE, more].concat()));
    number(&json(&out.join("metrics.json"))["test"]["psnr"])
}

#[test]
fn a_scene_of_any_size_trains_as_well() {
    let place = tempfile::tempdir().unwrap();
    for (more, exponents) in [(&["--method", "3dgs"], &[-3, -2, 2, 3][..]), (&["--method", "mcmc"], &[-2, 3])]
    {
        let usual = psnr_at(place.path(), 0, more);
        assert!(usual > 16.0, "{usual} {more:?}");
        for &exponent in exponents {
            let psnr = psnr_at(place.path(), exponent, more);
            assert!((psnr - usual).abs() < 0.3, "1e{exponent}: {psnr} instead of {usual} {more:?}");
        }
    }
    let [scene, out] = ["scene-2--method3dgs", "far"].map(|name| place.path().join(name));
    let far = [&SCHEDULE[..], &["--method", "3dgs", "--near", "0.2"]].concat();
    fail(train(&scene, &out, &far), &["no Gaussian is visible", "0.2 units", "(--near)"]);
}

#[test]
fn cameras_that_look_away_are_a_sentence() {
    let place = tempfile::tempdir().unwrap();
    let [scene, out] = ["scene", "run"].map(|name| place.path().join(name));
    copy_scene(&scene);
    let mut model = read_model(&find_model(&scene).unwrap()).unwrap();
    for point in &mut model.points {
        // Far up, and the cameras are level.
        point.position[2] += 1e6;
    }
    write_model(&scene.join("sparse/0"), &model).unwrap();
    fail(
        train(&scene, &out, &[&SCHEDULE[..], &["--method", "3dgs"]].concat()),
        &["no Gaussian is visible in any of the 10 training photos"],
    );
    // It has replaced nothing, and the folder can be used.
    let good = place.path().join("good");
    copy_scene(&good);
    succeed(train(&good, &out, &["--iterations", "3"]));
}
