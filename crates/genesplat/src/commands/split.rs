//! `genesplat split`: a large scene as several that can be trained one by one.

use anyhow::{Result, bail};
use genesplat::io::{LoadOptions, command_line, list_scene, shown};
use genesplat::run::settings::check_hold_out;
use genesplat::terminal::output;

use crate::args::SplitArgs;
use crate::blocks::claim::check_free;
use crate::blocks::split::split;

/// Writes the blocks, and says how each is trained.
pub(crate) fn run(args: &SplitArgs) -> Result<()> {
    check_free(&args.out)?;
    let hold_out = args.hold_out.asked()?.unwrap_or_default();
    check_hold_out(&hold_out)?;
    let list = list_scene(&args.data, &LoadOptions { hold_out, with_depth: true, ..LoadOptions::default() })?;
    list.notices.iter().for_each(|notice| output::tell(&format!("notice: {notice}")));
    let wanted: usize = args.blocks.0.iter().product();
    if list.points.len() < wanted {
        bail!(
            "{} has {} points, too few to tell {wanted} blocks apart",
            shown(&args.data),
            list.points.len()
        );
    }
    split(&args.data, &list, args.blocks.0, args.margin, &args.out)?;
    let merge = command_line(["genesplat", "merge", &shown(&args.out), "--out", "merged.ply"]);
    output::print(&format!("when all are trained: {merge}"))
}
