//! What is recorded for each stage.

mod contribution;
pub(crate) mod lists;
mod measure;
pub(crate) mod optimise;
pub(crate) mod pixels;
pub(crate) mod rows;
pub(crate) mod score;
pub(crate) mod sort;
pub(crate) mod tiles;
pub(crate) mod view_pass;
