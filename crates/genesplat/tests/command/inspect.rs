//! `inspect` tells what is there, what looks wrong, and what training will take.

use std::fs;

use serde_json::Value;

use crate::support::{copy_scene, fail, json, number, run, scene, succeed, text, train};

/// What the report says under `name`.
fn fact(report: &Value, name: &str) -> Value {
    let facts = report["facts"].as_array().unwrap();
    facts.iter().find(|fact| fact["name"] == name).unwrap_or_else(|| panic!("no {name} in {report}"))["value"]
        .clone()
}

#[test]
fn a_scene_is_described_before_it_is_trained() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("report.json");
    let said = succeed(["inspect", text(scene()), "--json", text(&file)]);
    assert!(said.contains("64x48 pixels") && said.contains("nothing looks wrong"), "{said}");
    let report = json(&file);
    assert_eq!((&report["kind"], report["warnings"].as_array().unwrap().len()), (&"scene".into(), 0));
    assert_eq!((fact(&report, "photos"), fact(&report, "test photos")), (12.into(), 2.into()));
    assert!(number(&fact(&report, "points")) > 100.0 && number(&fact(&report, "depth")) > 0.0);
    // 10 photos of 64x48 pixels over 2 times the root of their number.
    assert_eq!(fact(&report, "Gaussians"), Value::from(4857));
    assert!(number(&fact(&report, "time")) > 0.0 && number(&fact(&report, "memory")) > 4857.0 * 1000.0);
}

#[test]
fn a_photo_that_is_there_twice_is_named() {
    let folder = tempfile::tempdir().unwrap();
    copy_scene(folder.path());
    let images = folder.path().join("images");
    fs::copy(images.join("gallery_003.png"), images.join("gallery_004.png")).unwrap();
    let said = succeed(["inspect", text(folder.path())]);
    assert!(said.contains("look at: photos are there twice (gallery_003.png and gallery_004.png)"), "{said}");
}

#[test]
fn a_scene_without_hope_looks_wrong() {
    let folder = tempfile::tempdir().unwrap();
    copy_scene(folder.path());
    let images = folder.path().join("images");
    (3..7).for_each(|at| fs::remove_file(images.join(format!("gallery_{at:03}.png"))).unwrap());
    (0..9).for_each(|at| {
        _ = fs::copy(images.join("gallery_000.png"), images.join(format!("x{at}.png"))).unwrap()
    });
    fs::create_dir(folder.path().join("masks")).unwrap();
    fs::copy(images.join("gallery_000.png"), folder.path().join("masks/IMG_1.png")).unwrap();
    let said = succeed(["inspect", text(folder.path())]);
    for words in [
        "look at: the scene has 8 photos with cameras, and from fewer than 10",
        "look at: only 8 of the 17 photos have a camera in",
        "masks has no mask of any photo",
    ] {
        assert!(said.contains(words), "{said}");
    }
}

#[test]
fn what_a_scene_lacks_looks_wrong() {
    let folder = tempfile::tempdir().unwrap();
    copy_scene(folder.path());
    fs::remove_file(folder.path().join("images/gallery_003.png")).unwrap();
    let output = run(["inspect", text(folder.path())]);
    let [said, errors] = [output.stdout, output.stderr].map(|text| String::from_utf8(text).unwrap());
    assert!(
        said.contains("look at: 1 of the 12 photos that") && !said.contains("nothing looks wrong"),
        "{said}"
    );
    assert!(!errors.contains("of the 12 photos"), "told twice: {errors}");
}

#[test]
fn runs_and_splats_are_described() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    succeed(train(scene(), &run, &["--iterations", "30"]));
    let metrics = json(&run.join("metrics.json"));
    let file = folder.path().join("report.json");
    succeed(["inspect", text(&run), "--json", text(&file)]);
    let report = json(&file);
    assert_eq!((&report["kind"], fact(&report, "iterations")), (&"run".into(), 30.into()));
    assert_eq!(
        (fact(&report, "Gaussians"), fact(&report, "test PSNR")),
        (metrics["gaussians"].clone(), metrics["test"]["psnr"].clone())
    );

    let splat = run.join("point_cloud.ply");
    succeed(["inspect", text(&splat), "--json", text(&file)]);
    assert_eq!(
        (&json(&file)["kind"], fact(&json(&file), "Gaussians")),
        (&"splat".into(), metrics["gaussians"].clone())
    );
    fail(["inspect", text(&splat), "--json", text(&splat)], &["point_cloud.ply"]);
    fail(["inspect", text(&folder.path().join("absent"))], &["absent", "does not exist"]);
}
