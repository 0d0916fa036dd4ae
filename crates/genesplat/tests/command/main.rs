//! The built command, as a user runs it: files in, files and exit status out.

mod bad_input;
mod determinism;
mod experiment;
mod lpips;
mod overwrite;
mod peer;
mod poses;
mod resume;
mod run_folder;
mod support;
mod terminal;
mod tools;
