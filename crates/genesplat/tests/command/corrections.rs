//! Photos of other exposure than the rest, as the command is given them.

use std::fs;
use std::path::Path;

use genesplat::core::Photo;
use genesplat::gallery::{self, Gallery, GalleryOptions};
#[cfg(unix)]
use genesplat::run::{follow::Followed, splat};

#[cfg(unix)]
use crate::resume::signal;
#[cfg(unix)]
use crate::support::command;
use crate::support::{cloud, fail, json, number, run, scene, succeed, text, train};

/// A gallery whose photos were taken with these gains, with tracks.
fn write_scene(folder: &Path, gain: impl Fn(usize) -> f32) {
    write_damaged(folder, |index, _, _| gain(index));
}

/// The same with gains of a photo, a channel and a place between the middle, 0, and a corner, 1.
fn write_damaged(folder: &Path, gain: impl Fn(usize, usize, f32) -> f32) {
    let options = GalleryOptions { width: 64, height: 48, views: 16, points: 400, seed: 5 };
    let mut gallery = gallery::generate(&options);
    for (index, view) in gallery.views.iter_mut().enumerate() {
        let photo = view.photo.read().unwrap();
        let changed = |(place, value): (usize, &u8)| {
            let (x, y) = ((place / 3 % 64) as f32 - 31.5, (place / 192) as f32 - 23.5);
            let gain = gain(index, place % 3, (x * x + y * y) / 1600.0);
            (f32::from(*value) * gain).round().min(255.0) as u8
        };
        let rgb = photo.rgb.iter().enumerate().map(changed).collect();
        view.photo = Photo { rgb, ..*photo }.into();
    }
    gallery.write_colmap(folder).unwrap();
    fs::write(folder.join("sparse/0/points3D.bin"), points_with_tracks(&gallery)).unwrap();
}

fn points_with_tracks(gallery: &Gallery) -> Vec<u8> {
    let mut bytes = (gallery.points.len() as u64).to_le_bytes().to_vec();
    for (index, point) in (0u32..).zip(&gallery.points) {
        let track: Vec<u32> =
            (1u32..).zip(&gallery.seen).filter(|(_, seen)| seen.contains(&index)).map(|(id, _)| id).collect();
        bytes.extend(u64::from(index).to_le_bytes());
        bytes.extend(point.position.map(|value| f64::from(value).to_le_bytes()).concat());
        bytes.extend(point.rgb);
        bytes.extend(0.5f64.to_le_bytes());
        bytes.extend((track.len() as u64).to_le_bytes());
        bytes.extend(track.iter().flat_map(|id| [id.to_le_bytes(), 0u32.to_le_bytes()].concat()));
    }
    bytes
}

fn damage(index: usize) -> f32 {
    [1.0, 0.7, 1.3, 0.85, 1.15][index % 5]
}

#[test]
fn photos_of_other_exposure_are_brought_to_one_and_every_figure_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let [scene, first, second, off] =
        ["scene", "first", "second", "off"].map(|name| folder.path().join(name));
    write_scene(&scene, damage);
    let short = ["--iterations", "40", "--threads", "1", "--corrections", "on"];
    let output = run(train(&scene, &first, &short));
    assert!(output.status.success());
    let (said, told) = (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap());
    assert!(told.contains("are brought to one exposure, which explains"), "{told}");
    assert!(said.contains("at the exposure of training photos nearby; "), "{said}");
    let metrics = json(&first.join("metrics.json"));
    let (figure, unseen) =
        (|name: &str| number(&metrics["exposure"][name]), number(&metrics["test"]["psnr"]));
    assert!(figure("test_psnr_at_track_exposure") > unseen + 0.5, "nobody foretells this damage: {metrics}");
    assert!(figure("test_cc_psnr") > figure("test_psnr_raw"), "{metrics}");
    // The splat is at the mean exposure, so another command finds the same of it.
    let scores = folder.path().join("scores.json");
    succeed(["evaluate", text(&first), "--device", "cpu", "--json", text(&scores)]);
    let found = json(&scores);
    for (name, value) in [
        ("psnr_at_track_exposure", figure("test_psnr_at_track_exposure")),
        ("psnr_raw", figure("test_psnr_raw")),
    ] {
        let again = number(&found["exposure"][name]);
        assert!((again - value).abs() < 0.05, "{name}: {again} {value}");
    }
    assert!((number(&found["cc_psnr"]) - figure("test_cc_psnr")).abs() < 0.05);
    assert!((number(&found["psnr"]) - unseen).abs() < 0.05);
    // What a format loses is told at the exposure of the photos.
    let said = succeed(["convert", text(&first), text(&folder.path().join("a.spz"))]);
    let before = format!("{:.2} before", figure("test_psnr_at_track_exposure"));
    assert!(said.contains(&before), "{before}: {said}");
    succeed(train(&scene, &second, &["--iterations", "40", "--threads", "2"]));
    assert!(
        cloud(&first) == cloud(&second),
        "same seed, same bytes; and it is worth it, so nobody has to ask"
    );
    succeed(train(&scene, &off, &["--iterations", "40", "--threads", "1", "--corrections", "off"]));
    let metrics = json(&off.join("metrics.json"));
    assert!(metrics.get("exposure").is_none() && cloud(&off) != cloud(&first));
}

#[test]
fn photos_of_one_exposure_are_trained_on_as_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let [scene, usual, off] = ["scene", "usual", "off"].map(|name| folder.path().join(name));
    write_scene(&scene, |_| 1.0);
    let output = run(train(&scene, &usual, &["--iterations", "40"]));
    let told = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && told.contains("and keep their exposure"), "{told}");
    succeed(train(&scene, &off, &["--iterations", "40", "--corrections", "off"]));
    assert!(cloud(&usual) == cloud(&off) && json(&usual.join("metrics.json")).get("exposure").is_none());
}

#[test]
fn nine_tenths_of_known_damage_come_back_on_photos_without_any() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = ["plain", "damaged"].map(|name| folder.path().join(name));
    write_scene(&scenes[0], |_| 1.0);
    // Exposure, white balance and dark corners of training photos; test photos stay as they are.
    write_damaged(&scenes[1], |index, channel, place| match index % 8 {
        0 => 1.0,
        _ => {
            let white = 1.0 + 0.08 * ((index + 2 * channel) as f32).sin();
            (1.0 + 0.3 * (1.7 * index as f32).sin()) * white * (-0.2 * place).exp()
        }
    });
    // Raw: what was not damaged is as the mean exposure is.
    let psnr = |scene: &Path, corrections: &str| {
        let out = scene.with_extension(corrections);
        succeed(train(scene, &out, &["--iterations", "500", "--corrections", corrections]));
        let metrics = json(&out.join("metrics.json"));
        let is_on = corrections == "on";
        number(if is_on { &metrics["exposure"]["test_psnr_raw"] } else { &metrics["test"]["psnr"] })
    };
    let [plain, damaged, back] =
        [(0, "off"), (1, "off"), (1, "on")].map(|(scene, corrections)| psnr(&scenes[scene], corrections));
    assert!(plain > damaged + 3.0, "{plain} {damaged}");
    assert!(back - damaged > 0.9 * (plain - damaged), "{plain} {damaged} {back}");
}

#[test]
fn a_render_as_a_photo_has_its_exposure() {
    let folder = tempfile::tempdir().unwrap();
    let [scene, run_folder, mean, own] =
        ["scene", "run", "mean.png", "own.png"].map(|name| folder.path().join(name));
    write_scene(&scene, damage);
    succeed(train(&scene, &run_folder, &["--iterations", "60", "--corrections", "on"]));
    // Taken with seven tenths of the light.
    let render = |out: &Path, more: &[&str]| {
        let words = ["render", text(&run_folder), "--image", "gallery_001.png", "--device", "cpu", "--out"];
        succeed(words.into_iter().chain([text(out)]).chain(more.iter().copied()));
        let picture = genesplat::io::photos::read_photo(out).unwrap();
        picture.rgb.iter().map(|value| f64::from(*value)).sum::<f64>()
    };
    let ratio = render(&own, &["--as-photo"]) / render(&mean, &[]);
    assert!((ratio - 0.7).abs() < 0.05, "{ratio}");
    let cloud = run_folder.join("point_cloud.ply");
    let words = ["render", text(&cloud), "--data", text(&scene), "--image", "gallery_001.png", "--as-photo"];
    fail(words.into_iter().chain(["--out", text(&own)]), &["does not say what exposure", "--as-photo"]);
}

#[test]
fn a_refined_splat_stays_at_the_mean_exposure() {
    let folder = tempfile::tempdir().unwrap();
    let [scene, run, refined] = ["scene", "run", "refined.ply"].map(|name| folder.path().join(name));
    write_scene(&scene, damage);
    succeed(train(&scene, &run, &["--iterations", "60", "--corrections", "on"]));
    let said =
        succeed(["refine", text(&run), "--out", text(&refined), "--iterations", "20", "--device", "cpu"]);
    let psnr = |line: &&str| -> f64 { line.split_whitespace().nth(3).unwrap().parse().unwrap() };
    let of = |when: &str, split: &str| {
        said.lines().find(|line| line.starts_with(when) && line.contains(split)).as_ref().map(psnr).unwrap()
    };
    let (before, after) = (of("before", "train"), of("after", "train"));
    assert!(after > before - 0.2, "{before} {after}: {said}");
    let trained = number(&json(&run.join("metrics.json"))["train"]["psnr"]);
    assert!((before - trained).abs() < 0.05, "{before} {trained}");
}

#[test]
fn mistakes_about_corrections_are_sentences() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    // The shared scene has no tracks.
    fail(
        train(scene(), &out, &["--corrections", "on"]),
        &["which photos share which points", "--corrections on"],
    );
    let output = run(train(scene(), &out, &["--corrections", "maybe"]));
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(
        output.status.code() == Some(2) && said.contains("off") && said.contains("--corrections"),
        "{said}"
    );
    let scene = folder.path().join("scene");
    write_scene(&scene, damage);
    let white = ["--corrections", "on", "--background", "white"];
    fail(train(&scene, &out, &white), &["a white background has no exposure", "--corrections on"]);
}

#[cfg(unix)]
#[test]
fn a_run_that_was_stopped_goes_on_at_the_exposure_that_it_began_with() {
    let folder = tempfile::tempdir().unwrap();
    let [scene, whole, broken] = ["scene", "whole", "broken"].map(|name| folder.path().join(name));
    write_scene(&scene, damage);
    let steps = ["--iterations", "900", "--max-gaussians", "600", "--corrections", "on"];
    succeed(train(&scene, &whole, &steps));
    let mut stopped = command(train(&scene, &broken, &steps));
    let output = signal(&mut stopped, &broken, r#""event":"step""#, "-INT");
    assert_eq!(output.status.code(), Some(130), "{}", String::from_utf8_lossy(&output.stderr));
    // Who looks at it meanwhile sees the mean exposure, though the checkpoint has that of training.
    let saved = splat::open(&broken.join("point_cloud.ply")).unwrap().cloud;
    fs::remove_file(broken.join("point_cloud.ply")).unwrap();
    let shown = Followed::of(&broken).unwrap().open().unwrap().cloud;
    assert!(shown.len() == saved.len() && (shown.sh[0][0] - saved.sh[0][0]).abs() < 1e-4);
    let other = [&steps[..4], &["--resume", "--corrections", "off"]].concat();
    fail(train(&scene, &broken, &other), &["dataset.corrections is on there and off here"]);
    succeed(train(&scene, &broken, &["--resume"]));
    assert!(cloud(&whole) == cloud(&broken), "as if it had never been stopped");
}
