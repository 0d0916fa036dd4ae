//! The outside world of genesplat: scenes in, splats out.
//!
//! What it does, and in which direction data flows:
//! - [`load_scene`] detects how a folder describes its photos ([`colmap`], or the `transforms.json` of nerfstudio, instant-ngp and Blender), reads cameras
//!   and points, decodes the photos in parallel ([`photos`]) and splits them into training and test views.
//! - [`ply`] reads and writes clouds in the layout that every splat viewer opens.
//!
//! Every file is hostile until read: a count is believed only as far as the bytes behind it reach, and whatever is
//! wrong ends in one sentence that says what, where, and what to do. A panic here is a bug.

pub mod atomic;
pub mod colmap;
mod cursor;
mod error;
mod lens;
mod listing;
pub mod photos;
pub mod ply;
mod scene;
mod start_points;
mod transforms;

pub use error::SceneError;
pub use ply::{PlyError, PlyOptions, read_ply, write_ply};
pub use scene::{
    HoldOut, LEAST_SIDE_PX, LoadOptions, LoadProgress, PhotoSize, Point, Scene, load_points, load_scene,
};
