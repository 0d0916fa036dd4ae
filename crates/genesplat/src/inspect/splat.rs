//! What a finished splat is made of.

use std::fs;
use std::path::Path;

use anyhow::Result;
use genesplat::core::gaussians::sigmoid;
use genesplat::core::{Gaussians, RenderSettings, ScreenFilter, median, memory};
use genesplat::run::CLOUD;
use genesplat::run::metrics::Metrics;
use genesplat::run::numbers::memory as in_words;
use genesplat::run::numbers::{duration, thousands};
use genesplat::run::session::has_checkpoint;
use genesplat::run::splat::{self, Splat};

use super::shows::{self, Photos};
use super::{Fact, Report, offset};

/// A Gaussian is invisible below this opacity: no pixel shows it.
const INVISIBLE: f32 = 1.0 / 255.0;
/// A Gaussian is huge if it is longer than so many times the radius that half of the Gaussians are within.
const HUGE: f64 = 3.0;
/// Fractions from which there is something to look at.
const MANY_INVISIBLE: f64 = 0.3;
const MANY_HUGE: f64 = 0.01;

/// What a splat is, and how it shows `photos`, where some are given.
pub(crate) fn inspect_splat(path: &Path, photos: Option<Photos<'_>>) -> Result<Report> {
    let splat = open(path)?;
    let (mut facts, mut warnings) = look(&splat.cloud, splat.settings, path);
    facts.extend(splat.offset.map(offset));
    warnings.extend(splat::coarse_steps(splat.step, &splat.cloud));
    shows::add(&mut facts, &mut warnings, splat, path, photos)?;
    Ok(Report { kind: "splat", facts, warnings })
}

/// The figures of a run, and its splat.
pub(crate) fn inspect_run(folder: &Path, photos: Option<Photos<'_>>) -> Result<Report> {
    let splat = open(folder)?;
    let (mut facts, mut warnings) = look(&splat.cloud, splat.settings, &folder.join(CLOUD));
    facts.extend(splat.offset.map(offset));
    match Metrics::read(folder) {
        Some(metrics) => facts.extend(figures(&metrics)),
        None => warnings.push("the run has no figures yet: it was stopped, or is still training".into()),
    }
    if has_checkpoint(folder) {
        warnings.push(
            "the run was stopped before its end; the same command with --resume goes on with it".into(),
        );
    }
    shows::add(&mut facts, &mut warnings, splat, folder, photos)?;
    Ok(Report { kind: "run", facts, warnings })
}

/// The splat, and room for the lists that medians are found in.
fn open(path: &Path) -> Result<Splat> {
    let splat = splat::open(path)?;
    memory::ensure_memory(splat.cloud.len() * 4 * size_of::<f64>(), "figures of the Gaussians")?;
    Ok(splat)
}

fn figures(metrics: &Metrics) -> Vec<Fact> {
    let Metrics { iterations, test, seconds, .. } = metrics;
    let iterations = Fact::new("iterations", *iterations, thousands(*iterations as usize));
    let time = Fact::new("training time", seconds.training(), duration(seconds.training()));
    let scores = (!test.views.is_empty()).then(|| {
        [
            Fact::new("test PSNR", test.psnr, format!("{:.2} dB", test.psnr)),
            Fact::new("test SSIM", test.ssim, format!("{:.4}", test.ssim)),
        ]
    });
    [iterations, time].into_iter().chain(scores.into_iter().flatten()).collect()
}

/// What is there, and what looks wrong.
fn look(cloud: &Gaussians, settings: RenderSettings, path: &Path) -> (Vec<Fact>, Vec<String>) {
    let rows = cloud.len();
    let bytes = fs::metadata(path).map_or(0, |file| file.len());
    let (centre, radius) = reach(cloud);
    let invisible = cloud.opacity_logits.iter().filter(|logit| sigmoid(**logit) < INVISIBLE).count();
    let longest = |row: usize| f64::from(cloud.log_scales[row].into_iter().fold(f32::MIN, f32::max).exp());
    let huge = (0..rows).filter(|&row| longest(row) > HUGE * radius).count();
    let filter = match settings.filter {
        ScreenFilter::Classic => "classic: every splat is widened by 0.3 pixels",
        ScreenFilter::Antialiased => "antialiased: widened splats are dimmed",
        ScreenFilter::Mip => "mip: as Mip-Splatting has it",
    };
    let facts = vec![
        Fact::new("Gaussians", rows, thousands(rows)),
        Fact::new("file", bytes, in_words(bytes)),
        Fact::new(
            "colour",
            settings.sh_degree,
            format!("spherical harmonics up to degree {}", settings.sh_degree),
        ),
        Fact::new("screen filter", filter, filter),
        Fact::new("middle", centre.to_vec(), format!("{:.3} {:.3} {:.3}", centre[0], centre[1], centre[2])),
        Fact::new("radius", radius, format!("{radius:.3} world units around it hold half of the Gaussians")),
    ];
    let part = |count: usize| count as f64 / rows as f64;
    let invisible = (part(invisible) > MANY_INVISIBLE).then(|| {
        format!(
            "{:.0} % of the Gaussians are too faint for any pixel: `genesplat refine` makes use of them",
            100.0 * part(invisible)
        )
    });
    let huge = (part(huge) > MANY_HUGE).then(|| {
        format!(
            "{} Gaussians are longer than the scene is wide: seen from elsewhere they are fog",
            thousands(huge)
        )
    });
    (facts, [invisible, huge].into_iter().flatten().collect())
}

/// The median position, and the median distance from it.
fn reach(cloud: &Gaussians) -> ([f64; 3], f64) {
    let middle = |axis: usize| median(cloud.positions.iter().map(|p| f64::from(p[axis]))).unwrap_or(0.0);
    let centre = [0, 1, 2].map(middle);
    let distance =
        |p: &[f32; 3]| (0..3).map(|axis| (f64::from(p[axis]) - centre[axis]).powi(2)).sum::<f64>().sqrt();
    (centre, median(cloud.positions.iter().map(distance)).unwrap_or(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cloud(logit: f32, log_scale: f32) -> Gaussians {
        let positions = (0..100).map(|row| [row as f32 * 0.01, 0.0, 2.0]).collect();
        Gaussians {
            positions,
            log_scales: vec![[log_scale; 3]; 100],
            opacity_logits: vec![logit; 100],
            ..Gaussians::zeros(100)
        }
    }

    #[test]
    fn faint_and_huge_gaussians_are_noticed() {
        let warnings = |cloud: &Gaussians| look(cloud, RenderSettings::default(), Path::new("absent")).1;
        assert_eq!(warnings(&cloud(2.0, -5.0)), [] as [String; 0]);
        let faint = warnings(&cloud(-9.0, -5.0));
        assert!(
            faint.len() == 1 && faint[0].starts_with("100 % of the Gaussians are too faint"),
            "{faint:?}"
        );
        let huge = warnings(&cloud(2.0, 1.0));
        assert!(huge.len() == 1 && huge[0].starts_with("100 Gaussians are longer"), "{huge:?}");
    }

    #[test]
    fn the_middle_and_the_radius_are_medians() {
        let (centre, radius) = reach(&cloud(0.0, 0.0));
        assert!(
            (centre[0] - 0.5).abs() < 1e-6 && centre[2] == 2.0 && (radius - 0.25).abs() < 0.011,
            "{centre:?} {radius}"
        );
    }
}
