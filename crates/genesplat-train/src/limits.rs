//! How many Gaussians there may be.

use genesplat_core::View;

use crate::config::{EvolutionConfig, EvolutionMode, RenewalConfig, TrainConfig, Variant};
use crate::densify::mcmc;

/// The most Gaussians that density control may grow to, by who says so.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Limits {
    /// The user's limit or the variant's own.
    own: Option<usize>,
    /// What the photos feed, in mode `renew`.
    fed: Option<usize>,
}

impl Limits {
    pub(crate) fn new(config: &TrainConfig, views: &[View]) -> Self {
        let of_variant = (config.variant == Variant::Mcmc).then_some(mcmc::DEFAULT_CAP);
        Self { own: config.max_gaussians.or(of_variant), fed: fed_by(views, &config.evolution) }
    }

    /// The lower of the two.
    pub(crate) fn cap(self) -> Option<usize> {
        self.own.into_iter().chain(self.fed).min()
    }

    /// It cannot wait until that limit is reached: MCMC turns nobody away who could be told of.
    pub(crate) fn notice_of_lower_limit(self) -> Option<String> {
        let (own, fed) = (self.own?, self.fed?);
        (fed < own).then(|| {
            format!(
                "the cloud grows to at most {fed} Gaussians, which is what the photos feed (evolution.renewal), \
                 and not to the limit of {own}"
            )
        })
    }

    /// The limit of `cap` is reached in iteration `i`, and so many more wanted to grow; will any, later?
    pub(crate) fn notice_of_full_cloud(self, cap: usize, i: u32, refused: usize, is_last: bool) -> String {
        let source = if self.own == Some(cap) { "" } else { " that the photos feed (evolution.renewal)" };
        let rest = if is_last {
            ""
        } else {
            "; from now on only those with the strongest gradients grow into the room that pruning leaves"
        };
        format!(
            "iteration {i}: the limit of {cap} Gaussians{source} is reached ({refused} more wanted to grow){rest}"
        )
    }
}

/// How many Gaussians the photos feed, where that counts.
fn fed_by(views: &[View], evolution: &EvolutionConfig) -> Option<usize> {
    let pixels_of = |view: &View| f64::from(view.photo.width) * f64::from(view.photo.height);
    let (all, photos) = (views.iter().map(pixels_of).sum::<f64>(), views.len() as f64);
    let RenewalConfig { pixels, photo_pixels, .. } = evolution.renewal;
    let limits = [(all, pixels * photos.sqrt()), (all / photos, photo_pixels)];
    let counting =
        limits.into_iter().filter(|(_, each)| *each > 0.0 && evolution.mode == EvolutionMode::Renew);
    counting.map(|(pixels, each)| ((pixels / each) as usize).max(1)).min()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use genesplat_core::{Camera, Photo};
    use glam::{DQuat, DVec3};

    use super::*;

    #[test]
    fn photos_feed_what_users_and_variants_do_not_limit() {
        let camera = Camera {
            width: 30,
            height: 20,
            focal_px: [1.0; 2],
            principal_px: [15.0, 10.0],
            camera_from_world_rotation: DQuat::IDENTITY,
            camera_from_world_translation: DVec3::ZERO,
        };
        let photo = Arc::new(Photo { width: 30, height: 20, rgb: vec![0; 1800] });
        let views = vec![View { name: String::new(), camera, photo }; 9];
        let renewal = |pixels, photo_pixels| RenewalConfig { pixels, photo_pixels, ..Default::default() };
        let limit_with = |mode, variant, max_gaussians, renewal| {
            let mut config = TrainConfig { variant, max_gaussians, ..TrainConfig::default() };
            (config.evolution.mode, config.evolution.renewal) = (mode, renewal);
            Limits::new(&config, &views).cap()
        };
        let limit = |mode, variant, own, pixels| limit_with(mode, variant, own, renewal(pixels, 0.0));
        let (renew, off) = (EvolutionMode::Renew, EvolutionMode::Off);
        // 9 · 600 pixels over 2 · √9.
        assert_eq!(limit(renew, Variant::ThreeDgs, None, 2.0), Some(900));
        assert_eq!(limit(renew, Variant::ThreeDgs, Some(500), 2.0), Some(500));
        assert_eq!(limit(renew, Variant::Mcmc, None, 2.0), Some(900));
        assert_eq!(limit(renew, Variant::Mcmc, None, 1e-9), Some(mcmc::DEFAULT_CAP));
        assert_eq!(limit(renew, Variant::ThreeDgs, None, 0.0), None);
        assert_eq!(limit(off, Variant::ThreeDgs, None, 2.0), None);
        assert_eq!(limit(off, Variant::Mcmc, None, 2.0), Some(mcmc::DEFAULT_CAP));
        // 600 pixels over 0.3, where that is less.
        let of_one = |pixels, each| limit_with(renew, Variant::ThreeDgs, None, renewal(pixels, each));
        assert_eq!([of_one(0.0, 0.3), of_one(0.5, 0.3), of_one(2.0, 0.3)], [2000, 2000, 900].map(Some));
    }
}
