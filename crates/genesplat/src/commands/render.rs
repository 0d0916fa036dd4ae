//! `genesplat render`: a splat seen from the viewpoints of photos.

use std::path::Path;

use anyhow::{Result, bail};
use genesplat::core::{Backend, View};
use genesplat::io::{Scene, photos};

use crate::args::{RenderArgs, RenderSplit};
use crate::progress::Bar;
use crate::{device, files, output, same_scene, scene, splat};

/// Renders one viewpoint into a file, or many into a folder.
pub fn run(args: &RenderArgs) -> Result<()> {
    match args.image {
        Some(_) => files::check_writable(&args.out)?,
        None => files::check_folder(&args.out, "0001.png")?,
    }
    device::use_threads(args.machine.threads)?;
    let splat = splat::open(&args.splat)?.on(args.on);
    let scene = splat.load_scene(&args.data, args.size)?;
    scene::check_spared(&scene, &args.out)?;
    if args.split == Some(RenderSplit::Test) {
        same_scene::check_test_photos(&args.splat, &scene)?;
    }
    let jobs = match &args.image {
        Some(name) => vec![(find(&scene, name, &args.data)?, args.out.clone())],
        None => {
            let views = chosen(scene, args.split.unwrap_or(RenderSplit::All));
            let names = scene::picture_names(&views);
            views.into_iter().zip(names).map(|(view, name)| (view, args.out.join(name))).collect()
        }
    };
    let mut backend = device::open(device::choose(args.machine)?, 0)?;
    backend.upload(splat.cloud, None)?;
    let mut bar = Bar::new("renders", jobs.len() as u64);
    for (done, (view, path)) in (1..).zip(&jobs) {
        photos::write_png(path, &backend.render(&view.camera, &splat.settings)?.to_photo())?;
        bar.set(done, String::new);
    }
    drop(bar);
    output::print(&format!("{} pictures written to {}", jobs.len(), args.out.display()))
}

/// The photo called `name`, with or without its ending.
fn find(scene: &Scene, name: &str, data: &Path) -> Result<View> {
    let matches = |view: &&View| view.name == name || scene::stem(&view.name) == name;
    match scene.train.iter().chain(&scene.test).find(matches) {
        Some(view) => Ok(view.clone()),
        None => {
            let example = &scene.train[0].name;
            bail!("{} has no photo called {name}; its photos have names like {example}", data.display())
        }
    }
}

fn chosen(scene: Scene, split: RenderSplit) -> Vec<View> {
    match split {
        RenderSplit::Test => scene.test,
        RenderSplit::Train => scene.train,
        RenderSplit::All => [scene.train, scene.test].concat(),
    }
}
