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
}

impl<'a> CloudRenderer<'a> {
    /// What `renderer` holds, as `settings` show it.
    pub fn new(renderer: &'a mut dyn Renderer, settings: RenderSettings) -> Self {
        Self { renderer, settings }
    }

    /// The cloud as `camera` sees it.
    pub fn render(&mut self, camera: &Camera) -> Result<Image, BackendError> {
        self.renderer.render(camera, &self.settings)
    }

    /// The cloud itself; a copy where the device has a memory of its own.
    pub fn cloud(&mut self) -> Result<Cow<'_, Gaussians>, BackendError> {
        self.renderer.download()
    }

    /// How it is rendered.
    pub fn settings(&self) -> &RenderSettings {
        &self.settings
    }
}
