//! The built command, as a user runs it: files in, files and exit status out.

mod bad_input;
mod bench;
mod blocks;
mod camera_path;
mod convert;
mod determinism;
mod disk;
mod experiment;
mod hostile;
mod inspect;
mod kills;
mod limits;
mod live_page;
mod lpips;
mod mistakes;
mod overwrite;
mod peer;
mod photos;
#[cfg(unix)]
mod planted;
mod poses;
mod real_scene;
mod resume;
mod run_folder;
mod scale;
mod support;
mod tensorboard;
mod terminal;
mod tools;
