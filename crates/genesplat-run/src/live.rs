//! The live page, as the command opens it: what it shows, and where it is.

use std::net::SocketAddr;

use anyhow::Result;
use genesplat_core::Gaussians;
use genesplat_io::Scene;
use genesplat_kernels::cpu::CpuBackend;
use genesplat_viewer::{LiveView, SceneViews};

use crate::output;

/// Serves a page of a run on `scene`, and says where.
pub fn of_training(address: SocketAddr, scene: &Scene) -> Result<LiveView> {
    open(address, SceneViews::new(&scene.name, &scene.train, &scene.test, None), true)
}

/// The same of a finished splat called `name`, with the cameras of its scene where they are at hand.
pub fn of_splat(
    address: SocketAddr,
    name: &str,
    cloud: &Gaussians,
    scene: Option<&Scene>,
) -> Result<LiveView> {
    let (train, test) = scene.map_or((&[][..], &[][..]), |scene| (&scene.train, &scene.test));
    open(address, SceneViews::new(name, train, test, Some(cloud)), false)
}

fn open(address: SocketAddr, scene_views: SceneViews, can_train: bool) -> Result<LiveView> {
    let live = LiveView::start(address, scene_views, can_train, Box::new(CpuBackend::new()))?;
    output::print(&format!("view   {}", live.url()))?;
    Ok(live)
}
