//! How much each Gaussian contributes to the training photos, and how large the error is where it is seen.
//!
//! Both come from blending weights `α·T`, the fraction of a pixel that a Gaussian is, so they are measured by rendering; nothing is
//! differentiated. Their sum tells which Gaussians can go (Fan et al., "LightGaussian", 2024, and others prune by it); weighted with the
//! pixels' errors they tell where more Gaussians are wanted (Rota Bulò et al., "Revising Densification in Gaussian Splatting", 2024).

/// One Gaussian on some training views.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Contribution {
    /// Its blending weights, summed over the pixels of all views.
    pub weight: f32,
    /// Its blending weights times `|I − P|` (summed over the channels), summed over the pixels of a view: that of the view where it is
    /// largest.
    pub error: f32,
}
