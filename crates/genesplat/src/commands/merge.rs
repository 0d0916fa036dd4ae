//! `genesplat merge`: the splats of blocks as one.

use anyhow::Result;
use genesplat::io::format::{self, Options};
use genesplat::io::shown;
use genesplat::run::numbers::thousands;
use genesplat::run::output::WriteBar;
use genesplat::run::{files, splat};
use genesplat::terminal::output;

use super::next;
use crate::args::MergeArgs;
use crate::blocks::merge::{Merged, merge};

/// Reads the splat of every block, and writes what stands on its core.
pub(crate) fn run(args: &MergeArgs) -> Result<()> {
    let format = files::format_of(&args.out)?;
    let Merged { cloud, settings, offset } = merge(&args.blocks)?;
    let options = Options { screen_filter: settings.filter, ..Options::default() };
    format::write_told(&args.out, format, &cloud, &options, &WriteBar::default())?;
    splat::write_offset(&args.out, offset)?;
    splat::tell_losses(format, &cloud, settings.filter);
    output::print(&format!("{} Gaussians written to {}", thousands(cloud.len()), shown(&args.out)))?;
    next::after_splat(&args.out);
    Ok(())
}
