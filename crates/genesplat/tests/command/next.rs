//! What commands say one does next, and that it can be done.

use std::path::Path;
use std::process::Command;

use crate::support::{cloud, command, run, scene, succeed, text, train};

fn stderr_of(arguments: &[&str]) -> String {
    let output = run(arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stderr).unwrap()
}

#[test]
fn commands_end_with_what_one_does_next() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let [out, ply, spz, html, png] = ["run", "a.ply", "a.spz", "a.html", "a.png"].map(at);
    let short = ["--iterations", "40", "--no-lpips", "--device", "cpu"];
    let trained = stderr_of(&[&["train", text(scene()), "--out", &out], &short[..]].concat());
    assert!(trained.contains(&format!("next   genesplat view {out}")), "{trained}");
    assert!(trained.contains(&format!("genesplat export {out} --out scene.html")), "{trained}");
    let splat = Path::new(&out).join("point_cloud.ply");
    let data = ["--data", text(scene()), "--device", "cpu"];
    for (arguments, next) in [
        (vec!["convert", text(&splat), &spz], format!("genesplat view {spz}")),
        (vec!["export", &out, "--device", "cpu", "--out", &html], "send it".to_owned()),
        (vec!["inspect", &out], format!("genesplat view {out}")),
        (vec!["inspect", text(scene())], format!("genesplat train {}", text(scene()))),
        (vec!["evaluate", &out, "--device", "cpu", "--no-lpips"], format!("genesplat view {out}")),
        (
            vec!["render", &out, "--device", "cpu", "--image", "gallery_000", "--out", &png],
            "--path orbit".into(),
        ),
        (
            [&["refine", &out, "--out", &ply, "--iterations", "2"], &data[..]].concat(),
            format!("genesplat view {ply}"),
        ),
    ] {
        let said = stderr_of(&arguments);
        assert!(said.contains("next   ") && said.contains(&next), "{arguments:?}: {said}");
        let quiet = stderr_of(&[&arguments[..], &["--quiet"]].concat());
        assert!(!quiet.contains("next   "), "{arguments:?}: {quiet}");
    }
    // Other programs know what they do next.
    let json = at("figures.json");
    for what in [["inspect", &out], ["evaluate", &out]] {
        assert!(!stderr_of(&[&what[..], &["--json", &json]].concat()).contains("next   "));
    }
}

/// The command that a report prints.
fn printed(run: &Path) -> String {
    let page = std::fs::read_to_string(run.join("report.html")).unwrap();
    let (_, rest) = page.split_once("<pre class=\"command\">").unwrap();
    let (command, _) = rest.split_once("</pre>").unwrap();
    command.replace("&lt;", "<").replace("&gt;", ">").replace("&quot;", "\"").replace("&amp;", "&")
}

/// From another folder, with names that a shell would take apart.
#[cfg(unix)]
#[test]
fn what_a_report_prints_to_repeat_a_run_makes_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("my & run");
    let more = [
        "--iterations",
        "60",
        "--seed",
        "3",
        "--max-side",
        "48",
        "--test-every",
        "4",
        "--no-lpips",
        "--threads=2",
    ];
    succeed(train(scene(), &out, &more));
    let known = command(["train"]);
    let program = Path::new(known.get_program());
    let paths = std::env::var_os("PATH").unwrap();
    let paths = std::env::join_paths(
        [program.parent().unwrap().to_owned()].into_iter().chain(std::env::split_paths(&paths)),
    );
    let mut shell = Command::new("sh");
    shell
        .args(["-c", &printed(&out)])
        .env("PATH", paths.unwrap())
        .current_dir("/")
        .env_remove("GENESPLAT_LPIPS");
    let output = shell.output().unwrap();
    assert!(output.status.success(), "{}: {}", printed(&out), String::from_utf8_lossy(&output.stderr));
    assert!(cloud(&out) == cloud(&folder.path().join("my & run-again")), "the same bytes");
}
