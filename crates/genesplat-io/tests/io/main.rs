//! The crate from the outside. One program, so that it is linked once.

mod archive;
mod colmap;
mod common;
mod depth;
mod extremes;
mod far;
mod foreign;
mod formats;
mod found;
mod hostile_formats;
mod lenses;
mod masks;
mod photos;
mod ply;
mod ply_kinds;
mod real_scenes;
mod rigs;
mod split;
mod strangers;
mod tracks;
mod transforms;
mod wide;
