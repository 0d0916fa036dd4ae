//! A device that may be looked at, and not changed: what a run lends to whoever watches it.

use std::borrow::Cow;

use crate::backend::{BackendError, RenderSettings};
use crate::camera::Camera;
use crate::device::Renderer;
use crate::gaussians::Gaussians;
use crate::image::Image;

/// The cloud on a device, and how it is rendered.
pub struct CloudRenderer<'a> {
    renderer: &'a mut dyn Renderer,
    settings: RenderSettings,
    /// By what factor colours are brighter than those that the device holds.
    brightness: f32,
}

impl<'a> CloudRenderer<'a> {
    /// What `renderer` holds, as `settings` show it.
    pub fn new(renderer: &'a mut dyn Renderer, settings: RenderSettings) -> Self {
        Self { renderer, settings, brightness: 1.0 }
    }

    /// Shows it this many times as bright, pictures and rows.
    pub fn show_at(&mut self, brightness: f32) {
        self.brightness = brightness;
    }

    /// The cloud as `camera` sees it.
    pub fn render(&mut self, camera: &Camera) -> Result<Image, BackendError> {
        let mut image = self.renderer.render(camera, &self.settings)?;
        image.scale([self.brightness; 3]);
        Ok(image)
    }

    /// The cloud itself; a copy where the device has a memory of its own.
    pub fn cloud(&mut self) -> Result<Cow<'_, Gaussians>, BackendError> {
        let cloud = self.renderer.download()?;
        Ok(if self.brightness == 1.0 { cloud } else { Cow::Owned(cloud.at_brightness(self.brightness)) })
    }

    /// How it is rendered.
    pub fn settings(&self) -> &RenderSettings {
        &self.settings
    }
}
