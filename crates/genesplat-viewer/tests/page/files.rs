//! Files that a page asks for: made when somebody does, of the cloud that is shown, and saved by the browser.

use std::time::Duration;

use crate::support::{Show, TURN};

fn ask(show: &Show, name: &str) -> (String, String) {
    let path = show.url.split_once(show.host()).unwrap().1;
    show.answer(&format!("GET {path}{name} HTTP/1.1\r\nHost: {}\r\n\r\n", show.host()))
}

#[test]
fn the_splat_is_a_file_to_save_and_what_cannot_be_made_is_told_to_pages() {
    let _turn = TURN.lock();
    let show = Show::open(500);
    let (line, answer) = ask(&show, "point_cloud.ply");
    assert_eq!(line, "HTTP/1.1 200 OK");
    for header in ["Content-Disposition: attachment", "application/octet-stream", "Content-Length: 500000"] {
        assert!(answer.contains(header), "{header}");
    }
    let (_, body) = answer.split_once("\r\n\r\n").unwrap();
    assert_eq!(body.len(), 500_000);

    let mut page = show.page().unwrap();
    page.get_ref().set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let (line, _) = ask(&show, "scene.html");
    assert!(line.contains("503"), "{line}");
    while !page.read().unwrap().to_text().unwrap_or_default().contains("no page today") {}
    // Whoever comes later has not asked.
    let mut later = show.page().unwrap();
    later.get_ref().set_read_timeout(Some(Duration::from_millis(500))).unwrap();
    while let Ok(message) = later.read() {
        assert!(!message.to_text().unwrap_or_default().contains("no page today"), "a notice of before");
    }
}

#[test]
fn files_are_for_who_has_the_token_and_has_none_of_another_name() {
    let _turn = TURN.lock();
    let show = Show::open(10);
    let bare = show.answer(&format!("GET /point_cloud.ply HTTP/1.1\r\nHost: {}\r\n\r\n", show.host()));
    assert!(bare.0.contains("404"), "{}", bare.0);
    for name in ["../point_cloud.ply", "other.ply", "point_cloud.ply/x", "metrics.json"] {
        assert!(ask(&show, name).0.contains("404"), "{name}");
    }
}
