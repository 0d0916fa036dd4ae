//! `genesplat merge`: the splats of blocks as one.

use anyhow::{Context, Result};
use genesplat::io::format::{self, Format, Options};
use genesplat::io::shown;

use crate::args::MergeArgs;
use crate::blocks::merge::merge;
use crate::terminal::numbers::thousands;
use crate::terminal::output;

/// The format that is asked for.
pub(crate) fn format_of(args: &MergeArgs) -> Result<Format> {
    let endings = Format::ALL.map(Format::ending).join(", ");
    Format::of(&args.out).with_context(|| {
        format!("{} names no format that genesplat writes; end it in one of {endings}", shown(&args.out))
    })
}

/// Reads the splat of every block, and writes what stands on its core.
pub(crate) fn run(args: &MergeArgs) -> Result<()> {
    let (cloud, settings) = merge(&args.blocks)?;
    let options = Options { screen_filter: settings.filter, ..Options::default() };
    format::write(&args.out, format_of(args)?, &cloud, &options)?;
    output::print(&format!("{} Gaussians written to {}", thousands(cloud.len()), shown(&args.out)))
}
