//! Files in and out of genesplat: scenes are read, splats are read and written.
//!
//! - [`load_scene`] detects how a folder describes its photos ([`colmap`], or the `transforms.json` of nerfstudio,
//!   instant-ngp and Blender), reads cameras and points, decodes the photos in parallel ([`photos`]), and splits them
//!   into training and test views.
//! - [`ply`] reads and writes clouds in the layout that every splat viewer opens.
//! - [`atomic`] writes a file whole or not at all.
//!
//! Input is not trusted. A count is believed only as far as the bytes behind it reach. Whatever is wrong ends in a
//! typed error whose one sentence says what, where, and what to do. A panic here is a bug.

pub mod atomic;
pub mod colmap;
mod error;
mod listing;
pub mod photos;
pub mod ply;
mod scene;
mod transforms;

pub use error::SceneError;
pub use photos::PhotoSize;
pub use ply::{PlyError, PlyOptions, read_ply, write_ply};
pub use scene::{HoldOut, LoadOptions, LoadProgress, Point, SIDE_MIN_PX, Scene, load_points, load_scene};
