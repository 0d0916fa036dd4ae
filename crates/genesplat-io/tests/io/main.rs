//! The crate from the outside. One program, so that it is linked once.

mod colmap;
mod common;
mod lenses;
mod photos;
mod ply;
mod real_scenes;
mod transforms;
