//! What is recorded for each stage.
//!
//! | module | stages |
//! |---|---|
//! | `view_pass` | cameras, settings and rates as kernels read them |
//! | `lists`, `sort` | `project` and `bin`: from a cloud to the tile lists of a view |
//! | `pixels` | `rasterise`, `loss` and `rasterise_backward` |
//! | `optimise` | `project_backward`, the statistics, `adam` and `noise` |
//! | `rows` | row edits, opacity resets, genes, 3D filters |
//! | `measure` | losses of blends of averages |
//! | `contribution` | how much Gaussians contribute to views |
//! | `score` | losses of many individuals at once |

mod contribution;
pub(crate) mod lists;
mod measure;
pub(crate) mod optimise;
pub(crate) mod pixels;
pub(crate) mod rows;
pub(crate) mod score;
pub(crate) mod sort;
pub(crate) mod view_pass;
