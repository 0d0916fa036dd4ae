//! The live page of a run and of a finished splat, as a client of the socket sees it.
#![cfg(unix)]

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::LazyLock;
use std::time::{Duration, Instant};

use serde_json::Value;
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};

use crate::support::{cloud, command, fail, scene, succeed, text, train};

const SCHEDULE: [&str; 6] = ["--iterations", "500", "--max-gaussians", "1500", "--no-lpips", "--threads=2"];

/// A process that serves a page, and the page's address.
pub(crate) struct Served {
    pub(crate) child: Child,
    pub(crate) url: String,
}

impl Served {
    pub(crate) fn start(mut command: Command) -> Self {
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines().map(Result::unwrap);
        let url = lines.find_map(|line| Some(line.strip_prefix("view   ")?.to_owned())).expect("an address");
        // What the process prints later must not fill the pipe.
        std::thread::spawn(move || lines.for_each(drop));
        Self { child, url }
    }

    fn page(&self) -> WebSocket<TcpStream> {
        let host = self.url.split('/').nth(2).unwrap();
        let mut request =
            format!("ws{}socket", self.url.strip_prefix("http").unwrap()).into_client_request().unwrap();
        request.headers_mut().insert("origin", format!("http://{host}").parse().unwrap());
        let stream = TcpStream::connect(host).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        tungstenite::client(request, stream).unwrap().0
    }

    pub(crate) fn interrupt(&self) {
        assert!(
            Command::new("kill").args(["-INT", &self.child.id().to_string()]).status().unwrap().success()
        );
    }

    /// The exit status.
    pub(crate) fn end(&mut self) -> Option<i32> {
        self.child.wait().unwrap().code()
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn look(sequence: u32, render_mode: &str) -> Message {
    let (x, camera) = (0.01 * f64::from(sequence), if sequence.is_multiple_of(3) { "2" } else { "null" });
    Message::text(format!(
        r#"{{"type":"look","sequence":{sequence},"pose":{{"position":[{x},0,0],"rotation":[1,0,0,0],"fov_y":1}},"camera":{camera},
           "width":96,"height":72,"quality":80,"render_mode":"{render_mode}","error":true}}"#
    ))
}

enum Heard {
    Text(Value),
    Picture,
    Closed,
}

fn hear(page: &mut WebSocket<TcpStream>) -> Heard {
    match page.read() {
        Ok(Message::Text(text)) => Heard::Text(serde_json::from_str(&text).unwrap()),
        Ok(Message::Binary(_)) => Heard::Picture,
        Ok(Message::Close(_)) | Err(_) => Heard::Closed,
        Ok(_) => hear(page),
    }
}

/// Reads until a state holds.
fn await_state(page: &mut WebSocket<TcpStream>, holds: impl Fn(&Value) -> bool) -> Value {
    await_message(page, "state", holds)
}

fn await_message(page: &mut WebSocket<TcpStream>, kind: &str, holds: impl Fn(&Value) -> bool) -> Value {
    loop {
        match hear(page) {
            Heard::Text(message) if message["type"] == kind && holds(&message) => return message,
            Heard::Closed => panic!("the page was closed"),
            _ => {}
        }
    }
}

fn say(page: &mut WebSocket<TcpStream>, wish: &str) {
    page.send(Message::text(format!(r#"{{"type":"{wish}"}}"#))).unwrap();
}

/// The splat of a run that nobody looks at.
static ALONE: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    succeed(train(scene(), folder.path(), &SCHEDULE));
    cloud(folder.path())
});

/// The same run, which begins to be served.
fn serve(out: &Path) -> Served {
    Served::start(command(train(scene(), out, &[&SCHEDULE[..], &["--view"]].concat())))
}

#[test]
fn a_page_that_looks_pauses_and_saves_changes_no_byte() {
    let folder = tempfile::tempdir().unwrap();
    let watched = folder.path().join("run");
    let mut served = serve(&watched);
    let mut page = served.page();
    say(&mut page, "pause");
    let paused = await_state(&mut page, |state| state["phase"] == "paused");
    let mut pictures = 0;
    for (sequence, render_mode) in (1..).zip(["colour", "depth", "count", "points", "ellipses", "colour"]) {
        page.send(look(sequence, render_mode)).unwrap();
        while !matches!(hear(&mut page), Heard::Picture) {}
        pictures += 1;
    }
    say(&mut page, "snapshot");
    say(&mut page, "resume");
    let resumed = await_state(&mut page, |state| state["phase"] == "training");
    assert_eq!(paused["iteration"], resumed["iteration"], "no step was made meanwhile");
    let at = resumed["iteration"].as_u64().unwrap();
    let snapshot = watched.join(format!("snapshots/iteration-{at:06}.ply"));
    assert!(snapshot.exists());
    // It goes on looking until the run has ended.
    for sequence in 100.. {
        if page.send(look(sequence, ["colour", "count"][sequence as usize % 2])).is_err() {
            break;
        }
        match hear(&mut page) {
            Heard::Picture => pictures += 1,
            Heard::Text(state) if ["ended", "viewing"].contains(&state["phase"].as_str().unwrap_or("")) => {
                break;
            }
            Heard::Text(_) => {}
            Heard::Closed => break,
        }
    }
    drop(page);
    assert_eq!(served.end(), Some(0));
    assert!(pictures > 6, "{pictures} pictures, none of them while it trained");
    assert!(*ALONE == cloud(&watched), "the same bytes");
    assert!(std::fs::read(&snapshot).unwrap() != cloud(&watched), "an earlier state");
}

/// Connections that vanish, garbage, and a page that never reads, while it trains.
#[test]
fn strangers_change_no_byte() {
    let folder = tempfile::tempdir().unwrap();
    let pestered = folder.path().join("run");
    let mut served = serve(&pestered);
    let [mut deaf, mut babbler] = [served.page(), served.page()];
    let host = served.url.split('/').nth(2).unwrap().to_owned();
    let mut refused = 0;
    for round in 0..50 {
        drop(TcpStream::connect(&host));
        let Ok(mut stranger) = TcpStream::connect(&host) else { break };
        let asked = write!(stranger, "GET /wrong/{round} HTTP/1.1\r\nHost: evil.example\r\n\r\n");
        let mut answer = String::new();
        let _ = asked.and_then(|()| stranger.read_to_string(&mut answer));
        refused += usize::from(answer.contains("403"));
        let _ = deaf.send(look(round, "points"));
        let _ = babbler.send(Message::text("garbage"));
    }
    assert!(refused > 10, "{refused} strangers were refused");
    drop((deaf, babbler));
    assert_eq!(served.end(), Some(0));
    assert!(*ALONE == cloud(&pestered), "the same bytes");
}

#[test]
fn a_page_can_stop_a_run_which_is_saved() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let mut served = Served::start(command(train(scene(), &out, &["--iterations", "200000", "--view"])));
    let mut page = served.page();
    await_state(&mut page, |state| state["iteration"].as_u64() > Some(20));
    say(&mut page, "stop");
    assert_eq!(served.end(), Some(130));
    assert!(out.join("checkpoint/latest.checkpoint").exists() && out.join("point_cloud.ply").exists());
}

#[test]
fn a_run_waits_for_nobody_once_its_last_page_is_gone() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let mut served = serve(&out);
    let mut page = served.page();
    say(&mut page, "pause");
    await_state(&mut page, |state| state["phase"] == "paused");
    drop(page);
    let began = Instant::now();
    assert_eq!(served.end(), Some(0));
    assert!(began.elapsed() < Duration::from_secs(100));
}

#[test]
fn a_finished_run_and_a_bare_splat_are_shown_until_ctrl_c() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    succeed(train(scene(), &out, &["--iterations", "40"]));
    let splat = out.join("point_cloud.ply");
    for (what, cameras) in [(&out, 12), (&splat, 0)] {
        let mut served = Served::start(command(["view", text(what), "--device", "cpu"]));
        let mut page = served.page();
        let Heard::Text(hello) = hear(&mut page) else { panic!("no hello") };
        assert_eq!(hello["cameras"].as_array().unwrap().len(), cameras, "{}", what.display());
        if what == &out {
            let stages = await_message(&mut page, "curves", |_| true)["stages"].as_array().unwrap().len();
            assert_eq!(stages, 1, "averages at the end of the run");
        }
        page.send(look(1, "colour")).unwrap();
        while !matches!(hear(&mut page), Heard::Picture) {}
        served.interrupt();
        assert_eq!(served.end(), Some(0));
    }
    fail(["view", text(Path::new("absent.ply"))], &["absent.ply", "does not exist"]);
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    fail(
        ["view", text(&splat), "--device", "cpu", "--view-address", &address],
        &[&address, "--view-address"],
    );
}

/// What the page at `url` sends for `name`.
fn file(url: &str, name: &str) -> Vec<u8> {
    let (host, path) = (url.split('/').nth(2).unwrap(), url.splitn(4, '/').last().unwrap());
    let mut stream = TcpStream::connect(host).unwrap();
    write!(stream, "GET /{path}{name} HTTP/1.1\r\nHost: {host}\r\n\r\n").unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    let end = answer.windows(4).position(|bytes| bytes == b"\r\n\r\n").unwrap() + 4;
    assert!(answer.starts_with(b"HTTP/1.1 200"), "{}", String::from_utf8_lossy(&answer[..end]));
    answer.split_off(end)
}

/// Where there is no terminal: as long as somebody looks.
#[test]
fn the_page_of_a_run_outlives_it_and_gives_the_splat_and_a_page_to_send() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let mut served = serve(&out);
    let mut page = served.page();
    let first = await_state(&mut page, |_| true);
    assert_eq!(first["can_download"], false);
    await_state(&mut page, |state| state["phase"] == "viewing" && state["can_download"] == true);
    assert!(file(&served.url, "point_cloud.ply") == cloud(&out), "the bytes that the run has saved");
    let html = String::from_utf8(file(&served.url, "scene.html")).unwrap();
    assert!(html.contains("<title>") && html.len() > 50_000, "{} bytes", html.len());
    page.send(look(1, "colour")).unwrap();
    while !matches!(hear(&mut page), Heard::Picture) {}
    assert!(served.child.try_wait().unwrap().is_none(), "somebody looks");
    // Nobody is kept from the folder meanwhile.
    succeed(["inspect", text(&out)]);
    drop(page);
    assert_eq!(served.end(), Some(0));
}

#[test]
fn a_run_that_nobody_looks_at_ends_and_ctrl_c_closes_a_page_that_stays() {
    let folder = tempfile::tempdir().unwrap();
    let mut alone = serve(&folder.path().join("alone"));
    assert_eq!(alone.end(), Some(0));
    let mut watched = serve(&folder.path().join("watched"));
    let mut page = watched.page();
    await_state(&mut page, |state| state["can_download"] == true);
    watched.interrupt();
    assert_eq!(watched.end(), Some(0), "the run is whole");
}

#[test]
fn a_run_without_a_page_is_joined_by_view_which_follows_it_to_its_end() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let more = ["--iterations", "100000", "--max-gaussians", "800", "--checkpoint-every", "20", "--no-lpips"];
    let mut training =
        command(train(scene(), &out, &more)).stderr(Stdio::null()).stdout(Stdio::null()).spawn().unwrap();
    while !out.join("checkpoint/latest.checkpoint").exists() {
        assert!(training.try_wait().unwrap().is_none(), "it trains");
        std::thread::sleep(Duration::from_millis(20));
    }
    let served = Served::start(command(["view", text(&out), "--device", "cpu"]));
    let mut page = served.page();
    let state = await_state(&mut page, |state| state["phase"] == "following");
    assert_eq!(state["iterations"], 100_000);
    page.send(look(1, "colour")).unwrap();
    while !matches!(hear(&mut page), Heard::Picture) {}
    let before = state["iteration"].as_u64().unwrap();
    await_state(&mut page, |state| state["phase"] == "viewing" || state["iteration"].as_u64() > Some(before));
    Command::new("kill").args(["-INT", &training.id().to_string()]).status().unwrap();
    training.wait().unwrap();
    assert!(file(&served.url, "point_cloud.ply").starts_with(b"ply"));
}

/// Before anything is saved there is a page, which waits.
#[test]
fn a_run_that_has_saved_nothing_yet_is_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let whole = folder.path().join("whole");
    succeed(train(scene(), &whole, &["--iterations", "40"]));
    let begun = folder.path().join("begun");
    std::fs::create_dir(&begun).unwrap();
    std::fs::copy(whole.join("config.toml"), begun.join("config.toml")).unwrap();
    let served = Served::start(command(["view", text(&begun), "--device", "cpu"]));
    let mut page = served.page();
    await_state(&mut page, |state| state["phase"] == "waiting" && state["can_download"] == false);
    std::fs::copy(whole.join("point_cloud.ply"), begun.join("point_cloud.ply")).unwrap();
    await_state(&mut page, |state| state["phase"] == "viewing" && state["gaussians"].as_u64() > Some(0));
}
