//! Which photos are used, and for what, as a user says it.

use std::fs;
use std::path::Path;

use genesplat::core::Photo;
use genesplat::io::photos::{read_photo, write_png};

use crate::support::{cloud, copy_scene, fail, json, number, scene, succeed, text, train};

/// The names of a run's test photos, in order.
fn tested(run: &Path) -> Vec<String> {
    let metrics = json(&run.join("metrics.json"));
    let views = metrics["test"]["views"].as_array().unwrap().clone();
    views.iter().map(|view| view["name"].as_str().unwrap().to_owned()).collect()
}

fn evaluate(run: &Path, more: &[&str]) -> Vec<String> {
    let fixed = ["evaluate", text(run), "--data", text(scene()), "--device", "cpu"];
    fixed.iter().chain(more).map(|word| (*word).to_owned()).collect()
}

#[test]
fn a_run_keeps_the_photos_that_it_was_told_to_hold_out() {
    let folder = tempfile::tempdir().unwrap();
    let (run, scores) = (folder.path().join("run"), folder.path().join("scores.json"));
    succeed(train(scene(), &run, &["--iterations", "3", "--test-every", "5"]));
    assert_eq!(tested(&run), ["gallery_000.png", "gallery_005.png", "gallery_010.png"]);
    // Every eighth would be two of them, and one that training saw.
    succeed(evaluate(&run, &["--json", text(&scores)]));
    assert_eq!(json(&scores)["views"], json(&run.join("metrics.json"))["test"]["views"]);
    let renders = folder.path().join("renders");
    succeed(["render", text(&run), "--data", text(scene()), "--split", "test", "--out", text(&renders)]);
    assert_eq!(fs::read_dir(&renders).unwrap().count(), 3);
    fail(
        evaluate(&run, &["--test-every", "8"]),
        &["gallery_008.png is a test photo", "was none when the run"],
    );
    let again = folder.path().join("again");
    succeed(train(scene(), &again, &["--config", text(&run.join("config.toml"))]));
    assert_eq!(tested(&again), tested(&run));
}

#[test]
fn photos_are_held_out_by_name_or_not_at_all() {
    let folder = tempfile::tempdir().unwrap();
    let (run, list) = (folder.path().join("run"), folder.path().join("test.txt"));
    let listed = ["--iterations", "3", "--test-list", text(&list)];
    fs::write(&list, "gallery_007\n\n  gallery_002.png \n").unwrap();
    succeed(train(scene(), &run, &listed));
    assert_eq!(tested(&run), ["gallery_002.png", "gallery_007.png"]);
    // The run does not need the list any more.
    fs::remove_file(&list).unwrap();
    succeed(evaluate(&run, &[]));
    let other = folder.path().join("other");
    fail(train(scene(), &other, &listed), &["cannot read the list", "test.txt"]);
    fs::write(&list, "IMG_0001.jpg").unwrap();
    fail(train(scene(), &other, &listed), &["no photo called IMG_0001.jpg", "gallery_000.png"]);
    fs::write(&list, "\n").unwrap();
    fail(train(scene(), &other, &listed), &["test.txt", "names no photo", "--train-on-all"]);

    succeed(train(scene(), &other, &["--iterations", "3", "--train-on-all"]));
    assert_eq!(tested(&other), [""; 0]);
    fail(evaluate(&other, &[]), &["no test photos", "--split train"]);
}

/// The bundled scene, of which the right half of each photo is hidden, and `behind` the masks if that is a
/// grey.
fn write_half_hidden(scene: &Path, behind: Option<u8>) {
    write_masked(scene, |x, width| x >= width / 2, behind);
}

/// The bundled scene with masks over the columns that are to be hidden, and `behind` them if that is a grey.
fn write_masked(scene: &Path, is_hidden: impl Fn(u32, u32) -> bool, behind: Option<u8>) {
    copy_scene(scene);
    for entry in fs::read_dir(scene.join("images")).unwrap() {
        let path = entry.unwrap().path();
        let mut photo = read_photo(&path).unwrap();
        let mut mask = Photo { rgb: vec![255; photo.rgb.len()], ..photo };
        let hidden = |index: &usize| is_hidden(*index as u32 % photo.width, photo.width);
        for index in (0..photo.rgb.len() / 3).filter(hidden) {
            mask.rgb[3 * index..3 * index + 3].fill(0);
            if let Some(grey) = behind {
                photo.rgb[3 * index..3 * index + 3].fill(grey);
            }
        }
        let name = format!("{}.png", path.file_name().unwrap().to_str().unwrap());
        write_png(&scene.join("masks").join(name), &mask).unwrap();
        write_png(&path, &photo).unwrap();
    }
}

#[test]
fn what_a_mask_hides_changes_no_byte_of_the_splat() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let runs = [("white", Some(255)), ("black", Some(0)), ("whole", None)].map(|(name, behind)| {
        let (scene, run) = (place(name), place(&format!("{name}-run")));
        write_half_hidden(&scene, behind);
        succeed(train(&scene, &run, &["--iterations", "120"]));
        run
    });
    let test = |run: &Path| json(&run.join("metrics.json"))["test"].clone();
    for run in &runs[1..] {
        assert!(cloud(run) == cloud(&runs[0]), "{run:?}");
        assert_eq!(test(run), test(&runs[0]));
    }
    // Where a wall of white is background, it is learned.
    let evaluate = |more: &[&str]| {
        let scene = place("white");
        succeed([&["evaluate", text(&runs[0]), "--data", text(&scene), "--device", "cpu"], more].concat())
    };
    assert_ne!(evaluate(&[]), evaluate(&["--mask", "transparent", "--background", "white"]));
    let random = ["--mask", "transparent", "--background", "random"];
    fail(train(&place("white"), &place("run"), &random), &["mask is transparent", "background is random"]);
}

/// What weighs pixels and edges, and what evolves, sees as little of it.
#[test]
fn what_a_mask_hides_changes_no_method() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = [255, 0].map(|behind| {
        let scene = folder.path().join(behind.to_string());
        write_half_hidden(&scene, Some(behind));
        scene
    });
    for method in ["3dgs", "pixel-gs", "mip-splatting", "mcmc", "improved-gs"] {
        let [white, black] = [0, 1].map(|at| {
            let run = folder.path().join(format!("{method}-{at}"));
            let short = ["--method", method, "--iterations", "7000", "--steps-scale", "0.02"];
            succeed(train(&scenes[at], &run, &short));
            cloud(&run)
        });
        assert!(white == black, "{method}");
    }
}

/// A mask that hides nothing is none.
#[test]
fn a_white_mask_changes_no_byte() {
    let folder = tempfile::tempdir().unwrap();
    let masked = folder.path().join("masked");
    write_masked(&masked, |_, _| false, None);
    let [plain, masked] = [("plain", scene()), ("masked-run", &masked)].map(|(name, scene)| {
        let run = folder.path().join(name);
        succeed(train(scene, &run, &["--iterations", "7000", "--steps-scale", "0.02"]));
        cloud(&run)
    });
    assert!(plain == masked);
}

/// The left half is reconstructed as well as where nothing is hidden.
#[test]
fn half_of_each_photo_is_as_good_as_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let (hidden, file) = (folder.path().join("hidden"), folder.path().join("scores.json"));
    let unhurried = folder.path().join("unhurried.toml");
    fs::write(&unhurried, "[method]\nname = \"genesplat\"\nfew_looks = 0\n").unwrap();
    write_half_hidden(&hidden, Some(128));
    let psnr = |scene: &Path, name: &str| {
        let run = folder.path().join(name);
        succeed(train(scene, &run, &["--iterations", "600", "--config", text(&unhurried)]));
        // Of the whole scene's splat, too, the half that counts.
        succeed(["evaluate", text(&run), "--data", text(&hidden), "--json", text(&file), "--device", "cpu"]);
        number(&json(&file)["psnr"])
    };
    let (half, whole) = (psnr(&hidden, "half"), psnr(scene(), "whole"));
    assert!(half > whole - 0.5 && whole > 18.0, "{half} dB with masks, {whole} dB without");
}

#[test]
fn a_preset_is_settings_that_flags_change() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    succeed(train(scene(), &run, &["--preset", "quick", "--max-side", "48", "--iterations", "40"]));
    let config = fs::read_to_string(run.join("config.toml")).unwrap();
    assert!(config.contains("steps_scale = 1.0") && config.contains("max_side = 48"), "{config}");
    assert_eq!(json(&run.join("metrics.json"))["iterations"], 40, "as many as were asked for");
    let help = succeed(["train", "--help"]);
    assert!(
        ["quick", "standard", "best", "640 pixels", "30000 steps"].iter().all(|word| help.contains(word)),
        "{help}"
    );
}

#[test]
fn a_limit_of_gaussians_holds_from_the_first_step_on() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    let output = crate::support::run(train(scene(), &run, &["--iterations", "3", "--max-gaussians", "90"]));
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && said.contains("thinned evenly to 90 (--max-gaussians)"), "{said}");
    let gaussians = number(&json(&run.join("metrics.json"))["gaussians"]);
    assert!((45.0..=90.0).contains(&gaussians), "{gaussians}");
}
