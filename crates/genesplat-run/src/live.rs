//! The live page, as the command opens it: what it shows, and where it is.

use anyhow::Result;
use genesplat_core::{CloudRenderer, Gaussians, RenderSettings, View};
use genesplat_io::Scene;
use genesplat_kernels::cpu::CpuBackend;
use genesplat_viewer::{Address, Download, Keeper, LiveView, Phase, SceneViews};

use crate::device::Device;
use crate::edited::EditedFile;
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
    /// Where pages save what they have edited.
    pub edited: EditedFile,
}

impl Showing {
    /// Training has ended: shows what came of it until `is_over`, which hears whether anybody looks.
    pub fn serve(&mut self, scene: &Scene, is_over: impl FnMut(bool) -> bool) {
        self.live.set_phase(Phase::Viewing);
        self.serve_until(&scene.name, Some(scene), is_over);
    }

    /// Shows it, makes the files that pages ask for, and saves what they have edited.
    pub fn serve_until(&mut self, name: &str, scene: Option<&Scene>, is_over: impl FnMut(bool) -> bool) {
        let name = scene.map_or(name, |scene| &scene.name);
        let mut keeper = Files { title: name, scene, edited: &self.edited };
        let is_lost = self.live.serve_until(self.device.as_mut(), self.settings, &mut keeper, is_over);
        if is_lost {
            output::tell("notice: what was edited on the page was not saved");
        }
    }
}

/// The files of a page.
struct Files<'a> {
    title: &'a str,
    scene: Option<&'a Scene>,
    edited: &'a EditedFile,
}

impl Keeper for Files<'_> {
    fn make(&mut self, download: Download, renderer: &mut CloudRenderer<'_>) -> Result<Vec<u8>, String> {
        take_along::make(download, renderer, self.title, self.scene).map_err(|error| error.to_string())
    }

    fn save(&mut self, renderer: &mut CloudRenderer<'_>) -> Result<String, String> {
        let saved = self.edited.save(renderer).map_err(|error| error.to_string())?;
        output::tell(&saved);
        Ok(saved)
    }
}
