//! Files in and out of genesplat: scenes are read, splats are read and written.
//!
//! Input is not trusted. A count is believed only as far as the bytes behind it reach. Whatever is wrong ends
//! in a typed error whose one sentence says what, where, and what to do. A panic here is a bug.

mod alike;
pub mod archive;
pub mod atomic;
#[doc(hidden)]
pub mod bytes;
pub mod colmap;
mod digest;
mod error;
pub mod format;
pub mod input;
mod listing;
pub mod names;
pub mod offset;
pub mod own;
pub mod photos;
pub mod ply;
mod scene;
mod shown;
mod similar;
mod transforms;
mod visited;

pub use digest::Digest;
pub use error::SceneError;
pub use format::{Format, FormatError};
pub use listing::ListedDepth;
pub use offset::Offset;
pub use photos::PhotoSize;
pub use ply::{PlyError, PlyOptions, read_ply, write_ply};
pub use scene::{
    Doubt, HoldOut, LoadOptions, LoadProgress, MaskUse, Masks, PhotoDigests, Point, SIDE_MIN_PX, Scene,
    SceneDigests, SceneList, ScenePhoto, Sight, Spill, blocks, dense_name, list_scene, load_points,
    load_scene, mask_beside, model_of, replace_photos, scene_digests,
};
pub use shown::{command_line, plural, shown};
pub use similar::{PHOTO_ENDINGS, UNREAD, VIDEO_ENDINGS, convert, ending, is_part_of_scene, is_transforms};
pub use visited::Visited;
