//! Splats go from format to format, and every command reads them all.

use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use genesplat::core::gaussians::sigmoid;
use genesplat::core::spherical_harmonics::sh_index;
use genesplat::core::{Gaussians, Similarity};
use genesplat::io::colmap::{find_model, read_model, write_model};
use genesplat::io::format::{self, Format};
use genesplat::io::{PlyOptions, write_ply};
use glam::{DQuat, DVec3};
use tempfile::TempDir;

use crate::support::{copy_scene, fail, json, number, real_data, run, scene, succeed, text, train};

/// A short run that several tests look at.
static RUN: LazyLock<TempDir> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    succeed(train(scene(), &folder.path().join("run"), &["--iterations", "200", "--no-lpips"]));
    folder
});

fn finished_run() -> PathBuf {
    RUN.path().join("run")
}

fn psnr(splat: &Path, scene: &Path) -> f64 {
    let place = tempfile::tempdir().unwrap();
    let figures = place.path().join("scores.json");
    succeed(["evaluate", text(splat), "--data", text(scene), "--no-lpips", "--json", text(&figures)]);
    number(&json(&figures)["psnr"])
}

/// The figure of the line that begins so.
fn figure(said: &str, line: &str, word: usize) -> f64 {
    let line =
        said.lines().find(|text| text.starts_with(line)).unwrap_or_else(|| panic!("no {line}: {said}"));
    line.split_whitespace().nth(word).unwrap().replace(',', "").parse().unwrap()
}

#[test]
fn a_run_becomes_every_format_and_each_is_measured_and_refined() {
    let folder = tempfile::tempdir().unwrap();
    let run = finished_run();
    let before = psnr(&run, scene());
    for format in Format::ALL {
        let out = folder.path().join(format!("splat{}", format.ending()));
        let said = succeed(["convert", text(&run), text(&out), "--data", text(scene())]);
        let (after, lost) = (psnr(&out, scene()), figure(&said, "lost", 1));
        assert!(
            (figure(&said, "before", 3) - before).abs() < 0.006
                && (figure(&said, "after", 3) - after).abs() < 0.006
        );
        assert!((before - after - lost).abs() < 0.006, "{said}");
        let most = if format == Format::Splat { 2.0 } else { 0.5 };
        assert!(lost < most, "{format:?} loses {lost} dB");
        let (bytes, rows) = (std::fs::metadata(&out).unwrap().len(), format::read(&out).unwrap().cloud.len());
        let line = said.lines().find(|line| line.contains("written to")).unwrap();
        assert_eq!(figure(line, "", 0), rows as f64, "{line}");
        assert!(line.replace(',', "").contains(&format!(": {bytes} bytes")), "{line}");
        let refined = folder.path().join(format!("refined{}", format.ending()));
        succeed([
            "refine",
            text(&out),
            "--data",
            text(scene()),
            "--iterations",
            "3",
            "--out",
            text(&refined),
        ]);
        assert_eq!(format::read(&refined).unwrap().format, format, "the name says what is written");
    }
}

/// Nobody asks, and the photos of the run are there.
#[test]
fn what_a_run_loses_is_said_by_itself() {
    let folder = tempfile::tempdir().unwrap();
    let run_folder = finished_run();
    let lost = |said: &str| said.lines().find(|line| line.starts_with("lost")).map(str::to_owned);
    let spz = folder.path().join("a.spz");
    let line = lost(&succeed(["convert", text(&run_folder), text(&spz)])).unwrap();
    assert!(line.contains("photos that training never saw: "), "{line}");
    let before = psnr(&run_folder, scene());
    assert!(line.contains(&format!("{before:.2} before, {:.2} after", psnr(&spz, scene()))), "{line}");
    let page = succeed(["export", text(&run_folder), "--out", text(&folder.path().join("a.html"))]);
    assert!(lost(&page).unwrap().contains(&format!("{before:.2} before")), "{page}");
    // A copy loses nothing, and a file does not say which photos it shows.
    let ply = folder.path().join("a.ply");
    assert_eq!(lost(&succeed(["convert", text(&run_folder), text(&ply)])), None);
    assert_eq!(lost(&succeed(["convert", text(&ply), text(&spz)])), None);
    // Where the scene has gone, a sentence says so.
    let (moved, copied) = (folder.path().join("scene"), folder.path().join("run"));
    copy_scene(&moved);
    succeed(train(&moved, &copied, &["--iterations", "3", "--no-lpips"]));
    std::fs::remove_dir_all(&moved).unwrap();
    let output = run(["convert", text(&copied), text(&spz)]);
    let notice = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && notice.contains("what is lost is not measured"), "{notice}");
    assert!(notice.contains("is not there; give --data SCENE"), "{notice}");
    assert_eq!(lost(&String::from_utf8(output.stdout).unwrap()), None);
}

/// A PLY keeps all colours, so it does not count from where they are seen.
#[test]
fn cameras_are_asked_for_only_where_a_format_changes_colours() {
    let folder = tempfile::tempdir().unwrap();
    let (moved, run_folder) = (folder.path().join("scene"), folder.path().join("run"));
    copy_scene(&moved);
    succeed(train(&moved, &run_folder, &["--iterations", "3", "--no-lpips"]));
    std::fs::write(moved.join("sparse/0/images.bin"), "damaged").unwrap();
    for (out, is_told) in [("a.ply", false), ("a.compressed.ply", true)] {
        let output = run(["convert", text(&run_folder), text(&folder.path().join(out))]);
        let notice = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{notice}");
        assert_eq!(notice.contains("colours are written as they are"), is_told, "{out}: {notice}");
    }
}

/// The scene with cameras that are turned, scaled and moved.
fn write_moved(folder: &Path, by: &Similarity) {
    copy_scene(folder);
    let mut model = read_model(&find_model(folder).unwrap()).unwrap();
    for image in &mut model.images {
        let [w, x, y, z] = image.rotation;
        let old = DQuat::from_xyzw(x, y, z, w).normalize();
        let centre = by.point(old.inverse() * -DVec3::from(image.translation));
        let new = old * by.rotation.inverse();
        image.rotation = [new.w, new.x, new.y, new.z];
        image.translation = (-(new * centre)).to_array();
    }
    write_model(&folder.join("sparse/0"), &model).unwrap();
}

/// Splat and cameras turned together show the same pictures, highlights too.
#[test]
fn a_splat_is_turned_scaled_and_moved_with_its_colours() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let (run_folder, turned, moved, plain) =
        (finished_run(), place("turned.ply"), place("moved"), place("plain.ply"));
    let words = ["--rotate", "30,-70,110", "--scale", "1.5", "--translate", "-1,2,0.5"];
    succeed(["convert", text(&run_folder), text(&turned)].iter().chain(&words));
    let angles = [30.0f64, -70.0, 110.0].map(f64::to_radians);
    let rotation = DQuat::from_rotation_z(angles[2])
        * DQuat::from_rotation_y(angles[1])
        * DQuat::from_rotation_x(angles[0]);
    write_moved(&moved, &Similarity { rotation, scale: 1.5, translation: DVec3::new(-1.0, 2.0, 0.5) });
    let before = psnr(&run_folder, scene());
    assert!((psnr(&turned, &moved) - before).abs() < 0.005, "{before}");
    // With harmonics as they were, pictures differ.
    let mut wrong = format::read(&turned).unwrap().cloud;
    wrong.sh = format::read(&run_folder.join("point_cloud.ply")).unwrap().cloud.sh;
    write_ply(&plain, &wrong, &PlyOptions::default()).unwrap();
    assert!(psnr(&plain, &moved) < before - 0.02, "{before}");
    // The loss is measured where the splat was.
    let spz = place("turned.spz");
    let said = succeed(["convert", text(&run_folder), text(&spz)].iter().chain(&words));
    assert!(figure(&said, "lost", 1).abs() < 0.05, "{said}");
}

#[test]
fn up_is_what_cameras_have_as_up() {
    let folder = tempfile::tempdir().unwrap();
    let (run_folder, out) = (finished_run(), folder.path().join("up.ply"));
    let output = run(["convert", text(&run_folder), text(&out), "--up", "z"]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && said.contains("up was") && said.contains("by the cameras"), "{said}");
    let file = run_folder.join("point_cloud.ply");
    let output = run(["convert", text(&file), text(&out), "--up", "z"]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("up was") && said.contains("as files have it"), "{said}");
    let [before, after] = [&file, &out].map(|path| format::read(path).unwrap().cloud.positions);
    let is_turned = before
        .iter()
        .zip(&after)
        .all(|(a, b)| (b[2] + a[1]).abs() < 1e-4 && (b[0] - a[0]).abs() < 1e-4 && (b[1] - a[2]).abs() < 1e-4);
    assert!(is_turned, "-y has become z: {:?} {:?}", before[0], after[0]);
}

#[test]
fn splats_are_cut_on_the_way() {
    let folder = tempfile::tempdir().unwrap();
    let (run, out) = (finished_run(), folder.path().join("cut.ply"));
    let whole = format::read(&run.join("point_cloud.ply")).unwrap().cloud;
    let convert = |more: &[&str]| {
        succeed(["convert", text(&run), text(&out)].iter().chain(more));
        format::read(&out).unwrap().cloud
    };
    assert_eq!(convert(&[]), whole, "a PLY is a copy");
    let cropped = convert(&["--crop", "-0.5,-10,-10,0.5,10,10"]);
    let inside = whole.positions.iter().filter(|position| (-0.5..=0.5).contains(&position[0]));
    assert_eq!(cropped.len(), inside.count());
    assert!(!cropped.is_empty() && cropped.len() < whole.len());
    let pruned = convert(&["--prune", "0.2"]);
    let visible = whole.opacity_logits.iter().filter(|&&logit| sigmoid(logit) >= 0.2);
    assert_eq!(pruned.len(), visible.count());
    assert_eq!(convert(&["--sh-degree", "0"]).sh_degree_in_use(), 0);
    fail(["convert", text(&run), text(&out), "--crop", "90,90,90,91,91,91"], &["no Gaussian", "--crop"]);
}

#[test]
fn gaussians_that_cannot_be_shown_are_left_out_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("in.ply"), folder.path().join("out.ply"));
    let mut cloud = format::read(&finished_run().join("point_cloud.ply")).unwrap().cloud;
    let (whole, rows) = (cloud.clone(), cloud.len() as u32);
    let save = |cloud: &Gaussians| write_ply(&path, cloud, &PlyOptions::default()).unwrap();
    let notices = |data: &[&str]| {
        let output = run(["convert", text(&path), text(&out)].iter().chain(data));
        assert!(output.status.success(), "{output:?}");
        (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap())
    };
    cloud.positions[5][1] = f32::NAN;
    save(&cloud);
    let (said, notice) = notices(&["--data", text(scene())]);
    let one = format!(
        "notice: 1 of {rows} Gaussians is left out, since the position of Gaussian 5 is not finite\n"
    );
    assert!(notice.replace(',', "").contains(&one.replace(',', "")), "{notice}");
    let lines =
        ["read from", "written to"].map(|what| said.lines().find(|line| line.contains(what)).unwrap());
    assert_eq!(lines.map(|line| figure(line, "", 0)), [f64::from(rows), f64::from(rows - 1)]);
    let left: Vec<u32> = (0..rows).filter(|&row| row != 5).collect();
    assert_eq!(format::read(&out).unwrap().cloud, whole.gather(&left));
    let advice = format!("`genesplat convert {} OUT` leaves such Gaussians out", text(&path));
    fail(
        ["evaluate", text(&path), "--data", text(scene())],
        &["position of Gaussian 5 is not finite", &advice],
    );
    fail(["inspect", text(&path)], &[&advice]);

    cloud.sh[3][0] = f32::INFINITY;
    save(&cloud);
    let many = "Gaussians are left out, the first since the colour of Gaussian 3 is not finite";
    assert!(notices(&[]).1.contains(many));
    cloud.opacity_logits.fill(f32::NAN);
    save(&cloud);
    fail(
        ["convert", text(&path), text(&out)],
        &["no Gaussian of", "in.ply", "opacity of Gaussian 0", "export it again"],
    );
}

#[test]
fn flat_gaussians_are_shown_with_a_thickness() {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("2dgs.ply"), folder.path().join("out.spz"));
    let names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 rot_0 rot_1 rot_2 rot_3";
    let properties: String = names.split(' ').map(|name| format!("property float {name}\n")).collect();
    let row = "0 0 2 1 1 1 3 -2 -3 1 0 0 0";
    std::fs::write(
        &path,
        format!("ply\nformat ascii 1.0\nelement vertex 1\n{properties}end_header\n{row}\n"),
    )
    .unwrap();
    for words in [vec!["inspect", text(&path)], vec!["convert", text(&path), text(&out)]] {
        let output = run(words);
        let notices = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success() && notices.contains("2dgs.ply are flat (2DGS"), "{notices}");
    }
    let said = String::from_utf8(run(["inspect", text(&out)]).stderr).unwrap();
    assert!(!said.contains("notice: "), "what was written has a third scale: {said}");
}

#[test]
fn both_versions_of_spz_are_written() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("splat.spz");
    for (version, start) in [("3", [0x1f, 0x8b]), ("4", *b"NG")] {
        succeed(["convert", text(&finished_run()), text(&out), "--spz-version", version]);
        assert!(std::fs::read(&out).unwrap().starts_with(&start), "version {version}");
    }
}

#[test]
fn what_a_format_has_no_place_for_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let mip = folder.path().join("mip");
    let train = train(scene(), &mip, &["--iterations", "30", "--method", "mip-splatting", "--no-lpips"]);
    succeed(train);
    let notices = |out: &str| {
        let output = run(["convert", text(&mip), text(&folder.path().join(out))]);
        assert!(output.status.success());
        String::from_utf8(output.stderr).unwrap()
    };
    assert!(!notices("a.ply").contains("notice: "));
    assert!(notices("a.spz").contains("3D filter"));
    assert!(notices("a.glb").contains("antialiased"));
}

#[test]
fn names_without_a_format_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("splat.obj");
    fail(["convert", text(&finished_run()), text(&out)], &["splat.obj", ".compressed.ply", ".glb"]);
    let made_up = folder.path().join("made-up.spz");
    std::fs::write(&made_up, b"no splat").unwrap();
    fail(["convert", text(&made_up), text(&folder.path().join("a.ply"))], &["made-up.spz", "again"]);
}

/// Sizes and quality on a splat of another trainer; the figures of docs/formats.md.
#[test]
fn the_peers_splat_loses_little() {
    let Some(data) = real_data() else { return };
    let (peer, folder) = (data.join("peer"), tempfile::tempdir().unwrap());
    let (splat, scene) = (peer.join("opensplat_fox.ply"), peer.join("scene"));
    for (name, most_bytes, least_psnr) in [
        ("a.spz", 754_000, 27.87),
        ("a.compressed.ply", 1_400_000, 27.85),
        ("a.sog", 1_130_000, 27.74),
        ("a.glb", 5_400_000, 27.87),
        ("a.splat", 1_087_328, 27.59),
    ] {
        let out = folder.path().join(name);
        let said = succeed(["convert", text(&splat), text(&out), "--data", text(&scene)]);
        let bytes = std::fs::metadata(&out).unwrap().len();
        assert!(bytes <= most_bytes, "{name} has {bytes} bytes");
        assert!(figure(&said, "after", 3) >= least_psnr, "{name}: {said}");
    }
}

/// `.splat` shows one colour from everywhere: that which cameras see on average, where they are known.
#[test]
fn colours_of_a_format_without_highlights_are_those_that_cameras_see() {
    let folder = tempfile::tempdir().unwrap();
    let [ply, known, unknown] =
        ["a.ply", "known.splat", "unknown.splat"].map(|name| folder.path().join(name));
    let mut cloud = format::read(&finished_run().join("point_cloud.ply")).unwrap().cloud;
    for row in &mut cloud.sh {
        row[sh_index(0, 1)..].fill(0.0);
        row[sh_index(0, 2)] = 0.5;
    }
    write_ply(&ply, &cloud, &PlyOptions::default()).unwrap();
    succeed(["convert", text(&ply), text(&known), "--data", text(scene())]);
    succeed(["convert", text(&ply), text(&unknown)]);
    let [known, unknown] = [known, unknown].map(|file| format::read(&file).unwrap().cloud.sh);
    let moved = |channel: usize| {
        let differs = |row: &usize| known[*row][sh_index(channel, 0)] != unknown[*row][sh_index(channel, 0)];
        (0..known.len()).filter(differs).count()
    };
    assert!(moved(0) > known.len() / 2, "{} of {}", moved(0), known.len());
    assert_eq!((moved(1), moved(2)), (0, 0), "only red depends on where it is seen from");
}
