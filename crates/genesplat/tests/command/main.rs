//! The built command, as a user runs it: files in, files and exit status out.

mod bad_input;
mod camera_path;
mod determinism;
mod experiment;
mod live_page;
mod lpips;
mod overwrite;
mod peer;
mod resume;
mod run_folder;
mod support;
mod terminal;
mod tools;
