//! Mip-Splatting: 3DGS with two filters against aliasing. A 3D filter keeps each Gaussian as large as the
//! photos can resolve it, a 2D filter stands for a pixel's area and dims what it widens.
//!
//! Yu et al., "Mip-Splatting: Alias-free 3D Gaussian Splatting", CVPR 2024, and its code. Its later releases
//! grow by the gradients of Gaussian Opacity Fields; here are the published ones. In a stage of the search
//! the 3D filter stays as it is until the next densification, so that what is scored is what is rendered.

use genesplat_core::{DensitySignal, ScreenFilter};

use super::threedgs::{self, ThreeDgs};
use super::{Method, MethodConfig, MethodName};
use crate::config::TrainConfig;
use crate::density::Plan;
use crate::run::TrainError;
use crate::run::trainer::Trainer;
use crate::timeline::{Event, Length, Timeline, When};

pub(super) struct MipSplatting;

impl Method for MipSplatting {
    fn defaults(&self) -> MethodConfig {
        MethodConfig { name: MethodName::MipSplatting, ..ThreeDgs.defaults() }
    }

    fn own_settings(&self) -> &'static [&'static str] {
        &threedgs::SETTINGS
    }

    /// The 3D filter is computed anew after each densification, and later now and then until shortly before
    /// the end.
    fn timeline(&self, config: &TrainConfig, _looks: u32) -> Timeline {
        let mut timeline = threedgs::timeline(config, Length::of(config));
        let (densify, end) = (timeline.densify, timeline.iterations.saturating_sub(timeline.densify.every));
        timeline.add(Event::RefreshFilter, timeline.densifications());
        timeline
            .add(Event::RefreshFilter, When::multiples(densify.every, densify.until.saturating_add(1), end));
        timeline
    }

    fn density_signal(&self, extent: f64) -> Option<DensitySignal> {
        ThreeDgs.density_signal(extent)
    }

    fn densify(&self, trainer: &mut Trainer<'_>, i: u32) -> Result<Plan, TrainError> {
        threedgs::densify(trainer, i)
    }

    fn screen_filter(&self) -> Option<ScreenFilter> {
        Some(ScreenFilter::Mip)
    }

    fn has_filter_3d(&self) -> bool {
        true
    }
}
