//! Scenes and splats in coordinates of maps: far from their origin.

use std::fs;
use std::path::Path;

use genesplat::io::colmap::{find_model, read_model, write_model};
use genesplat::io::format;
use genesplat::io::offset::read_beside;
use glam::{DQuat, DVec3};

use crate::blocks::write_street;
#[cfg(unix)]
use crate::resume::signal;
#[cfg(unix)]
use crate::support::command;
use crate::support::{copy_scene, fail, json, number, run, scene, succeed, text, train};

/// UTM, metres.
const BY: DVec3 = DVec3::new(431_250.5, 5_412_345.25, 300.0);

/// The scene as a survey has it.
fn write_far(folder: &Path) {
    copy_scene(folder);
    move_far(folder);
}

/// Moves the scene in `folder`: points with all their digits, as text.
fn move_far(folder: &Path) {
    let sparse = folder.join("sparse/0");
    let mut model = read_model(&find_model(folder).unwrap()).unwrap();
    for image in &mut model.images {
        let [w, x, y, z] = image.rotation;
        let turned = DQuat::from_xyzw(x, y, z, w).normalize() * BY;
        image.translation = (DVec3::from(image.translation) - turned).to_array();
    }
    let line = |(id, point): (usize, &genesplat::io::Point)| {
        let [x, y, z] = (DVec3::from(point.position.map(f64::from)) + BY).to_array();
        let [r, g, b] = point.rgb;
        format!("{id} {x} {y} {z} {r} {g} {b} 1\n")
    };
    let points: String = model.points.iter().enumerate().map(line).collect();
    write_model(&sparse, &model).unwrap();
    fs::remove_file(sparse.join("points3D.bin")).unwrap();
    fs::write(sparse.join("points3D.txt"), points).unwrap();
}

fn psnr(splat: &Path, scene: &Path) -> f64 {
    let place = tempfile::tempdir().unwrap();
    let figures = place.path().join("scores.json");
    succeed(["evaluate", text(splat), "--data", text(scene), "--no-lpips", "--json", text(&figures)]);
    number(&json(&figures)["psnr"])
}

#[test]
fn a_scene_of_a_map_trains_and_its_coordinates_are_given_back() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    let (far, trained, near) = (at("far"), at("run"), at("near"));
    write_far(&far);
    let short = ["--iterations", "60", "--no-lpips"];
    let output = run(train(&far, &trained, &short));
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success() && said.contains("less the offset 43125"), "{said}");
    succeed(train(scene(), &near, &short));
    let score = |run: &Path| number(&json(&run.join("metrics.json"))["test"]["psnr"]);
    let here = score(&trained);
    assert!((here - score(&near)).abs() < 0.5, "{here} instead of {}", score(&near));
    let offset = read_beside(&trained.join("point_cloud.ply")).unwrap().unwrap();
    assert!(DVec3::from(offset).distance(BY) < 20.0, "{offset:?}");
    assert!(succeed(["inspect", text(&trained)]).contains("offset"));

    // Beside what is written, in every format; and gone with the next file of that name.
    let (spz, page, copy) = (at("a.spz"), at("a.html"), at("copy.spz"));
    succeed(["convert", text(&trained), text(&spz)]);
    succeed(["export", text(&trained), "--out", text(&page)]);
    for out in [&spz, &page] {
        assert_eq!(read_beside(out), Ok(Some(offset)), "{}", out.display());
    }
    succeed(["convert", text(&spz), text(&copy), "--translate", "1,2,3"]);
    let [x, y, z] = offset;
    assert_eq!(read_beside(&copy), Ok(Some([x - 1.0, y - 2.0, z - 3.0])));
    succeed(["convert", text(&near), text(&copy)]);
    assert_eq!(read_beside(&copy), Ok(None));
    assert!((psnr(&spz, &far) - here).abs() < 0.1, "{} {here}", psnr(&spz, &far));

    // As the map has it, in double precision.
    let map = at("map.ply");
    succeed(["convert", text(&spz), text(&map), "--georeferenced"]);
    let bytes = fs::read(&map).unwrap();
    assert!(String::from_utf8_lossy(&bytes[..150]).contains("property double x"));
    assert_eq!(read_beside(&map), Ok(None));
    let (given_back, written) = (format::read(&map).unwrap(), format::read(&spz).unwrap());
    let by = DVec3::from(given_back.offset.unwrap()) - DVec3::from(offset);
    for (there, here) in given_back.cloud.positions.iter().zip(&written.cloud.positions) {
        let [there, here] = [there, here].map(|position| DVec3::from(position.map(f64::from)));
        assert!((there + by).distance(here) < 1e-5, "{there} {here}");
    }
    assert!((psnr(&map, &far) - psnr(&spz, &far)).abs() < 1e-3);
    fail(
        ["convert", text(&spz), text(&copy), "--georeferenced"],
        &["--georeferenced is for .ply", "copy.spz"],
    );
    fail(
        ["convert", text(&near), text(&map), "--georeferenced"],
        &["has no offset", "leave --georeferenced out"],
    );
}

#[test]
fn a_splat_of_a_map_is_refined_where_it_was() {
    let place = tempfile::tempdir().unwrap();
    let [far, trained, refined] = ["far", "run", "refined.ply"].map(|name| place.path().join(name));
    write_far(&far);
    succeed(train(&far, &trained, &["--iterations", "30", "--no-lpips"]));
    succeed(["refine", text(&trained), "--out", text(&refined), "--iterations", "3"]);
    assert_eq!(read_beside(&refined), read_beside(&trained.join("point_cloud.ply")));
    let change = (psnr(&refined, &far) - psnr(&trained, &far)).abs();
    assert!(change < 1.0, "{change} dB in three steps");
}

#[cfg(unix)]
#[test]
fn an_interrupted_run_of_a_map_goes_on_where_it_was() {
    let place = tempfile::tempdir().unwrap();
    let [far, trained] = ["far", "run"].map(|name| place.path().join(name));
    write_far(&far);
    let arguments = |more: &[&str]| {
        let schedule = ["--iterations", "1200", "--no-lpips"];
        train(&far, &trained, &[&schedule, more].concat())
    };
    let output = signal(&mut command(arguments(&[])), &trained, r#""event":"step""#, "-INT");
    assert_eq!(output.status.code(), Some(130), "{}", String::from_utf8_lossy(&output.stderr));
    let offset = || json(&trained.join("inputs.json"))["scene"]["offset"].clone();
    let before = offset();
    // A photo less: from the others, another offset would be found.
    fs::remove_file(far.join("images").read_dir().unwrap().next().unwrap().unwrap().path()).unwrap();
    succeed(arguments(&["--resume", "--accept-changes"]));
    assert!(before.is_array() && offset() == before, "{before} {}", offset());
    assert_eq!(
        read_beside(&trained.join("point_cloud.ply")).unwrap().map(|by| serde_json::json!(by)),
        Some(before)
    );
}

#[test]
fn blocks_of_a_map_lie_in_one_frame() {
    let place = tempfile::tempdir().unwrap();
    let [street, blocks, merged] = ["street", "blocks", "merged.spz"].map(|name| place.path().join(name));
    write_street(&street);
    move_far(&street);
    succeed(["split", text(&street), "--blocks", "2x1", "--out", text(&blocks), "--train-on-all"]);
    let offset = json(&blocks.join("blocks.json"))["offset"].clone();
    for block in ["0-0", "1-0"] {
        let [scene, run] = ["scenes", "runs"].map(|folder| blocks.join(folder).join(block));
        let quick = ["--iterations", "3", "--train-on-all", "--no-lpips", "--anyway"];
        succeed(train(&scene, &run, &quick));
        assert_eq!(json(&run.join("inputs.json"))["scene"]["offset"], offset);
    }
    succeed(["merge", text(&blocks), "--out", text(&merged)]);
    assert_eq!(read_beside(&merged).unwrap().map(|by| serde_json::json!(by)), Some(offset));
    // Photos of the whole scene see it.
    succeed(["evaluate", text(&merged), "--data", text(&street), "--device", "cpu", "--no-lpips"]);
}

/// Single precision in metres of a map has steps of half a metre.
#[test]
fn a_splat_on_a_grid_is_noticed() {
    let place = tempfile::tempdir().unwrap();
    let (file, out) = (place.path().join("far.ply"), place.path().join("out.spz"));
    let names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    let properties: String = names.split(' ').map(|name| format!("property float {name}\n")).collect();
    let row = |k: usize| format!("{} {} {} 1 1 1 3 -4 -4 -4 1 0 0 0\n", k % 7, 5_412_345 + k % 5, k % 3);
    let rows: String = (0..60).map(row).collect();
    let header = format!("ply\nformat ascii 1.0\nelement vertex 60\n{properties}end_header\n");
    fs::write(&file, header + &rows).unwrap();
    // Words may have any number of digits.
    let mut whole = format::read(&file).unwrap();
    assert_eq!(whole.step, 0.0);
    whole.move_near();
    let mut cloud = whole.cloud;
    cloud.positions.iter_mut().for_each(|position| position[1] += 5_412_345.0);
    let single = place.path().join("single.ply");
    genesplat::io::write_ply(&single, &cloud, &genesplat::io::PlyOptions::default()).unwrap();
    let inspected = succeed(["inspect", text(&single)]);
    assert!(inspected.contains("look at: its coordinates have steps of 0.6"), "{inspected}");
    let output = run(["convert", text(&single), text(&out)]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(
        said.contains("far from its origin") && said.contains("single.ply: its coordinates have steps"),
        "{said}"
    );
    assert!(!said.contains("out.spz: its coordinates"), "what is written is near its origin: {said}");
    assert!((read_beside(&out).unwrap().unwrap()[1] - 5_412_345.0).abs() < 10.0);
}
