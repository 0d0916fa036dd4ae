//! A device that may be looked at, and not changed: what a run lends to whoever watches it.

use std::borrow::Cow;

use crate::backend::{Backend, BackendError, RenderSettings};
use crate::camera::Camera;
use crate::gaussians::Gaussians;
use crate::image::Image;

/// The cloud on a device, and how it is rendered.
pub struct Sight<'a> {
    backend: &'a mut dyn Backend,
    settings: RenderSettings,
}

impl<'a> Sight<'a> {
    /// What `backend` holds, as `settings` show it.
    pub fn new(backend: &'a mut dyn Backend, settings: RenderSettings) -> Self {
        Self { backend, settings }
    }

    /// The cloud as `camera` sees it.
    pub fn render(&mut self, camera: &Camera) -> Result<Image, BackendError> {
        self.backend.render(camera, &self.settings)
    }

    /// The cloud itself; a copy where the device has a memory of its own.
    pub fn cloud(&mut self) -> Result<Cow<'_, Gaussians>, BackendError> {
        self.backend.download()
    }

    /// How it is rendered.
    pub fn settings(&self) -> &RenderSettings {
        &self.settings
    }
}
