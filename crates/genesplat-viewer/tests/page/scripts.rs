//! What the pages' scripts decide, run by Node with a clock, a window and a server of the test's own.
//!
//! Where there is no Node, these tests are skipped with a line; in CI that is a failure.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

/// A folder for each page, with its modules under the names that they import each other by.
static PAGES: LazyLock<PathBuf> = LazyLock::new(|| {
    let (here, there) =
        (Path::new(env!("CARGO_MANIFEST_DIR")), Path::new(env!("CARGO_TARGET_TMPDIR")).join("scripts"));
    for (page, sources) in [("live", &["page"][..]), ("sent", &["page", "standalone"])] {
        let folder = there.join(page);
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join("package.json"), r#"{"type":"module"}"#).unwrap();
        for source in
            sources.iter().flat_map(|source| fs::read_dir(here.join(source)).unwrap()).map(Result::unwrap)
        {
            fs::copy(source.path(), folder.join(source.file_name())).unwrap();
        }
    }
    there
});

/// Runs `tests/page/scripts/NAME.mjs`, which fails with a sentence.
fn run(name: &str) {
    if Command::new("node").arg("--version").output().is_err() {
        assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "there is no Node, which CI needs");
        // Not by a macro, whose output a test runner keeps to itself.
        let _ = writeln!(std::io::stderr(), "skipped: there is no Node to run the pages' scripts");
        return;
    }
    let script =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/page/scripts").join(name).with_extension("mjs");
    let output = Command::new("node").arg(script).arg(&*PAGES).output().unwrap();
    assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn pictures_that_are_slow_become_smaller_while_the_view_moves() {
    run("live_resolution");
}

#[test]
fn only_slow_frames_make_pictures_coarse_and_fast_ones_bring_them_back() {
    run("sent_resolution");
}

#[test]
fn a_touch_on_a_phone_does_not_zoom_and_a_shift_follows_the_finger() {
    run("phones");
}

#[test]
fn charts_stay_in_their_plots_and_keys_are_what_they_say() {
    run("charts");
}

#[test]
fn a_page_that_finds_no_room_asks_less_and_less_often() {
    run("no_room");
}

#[test]
fn a_page_without_cameras_opens_in_front_of_its_scene() {
    run("overview");
}

#[test]
fn a_browser_that_is_too_old_for_a_sent_page_says_so() {
    run("old_browser");
}

#[test]
fn pictures_keep_their_shape_and_late_ones_are_announced() {
    run("letterbox");
}

#[test]
fn the_button_for_a_snapshot_counts_down() {
    run("snapshot");
}

#[test]
fn a_box_is_moved_by_its_faces_and_a_stroke_has_an_end() {
    run("edit");
}
