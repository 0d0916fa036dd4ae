//! A page gets what it asks for.

use genesplat_core::{Device, Gaussians, Image, RenderSettings, Renderer};
use genesplat_kernels::cpu::CpuBackend;
use genesplat_viewer::message::Pose;
use genesplat_viewer::render_mode::{RenderMode, derive, develop};

use crate::support::{Show, TURN, look, picture};

#[test]
fn a_page_gets_its_parts_and_the_pictures_it_asks_for() {
    let _turn = TURN.lock();
    let show = Show::open(500);
    let path = show.url.split_once(show.host()).unwrap().1;
    for part in ["", "main.js", "style.css"] {
        let (line, answer) =
            show.answer(&format!("GET {path}{part} HTTP/1.1\r\nHost: {}\r\n\r\n", show.host()));
        assert_eq!(line, "HTTP/1.1 200 OK", "{part}");
        assert!(answer.contains("default-src 'none'") && answer.contains("no-referrer"), "{answer}");
    }
    let mut page = show.page().unwrap();
    let mut jpegs = Vec::new();
    for (sequence, mode) in (1..).zip(["colour", "depth", "count", "points", "ellipses"]) {
        page.send(look(sequence, 160, 90, mode)).unwrap();
        let (header, jpeg) = picture(&mut page);
        assert_eq!(header["sequence"], sequence);
        assert_eq!(header["range"].is_array(), ["depth", "count"].contains(&mode), "{mode}: {header}");
        assert!(jpeg.starts_with(&[0xff, 0xd8]) && jpeg.len() > 600, "{mode}: {} bytes", jpeg.len());
        assert!(!jpegs.contains(&jpeg), "{mode} shows what another mode has shown");
        jpegs.push(jpeg);
    }
}

/// Opaque Gaussians one behind the other on the axis of a camera at the origin.
fn row_of(depths: &[f32], log_scale: f32) -> Gaussians {
    let mut cloud = Gaussians::zeros(depths.len());
    for (row, &depth) in depths.iter().enumerate() {
        cloud.positions[row] = [0.0, 0.0, depth];
        cloud.log_scales[row] = [log_scale; 3];
        cloud.opacity_logits[row] = 1.0;
    }
    cloud
}

/// What a render mode makes of a cloud: the render of the derived cloud, and the range of its picture.
fn through(mode: RenderMode, cloud: &Gaussians) -> (Image, Option<[f32; 2]>) {
    let camera = Pose { position: [0.0; 3], rotation: [1.0, 0.0, 0.0, 0.0], fov_y: 1.0 }.camera(64, 64);
    let (derived, settings) = derive(mode, cloud, &camera, &RenderSettings::default());
    let mut backend = CpuBackend::new();
    backend.upload(derived.into()).unwrap();
    let render = backend.render(&camera, &settings).unwrap();
    let range = develop(mode, &render).1;
    (render, range)
}

#[test]
fn gaussians_are_counted() {
    for count in [1, 3, 40] {
        let depths: Vec<f32> = (0..count).map(|row| 3.0 + 0.01 * row as f32).collect();
        let [least, most] = through(RenderMode::Count, &row_of(&depths, -1.0)).1.unwrap();
        assert_eq!(least, 0.0);
        assert!((most / count as f32 - 1.0).abs() < 0.06, "{most} for {count}");
    }
    // As far as a disc of the real Gaussian reaches: 2 ln(255 opacity) squared deviations.
    let (render, _) = through(RenderMode::Count, &row_of(&[3.0], -1.0));
    let real = row_of(&[3.0], -1.0);
    let camera = Pose { position: [0.0; 3], rotation: [1.0, 0.0, 0.0, 0.0], fov_y: 1.0 }.camera(64, 64);
    let mut backend = CpuBackend::new();
    backend.upload(real.into()).unwrap();
    let settings = RenderSettings { background: [1.0, 0.0, 0.0], ..RenderSettings::default() };
    let seen = backend.render(&camera, &settings).unwrap();
    let reached = |image: &Image| image.planes[..64 * 64].iter().filter(|&&value| value < 1.0).count();
    let (disc, splat) = (reached(&render), reached(&seen));
    assert!(disc.abs_diff(splat) * 20 <= splat, "{disc} pixels instead of {splat}");
}

#[test]
fn depth_is_that_of_what_is_seen() {
    let [near, far] = through(RenderMode::Depth, &row_of(&[5.0], -1.0)).1.unwrap();
    assert!((near - 5.0).abs() < 1e-3 && (far - 5.0).abs() < 1e-3, "{near} {far}");
    let [near, far] = through(RenderMode::Depth, &row_of(&[3.0, 30.0], -1.0)).1.unwrap();
    assert!(near < 12.0 && far < 30.0, "the first hides most of the second: {near} {far}");
    assert!(through(RenderMode::Depth, &Gaussians::default()).1.is_some(), "an empty view is a picture, too");
}
