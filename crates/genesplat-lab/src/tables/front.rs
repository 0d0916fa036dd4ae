//! Tables for users: methods by the names that the command has for them.

use std::path::Path;

use anyhow::Result;

use super::{BASELINE, Figures, IMPROVED, OURS, Part, Run, SINGLE, difference, markdown, runs_in, thousands};

/// Runs whose seconds were measured apart from their figures, and runs on graphics cards.
const SECONDS: &str = "seconds";

/// README's table, two lines a scene: PSNR and Gaussians, means over the seeds that all methods but MCMC
/// have; then the time of training, where it was measured.
pub(super) fn methods(parts: &[Part], results: &Path) -> Result<String> {
    let head = ["480 px, 7,000 iterations", "3DGS", "MCMC", "Improved-GS", "ours"];
    let (single, timed) = (runs_in(SINGLE, results)?, runs_in(SECONDS, results)?);
    let mut lines = Vec::new();
    for part in parts {
        let scene = part.runs[0].text("scene");
        let [plain, improved, ours] = shared_seeds(part)?;
        let is_mcmc = |run: &&Run| run.text("study") == "mcmc" && run.text("line") == scene && run.is("MCMC");
        let mcmc: Vec<&Run> = single.iter().filter(is_mcmc).collect();
        if ours.is_empty() {
            continue;
        }
        let methods = [plain, mcmc, improved, ours];
        let best = methods.iter().filter_map(|runs| psnr(runs)).fold(f64::NEG_INFINITY, f64::max);
        let [plain, mcmc, improved, ours] = methods.map(|runs| quality(&runs, best));
        lines.push([scene.to_owned(), plain, mcmc, improved, ours]);
        let [plain, improved, ours] = [BASELINE, IMPROVED, OURS].map(|arm| minutes(part, &timed, arm));
        if !plain.is_empty() {
            lines.push(["minutes".to_owned(), plain, String::new(), improved, ours]);
        }
    }
    Ok(markdown(head, lines))
}

/// Runs of 3DGS, Improved-GS and ours, of the seeds that all three have.
fn shared_seeds(part: &Part) -> Result<[Vec<&Run>; 3]> {
    let mut shared = [Vec::new(), Vec::new(), Vec::new()];
    for (plain, improved) in part.pairs(BASELINE, IMPROVED)? {
        if let Some(ours) = part.twin(OURS, improved)? {
            for (runs, run) in shared.iter_mut().zip([plain, improved, ours]) {
                runs.push(run);
            }
        }
    }
    Ok(shared)
}

fn psnr(runs: &[&Run]) -> Option<f64> {
    Figures::of(runs, |run| run.number("psnr")).average()
}

/// Empty where there is no run.
fn quality(runs: &[&Run], best: f64) -> String {
    let mark = if psnr(runs) == Some(best) { "**" } else { "" };
    let gaussians = Figures::of(runs, |run| run.number("gaussians")).mean(thousands);
    let one = if runs.len() == 1 { " (one run)" } else { "" };
    psnr(runs).map_or_else(String::new, |psnr| format!("{mark}{psnr:.2} dB{mark}, {gaussians}{one}"))
}

/// On the CPU, and on a graphics card if that was measured; empty where neither was.
fn minutes(part: &Part, timed: &[Run], arm: &str) -> String {
    let scene = part.runs[0].text("scene");
    let apart = |device: &str| -> Vec<&Run> {
        timed
            .iter()
            .filter(|run| run.is(arm) && run.text("scene") == scene && run.text("device") == device)
            .collect()
    };
    let mut on_cpu = part.runs_of(arm);
    on_cpu.extend(apart("cpu"));
    let mean = |runs: &[&Run], digits: usize| {
        Figures::of(runs, |run| run.seconds()).average().map(|seconds| format!("{:.digits$}", seconds / 60.0))
    };
    let (cpu, card) = (mean(&on_cpu, 1), mean(&apart("gpu"), 2));
    [cpu.map(|cpu| format!("CPU {cpu}")), card.map(|card| format!("GPU {card}"))]
        .into_iter()
        .flatten()
        .collect::<Vec<_>>()
        .join(", ")
}

/// PSNR of the published search and of as many seconds of gradient steps; at last a scene that size does not
/// prune.
pub(super) fn search(parts: &[Part], results: &Path) -> Result<String> {
    let head =
        ["160 px, 3,000 iterations", "3DGS: PSNR, dB", "3DGS + GA", "gradient steps in as many seconds"];
    let runs = runs_in("fern-unpruned", results)?;
    let unpruned = Part { label: "fern, nothing pruned by size".to_owned(), runs };
    let named = parts.iter().map(|part| (part.runs[0].text("scene").to_owned(), part));
    let named = named.chain([(unpruned.label.clone(), &unpruned)]);
    let line = |(label, part): (String, &Part)| -> Result<[String; 4]> {
        let plain = Figures::of(&part.runs_of(BASELINE), |run| run.number("psnr"));
        let gain = |arm: &str| -> Result<String> {
            let gain = difference(&part.pairs(BASELINE, arm)?, "psnr");
            Ok(gain.mean(|mean| format!("{mean:+.2}{}", gain.plus_minus())))
        };
        let plain = plain.mean(|mean| format!("{mean:.2}{}", plain.plus_minus()));
        Ok([label, plain, gain("paper")?, gain("control")?])
    };
    Ok(markdown(head, named.map(line).collect::<Result<_>>()?))
}

/// PSNR of runs of 30,000 iterations, one a cell.
pub(super) fn long_runs(parts: &[Part], _: &Path) -> Result<String> {
    let head = ["480 px, 30,000 iterations: PSNR, dB", "3DGS", "plain with averages", "ours"];
    let psnr =
        |part: &Part, arm: &str| part.runs_of(arm).first().map_or("", |run| run.text("psnr")).to_owned();
    let line = |part: &Part| {
        let [plain, averaged, ours] = [BASELINE, "strong-averaged", OURS].map(|arm| psnr(part, arm));
        [part.label.clone(), plain, averaged, ours]
    };
    Ok(markdown(head, parts.iter().map(line).collect()))
}
