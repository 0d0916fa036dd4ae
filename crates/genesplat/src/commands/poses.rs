//! `genesplat poses`: photos or a video in, a scene with cameras out.

use anyhow::Result;
use genesplat::io::{command_line, shown};
use genesplat::run::device;
use genesplat::terminal::program::Ending;
use genesplat::terminal::{interrupt, output};

use crate::args::PosesArgs;
use crate::poses::{self, Request};

pub(crate) fn run(args: &PosesArgs) -> Result<Ending> {
    device::use_threads(args.threads)?;
    let stop = interrupt::stop_flag();
    let PosesArgs { photos, out, frames, all_pairs, threads } = args;
    let request = Request { photos, out, frames: *frames, all_pairs: *all_pairs, threads: *threads };
    let Some(summary) = poses::find(&request, &stop)? else {
        output::print("stopped; the same command goes on from there")?;
        return Ok(Ending::Stopped);
    };
    summary.sentences().iter().try_for_each(|sentence| output::print(sentence))?;
    let train = command_line(["genesplat", "train", &shown(out), "--out", "RUN"]);
    output::print(&format!("train it: {train}"))?;
    Ok(Ending::Whole)
}
