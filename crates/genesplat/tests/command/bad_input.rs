//! Partial, empty and hostile inputs: exit status 1 and one sentence, never a panic, never all of the memory.

use std::fs;
use std::path::{Path, PathBuf};

use genesplat::core::{Gaussians, Photo};
use genesplat::io::PlyOptions;
use genesplat::io::photos::{read_photo, write_png};
use tempfile::TempDir;

use crate::support::{copy_scene, fail, judge_failure, run, scene, succeed, text, train, without_drivers};

/// A scene that `spoil` has damaged, and a place for results.
struct Spoilt {
    folder: TempDir,
}

impl Spoilt {
    fn new(spoil: impl FnOnce(&Path)) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let scene = folder.path().join("scene");
        copy_scene(&scene);
        spoil(&scene);
        Self { folder }
    }

    fn trains(&self, notice: &[&str]) {
        let (scene, out) = (self.folder.path().join("scene"), self.folder.path().join("run"));
        let output = run(train(&scene, &out, &["--iterations", "3"]));
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success() && notice.iter().all(|word| said.contains(word)), "{said}");
    }

    fn fails(&self, words: &[&str]) {
        let (scene, out) = (self.folder.path().join("scene"), self.folder.path().join("run"));
        fail(train(&scene, &out, &["--iterations", "10"]), words);
    }
}

fn points(scene: &Path) -> PathBuf {
    scene.join("sparse/0/points3D.bin")
}

fn photo(scene: &Path) -> PathBuf {
    scene.join("images/gallery_003.png")
}

fn edit(path: &Path, change: impl FnOnce(&mut Vec<u8>)) {
    let mut bytes = fs::read(path).unwrap();
    change(&mut bytes);
    fs::write(path, bytes).unwrap();
}

#[test]
fn a_truncated_points_file() {
    Spoilt::new(|scene| edit(&points(scene), |bytes| bytes.truncate(bytes.len() - 7)))
        .fails(&["points3D.bin", "again"]);
}

#[test]
fn a_count_of_two_to_the_sixtieth() {
    Spoilt::new(|scene| {
        edit(&points(scene), |bytes| bytes[..8].copy_from_slice(&(1u64 << 60).to_le_bytes()))
    })
    .fails(&["points3D.bin", "1152921504606846976", "again"]);
}

#[test]
fn a_position_that_is_not_a_number() {
    // After the count (8 bytes) and the first point's id (8 bytes) come three f64.
    Spoilt::new(|scene| edit(&points(scene), |bytes| bytes[16..24].copy_from_slice(&f64::NAN.to_le_bytes())))
        .trains(&[
            "1 of the 300 points of",
            "points3D.bin is not finite, or beyond 1e9 world units, and is left out",
        ]);
}

#[test]
fn no_points() {
    Spoilt::new(|scene| fs::write(points(scene), 0u64.to_le_bytes()).unwrap())
        .trains(&["no points", "100000 random ones"]);
}

#[test]
fn a_photo_of_another_size() {
    let shrink = |scene: &Path| {
        let mut picture = read_photo(&photo(scene)).unwrap();
        picture.height -= 16;
        picture.rgb.truncate(3 * (picture.width * picture.height) as usize);
        write_png(&photo(scene), &picture).unwrap();
    };
    Spoilt::new(shrink).trains(&[
        "1 of the 12 photos cannot be used and is left out",
        "gallery_003.png is 64x32",
        "64x48",
    ]);
}

/// Linux takes any bytes as names; settings are text.
#[cfg(target_os = "linux")]
#[test]
fn paths_that_are_no_text() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;

    let folder = tempfile::tempdir().unwrap();
    let odd = folder.path().join(OsStr::from_bytes(b"sc\xffne"));
    copy_scene(&odd);
    let out = folder.path().join("run");
    let arguments = |out: &Path| {
        [OsStr::new("train"), odd.as_os_str(), OsStr::new("--out"), out.as_os_str()].map(OsStr::to_owned)
    };
    let cpu = ["--device", "cpu", "--iterations", "3"].map(OsStr::new).map(OsStr::to_owned);
    fail(arguments(&out).iter().chain(&cpu), &["the path", "not UTF-8", "rename"]);
    assert!(!out.exists());
    // Where the scene's path is text, that of the results need not be.
    let mut fine = arguments(&odd.join("run"));
    fine[1] = scene().into();
    succeed(fine.iter().chain(&cpu));
}

#[test]
fn a_results_folder_that_cannot_be_written_fails_before_anything_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, b"in the way").unwrap();
    // A folder below a file cannot be made, whoever asks (root ignores permissions).
    let absent_scene = folder.path().join("absent");
    fail(train(&absent_scene, &file.join("run"), &[]), &["cannot write", "config.toml"]);
    let splat = folder.path().join("absent.ply");
    let out = file.join("splat.ply");
    fail(
        ["refine", text(&splat), "--data", text(scene()), "--out", text(&out)],
        &["cannot write", "splat.ply"],
    );
}

/// There is no room for the log, and training stops at its first line.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_stops_training_and_keeps_what_could_be_saved() {
    use crate::kills::killer::on_a_full_disk;
    use crate::support::command;

    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let run =
        on_a_full_disk(command(train(scene(), &out, &["--iterations", "20"])), "log.jsonl").output().unwrap();
    judge_failure(run, &["log.jsonl", "No space left", "--resume goes on from there", "--resume"]);
    assert!(out.join("point_cloud.ply").exists() && !out.join("metrics.json").exists());
    succeed(train(scene(), &out, &["--resume", "--iterations", "20"]));
}

/// A run that is not heard goes on; and an error is an exit status, not an abort.
#[cfg(target_os = "linux")]
#[test]
fn a_full_stderr_ends_nothing() {
    use std::process::Stdio;

    use crate::support::command;

    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let status = |arguments: Vec<String>| {
        let full = fs::File::options().write(true).open("/dev/full").unwrap();
        command(arguments).stderr(full).stdout(Stdio::null()).status().unwrap().code()
    };
    assert_eq!(status(train(scene(), &out, &["--iterations", "20"])), Some(0));
    assert!(out.join("metrics.json").exists());
    assert_eq!(status(train(&folder.path().join("absent"), &out, &[])), Some(1));
}

#[test]
fn a_folder_that_belongs_to_something_else_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("config.toml");
    fs::write(&config, "title = 'my site'").unwrap();
    fail(train(scene(), folder.path(), &[]), &["config.toml", "something else"]);
    assert_eq!(fs::read_to_string(&config).unwrap(), "title = 'my site'");
    // Of another program, too, which need not write UTF-8.
    fs::write(&config, b"title = 'caf\xe9'").unwrap();
    fail(train(scene(), folder.path(), &[]), &["config.toml", "something else"]);
    assert_eq!(fs::read(&config).unwrap(), b"title = 'caf\xe9'");
    fs::remove_file(&config).unwrap();
    let results = ["metrics.json", "report.html", "point_cloud.ply", "log.jsonl"];
    for name in results.into_iter().chain(["transforms.json", "test/photo.png", "sparse/cameras.bin"]) {
        let file = folder.path().join(name);
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        let name = name.split('/').next().unwrap();
        fs::write(&file, "of another program").unwrap();
        fail(train(scene(), folder.path(), &[]), &[name, "something else"]);
        assert_eq!(fs::read_to_string(&file).unwrap(), "of another program");
        fs::remove_file(&file).unwrap();
        let _ = fs::remove_dir(folder.path().join(name));
    }
    fs::write(folder.path().join("test"), "a list of mine").unwrap();
    fail(train(scene(), folder.path(), &[]), &["test is a file", "--out"]);
}

#[test]
fn a_folder_has_one_writer() {
    let place = tempfile::tempdir().unwrap();
    let out = place.path().join("run");
    fs::create_dir(&out).unwrap();
    let lock = fs::File::create(out.join(".lock")).unwrap();
    lock.lock().unwrap();
    // Of the run that is under way: no sentence says to remove it.
    fs::create_dir(out.join("checkpoint")).unwrap();
    fs::write(out.join("checkpoint/latest.checkpoint"), "hours of work").unwrap();
    let says = ["another genesplat is writing to", text(&out), "choose another --out"];
    // Before the scene is looked at.
    fail(train(&place.path().join("absent"), &out, &[]), &says);
    // Dropped alone, it would be held by whatever process another test is starting at this moment.
    lock.unlock().unwrap();
    fs::remove_dir_all(out.join("checkpoint")).unwrap();
    succeed(train(scene(), &out, &["--iterations", "3"]));
}

/// A Blender scene has its test photos where a run has its renders of them.
#[test]
fn photos_of_the_scene_are_never_written_over() {
    let folder = tempfile::tempdir().unwrap();
    let (blender, run) = (folder.path().join("blender"), folder.path().join("run"));
    write_blender(&blender);
    let photo = blender.join("test/r_0.png");
    let before = fs::read(&photo).unwrap();
    fail(train(&blender, &blender, &["--iterations", "3"]), &["blender", "folder of the scene"]);
    fail(train(&blender, &blender.join("../blender/."), &[]), &["folder of the scene"]);
    // Nor are those of another scene.
    fail(train(scene(), &blender, &["--iterations", "3"]), &["blender", "something else"]);
    // From inside, where the folder of the results is another one, but not that of the renders.
    let inner = blender.join("test/transforms.json");
    fs::copy(blender.join("transforms_test.json"), &inner).unwrap();
    fs::write(&inner, fs::read_to_string(&inner).unwrap().replace("./test/", "./")).unwrap();
    succeed(train(&blender, &run, &["--iterations", "3", "--anyway"]));
    fs::copy(run.join("config.toml"), blender.join("config.toml")).unwrap();
    fail(train(&blender.join("test"), &blender, &["--anyway"]), &["test", "photos of the scene"]);
    fs::remove_file(blender.join("config.toml")).unwrap();

    let render = |more: &[&str]| {
        let fixed = ["render", text(&run), "--data", text(&blender)];
        fixed.iter().chain(more).map(|word| (*word).to_owned()).collect::<Vec<_>>()
    };
    fail(render(&["--split", "test", "--out", text(&blender.join("test"))]), &["photos of the scene"]);
    fail(render(&["--image", "test_r_0.png", "--out", text(&photo)]), &["r_0.png", "photos of the scene"]);
    assert!(before == fs::read(&photo).unwrap());
    succeed(render(&["--split", "test", "--out", text(&blender.join("renders"))]));
}

/// Two photos to train on and two to test on, 32x32 pixels.
pub(crate) fn write_blender(scene: &Path) {
    for split in ["train", "test"] {
        let frames: Vec<_> = (0..2)
            .map(|index| {
                let photo = Photo { width: 32, height: 32, rgb: vec![40 + 90 * index as u8; 3 * 32 * 32] };
                write_png(&scene.join(format!("{split}/r_{index}.png")), &photo).unwrap();
                let pose = [[1, 0, 0, index], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]];
                serde_json::json!({"file_path": format!("./{split}/r_{index}"), "transform_matrix": pose})
            })
            .collect();
        let description = serde_json::json!({"camera_angle_x": 0.7, "frames": frames});
        fs::write(scene.join(format!("transforms_{split}.json")), description.to_string()).unwrap();
    }
}

#[test]
fn splats_that_are_partial_or_none() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    succeed(train(scene(), &out, &["--iterations", "3"]));
    let evaluate = |path: &Path| ["evaluate", text(path), "--data", text(scene())].map(str::to_owned);

    let partial = folder.path().join("partial.ply");
    fs::copy(out.join("point_cloud.ply"), &partial).unwrap();
    edit(&partial, |bytes| bytes.truncate(bytes.len() / 2));
    fail(evaluate(&partial), &["partial.ply", "cut off"]);

    let poisoned = folder.path().join("nan.ply");
    fs::copy(out.join("point_cloud.ply"), &poisoned).unwrap();
    edit(&poisoned, |bytes| {
        let last = bytes.len() - 4;
        bytes[last..].copy_from_slice(&f32::NAN.to_le_bytes());
    });
    fail(evaluate(&poisoned), &["nan.ply", "not finite"]);

    let empty = folder.path().join("empty.ply");
    genesplat::io::write_ply(&empty, &Gaussians::default(), &PlyOptions::default()).unwrap();
    fail(evaluate(&empty), &["empty.ply", "no Gaussians"]);
    let picture = folder.path().join("picture.png");
    let render = ["render", text(&empty), "--data", text(scene()), "--image", "gallery_000", "--out"];
    fail(render.iter().chain(&[text(&picture)]), &["empty.ply", "no Gaussians"]);
    let refine = ["refine", text(&empty), "--data", text(scene()), "--out", text(&partial)];
    fail(refine, &["empty.ply", "no Gaussians"]);

    fail(evaluate(&folder.path().join("absent.ply")), &["absent.ply", "does not exist", "folder of a run"]);
    fail(evaluate(folder.path()), &["not the folder of a run"]);
    fail(evaluate(&scene().join("images/gallery_000.png")), &["gallery_000.png", "not a PLY"]);
}

#[test]
fn configurations_that_are_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let (config, out) = (folder.path().join("c.toml"), folder.path().join("run"));
    for (content, words) in [
        ("iteration = 7", &["c.toml", "iteration", "`device`, `threads`, `dataset`, `"][..]),
        ("threads = 0", &["threads is 0", "from 1 to 1024"]),
        ("threads = 60000", &["threads is 60000", "from 1 to 1024"]),
        ("[dataset]\ndownscale = 0", &["downscale is 0", "from 1 to 64"]),
        ("[dataset]\nmax_side = 3", &["max_side is 3", "from 16"]),
        ("[dataset]\nmax_side = 64\ndownscale = 2", &["max_side and downscale", "keep one"]),
        ("iterations = 'many'", &["c.toml", "iterations"]),
        ("iterations = ", &["c.toml"]),
        ("method = { name = '3dgs', densify_every = 0 }", &["method.densify_every", "at least 1"]),
        ("method = { noise = 1.0 }", &["`noise` is no setting of genesplat", "mcmc"]),
        ("variant = 'mcmc'", &["`variant` is of an earlier version", "[method]"]),
        ("[evolution]\nmode = 'renew'", &["`evolution` is of an earlier version", "genesplat"]),
        ("[dataset]\nside = 3", &["c.toml", "side"]),
        ("[dataset]\nhold_out = { every = 1 }", &["hold_out.every is 1", "from 2"]),
        ("[dataset]\nhold_out = 'some'", &["c.toml", "some", "every-eighth"]),
        ("device = 'toaster'", &["c.toml", "toaster"]),
    ] {
        fs::write(&config, content).unwrap();
        fail(train(scene(), &out, &["--config", text(&config)]), words);
    }
    fail(train(scene(), &out, &["--config", text(&folder.path().join("absent.toml"))]), &["absent.toml"]);
}

#[test]
fn flags_that_do_not_go_together() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    fail(train(scene(), &out, &["--method", "mcmc", "--genetic"]), &["--genetic", "mcmc", "leave it out"]);
    fail(train(scene(), &out, &["--generations", "3"]), &["--generations", "--genetic"]);
}

#[test]
fn flags_of_earlier_versions_name_the_new_ones() {
    for (old, new) in [
        (&["--variant", "mcmc"][..], "--method mcmc"),
        (&["--evolve", "renew"], "--method genesplat"),
        (&["--evolve", "paper"], "--genetic"),
        (&["--evolve", "off"], "--method 3dgs"),
        (&["--densify-signal", "absgrad"], "its own signal"),
    ] {
        let refused = run([&["train", "x", "--out", "y"], old].concat());
        let said = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(refused.status.code() == Some(2) && said.contains(new), "{old:?}: {said}");
    }
}

#[test]
fn a_limit_that_no_file_can_hold() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let limit = ["--max-gaussians", "9223372036854775808"];
    fail(train(scene(), &out, &limit), &["max_gaussians is 9223372036854775808", "below 2^63"]);
}

#[test]
fn a_device_that_is_not_there() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let arguments = ["train", text(scene()), "--out", text(&out), "--device", "gpu"];
    judge_failure(without_drivers(arguments).output().unwrap(), &["no graphics device", "--device cpu"]);
    let numbered = ["train", text(scene()), "--out", text(&out), "--device", "gpu:7"];
    judge_failure(without_drivers(numbered).output().unwrap(), &["gpu:7", "genesplat devices"]);
    judge_failure(without_drivers(["devices", "--test"]).output().unwrap(), &["no graphics device"]);
}

#[test]
fn wrong_usage_has_status_2() {
    for arguments in [
        &["train"][..],
        &["train", "x", "--out", "y", "--iterations", "0"],
        &["train", "x", "--out", "y", "--steps-scale", "0"],
        &["train", "x", "--out", "y", "--method", "2dgs"],
        &["train", "x", "--out", "y", "--genetic", "--generations", "0"],
        &["refine", "x", "--data", "y", "--out", "z", "--generations", "0"],
        &["convert", "x", "y.ply", "--max-side", "100"],
        &["convert", "x", "y.ply", "--background", "white"],
        &["render", "x", "--data", "y", "--split", "test", "--out", "z", "--frames", "9"],
        &["train", "x", "--out", "y", "--max-side", "100", "--downscale", "2"],
        &["train", "x", "--out", "y", "--test-every", "1"],
        &["train", "x", "--out", "y", "--test-every", "3", "--train-on-all"],
        &["render", "x", "--data", "y", "--out", "z"],
        &["evaluate", "x", "--data", "y", "--background", "random"],
        &["devices", "--test", "--device", "cpu"],
        &["devices", "--device", "gpu"],
        &["train", "x", "--out", "y", "--device", "gpu:x"],
        &["nonsense"],
    ] {
        assert_eq!(run(arguments).status.code(), Some(2), "{arguments:?}");
    }
}

/// A published method would be cut short; that is known before a photo is read.
#[test]
fn minutes_are_of_a_method_whose_schedule_fits() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, run) = (folder.path().join("absent"), folder.path().join("run"));
    let words = ["train", text(&scene), "--out", text(&run), "--minutes", "1", "--method", "3dgs"];
    fail(words, &["--minutes is of --method genesplat", "give --iterations instead"]);
}
