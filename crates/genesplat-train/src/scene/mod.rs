//! What training reads from the scene: the first cloud, the size of things, the order of views.

pub(crate) mod coarse;
pub(crate) mod depth_views;
pub mod filter_3d;
pub mod initialise;
pub(crate) mod nearest;
pub mod surroundings;
pub(crate) mod thin;
pub mod views;
pub(crate) mod virtual_views;
