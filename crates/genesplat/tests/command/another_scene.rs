//! A splat of another scene is told from one of this scene, at every door where both can be given.

use std::path::Path;

use genesplat::core::Gaussians;
use genesplat::io::{PlyOptions, write_ply};

use crate::support::{fail, json, run, scene, succeed, text, train};

/// A splat in which nothing is where the photos of the bundled scene have it.
pub(crate) fn write_of_another_scene(file: &Path) {
    let mut cloud = Gaussians::zeros(9);
    cloud.rotations = vec![[1.0, 0.0, 0.0, 0.0]; 9];
    cloud.sh.iter_mut().for_each(|sh| sh[..3].copy_from_slice(&[9.0, -9.0, 9.0]));
    (cloud.opacity_logits, cloud.log_scales) = (vec![9.0; 9], vec![[3.0; 3]; 9]);
    write_ply(file, &cloud, &PlyOptions::default()).unwrap();
}

const WORDS: &str = "so it is a splat of another scene or in other axes";

#[test]
fn what_shows_another_scene_is_noticed_wherever_it_is_measured() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    let [splat, ply, png, page] = ["strange.ply", "out.spz", "out.png", "out.html"].map(at);
    write_of_another_scene(&splat);
    let of = |words: &[&str]| {
        let all = [words, &["--data", text(scene()), "--device", "cpu"]].concat();
        let output = run(all.clone());
        assert!(output.status.success(), "{all:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stderr).unwrap()
    };
    for words in [
        ["evaluate", text(&splat), "--no-lpips"].as_slice(),
        &["render", text(&splat), "--image", "gallery_003", "--out", text(&png)],
        &["render", text(&splat), "--split", "all", "--out", text(&at("renders"))],
        &["convert", text(&splat), text(&ply)],
        &["export", text(&splat), "--out", text(&page)],
    ] {
        assert!(of(words).contains(WORDS), "{words:?}");
    }
    fail(
        ["clean", text(&splat), "--data", text(scene()), "--out", text(&at("clean.ply")), "--device", "cpu"],
        &[WORDS, "--anyway"],
    );
}

#[test]
fn inspect_says_whether_a_splat_is_one_of_a_scene() {
    let place = tempfile::tempdir().unwrap();
    let [splat, trained, file] = ["strange.ply", "run", "report.json"].map(|name| place.path().join(name));
    write_of_another_scene(&splat);
    let said = succeed(["inspect", text(&splat), "--data", text(scene())]);
    assert!(said.contains(&format!("look at: {} shows 2 of 2 photos of", text(&splat))), "{said}");
    assert!(said.contains(WORDS), "{said}");
    succeed(train(scene(), &trained, &["--iterations", "60", "--no-lpips"]));
    for own in [trained.clone(), trained.join("point_cloud.ply")] {
        let said = succeed(["inspect", text(&own), "--data", text(scene()), "--max-side", "48"]);
        assert!(said.contains(" dB on 2 photos of") && !said.contains(WORDS), "{said}");
    }
    succeed(["inspect", text(&trained), "--data", text(scene()), "--json", text(&file)]);
    let report = json(&file);
    let psnr = report["facts"].as_array().unwrap().iter().find(|fact| fact["name"] == "PSNR").unwrap();
    assert!(psnr["value"].as_f64().unwrap() > 15.0, "{psnr}");
    fail(["inspect", text(&splat), "--max-side", "48"], &["no photos are looked at", "--data"]);
    fail(["inspect", text(scene()), "--data", text(scene())], &["is a scene itself", "leave --data out"]);
}
