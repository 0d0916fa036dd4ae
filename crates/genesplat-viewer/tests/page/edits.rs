//! Edits of a page: what a box or a brush removes, that undo gives it back, and what is saved.

use std::net::TcpStream;
use std::time::Duration;

use tungstenite::{Message, WebSocket};

use crate::support::{Show, TURN, look, picture};

const ALL: usize = 500;
/// The half of [`crate::support::cloud`] with positive x.
const BOX: &str =
    r#"{"type":"crop","centre":[5,0,0],"rotation":[1,0,0,0],"half_sizes":[5,9,9],"removes":"inside"}"#;

/// The next message of a type.
fn next(page: &mut WebSocket<TcpStream>, kind: &str) -> serde_json::Value {
    loop {
        let Message::Text(text) = page.read().unwrap() else { continue };
        let message: serde_json::Value = serde_json::from_str(&text).unwrap();
        if message["type"] == kind {
            return message;
        }
    }
}

/// What is told after an edit.
fn told(page: &mut WebSocket<TcpStream>, message: &str) -> String {
    page.send(Message::text(message)).unwrap();
    next(page, "notice")["text"].as_str().unwrap().to_owned()
}

fn shown(page: &mut WebSocket<TcpStream>, sequence: u32) -> Vec<u8> {
    page.send(look(sequence, 64, 64, "colour")).unwrap();
    loop {
        let (header, jpeg) = picture(page);
        if header["sequence"] == sequence {
            return jpeg;
        }
    }
}

fn downloaded(show: &Show) -> usize {
    let path = show.url.split_once(show.host()).unwrap().1;
    let request = format!("GET {path}point_cloud.ply HTTP/1.1\r\nHost: {}\r\n\r\n", show.host());
    show.answer(&request).1.split_once("\r\n\r\n").unwrap().1.len() / 1000
}

#[test]
fn a_box_and_a_brush_remove_what_is_downloaded_no_more_until_it_is_undone() {
    let _turn = TURN.lock();
    let show = Show::open(ALL);
    let mut page = show.page().unwrap();
    page.get_ref().set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let whole = shown(&mut page, 1);
    assert_eq!(told(&mut page, r#"{"type":"save"}"#), "nothing was edited, so there is nothing to save");
    let sentence = told(&mut page, BOX);
    let removed: usize = sentence.split(' ').next().unwrap().parse().unwrap();
    assert!((200..300).contains(&removed) && sentence.contains("of 500 Gaussians removed"), "{sentence}");
    assert_eq!(downloaded(&show), ALL - removed);
    let half = shown(&mut page, 2);
    assert_ne!(half, whole);
    // In the left half of a picture of 64 px, through everything.
    let erase = r#"{"type":"erase","pose":{"position":[0,0,-4],"rotation":[1,0,0,0],"fov_y":1},"width":64,"height":64,
        "radius":10,"path":[[10,32],[20,32]],"through":true}"#;
    assert!(told(&mut page, erase).contains(&format!("of {} Gaussians removed", ALL - removed)));
    assert_ne!(shown(&mut page, 3), half);
    assert!(told(&mut page, r#"{"type":"undo"}"#).ends_with("Gaussians are back"));
    assert_eq!(shown(&mut page, 4), half, "the same rows are back in their places");
    assert_eq!(told(&mut page, r#"{"type":"save"}"#), format!("{} are saved", ALL - removed));
    assert!(
        told(&mut page, r#"{"type":"save"}"#).contains("try again in"),
        "one after the other fills disks"
    );
    told(&mut page, r#"{"type":"undo"}"#);
    assert_eq!((shown(&mut page, 5), downloaded(&show)), (whole, ALL));
    assert_eq!(told(&mut page, r#"{"type":"undo"}"#), "there is nothing to undo");
}

#[test]
fn edits_that_would_leave_nothing_or_change_nothing_are_told_and_not_made() {
    let _turn = TURN.lock();
    let show = Show::open(ALL);
    let mut page = show.page().unwrap();
    page.get_ref().set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let outside = BOX.replace("[5,0,0]", "[50,0,0]");
    assert!(told(&mut page, &outside).contains("no Gaussian is there"));
    let all = outside.replace("inside", "outside");
    assert!(told(&mut page, &all).contains("would remove everything"));
    assert_eq!(downloaded(&show), ALL);
}
