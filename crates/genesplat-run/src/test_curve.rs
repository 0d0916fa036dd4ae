//! PSNR of the test photos while training goes on, for the curve in `report.html`.
//!
//! Training does not see the scores, and the time is billed to neither gradients nor evolution.

use anyhow::Result;
use genesplat_core::{CloudRenderer, Image, Photo, View};
use genesplat_metrics::psnr_under;
use rayon::prelude::*;

use crate::exposure::{Light, Shade};

/// Points of the curve.
pub(crate) const POINTS: u32 = 12;

pub(crate) struct TestCurve<'a> {
    views: &'a [View],
    light: Option<Light<'a>>,
    every: u32,
}

impl<'a> TestCurve<'a> {
    /// For a run of `iterations`, on renders in this light; `None` where no photo was held out.
    pub(crate) fn new(views: &'a [View], light: Option<Light<'a>>, iterations: u32) -> Option<Self> {
        let every = iterations.div_ceil(POINTS).max(1);
        (!views.is_empty()).then_some(Self { views, light, every })
    }

    pub(crate) fn is_due(&self, iteration: u32) -> bool {
        iteration.is_multiple_of(self.every)
    }

    /// Mean PSNR, dB; `None` when a photo is reproduced exactly.
    pub(crate) fn score(&self, renderer: &mut CloudRenderer<'_>) -> Result<Option<f64>> {
        let mut all = Vec::with_capacity(self.views.len());
        // As many renders at a time as there are cores to compare them with their photos.
        for views in self.views.chunks(rayon::current_num_threads()) {
            let images: Vec<Image> =
                views.iter().map(|view| renderer.render(&view.camera)).collect::<Result<_, _>>()?;
            let psnr = |(view, image): (&View, Image)| -> Result<f64> {
                Ok(psnr_under(view.mask.as_deref(), &self.shown(view, image), &*view.photo.read()?)?)
            };
            all.extend(views.par_iter().zip(images).map(psnr).collect::<Result<Vec<f64>>>()?);
        }
        let mean = all.iter().sum::<f64>() / self.views.len() as f64;
        Ok(mean.is_finite().then_some(mean))
    }

    /// The render as the photo of `view` is expected to be.
    fn shown(&self, view: &View, mut image: Image) -> Photo {
        let shade = self.light.map_or(Shade::NONE, |light| light.foretold(&view.name));
        shade.put_on(&mut image, &view.camera);
        image.to_photo()
    }
}
