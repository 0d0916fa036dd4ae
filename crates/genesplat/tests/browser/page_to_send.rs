//! The page of `genesplat export`, opened from the disk in a browser that reaches no network.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use genesplat::core::{Gaussians, Photo, ScreenFilter};
use genesplat::gallery::{self, GalleryOptions};
use genesplat::io::format::{self, Options};
use genesplat::io::photos::read_photo;
use genesplat::io::{Format, HoldOut};
use genesplat::metrics::psnr;

use crate::webdriver::Browser;
use crate::{await_rest, shoot};

/// WebGL2 without a graphics card; no name leads anywhere.
const FLAGS: [&str; 2] = ["--enable-unsafe-swiftshader", "--host-resolver-rules=MAP * ~NOTFOUND"];

fn genesplat(arguments: &[&str]) {
    let output = Command::new(env!("CARGO_BIN_EXE_genesplat")).args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// What the page at `html` shows from a camera, and nothing else, in the size of `like`.
fn seen(browser: &Browser, html: &Path, camera: &str, like: &Photo) -> Photo {
    browser.resize(like.width, like.height);
    open(browser, html, camera);
    browser.press("h");
    await_rest();
    let picture = crate::screenshots().join(format!("seen-{camera}.png"));
    browser.screenshot(&picture);
    read_photo(&picture).unwrap()
}

fn open(browser: &Browser, html: &Path, camera: &str) {
    // Another fragment alone would not load the page again.
    browser.go_to("about:blank");
    browser.go_to(&format!("file://{}#camera={camera}", text(html)));
    browser.wait_for("document.getElementById('view')?.dataset.rest !== undefined");
    assert_eq!(browser.run("return document.getElementById('view').dataset.camera"), camera);
    assert_eq!(browser.run("return document.getElementById('message').textContent"), "");
    assert_eq!(complaints(browser), [""; 0]);
}

/// What the browser complains about, but that drawing without a graphics card is slow.
fn complaints(browser: &Browser) -> Vec<String> {
    browser
        .messages()
        .into_iter()
        .filter(|message| !message.contains("GL Driver Message (OpenGL, Performance"))
        .collect()
}

/// Gaussians of all shapes, shades and opacities at the points of a gallery.
fn colourful(options: &GalleryOptions) -> Gaussians {
    let points = gallery::generate(options).into_scene(HoldOut::EveryEighth).points;
    let mut cloud = Gaussians::zeros(points.len());
    let mut state = 7_u32;
    // Between -1 and 1.
    let mut draw = || {
        state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        (state >> 8) as f32 / 8_388_608.0 - 1.0
    };
    for (row, point) in points.iter().enumerate() {
        cloud.positions[row] = point.position;
        cloud.log_scales[row] = std::array::from_fn(|_| -4.2 + 1.2 * draw());
        cloud.rotations[row] = std::array::from_fn(|_| draw());
        cloud.opacity_logits[row] = 3.0 * draw();
        cloud.sh[row] = std::array::from_fn(|slot| if slot < 3 { 1.2 * draw() } else { 0.25 * draw() });
    }
    cloud
}

/// A near plane that hides what is nearest.
const NEARER: (&str, &str) = ("\"near\":0.2", "\"near\":4.0");

#[test]
fn the_page_draws_what_render_draws() {
    let Some(browser) = Browser::open(&FLAGS) else { return };
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let options = GalleryOptions { width: 240, height: 160, views: 24, points: 3000, seed: 5 };
    let [scene, html, png] = ["gallery", "scene.html", "render.png"].map(at);
    gallery::generate(&options).write_colmap(&scene).unwrap();
    let mut cloud = colourful(&options);
    // What the comparison asks for, and an error that it must find.
    for (filter, least, good, bad) in [
        (ScreenFilter::Classic, 47.0, "\"filter\":\"classic\"", "\"filter\":\"antialiased\""),
        (ScreenFilter::Antialiased, 47.0, "\"filter\":\"antialiased\"", "\"filter\":\"classic\""),
        (ScreenFilter::Mip, 47.0, "\"dilation\":0.1", "\"dilation\":0.3"),
    ] {
        let splat = at("splat.ply");
        cloud.filter_3d = (filter == ScreenFilter::Mip).then(|| vec![0.01; cloud.len()]);
        format::write(&splat, Format::Ply, &cloud, &Options { screen_filter: filter, ..Options::default() })
            .unwrap();
        let common = [text(&splat), "--data", text(&scene), "--device", "cpu", "--out"];
        genesplat(&[&["export"], &common[..], &[text(&html)]].concat());
        let render = |name: &str| {
            genesplat(&[&["render"], &common[..], &[text(&png), "--image", name]].concat());
            read_photo(&png).unwrap()
        };
        let [here, elsewhere] = ["gallery_008", "gallery_016"].map(render);
        let page = seen(&browser, &html, "gallery_008.png", &here);
        let (same, other) = (psnr(&page, &here).unwrap(), psnr(&page, &elsewhere).unwrap());
        eprintln!("{filter:?}: {same:.2} dB, another camera {other:.2} dB");
        assert!(same > least && other < 25.0, "{filter:?}: {same} dB, another camera {other} dB");

        let exported = fs::read_to_string(&html).unwrap();
        for (good, bad) in [(good, bad), NEARER] {
            let planted = exported.replacen(good, bad, 1);
            assert_ne!(planted, exported, "{good}");
            fs::write(&html, planted).unwrap();
            let spoilt = psnr(&seen(&browser, &html, "gallery_008.png", &here), &here).unwrap();
            eprintln!("{filter:?}, {bad} planted: {spoilt:.2} dB");
            assert!(spoilt < least, "{bad}: {spoilt} dB");
        }
    }
}

/// The folder of real data for tests, if this machine has it; in CI it must be there.
fn real_data() -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let folder = std::env::var_os("GENESPLAT_DATA").map_or(beside, PathBuf::from);
    if !folder.is_dir() {
        assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "CI has no data in {}", folder.display());
        crate::skipped(&format!("there is no data in {} (set GENESPLAT_DATA)", folder.display()));
    }
    folder.is_dir().then_some(folder)
}

#[test]
fn the_peers_splat_travels_as_one_file() {
    let (Some(data), Some(browser)) = (real_data(), Browser::open(&FLAGS)) else { return };
    let (peer, folder) = (data.join("peer"), tempfile::tempdir().unwrap());
    let (splat, scene) = (peer.join("opensplat_fox.ply"), peer.join("scene"));
    let [html, png] = ["fox.html", "render.png"].map(|name| folder.path().join(name));
    let common = [text(&splat), "--data", text(&scene), "--device", "cpu", "--out"];
    genesplat(&[&["export"], &common[..], &[text(&html), "--title", "Fox"]].concat());
    genesplat(&[&["render"], &common[..], &[text(&png), "--image", "0042"]].concat());
    let [render, photo] = [png, scene.join("images/0042.jpg")].map(|path| read_photo(&path).unwrap());
    let page = seen(&browser, &html, "0042.jpg", &render);
    let [of_page, of_render] = [&page, &render].map(|picture| psnr(picture, &photo).unwrap());
    eprintln!("{of_page:.2} dB in the browser, {of_render:.2} dB by render");
    assert!((of_page - of_render).abs() < 1.0, "{of_page} dB in the browser, {of_render} dB by render");
    look_at_the_page(&browser, &html);
    use_the_page(&browser);
}

fn look_at_the_page(browser: &Browser, html: &Path) {
    // The last is wide enough for what only wide windows have.
    for (is_dark, width, height) in
        [(true, 1200, 800), (false, 360, 780), (false, 1200, 800), (false, 1800, 700)]
    {
        browser.prefer_dark(is_dark);
        browser.resize(width, height);
        open(browser, html, "0001.jpg");
        shoot(browser, width, height, if is_dark { "page-to-send-dark" } else { "page-to-send" });
    }
    // Moving pictures of a processor are to be small.
    browser.resize(420, 320);
    open(browser, html, "0001.jpg");
}

/// Where the page looks from.
const CAMERA: &str = "return document.getElementById('view').dataset.camera";
const IS_TOURING: &str = "return document.getElementById('tour').ariaPressed";
const IS_AT_REST: &str = "document.getElementById('view').dataset.rest !== undefined";

fn use_the_page(browser: &Browser) {
    browser.click("#strip li:nth-child(4) button");
    assert_eq!(browser.run(CAMERA), "0042.jpg");
    browser.click("#next");
    assert_eq!(browser.run(CAMERA), "0073.jpg");
    // The focus is on the button.
    browser.press("[");
    assert_eq!(browser.run(CAMERA), "0042.jpg");
    browser.wait_for(IS_AT_REST);
    browser.drag("#view", 120, 40);
    assert_eq!(browser.run(CAMERA), "", "the view is free");
    browser.press("]");
    assert_ne!(browser.run(CAMERA), "");
    browser.click("#tour");
    assert_eq!(browser.run(IS_TOURING), "true");
    browser.drag("#view", 20, 0);
    assert_eq!(browser.run(IS_TOURING), "false", "a drag ends the tour");
    browser.click("#help");
    assert_eq!(browser.run("return document.getElementById('keys-dialog').open"), true);
    assert_eq!(complaints(browser), [""; 0]);
}
