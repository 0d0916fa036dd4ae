//! Settings of density control: that of 3DGS and its variants, and what MCMC has in its place.

use serde::{Deserialize, Serialize};

/// Improved-GS prunes what is fainter than this when opacities have had time to recover from a reset.
pub(crate) const RECOVERED_OPACITY: f32 = 0.02;

/// Which screen-space gradient makes a Gaussian grow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Signal {
    /// The variant's own: signed over pixels for 3DGS and Mip-Splatting, weighted by pixels for Pixel-GS.
    #[default]
    Published,
    /// gsplat's "absgrad": absolute values, which do not cancel out across a large Gaussian.
    Absolute,
    /// That of Gaussian Opacity Fields, which Mip-Splatting's later releases adopted: the signed one or, for as many
    /// Gaussians as reach its threshold, the largest absolute ones.
    Gof,
}

impl Signal {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Published, Self::Absolute, Self::Gof];

    /// As the command and the configuration file write it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Published => "published",
            Self::Absolute => "absolute",
            Self::Gof => "gof",
        }
    }
}

/// Density control; defaults are those of the published numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DensifyConfig {
    /// Densification starts after this iteration. Default 500.
    pub from: u32,
    /// Densification and opacity resets end before this iteration. Default 15,000; 0 switches both off. With
    /// evolution's mode `renew` that is half of the run, however long it is; where it does not select, densification ends at
    /// 65 % of the run at the latest, and resets at half. (With `mcmc`, only where evolution's reset triggers end; see
    /// `mcmc.until`.)
    pub until: u32,
    /// Iterations between two densifications. Default 100; at least 1.
    pub every: u32,
    /// Gradient that is looked at. Default `published`, the variant's own; or `absolute`, `gof`, for `3dgs` and
    /// `mip-splatting` only.
    pub signal: Signal,
    /// Mean screen-space gradient from which a Gaussian grows, in normalised device coordinates. Default 2e-4, 8e-4 for
    /// the signal `absolute`, which is larger (gsplat's advice; its published comparison has 6e-4), and 3e-4 with
    /// `improved-gs` and `renew`, whose signal is absolute, too; above 0. Lower grows more Gaussians.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gradient_threshold: Option<f32>,
    /// Growing Gaussians up to this size are cloned, larger ones split; in scene extents. Default 0.01; above 0.
    /// (`improved-gs` and `renew` split all of them.)
    pub clone_size: f64,
    /// Fainter Gaussians are pruned. Default 0.005; 0 to 1.
    pub prune_opacity: f32,
    /// Larger Gaussians are pruned, except with `improved-gs` and evolution's mode `renew`; in scene extents. Default 0.1;
    /// above 0. (In forward-facing scenes walls and floors are larger than that, and plain training loses them.)
    pub prune_size: f64,
    /// Iteration after which they are. Default 3000.
    pub size_prune_after: u32,
    /// Iterations between two opacity resets. Default 3000; at least 1.
    pub reset_every: u32,
    /// A reset limits opacity to this. Default 0.01, and 0.05 with `improved-gs` and `renew`; above 0, below 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reset_opacity: Option<f32>,
}

impl Default for DensifyConfig {
    fn default() -> Self {
        Self {
            from: 500,
            until: 15_000,
            every: 100,
            signal: Signal::Published,
            gradient_threshold: None,
            clone_size: 0.01,
            prune_opacity: 0.005,
            prune_size: 0.1,
            size_prune_after: 3000,
            reset_every: 3000,
            reset_opacity: None,
        }
    }
}

/// 3DGS-MCMC; defaults are those of gsplat, which reproduces the published numbers. `densify.from` and `densify.every`
/// hold here, too; the rest of `densify` does not, but for evolution's triggers, which lie where resets would be.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct McmcConfig {
    /// Relocation and growth end before this iteration. Default 25,000; 0 switches both off. With evolution's mode
    /// `renew` they end at half of the run at the latest.
    pub until: u32,
    /// Fraction of Gaussians added each time, until `max_gaussians` are reached. Default 0.05; not negative.
    pub growth: f64,
    /// Exploration noise, in multiples of the position rate. Default 5e5; not negative. As in the authors' code it is
    /// in the scene's own units: its reach grows with the square of the cameras' extent (gsplat brings scenes to an
    /// extent of about 1 first). A scene whose extent is below 1 or above 10 is measured as if it were 1 or 10.
    pub noise: f32,
    /// Weight of the mean opacity in the loss. Default 0.01; not negative. Higher leaves more Gaussians to relocate.
    pub opacity_weight: f32,
    /// Weight of the mean scale in the loss, in the same units. Default 0.01; not negative. Higher makes Gaussians smaller.
    pub scale_weight: f32,
}

impl Default for McmcConfig {
    fn default() -> Self {
        Self { until: 25_000, growth: 0.05, noise: 5e5, opacity_weight: 0.01, scale_weight: 0.01 }
    }
}
