//! Data and maths of genesplat, and nothing else: no input or output, no threads, no device.
//!
//! - **Frames.** `camera_from_world` maps world to camera coordinates; camera axes are x right, y down, z
//!   forward.
//! - **Pixels.** The centre of pixel `i` is at coordinate `i`; a camera's principal point follows COLMAP,
//!   with the top-left *corner* of the image at (0, 0), so `u = fx·x/z + cx − 0.5`.
//! - **Parameters are raw** (before activation): log-scales, opacity logits, unnormalised `(w, x, y, z)`
//!   quaternions.
//! - **Shapes** are written as `[N, 3]`, outermost first.

pub mod backend;
pub mod camera;
pub mod cloud_renderer;
pub mod constants;
pub mod covariance;
pub mod depth_map;
pub mod device;
pub mod edit;
pub mod gaussians;
pub mod genes;
mod halved;
pub mod image;
pub mod median;
pub mod memory;
pub mod morton;
pub mod owners;
pub mod rng;
pub mod row_versions;
pub mod similarity;
pub mod spherical_harmonics;
pub mod splat;
pub mod state_mean;
pub mod statistics;
pub mod stored_photo;

pub use backend::{
    BackendError, Channels, LearningRates, RenderSettings, ScreenFilter, TrainStep, Update, View,
};
pub use camera::Camera;
pub use cloud_renderer::CloudRenderer;
pub use depth_map::DepthMap;
pub use device::{Device, DeviceState, Edit, Renderer, Upload};
pub use edit::{EditPart, Origin, RowEdit};
pub use gaussians::{Gaussians, Moments};
pub use genes::{GENES, Genes, SparseDelta};
pub use image::{Image, Mask, Photo};
pub use median::median;
pub use morton::morton_order;
pub use owners::{Alone, RowOwners};
pub use rng::{Rng, Stream};
pub use similarity::Similarity;
pub use splat::{Splat, SplatSums};
pub use state_mean::{Held, StateMean, ViewLoss};
pub use statistics::{DensitySignal, Statistics, StatisticsRequest};
pub use stored_photo::{PhotoLost, PhotoStore, StoredPhoto};
