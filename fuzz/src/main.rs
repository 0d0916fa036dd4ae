//! One program that fuzzes every reader of strangers' bytes. `fuzz/run` builds and starts it; see
//! `fuzz/README.md`.
//!
//! `GENESPLAT_FUZZ` names the target, and the arguments are libFuzzer's. `GENESPLAT_SEEDS` names a folder:
//! the program writes the first inputs of every target there, and ends. `GENESPLAT_PLANTED` plants a bug.

#![no_main]

mod memory;
mod planted;
mod seeds;
mod targets;
mod wrap;

use std::path::Path;
use std::sync::OnceLock;

use libfuzzer_sys::fuzz_target;

use targets::Target;

#[global_allocator]
static MEMORY: memory::Bounded = memory::Bounded;

static TARGET: OnceLock<Target> = OnceLock::new();

fuzz_target!(init: begin(), |bytes: &[u8]| TARGET.get().expect("begin has chosen it")(bytes));

fn begin() {
    if let Ok(folder) = std::env::var("GENESPLAT_SEEDS") {
        seeds::write(Path::new(&folder)).expect("seeds are written to a folder of ours");
        std::process::exit(0);
    }
    let name = std::env::var("GENESPLAT_FUZZ").unwrap_or_default();
    let Some((_, target)) = targets::ALL.iter().find(|(known, _)| *known == name) else {
        targets::ALL.iter().for_each(|(name, _)| println!("{name}"));
        std::process::exit(2);
    };
    TARGET.get_or_init(|| *target);
}
