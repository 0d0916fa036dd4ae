//! The built laboratory, as it is used: files in, files and exit status out.

mod bench;
mod experiment;
mod kills;
mod quality;
mod refused;
#[allow(dead_code, reason = "the command's tests use the rest")]
#[path = "../../../genesplat/tests/command/support.rs"]
mod support;
