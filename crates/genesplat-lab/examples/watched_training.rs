#![allow(clippy::print_stdout, reason = "an example prints what it measures")]
//! What a page that looks all the time costs training: pairs of runs, without and with one, and the ratio of
//! their times.
//!
//! `cargo build --release && cargo run --release -p genesplat-lab --example watched_training [SCENE
//! [ITERATIONS [PAIRS]]]`
//!
//! Without a scene it is a gallery of 480x320 pixels. Both runs of a pair do the same steps; which is first
//! alternates.

use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::{self, JoinHandle};

use genesplat::gallery::{self, GalleryOptions};
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};

const ITERATIONS: &str = "800";
const PAIRS: u32 = 3;
/// What a laptop's window asks for.
const WIDTH: u32 = 960;
const HEIGHT: u32 = 540;

fn main() {
    let mut words = std::env::args().skip(1);
    let folder = tempfile::tempdir().expect("a folder for the runs");
    let scene = words.next().map_or_else(|| write_gallery(&folder.path().join("scene")), PathBuf::from);
    let iterations = words.next().unwrap_or_else(|| ITERATIONS.into());
    let pairs = words.next().map_or(PAIRS, |word| word.parse().expect("a number of pairs"));
    let mut ratios = Vec::new();
    for pair in 1..=pairs {
        let measure = |is_watched: bool| {
            let out = folder.path().join(format!("{pair}-{is_watched}"));
            train(&scene, &out, &iterations, is_watched)
        };
        let (alone, watched) = if pair % 2 == 1 {
            (measure(false), measure(true))
        } else {
            let watched = measure(true);
            (measure(false), watched)
        };
        let ratio = watched.seconds / alone.seconds;
        println!(
            "pair {pair}: {:.2} s alone, {:.2} s watched ({} pictures), ratio {ratio:.4}",
            alone.seconds, watched.seconds, watched.pictures
        );
        ratios.push(ratio);
    }
    ratios.sort_by(f64::total_cmp);
    println!(
        "median ratio {:.4} of {} pairs, {iterations} iterations",
        ratios[ratios.len() / 2],
        ratios.len()
    );
}

fn write_gallery(folder: &Path) -> PathBuf {
    let options = GalleryOptions { width: 480, height: 320, views: 40, points: 10_000, seed: 5 };
    gallery::generate(&options).write_colmap(folder).expect("the gallery is written");
    folder.to_owned()
}

struct Measured {
    /// From the first step to the last.
    seconds: f64,
    pictures: u32,
}

fn train(scene: &Path, out: &Path, iterations: &str, is_watched: bool) -> Measured {
    let examples = std::env::current_exe().expect("this program has a path");
    let program = examples.ancestors().nth(2).expect("it is in target/release/examples").join("genesplat");
    let mut command = Command::new(&program);
    command.arg("train").arg(scene).arg("--out").arg(out).args([
        "--iterations",
        iterations,
        "--no-lpips",
        "--quiet",
    ]);
    command.args(is_watched.then_some("--view")).args(["--device", "cpu"]);
    let started = command.stdout(Stdio::piped()).spawn();
    let mut child =
        started.unwrap_or_else(|error| panic!("{}: {error}; cargo build --release first", program.display()));
    let watcher = is_watched.then(|| watch(&mut child));
    assert!(child.wait().expect("it ends").success(), "training has failed");
    let pictures = watcher.map_or(0, |watcher| watcher.join().expect("the page is watched"));
    let metrics = std::fs::read(out.join("metrics.json")).expect("figures");
    let metrics: serde_json::Value = serde_json::from_slice(&metrics).expect("figures are JSON");
    let of = |phase: &str| metrics["seconds"][phase].as_f64().expect("seconds");
    Measured { seconds: of("total") - of("load") - of("evaluate"), pictures }
}

/// Looks from one place, as who waits does, until the run has ended; returns how many pictures there were.
/// (For who moves, training yields.)
fn watch(child: &mut Child) -> JoinHandle<u32> {
    let mut lines = BufReader::new(child.stdout.take().expect("it is piped")).lines().map_while(Result::ok);
    let url =
        lines.find_map(|line| Some(line.strip_prefix("view   ")?.to_owned())).expect("the page's address");
    // What it prints later must not fill the pipe.
    thread::spawn(move || lines.for_each(drop));
    thread::spawn(move || {
        let mut page = connect(&url);
        let mut pictures = 0;
        let is_open = page.send(look(0)).is_ok();
        while is_open && await_picture(&mut page) {
            pictures += 1;
        }
        pictures
    })
}

fn await_picture(page: &mut WebSocket<TcpStream>) -> bool {
    loop {
        match page.read() {
            Ok(Message::Binary(_)) => return true,
            // The run has ended; its page stays as long as somebody looks.
            Ok(Message::Text(text)) if text.contains(r#""can_download":true"#) => return false,
            Ok(Message::Close(_)) | Err(_) => return false,
            Ok(_) => {}
        }
    }
}

fn look(sequence: u32) -> Message {
    Message::text(format!(
        r#"{{"type":"look","sequence":{sequence},"pose":{{"position":[0,0,0],"rotation":[1,0,0,0],"fov_y":1}},
           "camera":{},"width":{WIDTH},"height":{HEIGHT},"quality":75}}"#,
        sequence % 10
    ))
}

fn connect(url: &str) -> WebSocket<TcpStream> {
    let host = url.split('/').nth(2).expect("a URL has a host");
    let mut request = format!("{}socket", url.replace("http", "ws")).into_client_request().expect("a URL");
    request.headers_mut().insert("origin", format!("http://{host}").parse().expect("a header"));
    tungstenite::client(request, TcpStream::connect(host).expect("it listens")).expect("it answers").0
}
