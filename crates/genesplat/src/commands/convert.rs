//! `genesplat convert`: a splat in another format.

use std::fs;
use std::path::Path;

use anyhow::{Result, bail, ensure};
use genesplat::core::gaussians::sigmoid;
use genesplat::core::{Gaussians, memory};
use genesplat::io::format::{self, Format, Options};
use genesplat::io::ply::leave_out_faults;
use genesplat::io::{plural, shown};
use genesplat::run::CLOUD;
use genesplat::run::numbers::thousands;
use genesplat::run::output::WriteBar;
use genesplat::run::photos::check_test_photos;
use genesplat::run::score::evaluate_all;
use genesplat::run::splat::Splat;
use genesplat::run::{device, files, splat};
use genesplat::terminal::output;

use super::next;
use crate::args::ConvertArgs;

/// Reads, cleans, cuts, writes, and says what that cost.
pub(crate) fn run(args: &ConvertArgs) -> Result<()> {
    device::use_threads(args.machine.threads)?;
    let format = files::format_of(&args.out)?;
    ensure!(
        args.spz_version.is_none() || format == Format::Spz,
        "--spz-version is for .spz, and {} is none; leave it out",
        shown(&args.out)
    );
    let mut splat = splat::open_unchecked(&args.splat)?.on(args.on.background);
    let in_file = splat.cloud.len();
    splat.cloud = clean(splat.cloud, &args.splat)?;
    let scene = args.data.as_deref().map(|data| splat.load_scene(data, &args.photos.asked()?)).transpose()?;
    if let Some(scene) = &scene {
        check_test_photos(&args.splat, scene)?;
        ensure!(
            !scene.test.is_empty(),
            "{} has no test photos to measure a loss on; leave --data out",
            scene.name
        );
    }
    say_size("read from", &args.splat, in_file)?;
    let cloud = cut(&splat.cloud, args)?;
    let options = Options {
        screen_filter: splat.settings.filter,
        sh_degree: args.sh_degree.unwrap_or(Options::default().sh_degree),
        spz_version: args.spz_version.unwrap_or_default(),
    };
    format::write_told(&args.out, format, &cloud, &options, &WriteBar::default())?;
    splat::tell_losses(format, &cloud, splat.settings.filter);
    say_size("written to", &args.out, cloud.len())?;
    drop(cloud);
    next::after_splat(&args.out);
    let Some(scene) = scene else { return Ok(()) };

    let background = splat.settings.background;
    let mut backend = device::open(args.machine.device().unwrap_or_default())?;
    let mut score = |when: &str, mut splat: Splat| {
        splat.settings.background = background;
        backend.upload(splat.cloud.into())?;
        let scores = evaluate_all(&mut backend, &scene.test, &splat.settings, None)?;
        output::print(&format!("{when:<6} {}", output::scores_line("test", &scores)))?;
        anyhow::Ok(scores.psnr)
    };
    let before = score("before", splat)?;
    let after = score("after", splat::open(&args.out)?)?;
    output::print(&format!("lost   {:.2} dB", before - after))
}

/// The Gaussians that can be shown; a notice counts the others.
fn clean(cloud: Gaussians, path: &Path) -> Result<Gaussians> {
    let in_file = thousands(cloud.len());
    ensure_memory(cloud.len())?;
    let (cloud, faults) = leave_out_faults(cloud);
    let Some(first) = faults.first() else { return Ok(cloud) };
    let count = thousands(faults.len());
    let since = plural(faults.len(), "is left out, since", "are left out, the first since");
    ensure!(
        !cloud.is_empty(),
        "no Gaussian of {} can be shown, the first since {first}; export it again",
        shown(path)
    );
    output::tell(&format!("notice: {count} of {in_file} Gaussians {since} {first}"));
    Ok(cloud)
}

/// The Gaussians that are asked for.
fn cut(cloud: &Gaussians, args: &ConvertArgs) -> Result<Gaussians> {
    let is_kept = |row: usize| {
        let opacity = sigmoid(cloud.opacity_logits[row]) * cloud.filter_dimming(row);
        args.crop.is_none_or(|crop| crop.contains(cloud.positions[row]))
            && args.prune.is_none_or(|least| opacity >= least)
    };
    ensure_memory(cloud.len())?;
    let rows: Vec<u32> = (0..cloud.len() as u32).filter(|&row| is_kept(row as usize)).collect();
    if rows.is_empty() {
        bail!("no Gaussian of {} is left by --crop and --prune; widen them", shown(&args.splat));
    }
    ensure_memory(rows.len())?;
    Ok(cloud.gather(&rows))
}

/// Fails where there is no room for so many more Gaussians, and for a list of them.
fn ensure_memory(gaussians: usize) -> Result<()> {
    Ok(memory::ensure_memory(gaussians * (Gaussians::BYTES_PER_ROW + 64), "the Gaussians that are kept")?)
}

fn say_size(what: &str, path: &Path, gaussians: usize) -> Result<()> {
    let file = if path.is_dir() { path.join(CLOUD) } else { path.to_owned() };
    let bytes = fs::metadata(&file).map_or(0, |file| file.len());
    let (count, size, each) =
        (thousands(gaussians), thousands(bytes as usize), bytes as f64 / gaussians as f64);
    output::print(&format!("{count} Gaussians {what} {}: {size} bytes, {each:.1} a Gaussian", shown(file)))
}
