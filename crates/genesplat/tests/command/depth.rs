//! Depth maps, as the command is given them.

use std::fs;
use std::path::Path;

use genesplat::gallery::{self, GalleryOptions};

#[cfg(unix)]
use crate::resume::signal;
#[cfg(unix)]
use crate::support::command;
use crate::support::{cloud, fail, json, number, run, succeed, text, train};

/// A gallery with the depth maps of a dense reconstruction, each depth times `factor`.
fn write_scene(folder: &Path, factor: f32) {
    let options = GalleryOptions { width: 64, height: 48, views: 16, points: 400, seed: 5 };
    let gallery = gallery::generate(&options);
    gallery.write_colmap(folder).unwrap();
    for (view, depths) in gallery.views.iter().zip(gallery::depths(&options)) {
        write_map(folder, &view.name, depths.into_iter().map(|depth| factor * depth));
    }
}

fn write_map(folder: &Path, photo: &str, depths: impl Iterator<Item = f32>) {
    let values = depths.flat_map(|depth| depth.to_le_bytes());
    let bytes: Vec<u8> = b"64&48&1&".iter().copied().chain(values).collect();
    let maps = folder.join("stereo/depth_maps");
    fs::create_dir_all(&maps).unwrap();
    fs::write(maps.join(format!("{photo}.geometric.bin")), bytes).unwrap();
}

const SHORT: [&str; 4] = ["--iterations", "300", "--corrections", "off"];

#[test]
fn depth_maps_train_shapes_and_their_error_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let [scene, feet, first, second, off, published] =
        ["scene", "feet", "first", "second", "off", "published"].map(|name| folder.path().join(name));
    write_scene(&scene, 1.0);
    let output = run(train(&scene, &first, &SHORT));
    let (said, told) = (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap());
    assert!(output.status.success(), "{told}");
    assert!(told.contains("16 of 16 photos have a depth map, which trains shapes (--depth off)"), "{told}");
    assert!(said.contains("depths of test photos are off by "), "{said}");
    let error = |out: &Path| number(&json(&out.join("metrics.json"))["test_depth_error"]);
    assert!((0.001..0.25).contains(&error(&first)), "{}", error(&first));
    assert!(
        fs::read_to_string(first.join("report.html")).unwrap().contains("Depths of test photos are off by")
    );

    // In another unit they are the same maps, but for rounding.
    write_scene(&feet, 3.28);
    let output = run(train(&feet, &second, &[&SHORT[..], &["--threads", "1"]].concat()));
    let told = String::from_utf8(output.stderr).unwrap();
    assert!(told.contains("16 depth maps are brought to the scene's unit by its points"), "{told}");
    assert!((error(&second) - error(&first)).abs() < 0.03, "{} {}", error(&second), error(&first));

    // Without them shapes are worse, and nothing is told of them.
    let told =
        String::from_utf8(run(train(&scene, &off, &[&SHORT[..], &["--depth", "off"]].concat())).stderr);
    assert!(!told.unwrap().contains("depth map"));
    assert!(json(&off.join("metrics.json"))["test_depth_error"].is_null());
    assert_ne!(cloud(&off), cloud(&first));
    // A published method knows photos alone.
    run(train(&scene, &published, &["--iterations", "20", "--method", "3dgs"]));
    assert!(json(&published.join("metrics.json"))["test_depth_error"].is_null());
    succeed(["evaluate", text(&first), "--device", "cpu"]);
    let found = succeed(["inspect", text(&scene)]);
    assert!(
        found.contains("16 of 16 photos have a depth map") && found.contains("look at a depth map"),
        "{found}"
    );
}

#[test]
#[cfg(unix)]
fn the_bytes_depend_on_no_thread_and_a_stopped_run_ends_as_one_that_was_not() {
    let folder = tempfile::tempdir().unwrap();
    let [scene, whole, broken] = ["scene", "whole", "broken"].map(|name| folder.path().join(name));
    write_scene(&scene, 1.0);
    let steps = ["--iterations", "900", "--max-gaussians", "600", "--corrections", "off"];
    succeed(train(&scene, &whole, &[&steps[..], &["--threads", "1"]].concat()));
    let mut stopped = command(train(&scene, &broken, &[&steps[..], &["--threads", "2"]].concat()));
    let output = signal(&mut stopped, &broken, r#""event":"step""#, "-INT");
    assert_eq!(output.status.code(), Some(130), "{}", String::from_utf8_lossy(&output.stderr));
    // A map that is another one by now is noticed.
    let map = scene.join("stereo/depth_maps/gallery_003.png.geometric.bin");
    let before = fs::read(&map).unwrap();
    write_map(&scene, "gallery_003.png", (0..64 * 48).map(|_| 2.0));
    let resume = train(&scene, &broken, &["--resume"]);
    fail(resume.clone(), &["the depth map of photo gallery_003.png is not what the run began with"]);
    fs::write(&map, before).unwrap();
    fail(train(&scene, &broken, &["--resume", "--depth", "off"]), &["depth"]);
    succeed(resume);
    assert!(cloud(&whole) == cloud(&broken), "as if it had never been stopped, on one thread");
}
