//! `genesplat inspect`: what is there, what looks wrong, and what training will take.

use anyhow::{Result, ensure};
use genesplat::io::archive::is_zip;
use genesplat::io::{Format, is_part_of_scene, shown};
use genesplat::run::session::is_run;
use genesplat::run::settings::Dataset;
use genesplat::terminal::output;
use genesplat::train::TrainConfig;

use super::next;
use crate::args::{InspectArgs, PhotosArgs};
use crate::inspect::{inspect_run, inspect_scene, inspect_splat};

pub(crate) fn run(args: &InspectArgs) -> Result<()> {
    let what = &args.what;
    ensure!(what.exists(), "{} does not exist; give the folder of a scene or a run, or a splat", shown(what));
    // A zip that is no splat is one of a scene, which `inspect_scene` has a sentence for.
    let is_of_scene = is_part_of_scene(what) || (is_zip(what) && Format::of(what).is_none());
    let is_splat = what.is_file() && !is_of_scene;
    ensure!(
        args.photos == PhotosArgs::default() || args.data.is_some() || !(is_splat || is_run(what)),
        "{} is no scene, so no photos are looked at; leave out the options that are about photos, or give the scene that it shows as \
         --data",
        shown(what)
    );
    ensure!(
        args.data.is_none() || is_splat || is_run(what),
        "{} is a scene itself; give the splat that shows --data, or leave --data out",
        shown(what)
    );
    ensure!(
        args.method.is_none() || !(is_splat || is_run(what)),
        "{} is no scene, so nothing is to be trained; leave --method out",
        shown(what)
    );
    let asked = args.photos.asked()?;
    let photos = args.data.as_deref().map(|data| (data, &asked));
    let report = match () {
        () if is_splat => inspect_splat(what, photos)?,
        () if is_run(what) => inspect_run(what, photos)?,
        () => inspect_scene(&Dataset::of(what, &asked), &config_of(args))?,
    };
    output::print(&report.to_text())?;
    args.json.write(&report)?;
    match () {
        // Other programs know what they do next.
        () if args.json.path.is_some() => {}
        () if is_splat || is_run(what) => next::after_splat(what),
        () => next::after_scene(what),
    }
    Ok(())
}

/// What a training is taken to be.
fn config_of(args: &InspectArgs) -> TrainConfig {
    let usual = TrainConfig::of(args.method.unwrap_or_default());
    TrainConfig { iterations: args.iterations.unwrap_or(usual.iterations), ..usual }
}
