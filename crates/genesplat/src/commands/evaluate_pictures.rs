//! `genesplat evaluate A.png B.png`: how alike two pictures are.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Result, anyhow};
use genesplat::core::Photo;
use genesplat::io::photos::read_photo_and_discarded;
use genesplat::io::shown;
use genesplat::metrics::lpips::{InputRange, LpipsError, Net};
use genesplat::metrics::{Lpips, ViewScore, compare};
use genesplat::run::{device, lpips};
use genesplat::terminal::output;
use serde::Serialize;

use crate::args::EvaluateArgs;

/// LPIPS with both conventions of what the network is fed.
#[derive(Clone, Copy, Serialize)]
struct Conventions {
    /// As published tables of this field have it.
    zero_to_one: f64,
    /// As the authors of LPIPS meant it.
    minus_one_to_one: f64,
}

#[derive(Serialize)]
struct Report {
    /// Its `lpips` is VGG16's with inputs from 0 to 1.
    #[serde(flatten)]
    score: ViewScore,
    /// By network; `null` where its weights are not there, or the pictures are too small for it.
    lpips_by_network: BTreeMap<&'static str, Option<Conventions>>,
}

pub(crate) fn run(pictures: [&Path; 2], args: &EvaluateArgs) -> Result<()> {
    device::use_threads(args.machine.threads)?;
    let metrics = lpips::open_all(&args.lpips.asked())?;
    let (first, second) = (read(pictures[0])?, read(pictures[1])?);
    let name = pictures[0].file_name().unwrap_or_default().to_string_lossy();
    let mut score = compare(&name, &first, &second).map_err(|mismatch| anyhow!("{mismatch}"))?;
    output::print(&format!("PSNR {:.4} dB  SSIM {:.6}", score.psnr, score.ssim))?;
    let mut lpips_by_network = BTreeMap::new();
    for net in Net::ALL {
        let metric = metrics.iter().find(|metric| metric.net() == net);
        if metric.is_none() && !args.lpips.no_lpips {
            lpips::notify_absent(net);
        }
        let distances = metric.map_or(Ok(None), |metric| measure(metric, &first, &second))?;
        if let Some(Conventions { zero_to_one, minus_one_to_one }) = distances {
            output::print(&format!(
                "LPIPS {:<8} {zero_to_one:.6} (inputs from 0 to 1, as published tables)  {minus_one_to_one:.6} (from -1 to 1, as its authors)",
                net.to_string()
            ))?;
        }
        lpips_by_network.insert(net.name(), distances);
    }
    score.lpips = lpips_by_network[Net::Vgg16.name()].map(|distances| distances.zero_to_one);
    let report = Report { score, lpips_by_network };
    args.json.write(&report)
}

/// A picture, with a notice of what of it is not compared.
fn read(path: &Path) -> Result<Photo> {
    let (photo, discarded) = read_photo_and_discarded(path)?;
    let path = shown(path);
    if discarded.depth {
        output::tell(&format!("notice: {path} has more than 8 bits a channel, and is compared at 8"));
    }
    if discarded.transparency {
        output::tell(&format!(
            "notice: {path} is transparent in places, and is compared as it looks on black"
        ));
    }
    Ok(photo)
}

/// Both conventions; `None`, with a notice, for pictures that are too small.
fn measure(metric: &Lpips, first: &Photo, second: &Photo) -> Result<Option<Conventions>> {
    let distance = |range| metric.distance(first, second, range);
    match distance(InputRange::ZeroToOne) {
        Ok(zero_to_one) => {
            let minus_one_to_one = distance(InputRange::MinusOneToOne)?;
            Ok(Some(Conventions { zero_to_one, minus_one_to_one }))
        }
        Err(error @ LpipsError::TooSmall { .. }) => {
            output::tell(&format!("notice: {error}"));
            Ok(None)
        }
        Err(error) => Err(error.into()),
    }
}
