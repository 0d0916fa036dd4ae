//! Both pages in a real browser: what a user does with them, and what they look like.
#![cfg(unix)]

mod edits;
mod page_to_send;
mod webdriver;

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use genesplat::gallery::{self, GalleryOptions};
use genesplat::io::photos::read_photo;
use webdriver::Browser;

/// Says so where everybody sees it: what a test prints by macros is kept from the terminal.
fn skipped(why: &str) {
    let _ = writeln!(std::io::stderr(), "skipped: {why}");
}

/// The command, serving a page.
struct Served {
    child: Child,
    url: String,
}

impl Served {
    fn start(arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_genesplat"));
        command.args(arguments).args(["--device", "cpu"]).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut child = command.spawn().unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines().map(Result::unwrap);
        let url = lines.find_map(|line| Some(line.strip_prefix("view   ")?.to_owned())).expect("an address");
        std::thread::spawn(move || lines.for_each(drop));
        Self { child, url }
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The picture as it is shown, small.
const PICTURE: &str =
    "const small = document.createElement('canvas'); [small.width, small.height] = [32, 24];
    small.getContext('2d').drawImage(document.getElementById('picture'), 0, 0, 32, 24);
    return small.toDataURL();";
const ITERATION: &str = "return Number(document.getElementById('iteration').dataset.iteration)";

/// Waits for a picture that differs from the one there is.
fn await_other_picture(browser: &Browser, before: &serde_json::Value, after: &str) {
    let deadline = std::time::Instant::now() + std::time::Duration::from_secs(60);
    while browser.run(PICTURE) == *before {
        assert!(std::time::Instant::now() < deadline, "the picture stays the same after {after}");
        std::thread::sleep(std::time::Duration::from_millis(100));
    }
}

fn await_rest() {
    std::thread::sleep(std::time::Duration::from_millis(1200));
}

/// `target/screenshots`.
fn screenshots() -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join("../screenshots")
}

/// Writes a screenshot, which must not be blank.
fn shoot(browser: &Browser, width: u32, height: u32, name: &str) {
    browser.resize(width, height);
    await_rest();
    let path = screenshots().join(format!("{name}-{width}.png"));
    browser.screenshot(&path);
    let picture = read_photo(&path).unwrap();
    assert_eq!(picture.width, width);
    let mut colours: Vec<&[u8]> = picture.rgb.chunks_exact(3).collect();
    colours.sort_unstable();
    colours.dedup();
    assert!(colours.len() > 500, "{name} at {width} px has {} colours", colours.len());
    let overflow = browser.run("return document.documentElement.scrollWidth - innerWidth");
    assert!(overflow.as_i64() <= Some(0), "{name} at {width} px is {overflow} px too wide");
}

#[test]
fn a_user_looks_around_pauses_and_stops() {
    let folder = tempfile::tempdir().unwrap();
    let [scene, run] = ["gallery", "run"].map(|name| folder.path().join(name));
    let options = GalleryOptions { width: 240, height: 160, views: 24, points: 3000, seed: 5 };
    gallery::generate(&options).write_colmap(&scene).unwrap();
    let Some(browser) = Browser::open(&[]) else { return };
    let [scene, out] = [&scene, &run].map(|path| path.to_str().unwrap());
    let mut served = Served::start(&["train", scene, "--out", out, "--iterations", "30000", "--view"]);
    browser.resize(1200, 800);
    browser.go_to(&served.url);
    browser.wait_for("document.getElementById('stage').dataset.pictures > 0");
    browser.wait_for("document.getElementById('iteration').dataset.iteration > 400");

    browser.click("#pause");
    browser.wait_for("document.getElementById('phase').dataset.phase === 'paused'");
    await_rest();
    let (paused_at, still) = (browser.run(ITERATION), browser.run(PICTURE));
    browser.drag("#stage", 160, 40);
    await_other_picture(&browser, &still, "a drag");
    await_rest();
    let turned = browser.run(PICTURE);
    browser.press("w");
    await_other_picture(&browser, &turned, "the key w");
    await_rest();
    let free = browser.run(PICTURE);
    lay_a_notice_over(&browser, "#cameras li:nth-child(6) button");
    browser.click("#cameras li:nth-child(6) button");
    browser.run("document.getElementById('notice').removeAttribute('style')");
    await_other_picture(&browser, &free, "a jump to a camera");
    // The focus is on the camera's button.
    browser.press("]");
    assert_eq!(
        browser.run("return document.querySelector('#cameras li:nth-child(7) button').ariaCurrent"),
        "true"
    );
    assert_eq!(browser.run(ITERATION), paused_at, "a pause is one");
    let is_hidden = |id: &str| browser.run(&format!("return document.getElementById('{id}').hidden"));
    assert_eq!(
        [is_hidden("edit-tools"), is_hidden("downloads"), is_hidden("edit-waits")],
        [true, true, false]
    );
    look_at_a_camera(&browser);
    look_in_all_modes(&browser);

    browser.click("#snapshot");
    browser.wait_for("document.getElementById('notice').textContent.startsWith('saved as')");
    browser.click("#pause");
    browser.wait_for(&format!("document.getElementById('iteration').dataset.iteration > {paused_at} + 10"));
    browser.wait_for("document.querySelectorAll('.chart:not([hidden])').length >= 2");
    shoot(&browser, 1200, 800, "training");

    assert_eq!(browser.messages(), [""; 0], "the browser complains");
    browser.click("#stop");
    browser.click("#stop-dialog button[value=stop]");
    assert_eq!(served.child.wait().unwrap().code(), Some(130));
    assert!(run.join("point_cloud.ply").exists() && run.join("snapshots").exists());
}

/// A long notice, as the run may send one at any time, whose middle is over the element until its style is
/// taken away.
fn lay_a_notice_over(browser: &Browser, selector: &str) {
    browser.run(&format!(
        "const [notice, below] = [document.getElementById('notice'), document.querySelector('{selector}')];
         below.scrollIntoView();
         notice.textContent = 'a notice of the run '.repeat(20);
         notice.style.cssText = 'display: block !important';
         const [covering, covered] = [notice, below].map(element => element.getBoundingClientRect());
         notice.style.bottom = `${{innerHeight - (covered.top + covered.bottom + covering.height) / 2}}px`;
         notice.style.left = `${{(covered.left + covered.right) / 2}}px`;"
    ));
}

fn look_at_a_camera(browser: &Browser) {
    let slide = |value: f64| {
        browser.run(&format!(
            "const range = document.getElementById('compare-range'); range.value = {value};
             range.dispatchEvent(new Event('input'));"
        ));
    };
    let is_hidden = |id: &str| browser.run(&format!("return document.getElementById('{id}').hidden")) == true;
    slide(0.0);
    assert!(!is_hidden("photo") && is_hidden("error"));
    slide(0.5);
    assert!(!is_hidden("photo") && !is_hidden("divider"));
    shoot(browser, 1200, 800, "photo");
    slide(1.5);
    browser.wait_for("document.getElementById('error').width > 300");
    assert!(is_hidden("photo") && !is_hidden("error"));
    shoot(browser, 1200, 800, "error");
    slide(1.0);
    assert!(is_hidden("photo") && is_hidden("error") && is_hidden("divider"));
    browser.prefer_dark(true);
    shoot(browser, 1200, 800, "camera-dark");
    browser.prefer_dark(false);
    for (width, height) in [(360, 780), (1200, 800), (2560, 1440)] {
        shoot(browser, width, height, "camera");
    }
    browser.resize(1200, 800);
}

fn look_in_all_modes(browser: &Browser) {
    for mode in ["depth", "count", "points", "ellipses", "colour"] {
        await_rest();
        let before = browser.run(PICTURE);
        browser.click(&format!("#render-mode label:has([value={mode}])"));
        await_other_picture(browser, &before, mode);
        let has_legend = browser.run("return !document.getElementById('legend').hidden") == true;
        assert_eq!(has_legend, ["depth", "count"].contains(&mode), "{mode}");
        shoot(browser, 1200, 800, mode);
    }
    browser.click("#frusta");
    browser.drag("#stage", 30, -20);
    browser.run("document.querySelector('#movement [value=fly]').click()");
    browser.press("s");
    shoot(browser, 1200, 800, "frusta");
}
