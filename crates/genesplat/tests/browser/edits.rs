//! The page outlives its run: what a user takes along, removes, takes back and saves.

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use genesplat::gallery::{self, GalleryOptions};
use genesplat::run::splat;

use crate::webdriver::Browser;
use crate::{PICTURE, Served, await_other_picture, await_rest, shoot};

const GAUSSIANS: &str = "return document.getElementById('gaussians').textContent.replaceAll(',', '')";

fn shown_gaussians(browser: &Browser) -> usize {
    browser.run(GAUSSIANS).as_str().unwrap().parse().unwrap()
}

fn gaussians_in(ply: &Path) -> usize {
    splat::open(ply).unwrap().cloud.len()
}

fn choose(browser: &Browser, tool: &str) {
    browser.click(&format!("#tool label:has([value={tool}])"));
    assert_eq!(browser.run("return document.getElementById('stage').dataset.tool"), tool);
}

/// Waits until the page tells of so many edits.
fn await_edits(browser: &Browser, edits: usize) {
    let ending = if edits == 1 { "1 edit".to_owned() } else { format!("{edits} edits") };
    browser.wait_for(&format!("document.getElementById('edit-count').textContent.endsWith(' by {ending}')"));
}

/// Waits until a download is whole.
fn await_file(path: &Path) {
    let deadline = Instant::now() + Duration::from_secs(120);
    while !path.exists() {
        assert!(Instant::now() < deadline, "{} never came", path.display());
        std::thread::sleep(Duration::from_millis(100));
    }
}

#[test]
fn a_finished_run_is_taken_along_edited_and_saved_beside() {
    let folder = tempfile::tempdir().unwrap();
    let [scene, run, taken] = ["gallery", "run", "taken"].map(|name| folder.path().join(name));
    let options = GalleryOptions { width: 120, height: 80, views: 12, points: 1500, seed: 5 };
    gallery::generate(&options).write_colmap(&scene).unwrap();
    fs::create_dir(&taken).unwrap();
    let Some(browser) = Browser::open(&[]) else { return };
    browser.save_downloads(&taken);
    let [data, out] = [&scene, &run].map(|path| path.to_str().unwrap());
    let mut served = Served::start(&["train", data, "--out", out, "--iterations", "300", "--view"]);
    browser.resize(1200, 800);
    browser.go_to(&served.url);
    browser.wait_for("document.getElementById('phase').dataset.phase === 'viewing'");
    browser.wait_for("document.getElementById('stage').dataset.pictures > 0");
    let of_run = fs::read(run.join("point_cloud.ply")).unwrap();
    take_along(&browser, &taken, &of_run);

    let all = shown_gaussians(&browser);
    await_rest();
    let whole = browser.run(PICTURE);
    crop(&browser, &whole);
    let cropped = shown_gaussians(&browser);
    assert!(cropped < all && cropped > 0, "{cropped} of {all}");
    erase_and_undo(&browser, cropped);
    browser.click("#save-edited");
    browser.wait_for("document.getElementById('notice').textContent.startsWith('saved as')");
    assert_eq!(gaussians_in(&run.join("edited.ply")), cropped);
    browser.click("#undo");
    browser.wait_for("document.getElementById('edit-count').hidden");
    assert_eq!(shown_gaussians(&browser), all);
    await_rest();
    assert_eq!(browser.run(PICTURE), whole, "all is back in its place");
    assert_eq!(fs::read(run.join("point_cloud.ply")).unwrap(), of_run, "what was trained stays");
    assert_eq!(browser.messages(), [""; 0], "the browser complains");
    browser.go_to("about:blank");
    assert!(served.child.wait().unwrap().success(), "it ends when nobody looks any more");
    view_what_was_saved(&browser, &run);
}

fn take_along(browser: &Browser, taken: &Path, of_run: &[u8]) {
    browser.wait_for("!document.getElementById('downloads').hidden");
    browser.click("#download-splat");
    await_file(&taken.join("gallery.ply"));
    assert!(fs::read(taken.join("gallery.ply")).unwrap() == of_run, "it is the splat of the run");
    browser.click("#download-page");
    await_file(&taken.join("gallery.html"));
    assert!(fs::read_to_string(taken.join("gallery.html")).unwrap().contains("</html>"));
}

/// The middle of the box is in the middle of the picture, where the mouse is pressed.
fn crop(browser: &Browser, whole: &serde_json::Value) {
    choose(browser, "box");
    shoot(browser, 1200, 800, "box");
    let centre = "return ['x', 'y', 'z'].map((axis) => document.getElementById(`box-centre-${axis}`).value)";
    let before = browser.run(centre);
    browser.drag("#stage", 30, 10);
    assert_ne!(browser.run(centre), before, "the box follows the mouse");
    await_rest();
    assert_eq!(browser.run(PICTURE), *whole, "and the view stays");
    browser.click("#remove-inside");
    await_edits(browser, 1);
    await_other_picture(browser, whole, "a box was emptied");
}

fn erase_and_undo(browser: &Browser, cropped: usize) {
    choose(browser, "eraser");
    await_rest();
    let before = browser.run(PICTURE);
    browser.drag("#stage", 200, 60);
    await_edits(browser, 2);
    await_other_picture(browser, &before, "a stroke of the eraser");
    assert!(shown_gaussians(browser) < cropped);
    shoot(browser, 1200, 800, "eraser");
    browser.click("#undo");
    await_edits(browser, 1);
    assert_eq!(shown_gaussians(browser), cropped);
}

/// `genesplat view` of a file has the same tools.
fn view_what_was_saved(browser: &Browser, run: &Path) {
    let saved = run.join("edited.ply");
    let served = Served::start(&["view", saved.to_str().unwrap()]);
    browser.go_to(&served.url);
    browser.wait_for("document.getElementById('stage').dataset.pictures > 0");
    choose(browser, "box");
    browser.click("#keep-inside");
    await_edits(browser, 1);
    let left = shown_gaussians(browser);
    browser.click("#save-edited");
    browser.wait_for("document.getElementById('notice').textContent.includes('edited-edited.ply')");
    assert_eq!(gaussians_in(&run.join("edited-edited.ply")), left);
    assert!(left < gaussians_in(&saved));
}
