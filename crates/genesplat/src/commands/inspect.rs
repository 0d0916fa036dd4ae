//! `genesplat inspect`: what is there, what looks wrong, and what training will take.

use anyhow::{Result, ensure};
use genesplat::io::shown;

use crate::args::InspectArgs;
use crate::inspect::{inspect_run, inspect_scene, inspect_splat};
use crate::run::session::is_run;
use crate::settings::Dataset;
use crate::terminal::output;

pub(crate) fn run(args: &InspectArgs) -> Result<()> {
    let what = &args.what;
    ensure!(what.exists(), "{} does not exist; give the folder of a scene or a run, or a splat", shown(what));
    let report = match () {
        () if what.is_file() => inspect_splat(what)?,
        () if is_run(what) => inspect_run(what)?,
        () => inspect_scene(&Dataset::of(what, &args.photos)?)?,
    };
    output::print(&report.to_text())?;
    args.json.write(&report)
}
