//! Renders at the exposure of a photo.

use std::borrow::Cow;

use anyhow::Result;
use genesplat_core::{BackendError, Camera, Gaussians, Image, RenderSettings, Renderer, View};

use super::{Exposure, scaled};

/// What renders and photos that are compared have to do with the exposure that photos were brought to.
#[derive(Clone, Copy, Debug)]
pub struct Light<'a> {
    exposure: &'a Exposure,
    /// By what factor the cloud is brighter than the mean exposure.
    cloud: f32,
    /// Whether the photos are those that training sees.
    is_brought: bool,
}

impl<'a> Light<'a> {
    /// Of a finished cloud, and photos as they were taken.
    pub fn finished(exposure: &'a Exposure) -> Self {
        Self { exposure, cloud: 1.0, is_brought: false }
    }

    /// Of a cloud under training.
    pub fn in_training(exposure: &'a Exposure) -> Self {
        Self { cloud: exposure.dark, ..Self::finished(exposure) }
    }

    /// With photos that were brought to the exposure that training sees.
    pub fn brought(self) -> Self {
        Self { is_brought: true, ..self }
    }

    /// What a render is multiplied by to look as the photo of this name.
    pub(crate) fn of_photo(&self, name: &str) -> [f32; 3] {
        self.exposure.gain(name).map(|gain| gain / self.cloud)
    }

    /// What a render is multiplied by to be at the mean exposure.
    pub(crate) fn mean(&self) -> [f32; 3] {
        [1.0 / self.cloud; 3]
    }

    /// The view with its photo as it was taken.
    pub(crate) fn as_taken(&self, view: &View) -> Result<View> {
        if !self.is_brought {
            return Ok(view.clone());
        }
        let back = self.exposure.gain(&view.name).map(|gain| gain / self.exposure.dark);
        Ok(View { photo: scaled(&*view.photo.read()?, back).into(), ..view.clone() })
    }
}

/// Draws what another device draws, times `factors`.
pub(crate) struct Lit<'a> {
    pub(crate) renderer: &'a mut dyn Renderer,
    pub(crate) factors: [f32; 3],
}

impl Renderer for Lit<'_> {
    fn describe(&self) -> String {
        self.renderer.describe()
    }

    fn gaussian_count(&self) -> usize {
        self.renderer.gaussian_count()
    }

    fn download(&mut self) -> Result<Cow<'_, Gaussians>, BackendError> {
        self.renderer.download()
    }

    fn render(&mut self, camera: &Camera, settings: &RenderSettings) -> Result<Image, BackendError> {
        let mut image = self.renderer.render(camera, settings)?;
        image.scale(self.factors);
        Ok(image)
    }
}
