//! What the backend's tests compare with the reference.

use genesplat_core::spherical_harmonics::SH_STRIDE;

use super::Trained;

/// Colours without the steps that they have yet to make.
pub(crate) fn colours_as_they_are(trained: &Trained) -> Vec<[f32; SH_STRIDE]> {
    trained.cloud.sh.clone()
}
