//! The stages of a step in pieces, for a backend that holds some rows of a cloud and draws a band of each
//! picture: what [`CpuBackend`](super::CpuBackend) does with a whole cloud and a whole picture.
//!
//! The numbers are the same to the bit, provided that shares of rows begin at a multiple of
//! [`ROWS_TOGETHER`], that splats are drawn in the order of their rows, and that sums are taken in the order
//! of the picture.

pub use fearless_simd::Level;

pub use super::bin::coverage::tile_rows;
pub use super::blend::blending_weights::weights_of;
pub use super::blend::gradient_row::{GradientRow, columns_of};
pub use super::loss::squared_error::{mean_squared_error, squared_errors};
pub use super::loss::{LOSS_REACH, Wanted, loss_of_rows, loss_of_sums};
pub use super::update::{Share, SplatGradients};
pub use super::view::{Band, CHUNK as ROWS_TOGETHER, Splat, Splats};
