//! What a render mode takes of the memory, and what happens where there is too little.
#![cfg(target_os = "linux")]

use std::process::Command;

use genesplat_core::Gaussians;
use tungstenite::Message;

use crate::support::{Show, look, picture, reserved_bytes, resident_bytes};

const GAUSSIANS: usize = 400_000;
const CLOUD_BYTES: u64 = (GAUSSIANS * Gaussians::BYTES_PER_ROW) as u64;
/// Set in a process that runs nothing but this test, since a limit is one of the process.
const ALONE: &str = "GENESPLAT_TEST_ALONE";

/// The process may take so many bytes, or as many as it likes.
fn limit_memory(bytes: &str) {
    let [process, limit] = [format!("--pid={}", std::process::id()), format!("--as={bytes}:")];
    assert!(Command::new("prlimit").args([process, limit]).status().unwrap().success());
}

#[test]
fn a_lens_keeps_no_memory_and_one_that_gets_none_is_a_notice() {
    if std::env::var_os(ALONE).is_none() {
        let name = "memory::a_lens_keeps_no_memory_and_one_that_gets_none_is_a_notice";
        let test =
            Command::new(std::env::current_exe().unwrap()).args(["--exact", name]).env(ALONE, "1").output();
        let test = test.unwrap();
        let said =
            [test.stdout, test.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).concat();
        assert!(test.status.success() && said.contains("1 passed"), "{:?}: {said}", test.status);
        return;
    }
    let show = Show::open(GAUSSIANS);
    let mut page = show.page().unwrap();
    page.send(look(1, 64, 48, "colour")).unwrap();
    picture(&mut page);
    let before = resident_bytes();
    page.send(look(2, 64, 48, "depth")).unwrap();
    picture(&mut page);
    let kept = resident_bytes().saturating_sub(before);
    assert!(kept < CLOUD_BYTES / 2, "{kept} bytes are kept of a render mode on a cloud of {CLOUD_BYTES}");

    // Less than the mode, and what is asked to be spare, need.
    limit_memory(&(reserved_bytes() + CLOUD_BYTES / 2 + (32 << 20)).to_string());
    page.send(look(3, 64, 48, "depth")).unwrap();
    let said = loop {
        match page.read().unwrap() {
            Message::Text(text) if text.contains("notice") => break text,
            Message::Binary(_) => panic!("it was drawn"),
            _ => {}
        }
    };
    assert!(said.contains("no picture: out of memory") && said.contains("for a render mode"), "{said}");
    limit_memory("unlimited");
    for (sequence, mode) in [(4, "colour"), (5, "depth")] {
        page.send(look(sequence, 64, 48, mode)).unwrap();
        assert_eq!(picture(&mut page).0["sequence"], sequence);
    }
}
