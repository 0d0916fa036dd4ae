//! The built command, as a user runs it: files in, files and exit status out.

mod bad_input;
mod blocks;
mod camera_path;
mod clean;
mod convert;
mod corrections;
mod determinism;
mod disk;
mod foreign_folders;
mod georeferenced;
mod golden;
mod hostile;
mod inputs;
mod inspect;
mod kills;
mod limits;
mod live_page;
mod lpips;
mod mistakes;
mod next;
mod overwrite;
mod pairs;
mod peer;
mod photos;
#[cfg(unix)]
mod planted;
mod poses;
mod real_scene;
mod resume;
mod run_folder;
mod scale;
mod signals;
mod support;
mod tensorboard;
mod terminal;
mod tools;
