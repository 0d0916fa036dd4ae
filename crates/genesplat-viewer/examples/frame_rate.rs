#![allow(clippy::print_stdout, reason = "an example prints what it measures")]
//! How many pictures a second a page gets while nothing is trained: over the real socket, encoded as pages
//! get them.
//!
//! `cargo run --release -p genesplat-viewer --example frame_rate [GAUSSIANS [WIDTH HEIGHT]]`

use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

use genesplat_core::{CloudRenderer, Device, Gaussians, RenderSettings, Rng, Stream};
use genesplat_kernels::cpu::CpuBackend;
use genesplat_viewer::{Download, Keeper, LiveView, SceneViews};
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};

const SECONDS: u64 = 5;

/// A ball of splats as large as those of trained scenes: some pixels each.
fn cloud(gaussians: usize) -> Gaussians {
    let mut cloud = Gaussians::zeros(gaussians);
    let rng = Rng::new(1);
    for row in 0..gaussians {
        let draw = rng.at(Stream::Background, row as u32, 0, 0);
        cloud.positions[row] = std::array::from_fn(|axis| 3.0 * draw.uniform(axis) - 1.5);
        cloud.log_scales[row] = std::array::from_fn(|axis| -5.2 + 1.4 * draw.uniform(axis));
        cloud.opacity_logits[row] = 1.0;
        cloud.sh[row][row % 3] = 1.0;
    }
    cloud
}

fn connect(url: &str) -> WebSocket<TcpStream> {
    let host = url.split('/').nth(2).expect("a URL has a host");
    let mut request = format!("{}socket", url.replace("http", "ws")).into_client_request().expect("a URL");
    request.headers_mut().insert("origin", format!("http://{host}").parse().expect("a header"));
    tungstenite::client(request, TcpStream::connect(host).expect("it listens")).expect("it answers").0
}

struct NoFiles;

impl Keeper for NoFiles {
    fn make(&mut self, _: Download, _: &mut CloudRenderer<'_>) -> Result<Vec<u8>, String> {
        Err("no files here".into())
    }

    fn save(&mut self, _: &mut CloudRenderer<'_>) -> Result<String, String> {
        Err("no files here".into())
    }
}

fn main() {
    let numbers: Vec<usize> = std::env::args().skip(1).map(|word| word.parse().expect("a number")).collect();
    let gaussians = numbers.first().copied().unwrap_or(100_000);
    let [width, height] = [1, 2].map(|at| numbers.get(at).copied().unwrap_or([0, 960, 540][at]));
    let (sender, receiver) = mpsc::channel();
    static OVER: AtomicBool = AtomicBool::new(false);
    let server = thread::spawn(move || {
        let cloud = cloud(gaussians);
        let scene_views = SceneViews::new("frame rate", &[], &[], Some(&cloud));
        let address = std::net::SocketAddr::from(([127, 0, 0, 1], 0));
        let mut live =
            LiveView::start(address, scene_views, false, Box::new(CpuBackend::new())).expect("a port");
        let mut backend = CpuBackend::new();
        backend.upload(cloud.into()).expect("memory");
        sender.send(live.url()).expect("it is awaited");
        let settings = RenderSettings { sh_degree: 0, ..RenderSettings::default() };
        live.serve_until(&mut backend, settings, &mut NoFiles, |_| OVER.load(Ordering::Relaxed));
    });
    let mut page = connect(&receiver.recv().expect("a URL"));
    for mode in ["colour", "depth", "count", "points", "ellipses"] {
        let (began, mut pictures, mut bytes) = (Instant::now(), 0, 0);
        while began.elapsed() < Duration::from_secs(SECONDS) {
            let x = 0.1 * f64::from(pictures).sin();
            let look = format!(
                r#"{{"type":"look","sequence":{pictures},"pose":{{"position":[{x},0,-4],"rotation":[1,0,0,0],"fov_y":0.8}},
                   "width":{width},"height":{height},"quality":68,"render_mode":"{mode}"}}"#
            );
            page.send(Message::text(look)).expect("the server listens");
            bytes += next_picture(&mut page);
            pictures += 1;
        }
        let rate = f64::from(pictures) / began.elapsed().as_secs_f64();
        let size = bytes / pictures as usize / 1024;
        println!(
            "{mode:<9} {rate:5.1} pictures a second, {width}x{height}, {gaussians} Gaussians, {size} KiB each"
        );
    }
    OVER.store(true, Ordering::Relaxed);
    drop(page);
    server.join().expect("the server ends");
}

/// Waits for it, and returns its bytes.
fn next_picture(page: &mut WebSocket<TcpStream>) -> usize {
    loop {
        if let Message::Binary(bytes) = page.read().expect("the server answers") {
            return bytes.len();
        }
    }
}
