//! Scenes that one memory does not hold: cut into blocks on the ground ([`genesplat::io::blocks`]), each an
//! ordinary scene, and put together again.

pub(crate) mod claim;
mod folder;
pub(crate) mod merge;
pub(crate) mod split;
