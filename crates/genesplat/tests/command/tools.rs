//! The commands that look at finished splats, and those that look at the machine.

use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use genesplat::core::Photo;
use genesplat::io::colmap::{find_model, read_model, write_model};
use genesplat::io::photos::{read_photo, write_png};

use crate::support::{
    command, copy_scene, fail, finished_run, json, number, run, scene, succeed, text, train, without_drivers,
};

#[test]
fn evaluating_a_run_repeats_its_metrics() {
    let folder = tempfile::tempdir().unwrap();
    let (run, file) = (finished_run(), folder.path().join("scores.json"));
    let metrics = json(&run.join("metrics.json"));
    for split in ["test", "train"] {
        let arguments =
            ["evaluate", text(&run), "--data", text(scene()), "--split", split, "--json", text(&file)];
        assert!(succeed(arguments).contains("PSNR"));
        let scores = json(&file);
        assert_eq!(scores["psnr"], metrics[split]["psnr"], "at the size that the run was trained at");
        assert_eq!(scores["views"], metrics[split]["views"]);
        assert_eq!(scores["split"], split);
    }
    // The bare PLY does not know that size; given by flag, the figures are the same.
    let ply = run.join("point_cloud.ply");
    let arguments =
        ["evaluate", text(&ply), "--data", text(scene()), "--max-side", "56", "--json", text(&file)];
    succeed(arguments);
    assert_eq!(json(&file)["psnr"], metrics["test"]["psnr"]);
    // A run knows its scene, and a file does not.
    succeed(["evaluate", text(&run), "--json", text(&file)]);
    assert_eq!(json(&file)["psnr"], metrics["test"]["psnr"]);
    fail(["evaluate", text(&ply)], &["does not say which scene it shows", "--data"]);
}

#[test]
fn a_run_is_evaluated_at_a_fraction_of_its_size() {
    let folder = tempfile::tempdir().unwrap();
    let (run, file) = (finished_run(), folder.path().join("scores.json"));
    let ply = run.join("point_cloud.ply");
    // Trained at 56x42; a bare PLY does not say so, and then photos of 64x48 are divided.
    let cases = [
        (&run, ["--downscale", "2"], [28, 21]),
        (&run, ["--max-side", "28"], [28, 21]),
        (&ply, ["--downscale", "2"], [32, 24]),
    ];
    let scores = cases.map(|(splat, flag, size)| {
        let arguments = ["evaluate", text(splat), "--data", text(scene()), "--json", text(&file)];
        let said = succeed(arguments.iter().chain(&flag));
        assert!(said.contains(&format!("{}x{} pixels", size[0], size[1])), "{said}");
        let scores = json(&file);
        assert_eq!(scores["size"], serde_json::json!(size));
        scores
    });
    assert_eq!(scores[0]["views"], scores[1]["views"], "two ways to ask for the same size");
    let full = json(&run.join("metrics.json"))["test"]["psnr"].as_f64().unwrap();
    let half = scores[0]["psnr"].as_f64().unwrap();
    // Cameras that did not follow their photos would cost far more than the other size does.
    assert!(half > full - 3.0, "{half} dB at half the size, {full} dB at the full one");
    let picture = folder.path().join("half.png");
    let arguments = ["render", text(&run), "--data", text(scene()), "--image", "gallery_008"];
    succeed(arguments.iter().chain(&["--downscale", "2", "--out", text(&picture)]));
    assert_eq!(read_photo(&picture).unwrap().width, 28);
}

#[test]
fn a_run_that_has_no_splat_yet_is_named_as_such() {
    let folder = tempfile::tempdir().unwrap();
    let evaluate = ["evaluate", text(folder.path()), "--data", text(scene())];
    std::fs::copy(finished_run().join("config.toml"), folder.path().join("config.toml")).unwrap();
    fail(
        evaluate,
        &["unfinished", "genesplat train", text(scene()), text(folder.path()), "--config", "anew"],
    );
    std::fs::create_dir(folder.path().join("checkpoint")).unwrap();
    std::fs::write(folder.path().join("checkpoint/latest.checkpoint"), "hours of work").unwrap();
    fail(evaluate, &["unfinished", "genesplat train", "--resume goes on"]);
}

#[test]
fn a_splat_is_shown_on_the_background_of_its_run_unless_another_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let (run, file) = (folder.path().join("run"), folder.path().join("scores.json"));
    let (ply, picture) = (run.join("point_cloud.ply"), folder.path().join("picture.png"));
    succeed(train(scene(), &run, &["--iterations", "3", "--background", "white"]));
    let looks = |splat, more: &[&str]| {
        let fixed = [text(splat), "--data", text(scene()), "--device", "cpu"];
        let of = |own: &[&str]| {
            let words = [&own[..1], &fixed, more, &own[1..]].concat();
            words.into_iter().map(str::to_owned).collect::<Vec<_>>()
        };
        succeed(of(&["evaluate", "--json", text(&file)]));
        succeed(of(&["render", "--image", "gallery_000", "--out", text(&picture)]));
        (json(&file)["psnr"].clone(), read_photo(&picture).unwrap())
    };
    let white = looks(&run, &[]);
    let truth = read_photo(&run.join("test/gallery_000.png")).unwrap();
    assert_eq!(white, (json(&run.join("metrics.json"))["test"]["psnr"].clone(), truth));
    assert_eq!(looks(&ply, &["--background", "white"]), white);
    let black = looks(&ply, &[]);
    assert!(black.0 != white.0 && black.1 != white.1, "a PLY does not say what is behind it");
    assert_eq!(looks(&run, &["--background", "black"]), black);
}

/// Without its first photo, every eighth of a scene is another one, which this run was trained on.
#[test]
fn photos_that_training_saw_are_not_called_test_photos() {
    let folder = tempfile::tempdir().unwrap();
    let (run, fewer, out) = (finished_run(), folder.path().join("fewer"), folder.path().join("out"));
    copy_scene(&fewer);
    let found = find_model(&fewer).unwrap();
    let mut model = read_model(&found).unwrap();
    model.images.retain(|image| image.name != "gallery_000.png");
    write_model(&found.path, &model).unwrap();
    let of = |command: &str, splat: &Path, split: &str| {
        let fixed = [command, text(splat), "--data", text(&fewer), "--split", split, "--device", "cpu"];
        let out: &[&str] = if command == "render" { &["--out", text(&out)] } else { &[] };
        fixed.iter().chain(out).map(|word| (*word).to_owned()).collect::<Vec<_>>()
    };
    let words = ["gallery_001.png is a test photo", "was none", "bring back", "point_cloud.ply"];
    for command in ["evaluate", "render"] {
        fail(of(command, &run, "test"), &words);
        succeed(of(command, &run, "train"));
    }
    succeed(of("evaluate", &run.join("point_cloud.ply"), "test"));
    succeed(of("render", &run, "all"));
}

#[test]
fn renders_are_those_of_the_evaluation() {
    let folder = tempfile::tempdir().unwrap();
    let (run, all) = (finished_run(), folder.path().join("all"));
    succeed(["render", text(&run), "--data", text(scene()), "--split", "all", "--out", text(&all)]);
    assert_eq!(std::fs::read_dir(&all).unwrap().count(), 12);
    let one = folder.path().join("one.png");
    succeed([
        "render",
        text(&run),
        "--data",
        text(scene()),
        "--image",
        "gallery_008.png",
        "--out",
        text(&one),
    ]);
    let truth = read_photo(&run.join("test/gallery_008.png")).unwrap();
    assert_eq!(read_photo(&one).unwrap(), truth);
    assert_eq!(read_photo(&all.join("gallery_008.png")).unwrap(), truth);
    let arguments = ["render", text(&run), "--data", text(scene()), "--image", "absent", "--out", text(&one)];
    fail(arguments, &["no photo called absent", "gallery_00"]);
    let arguments =
        ["render", text(&run), "--data", text(scene()), "--split", "test", "--train-on-all", "--out"];
    fail(arguments.into_iter().chain([text(&all)]), &["has no test photos", "--split train"]);
}

#[test]
fn pictures_are_compared() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("scores.json");
    let [a, b] = ["gallery_000.png", "gallery_001.png"].map(|name| scene().join("images").join(name));
    succeed(["evaluate", text(&a), text(&b), "--json", text(&file)]);
    let scores = json(&file);
    assert!(number(&scores["psnr"]) > 5.0 && number(&scores["ssim"]) < 1.0 && scores["lpips"].is_null());
    succeed(["evaluate", text(&a), text(&a), "--json", text(&file)]);
    assert_eq!((&json(&file)["psnr"], &json(&file)["ssim"]), (&120.0.into(), &1.0.into()));
    let smaller = finished_run().join("test/gallery_000.png");
    fail(["evaluate", text(&a), text(&smaller)], &["64x48", "56x42"]);
    fail(
        ["evaluate", text(&a)],
        &["gallery_000.png is not a PLY or another splat but a picture", "a second one"],
    );
    fail(["evaluate", text(&a)], &["gallery_000.png is not a PLY", "but a picture", "give a second one"]);
    let of_splats = run(["evaluate", text(&a), text(&a), "--max-side", "32"]);
    assert_eq!(of_splats.status.code(), Some(2), "a flag that says nothing of two pictures");
    assert_eq!(run(["evaluate"]).status.code(), Some(2), "nothing to evaluate");
}

/// 16x16 pixels of 16 bits, half transparent.
const DEEP_AND_TRANSPARENT: &str = "iVBORw0KGgoAAAANSUhEUgAAABAAAAAQEAYAAABPYyMiAAAAKElEQVR42mNoVHZg/P+/gWGgaIZRB4w6YNQBow4YdcCoA0YdMNAOAAAqWWMuyTvP7AAAAABJRU5ErkJggg==";

#[test]
fn what_is_not_compared_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let [deep, black, white] = ["deep.png", "black.png", "white.png"].map(|name| folder.path().join(name));
    std::fs::write(&deep, STANDARD.decode(DEEP_AND_TRANSPARENT).unwrap()).unwrap();
    for (path, level) in [(&black, 0), (&white, 255)] {
        write_png(path, &Photo { width: 16, height: 16, rgb: vec![level; 3 * 16 * 16] }).unwrap();
    }
    let compared = |a, b| {
        let output = run(["evaluate", text(a), text(b), "--no-lpips"]);
        assert!(output.status.success());
        [output.stdout, output.stderr].map(|said| String::from_utf8(said).unwrap())
    };
    let [_, notices] = compared(&white, &deep);
    let notices: Vec<&str> = notices.lines().collect();
    assert!(notices.len() == 2 && notices.iter().all(|notice| notice.contains("deep.png")), "{notices:?}");
    assert!(notices[0].contains("compared at 8") && notices[1].contains("on black"), "{notices:?}");
    let [figures, notices] = compared(&black, &white);
    assert!(figures.starts_with("PSNR 0.0000 dB") && notices.is_empty(), "{figures} {notices}");
}

#[test]
fn the_papers_search_makes_no_gradient_step_and_keeps_colours() {
    let folder = tempfile::tempdir().unwrap();
    let (ply, out) = (finished_run().join("point_cloud.ply"), folder.path().join("refined.ply"));
    let before = genesplat::io::read_ply(&ply).unwrap();
    let small = ["--genetic", "--generations", "4", "--population", "10", "--max-side", "56"];
    let arguments = ["refine", text(&ply), "--data", text(scene()), "--out", text(&out)];
    let said = succeed(arguments.iter().chain(&small));
    assert!(said.contains("before") && said.contains("after"), "{said}");
    let after = genesplat::io::read_ply(&out).unwrap();
    assert_eq!((before.len(), &before.sh, &before.rotations), (after.len(), &after.sh, &after.rotations));
}

/// A `.splat` has no view-dependent colour, and the scores are those of what was written.
#[test]
fn settings_of_a_run_refine_too_and_the_file_is_scored() {
    let folder = tempfile::tempdir().unwrap();
    let (ply, out) = (finished_run().join("point_cloud.ply"), folder.path().join("refined.splat"));
    for method in ["3dgs", "genesplat"] {
        let config = folder.path().join("config.toml");
        std::fs::write(&config, format!("iterations = 300\nsteps_scale = 0.1\nmethod = \"{method}\""))
            .unwrap();
        let arguments = ["refine", text(&ply), "--data", text(scene()), "--out", text(&out)];
        let refined = run(arguments.iter().chain(&["--config", text(&config)]));
        let [said, told] = [refined.stdout, refined.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
        assert!(refined.status.success() && told.contains("no view-dependent colour"), "{told}");
        assert!(told.contains("(30 of 30)"), "{told}");
        let evaluated = succeed(["evaluate", text(&out), "--data", text(scene()), "--no-lpips"]);
        let scores = |text: &str, start: &str| {
            let line = text.lines().find(|line| line.starts_with(start)).unwrap_or_else(|| panic!("{text}"));
            line.split_whitespace().skip_while(|word| *word != "PSNR").take(5).collect::<Vec<_>>().join(" ")
        };
        assert_eq!(scores(&said, "after"), scores(&evaluated, "test"), "{said}{evaluated}");
    }
}

#[test]
fn a_refinement_is_refused_what_does_not_go_together() {
    let folder = tempfile::tempdir().unwrap();
    let [out, config] = ["refined.ply", "config.toml"].map(|name| folder.path().join(name));
    std::fs::write(&config, "background = \"random\"").unwrap();
    let ply = finished_run().join("point_cloud.ply");
    let refine = ["refine", text(&ply), "--data", text(scene()), "--out", text(&out)];
    let transparent = ["--mask", "transparent", "--config", text(&config)];
    fail(refine.iter().chain(&transparent), &["mask is transparent", "background is random"]);
    let search = ["--genetic", "--iterations", "50"];
    fail(refine.iter().chain(&search), &["--iterations", "--generations"]);
    assert!(!out.exists());
}

#[test]
fn refining_makes_an_unfinished_splat_better_and_threads_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let ply = finished_run().join("point_cloud.ply");
    let rows = genesplat::io::read_ply(&ply).unwrap().len();
    let refined = |threads: &str| {
        let out = folder.path().join(threads).with_extension("ply");
        let arguments = ["refine", text(&ply), "--data", text(scene()), "--out", text(&out)];
        let said = succeed(arguments.iter().chain(&["--iterations", "200", "--threads", threads]));
        (std::fs::read(&out).unwrap(), said)
    };
    let (one, said) = refined("1");
    let psnr = |line: &str| {
        let line = said.lines().find(|text| text.starts_with(line)).expect("a line for each split");
        line.split_whitespace().nth(3).unwrap().parse::<f64>().unwrap()
    };
    assert!(psnr("after  train") > psnr("before train") + 0.3, "{said}");
    assert!(psnr("after  test") > psnr("before test"), "{said}");
    assert_eq!(genesplat::io::read_ply(&folder.path().join("1.ply")).unwrap().len(), rows, "none is added");
    assert!(one == refined("2").0 && one == refined("7").0);
}

#[test]
fn inputs_are_not_written_over() {
    let (run, photo) = (finished_run(), scene().join("images/gallery_000.png"));
    let [splat, config] = ["point_cloud.ply", "config.toml"].map(|name| run.join(name));
    let before = [&photo, &splat, &config].map(|file| std::fs::read(file).unwrap());
    // The scene is absent, and would be missed first if it were read.
    let refine = ["refine", text(&splat), "--data", "absent", "--out"];
    fail(refine.into_iter().chain([text(&photo)]), &["gallery_000.png is a picture"]);
    fail(refine.into_iter().chain([text(&splat)]), &["point_cloud.ply is an input"]);
    let evaluate = ["evaluate", text(&run), "--data", "absent", "--json", text(&config)];
    fail(evaluate, &["config.toml is part of a run", "another file"]);
    fail(["evaluate", text(&photo), text(&photo), "--json", text(&photo)], &["is an input"]);
    lists_are_not_written_over(&run);
    assert!(before == [&photo, &splat, &config].map(|file| std::fs::read(file).unwrap()));
}

/// Lists of held-out photos, by whatever name.
fn lists_are_not_written_over(run: &Path) {
    let folder = tempfile::tempdir().unwrap();
    let list = |name: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, "gallery_000").unwrap();
        text(&path).to_owned()
    };
    let [figures, splat, page, picture] = ["list.txt", "list.ply", "list.html", "list.png"].map(list);
    let (run, data) = (text(run), ["--data", "absent", "--test-list"]);
    let cases = [
        (vec!["inspect", "."], vec!["--test-list", &figures, "--json", &figures]),
        (vec!["evaluate", run], [&data[..], &[&figures, "--json", &figures]].concat()),
        (vec!["refine", run], [&data[..], &[&splat, "--out", &splat]].concat()),
        (vec!["convert", run, &splat], [&data[..], &[&splat]].concat()),
        (vec!["export", run], [&data[..], &[&page, "--out", &page]].concat()),
        (vec!["render", run, "--image", "gallery_000"], [&data[..], &[&picture, "--out", &picture]].concat()),
    ];
    for (command, flags) in cases {
        fail(command.iter().chain(&flags), &["list.", "is an input of this command"]);
    }
}

/// After a search of an hour is too late.
#[test]
fn what_cannot_be_written_is_said_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let (run, here, file) = (finished_run(), text(folder.path()), folder.path().join("file"));
    std::fs::write(&file, "in the way").unwrap();
    let photo = scene().join("images/gallery_000.png");
    // The scene is absent, and would be missed first if it were read.
    let of_run = |command: &str, more: &[&str]| {
        let fixed = [command, text(&run), "--data", "absent"];
        fixed.iter().chain(more).map(|word| (*word).to_owned()).collect::<Vec<_>>()
    };
    let is_a_folder = [here, "is a folder", "name of a file"];
    fail(of_run("refine", &["--out", here]), &is_a_folder);
    fail(of_run("evaluate", &["--json", here]), &is_a_folder);
    let (picture, film) = (folder.path().join("a.png"), folder.path().join("film.webm"));
    fail(
        of_run("render", &["--image", "gallery_000", "--out", text(&picture.with_extension(""))]),
        &["no picture", ".png"],
    );
    fail(of_run("render", &["--split", "test", "--out", text(&picture)]), &["a.png", "need a folder"]);
    fail(of_run("render", &["--path", "orbit", "--out", text(&film)]), &["film.webm", ".mp4 or .gif"]);
    fail(of_run("refine", &["--out", text(&picture.with_extension("obj"))]), &["names no format", ".spz"]);
    let ply = picture.with_extension("ply");
    fail(["convert", text(&run), text(&ply), "--spz-version", "3"], &["--spz-version is for .spz"]);
    fail(["inspect", text(&run), "--near", "1"], &["is no scene", "leave out"]);
    fail(of_run("render", &["--split", "test", "--out", text(&file)]), &["is a file", "--out"]);
    fail(["evaluate", text(&photo), text(&photo), "--json", here], &is_a_folder);
    fail(train(scene(), &file, &["--iterations", "3"]), &["is a file", "results need a folder"]);
}

#[cfg(target_os = "linux")]
#[test]
fn figures_may_go_to_a_pipe() {
    let folder = tempfile::tempdir().unwrap();
    let picture = text(&finished_run().join("test/gallery_000.png")).to_owned();
    let said = succeed(["evaluate", &picture, &picture, "--no-lpips", "--json", "/dev/stdout"]);
    assert!(said.contains("PSNR") && said.contains("\"ssim\": 1.0"), "{said}");
    // Where stdout is a file, figures follow what was printed.
    let file = folder.path().join("said.txt");
    let stdout = std::fs::File::create(&file).unwrap();
    let arguments = ["evaluate", &picture, &picture, "--no-lpips", "--json", "/dev/stdout"];
    assert!(command(arguments).stdout(stdout).status().unwrap().success());
    assert_eq!(std::fs::read_to_string(&file).unwrap(), said);
}

#[test]
fn auto_without_a_driver_works_on_the_cpu_and_evaluate_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let announced = |arguments: Vec<String>| {
        let output = without_drivers(arguments).output().unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{stderr}");
        stderr.lines().filter(|line| line.contains("the CPU did all the work")).count()
    };
    let mut arguments = train(scene(), &out, &["--iterations", "3", "--no-lpips"]);
    let device = arguments.iter().position(|word| word == "cpu").unwrap();
    arguments[device] = "auto".into();
    assert_eq!(announced(arguments.clone()), 0, "`devices` and `evaluate` say so");
    // The configuration of a run names the device that it had, and then nothing was left to us.
    arguments.drain(device - 1..=device);
    let place = arguments.iter().position(|word| word == text(&out)).unwrap();
    arguments[place] = text(&folder.path().join("repeated")).into();
    arguments.extend(["--config".into(), text(&out.join("config.toml")).into()]);
    assert_eq!(announced(arguments), 0);
    let evaluate = ["evaluate", text(&out), "--data", text(scene()), "--no-lpips"].map(str::to_owned);
    assert_eq!(announced(evaluate.to_vec()), 1);
    assert_eq!(announced([&evaluate[..], &["--device".into(), "cpu".into()]].concat()), 0);
}

#[test]
fn devices_are_listed_without_errors_that_are_none() {
    for arguments in [&["devices"][..], &["devices", "-v"]] {
        let output = command(arguments).env_remove("XDG_RUNTIME_DIR").output().unwrap();
        let [said, told] = [output.stdout, output.stderr].map(|text| String::from_utf8(text).unwrap());
        assert!(["cpu", "gpu"].iter().all(|kind| said.lines().any(|line| line.starts_with(kind))), "{said}");
        assert!(!told.contains("error: ") && !told.contains("XDG_RUNTIME_DIR"), "{told}");
    }
}

#[test]
fn shells_and_man_are_told_of_every_command() {
    for (shell, sign) in
        [("bash", "complete -F"), ("zsh", "#compdef genesplat"), ("fish", "complete -c genesplat")]
    {
        let script = succeed(["man", "--completions", shell]);
        assert!(script.contains(sign) && script.contains("max-gaussians"), "{shell}: {script}");
    }
    let page = succeed(["man"]);
    assert!(page.starts_with(".ie") && page.contains(".TH genesplat 1") && page.contains("refine"), "{page}");
    let page = succeed(["man", "train"]);
    assert!(page.contains(".TH genesplat-train 1") && page.contains("\\-\\-max\\-gaussians"), "{page}");
    fail(["man", "trains"], &["no command \"trains\"", "refine"]);
}

#[test]
fn commands_of_earlier_versions_say_where_they_are_now() {
    for (old, new) in [
        (&["experiment", "smoke", "--out", "x"][..], "genesplat-lab experiment"),
        (&["bench", "step"], "genesplat-lab bench"),
        (&["compare", "a.png", "b.png"], "genesplat evaluate A.png B.png"),
        (&["lpips", "install", "a.pth"], "genesplat evaluate --install-lpips"),
        (&["completions", "bash"], "genesplat man --completions"),
    ] {
        let output = run(old);
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(
            output.status.code() == Some(2) && said.lines().count() == 1 && said.contains(new),
            "{old:?}: {said}"
        );
    }
    let said = String::from_utf8(run(["trian"]).stderr).unwrap();
    assert!(said.contains("unrecognized subcommand") && said.contains("train"), "{said}");
}
