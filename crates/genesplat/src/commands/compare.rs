//! `genesplat compare`: how alike two pictures are.

use anyhow::{Result, anyhow};
use genesplat::io::photos::read_photo;
use genesplat::train::evaluate::compare;

use crate::args::CompareArgs;
use crate::{output, run_folder};

/// Measures, and prints.
pub fn run(args: &CompareArgs) -> Result<()> {
    let (first, second) = (read_photo(&args.first)?, read_photo(&args.second)?);
    let name = args.first.file_name().unwrap_or_default().to_string_lossy();
    let score = compare(&name, &first, &second, None).map_err(|mismatch| anyhow!("{mismatch}"))?;
    output::print(&format!("PSNR {:.4} dB  SSIM {:.6}", score.psnr, score.ssim))?;
    args.json.as_ref().map_or(Ok(()), |path| run_folder::write_json(path, &score))
}
