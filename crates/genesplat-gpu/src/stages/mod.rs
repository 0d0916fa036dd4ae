//! What is recorded for each stage.

pub(crate) mod lists;
pub(crate) mod optimise;
pub(crate) mod order;
pub(crate) mod pixels;
pub(crate) mod score;
pub(crate) mod tiles;
pub(crate) mod traffic;
pub(crate) mod view_pass;
