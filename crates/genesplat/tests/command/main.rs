//! The built command, as a user runs it: files in, files and exit status out.

mod bad_input;
mod determinism;
mod disk;
mod experiment;
mod kills;
mod limits;
mod lpips;
mod overwrite;
mod peer;
mod resume;
mod run_folder;
mod scale;
mod support;
mod terminal;
mod tools;
