//! The live page, as the command opens it: what it shows, and where it is.

use anyhow::Result;
use genesplat_core::{CloudRenderer, Gaussians, RenderSettings, View};
use genesplat_io::Scene;
use genesplat_kernels::cpu::CpuBackend;
use genesplat_viewer::{Address, LiveView, Phase, SceneViews};

use crate::device::Device;
use crate::exposure::{Exposure, Light};
use crate::{output, take_along};

/// Serves a page of a run on `scene`, and says where; where its training photos were brought to one
/// `exposure`, all photos are shown at the mean, as renders are.
pub fn of_training(address: &Address, scene: &Scene, exposure: Option<&Exposure>) -> Result<LiveView> {
    let shown = |views: &[View], light: Option<Light<'_>>| -> Vec<View> {
        views.iter().map(|view| light.map_or_else(|| view.clone(), |light| light.at_mean(view))).collect()
    };
    let light = exposure.map(Light::in_training);
    let (train, test) = (shown(&scene.train, light.map(Light::brought)), shown(&scene.test, light));
    open(address, SceneViews::new(&scene.name, &train, &test, None), true)
}

/// The same of a splat called `name` that is not trained here, with the name and the cameras of its scene
/// where they are at hand.
pub fn of_splat(address: &Address, name: &str, cloud: &Gaussians, scene: Option<&Scene>) -> Result<LiveView> {
    let (train, test) = scene.map_or((&[][..], &[][..]), |scene| (&scene.train, &scene.test));
    let name = scene.map_or(name, |scene| &scene.name);
    open(address, SceneViews::new(name, train, test, Some(cloud)), false)
}

fn open(address: &Address, scene_views: SceneViews, can_train: bool) -> Result<LiveView> {
    let live = LiveView::start(address.clone(), scene_views, can_train, Box::new(CpuBackend::new()))?;
    let url = live.url();
    output::print(&format!("view   {url}"))?;
    let path = url.splitn(4, '/').last().unwrap_or_default();
    for host in &address.hosts {
        output::tell(&format!(
            "       https://{host}/{path} where a proxy or tunnel leads from there to here"
        ));
    }
    Ok(live)
}

/// A page that shows what a device holds, for as long as somebody wants it.
pub struct Showing {
    /// The page.
    pub live: LiveView,
    /// What renders.
    pub device: Device,
    /// How.
    pub settings: RenderSettings,
    /// This many times as bright as the device holds it.
    pub brightness: f32,
}

impl Showing {
    /// Training has ended: shows what came of it until `is_over`, which hears whether anybody looks.
    pub fn serve(&mut self, scene: &Scene, is_over: impl FnMut(bool) -> bool) {
        self.live.set_phase(Phase::Viewing);
        self.serve_until(&scene.name, Some(scene), is_over);
    }

    /// Shows it, and makes the files that pages ask for.
    pub fn serve_until(&mut self, name: &str, scene: Option<&Scene>, is_over: impl FnMut(bool) -> bool) {
        let mut renderer = CloudRenderer::new(self.device.as_mut(), self.settings);
        renderer.show_at(self.brightness);
        let name = scene.map_or(name, |scene| &scene.name);
        let mut make = |download, renderer: &mut CloudRenderer<'_>| {
            take_along::make(download, renderer, name, scene).map_err(|error| error.to_string())
        };
        self.live.serve_until(&mut renderer, &mut make, is_over);
    }
}
