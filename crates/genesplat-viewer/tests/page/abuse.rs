//! What strangers cannot do: get in, stop others from being served, or make threads and memory grow.
#![cfg(target_os = "linux")]

use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use tungstenite::{Message, WebSocket};

use crate::support::{Show, TURN, comes_true, look, picture, resident_bytes, threads};

/// A server that works, and the number of its process's threads while nobody is connected.
fn show(gaussians: usize) -> (Show, usize) {
    let show = Show::open(gaussians);
    let mut page = show.page().unwrap();
    page.send(look(1, 64, 48, "colour")).unwrap();
    picture(&mut page);
    drop(page);
    (show, settled_threads())
}

/// Threads of this process, once none has begun or ended for 300 ms.
fn settled_threads() -> usize {
    let (mut count, mut since) = (threads(), Instant::now());
    while since.elapsed() < Duration::from_millis(300) {
        std::thread::sleep(Duration::from_millis(10));
        let now = threads();
        if now != count {
            (count, since) = (now, Instant::now());
        }
    }
    count
}

/// Whether the server ends the connection within ten seconds.
fn is_hung_up(page: &mut WebSocket<TcpStream>) -> bool {
    page.get_ref().set_read_timeout(Some(Duration::from_millis(100))).unwrap();
    comes_true(10, || match page.read() {
        Err(tungstenite::Error::Io(error)) => error.kind() != ErrorKind::WouldBlock,
        other => other.is_err(),
    })
}

fn assert_serves(show: &Show) {
    // Connections that vanished may still wait to be accepted, and take room for a moment.
    let mut page = None;
    let is_let_in = || {
        page = show.page();
        page.is_some()
    };
    assert!(comes_true(10, is_let_in), "there is no room");
    let mut page = page.unwrap();
    page.send(look(9, 64, 48, "colour")).unwrap();
    assert_eq!(picture(&mut page).0["sequence"], 9);
}

#[test]
fn clients_that_connect_and_vanish_leave_nothing_behind() {
    let _turn = TURN.lock();
    let (show, quiet) = show(100);
    let pages: Vec<_> = (0..50).map(|_| show.page()).collect();
    let served = pages.iter().flatten().count();
    assert!((1..=8).contains(&served), "{served} pages are open");
    assert!(comes_true(10, || threads() <= quiet + 8), "{} threads", threads());
    drop(pages);
    let silent: Vec<_> = (0..50).map(|_| show.connect()).collect();
    // Threads of the pages that have gone may still be ending.
    assert!(comes_true(10, || threads() <= quiet + 32 + 1), "{} threads", threads());
    drop(silent);
    assert!(comes_true(10, || threads() <= quiet), "{} threads instead of {quiet}", threads());
    assert_serves(&show);
}

/// Before, they kept everybody out for four seconds, again and again.
#[test]
fn silent_connections_keep_nobody_out_who_has_the_token() {
    let _turn = TURN.lock();
    let (show, quiet) = show(100);
    let mut before = show.page().unwrap();
    let mut silent: Vec<_> = (0..60).map(|_| show.connect()).collect();
    let mut pages: Vec<_> = (0..3).map(|_| show.page().expect("whoever has the token is let in")).collect();
    // Letters that never become a request are no better.
    for _ in 0..60 {
        let mut stream = show.connect();
        stream.write_all(b"GET /").unwrap();
        silent.push(stream);
    }
    let (path, host) = (show.url.split_once(show.host()).unwrap().1, show.host());
    let (line, _) = show.answer(&format!("GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n"));
    assert!(line.contains("200"), "{line}");
    for page in pages.iter_mut().chain([&mut before]) {
        page.send(look(7, 64, 48, "colour")).unwrap();
        assert_eq!(picture(page).0["sequence"], 7, "who was let in stays");
    }
    assert!(comes_true(10, || threads() <= quiet + 4 + 32), "{} threads", threads());
    drop((silent, pages, before));
    assert!(comes_true(10, || threads() <= quiet), "{} threads instead of {quiet}", threads());
}

#[test]
fn a_page_too_many_is_told_so() {
    let _turn = TURN.lock();
    let (show, quiet) = show(100);
    let pages: Vec<_> = (0..8).map(|_| show.page().expect("there is room")).collect();
    let mut ninth = show.socket().unwrap();
    // Whoever comes back asks at once.
    ninth.send(look(1, 64, 48, "colour")).unwrap();
    let said = ninth.read().unwrap();
    assert_eq!(said.to_text().unwrap(), r#"{"type":"notice","text":"Too many pages are open; close one."}"#);
    assert!(is_hung_up(&mut ninth), "it stays");
    drop(pages);
    assert!(comes_true(10, || threads() <= quiet), "{} threads instead of {quiet}", threads());
    assert_serves(&show);
}

#[test]
fn a_client_that_never_reads_is_dropped_and_delays_nobody() {
    let _turn = TURN.lock();
    let (show, quiet) = show(40_000);
    let mut deaf = show.page().unwrap();
    let mut other = show.page().unwrap();
    let began = Instant::now();
    // Until its connection is closed; pictures are noise, so that they are large.
    let mut sequence = 0;
    while deaf.send(look(sequence, 1280, 720, "points")).is_ok() {
        sequence += 1;
        other.send(look(sequence, 64, 48, "colour")).unwrap();
        let asked = Instant::now();
        while picture(&mut other).0["sequence"] != sequence {}
        assert!(asked.elapsed() < Duration::from_secs(4), "the other waits");
        assert!(began.elapsed() < Duration::from_secs(120), "it is still connected");
    }
    drop(other);
    assert!(comes_true(10, || threads() <= quiet), "{} threads instead of {quiet}", threads());
}

#[test]
fn garbage_ends_a_connection_and_costs_no_memory() {
    let _turn = TURN.lock();
    let (show, quiet) = show(100);
    let before = resident_bytes();
    for kind in 0..4 {
        let mut page = show.page().unwrap();
        let message = |n: u32| match kind {
            0 => Message::text("{".repeat(n as usize % 1500)),
            1 => Message::binary(vec![n as u8; 1000]),
            2 => Message::text(format!(r#"{{"type":"look","sequence":{n}}}"#)),
            _ => Message::text("x".repeat(100_000)),
        };
        // All of it may fit into the kernel's buffers before the server reads a byte.
        let _sent = (0..10_000).take_while(|&n| page.send(message(n)).is_ok()).count();
        assert!(is_hung_up(&mut page), "garbage of kind {kind} is listened to without end");
    }
    assert!(comes_true(10, || threads() <= quiet), "{} threads instead of {quiet}", threads());
    let grown = resident_bytes().saturating_sub(before);
    assert!(grown < 32 << 20, "{grown} bytes");
    // The counterpart: as many good messages are.
    let mut page = show.page().unwrap();
    for sequence in 1..=10_000 {
        page.send(look(sequence, 16, 16, "colour")).unwrap();
    }
    while picture(&mut page).0["sequence"] != 10_000 {}
}

#[test]
fn strangers_are_refused() {
    let _turn = TURN.lock();
    let (show, _) = show(100);
    let (host, path) = (show.host(), show.url.split_once(show.host()).unwrap().1);
    let upgrade = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n\
                   Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n";
    let status = |path: &str, headers: &str| show.answer(&format!("GET {path} HTTP/1.1\r\n{headers}\r\n")).0;
    let socket = format!("{path}socket");
    for (path, headers, expected) in [
        (path, format!("Host: {host}\r\n"), "200"),
        (path, "Host: evil.example\r\n".into(), "403"),
        (path, format!("Host: {host}\r\nOrigin: http://evil.example\r\n"), "403"),
        ("/", format!("Host: {host}\r\n"), "404"),
        ("/0123456789abcdef0123456789abcdef/", format!("Host: {host}\r\n"), "404"),
        (&format!("{path}../../etc/passwd"), format!("Host: {host}\r\n"), "404"),
        (&socket, format!("Host: {host}\r\n{upgrade}"), "403"),
        (&socket, format!("Host: {host}\r\nOrigin: http://evil.example\r\n{upgrade}"), "403"),
        (&socket, format!("Host: evil.example\r\nOrigin: http://evil.example\r\n{upgrade}"), "403"),
        (&socket, format!("Host: {host}\r\nOrigin: http://{host}\r\n"), "400"),
    ] {
        let line = status(path, &headers);
        assert!(line.contains(expected), "{path} {headers}: {line}");
    }
    assert!(show.answer(&format!("POST {path} HTTP/1.1\r\nHost: {host}\r\n\r\n")).0.contains("405"));
    assert!(
        show.answer(&format!("GET {path} HTTP/1.1\r\nHost: {host}\r\nX: {}\r\n\r\n", "x".repeat(9000)))
            .0
            .contains("431")
    );
    // The counterpart: with our own origin, the socket opens.
    let mut stream = show.connect();
    write!(stream, "GET {socket} HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\n{upgrade}\r\n")
        .unwrap();
    let mut start = [0; 12];
    stream.read_exact(&mut start).unwrap();
    assert_eq!(&start, b"HTTP/1.1 101");
}

#[test]
fn who_asks_too_slowly_is_hung_up_on() {
    let _turn = TURN.lock();
    let (show, quiet) = show(100);
    let mut slow = show.connect();
    let began = Instant::now();
    // A letter now and then keeps no connection open.
    while slow.write_all(b"G").is_ok() {
        std::thread::sleep(Duration::from_millis(200));
        assert!(began.elapsed() < Duration::from_secs(15), "it is still connected");
    }
    assert!(comes_true(10, || threads() <= quiet), "{} threads instead of {quiet}", threads());
    assert_serves(&show);
}
