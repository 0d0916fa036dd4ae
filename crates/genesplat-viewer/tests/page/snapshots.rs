//! What a page may save: one file in some seconds, however often it asks.

use std::net::{SocketAddr, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc;
use std::thread;
use std::time::Instant;

use genesplat_core::{CloudRenderer, Device, RenderSettings};
use genesplat_kernels::cpu::CpuBackend;
use genesplat_viewer::{LiveView, Owner, Phase, SceneViews};
use serde_json::Value;
use tungstenite::{Message, WebSocket};

use crate::support::{TURN, cloud, socket};

/// Counts what is saved.
struct Counter<'a>(&'a AtomicUsize);

impl Owner for Counter<'_> {
    fn snapshot(&mut self, _: &mut CloudRenderer<'_>) -> String {
        format!("saved number {}", self.0.fetch_add(1, Ordering::Relaxed) + 1)
    }

    fn stop(&mut self) {}

    fn is_stopped(&self) -> bool {
        false
    }
}

/// A run whose steps take no time, until it is stopped.
fn run(saved: &AtomicUsize, stop: &AtomicBool, url: &mpsc::Sender<String>) {
    let (scene_views, mode_backend) = (SceneViews::new("test", &[], &[], None), Box::new(CpuBackend::new()));
    let mut live =
        LiveView::start(SocketAddr::from(([127, 0, 0, 1], 0)), scene_views, true, mode_backend).unwrap();
    let mut backend = CpuBackend::new();
    backend.upload(cloud(10).into()).unwrap();
    let mut renderer =
        CloudRenderer::new(&mut backend, RenderSettings { sh_degree: 0, ..RenderSettings::default() });
    live.begin("test", 10, u32::MAX);
    live.set_phase(Phase::Training);
    url.send(live.url()).unwrap();
    for iteration in 1.. {
        if stop.load(Ordering::Relaxed) {
            return;
        }
        live.step(iteration, 10, None);
        if live.is_due() {
            live.attend(&mut renderer, &mut Counter(saved));
        }
        thread::yield_now();
    }
}

/// What the page hears next of this kind.
fn hear(page: &mut WebSocket<TcpStream>, kind: &str) -> Value {
    loop {
        let Message::Text(text) = page.read().unwrap() else { continue };
        let message: Value = serde_json::from_str(&text).unwrap();
        if message["type"] == kind {
            return message;
        }
    }
}

fn ask(page: &mut WebSocket<TcpStream>) {
    page.send(Message::text(r#"{"type":"snapshot"}"#)).unwrap();
}

/// Does this with the page of a run; returns how often it has saved.
fn with_page(work: impl FnOnce(&mut WebSocket<TcpStream>)) -> usize {
    let (saved, stop, (sender, url)) = (AtomicUsize::new(0), AtomicBool::new(false), mpsc::channel());
    thread::scope(|scope| {
        let _training = scope.spawn(|| run(&saved, &stop, &sender));
        let _end = End(&stop);
        work(&mut socket(&url.recv().unwrap()).unwrap());
    });
    saved.into_inner()
}

/// Ends the run, also where the test fails.
struct End<'a>(&'a AtomicBool);

impl Drop for End<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

#[test]
fn a_page_that_asks_for_a_snapshot_after_each_step_is_told_to_wait() {
    let _turn = TURN.lock();
    let (began, mut refused) = (Instant::now(), 0);
    let saved = with_page(|page| {
        for _ in 0..50 {
            ask(page);
            let said = hear(page, "notice")["text"].as_str().unwrap().to_owned();
            assert!(
                said.starts_with("saved number") || said.contains("one is saved in 10 seconds"),
                "{said}"
            );
            refused += usize::from(said.starts_with("no snapshot yet"));
        }
    });
    let most = 1 + began.elapsed().as_secs() as usize / 10;
    assert!(
        (1..=most).contains(&saved) && refused + saved == 50,
        "{saved} were saved, and {refused} were not"
    );
}

/// The page's button says when it may be pressed again.
#[test]
fn a_page_is_told_how_long_it_must_wait() {
    let _turn = TURN.lock();
    with_page(|page| {
        assert_eq!(hear(page, "state")["snapshot_wait"], 0);
        ask(page);
        let wait = std::iter::repeat_with(|| hear(page, "state")["snapshot_wait"].as_u64().unwrap());
        assert!({ wait }.find(|wait| *wait > 0).unwrap() <= 10);
    });
}
