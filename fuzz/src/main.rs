//! Every reader of genesplat on bytes that libFuzzer makes up.
//!
//! One program holds all targets, since each would link the same libraries: `GENESPLAT_FUZZ` names the one that runs
//! (`fuzz/run` lists them). A reader may refuse bytes; it may not panic, hang, or take memory that they do not fill.

#![no_main]

mod args;
#[path = "../../crates/genesplat/src/experiment/file.rs"]
mod experiment_file;
mod targets;

use std::sync::LazyLock;

// As the command's sources know them.
extern crate self as genesplat;
pub(crate) use {genesplat_gallery as gallery, genesplat_train as train};

static TARGET: LazyLock<fn(&[u8])> = LazyLock::new(|| {
    let name = std::env::var("GENESPLAT_FUZZ").expect("GENESPLAT_FUZZ names a target");
    targets::named(&name).unwrap_or_else(|| panic!("there is no target {name}"))
});

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| (*TARGET)(bytes));
