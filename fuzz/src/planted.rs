//! Bugs behind six conditions on the first row of a splat, so that it is known what the harness finds.
//!
//! Each condition is an edge of its own, so coverage keeps an input that meets one more. A row of random
//! bytes meets all of them once in 2.6 billion times.

use std::hint::black_box;
use std::sync::LazyLock;

static PLANTED: LazyLock<Option<String>> = LazyLock::new(|| std::env::var("GENESPLAT_PLANTED").ok());

/// Called with the bytes of every `.splat` that was read.
pub(crate) fn meet(bytes: &[u8]) {
    let (Some(kind), Some(row)) = (PLANTED.as_deref(), bytes.first_chunk::<32>()) else { return };
    let float = |at: usize| f32::from_le_bytes([row[at], row[at + 1], row[at + 2], row[at + 3]]);
    let conditions = [
        row[24] >> 4 == 0x4,
        row[25] >> 4 == 0x9,
        row[26] >> 4 == 0x1,
        row[27] >> 4 == 0x7,
        (1e3..1e6).contains(&float(0)),
        (-1e6..-1e3).contains(&float(4)),
    ];
    match black_box(conditions) {
        [false, ..] => {}
        [_, false, ..] => stop_at(1),
        [_, _, false, ..] => stop_at(2),
        [_, _, _, false, ..] => stop_at(3),
        [_, _, _, _, false, _] => stop_at(4),
        [_, _, _, _, _, false] => stop_at(5),
        _ => fail(kind),
    }
}

/// An edge that is met with another number is another edge.
fn stop_at(condition: u32) {
    black_box(condition);
}

fn fail(kind: &str) {
    match kind {
        "panic" => panic!("the planted panic"),
        "memory" => drop(black_box(vec![0u8; 4 << 30])),
        "hang" => std::thread::sleep(std::time::Duration::from_secs(3600)),
        other => panic!("GENESPLAT_PLANTED is panic, memory or hang, not {other}"),
    }
}
