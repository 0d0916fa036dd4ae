//! `genesplat clean`.

use std::path::PathBuf;

use clap::Args;
use genesplat::flags::MORE;

use super::SplatArgs;

#[derive(Debug, Args)]
pub(crate) struct CleanArgs {
    /// Folder of the scene that the splat shows [default: that of the RUN; a SPLAT needs it]
    #[arg(long, value_name = "DATASET")]
    pub(crate) data: Option<PathBuf>,
    /// The splat to write, in the format that its name ends in; FILE.png beside it shows the splat before
    /// (above) and after, from a step back
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,
    /// Write it although photos that training never saw look worse without what is removed, or the splat
    /// shows less of the photos than one colour each would, as one of another scene does
    #[arg(long, help_heading = MORE)]
    pub(crate) anyway: bool,
    #[command(flatten)]
    pub(crate) splat: SplatArgs,
}
