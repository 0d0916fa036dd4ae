//! The page of one run.

use std::path::Path;

use anyhow::Result;
use genesplat::core::{Photo, View};
use genesplat::io::Scene;
use genesplat::io::photos::read_photo;
use genesplat::metrics::{Evaluation, ViewScore};
use genesplat::train::{StageKind, StageRecord};

use super::chart::{Chart, Series};
use super::curves::{Curves, Stage, thinned};
use super::html::{Html, document};
use super::picture::{self, ERROR_LEGEND};
use crate::run::metrics::Metrics;
use crate::run::{LOG, TEST};
use crate::scene::picture_names;

/// Points of a curve: more than a screen can show.
const CURVE_POINTS: usize = 300;
/// Stages whose curves are drawn.
const STAGES_MAX: usize = 8;
/// Longer side of a picture, px.
const PICTURE_PX: u32 = 480;

/// What a page is made of.
pub struct RunPage<'a> {
    /// The figures.
    pub metrics: &'a Metrics,
    /// What was trained on.
    pub scene: &'a Scene,
    /// The run folder, with log and renders.
    pub folder: &'a Path,
    /// `config.toml`.
    pub config: &'a str,
    /// What repeats the run.
    pub command: &'a str,
}

impl RunPage<'_> {
    /// The page.
    pub fn to_html(&self) -> Result<String> {
        let Metrics { dataset, variant, evolve, seed, .. } = self.metrics;
        let title = format!("{dataset}: {variant}, evolution {}, seed {seed}", evolve.name());
        let curves = Curves::read(&self.folder.join(LOG))?;
        let mut page = Html::new();
        page.element("h1", &title);
        self.write_figures(&mut page);
        for notice in &curves.notices {
            page.element("p", &format!("Notice: {notice}"));
        }
        write_curves(&mut page, &curves);
        write_evolution(&mut page, &self.metrics.evolution, &curves.stages);
        self.write_views(&mut page)?;
        write_repeat(&mut page, self.command);
        page.element("h2", "Configuration").element("pre", self.config);
        Ok(document(&title, page))
    }

    fn write_figures(&self, page: &mut Html) {
        let metrics = self.metrics;
        page.open("figure class=\"table\"").open("table").open("tr");
        ["", "photos", "PSNR", "SSIM", "LPIPS"].iter().for_each(|name| _ = page.element("th", name));
        page.close("tr");
        write_scores(page, "test", &metrics.test);
        write_scores(page, "train", &metrics.train);
        page.close("table").close("figure");
        let seconds = &metrics.seconds;
        page.element(
            "p",
            &format!(
                "Training never saw the test photos. {} Gaussians after {} iterations; {:.1} s of gradient steps, {:.1} s of evolution, {:.1} s in all{}.",
                metrics.gaussians,
                metrics.iterations,
                seconds.gradient,
                seconds.evolution,
                seconds.total,
                metrics.peak_memory_bytes.map_or(String::new(), |bytes| format!("; {} MB at most", bytes >> 20)),
            ),
        );
    }

    /// The best and the worst test view.
    fn write_views(&self, page: &mut Html) -> Result<()> {
        let scores = &self.metrics.test.views;
        let by_psnr = |a: &usize, b: &usize| scores[*a].psnr.total_cmp(&scores[*b].psnr);
        let (best, worst) = ((0..scores.len()).max_by(by_psnr), (0..scores.len()).min_by(by_psnr));
        page.element("h2", "Test photos");
        let (Some(best), Some(worst)) = (best, worst) else {
            page.element("p", "No photo was held out.");
            return Ok(());
        };
        page.element("p class=\"dim\"", &format!("Photo, render, {ERROR_LEGEND}."));
        let names = picture_names(&self.scene.test);
        for (word, at) in
            [("Best", best), ("Worst", worst)].into_iter().take(if best == worst { 1 } else { 2 })
        {
            let render = read_photo(&self.folder.join(TEST).join(&names[at]))?;
            write_view(page, word, &scores[at], &self.scene.test[at], &render);
        }
        Ok(())
    }
}

fn write_scores(page: &mut Html, name: &str, scores: &Evaluation) {
    page.open("tr").element("th", name);
    let number = |value: Option<f64>, digits: usize| {
        value.filter(|value| value.is_finite()).map_or("-".to_owned(), |value| format!("{value:.digits$}"))
    };
    page.element("td", &scores.views.len().to_string());
    page.element("td", &number(Some(scores.psnr), 2)).element("td", &number(Some(scores.ssim), 4));
    page.element("td", &number(scores.lpips, 3)).close("tr");
}

fn write_view(page: &mut Html, word: &str, score: &ViewScore, view: &View, render: &Photo) {
    let caption = format!("{word}: {}, {:.2} dB, SSIM {:.4}", score.name, score.psnr, score.ssim);
    page.open("figure").element("figcaption", &caption).open("div class=\"views\"");
    picture::write(page, &view.photo, PICTURE_PX, "photo");
    picture::write(page, render, PICTURE_PX, "render");
    picture::write(page, &picture::error_map(&view.photo, render), PICTURE_PX, "error");
    page.close("div").close("figure");
}

fn write_curves(page: &mut Html, curves: &Curves) {
    page.element("h2", "Over time").open("div class=\"row\"");
    let curve = |caption: &str, points: &[[f64; 2]]| Chart {
        caption: caption.into(),
        x_name: "iteration".into(),
        series: vec![Series { points: thinned(points, CURVE_POINTS), ..Series::default() }],
    };
    curve("Training loss (Eq. 5), of one photo at a time", &curves.loss).write(page);
    curve("PSNR of the test photos, dB", &curves.test_psnr).write(page);
    curve("Gaussians", &curves.gaussians).write(page);
    page.close("div");
}

/// What each stage did, and how those of several generations went.
fn write_evolution(page: &mut Html, records: &[StageRecord], stages: &[Stage]) {
    if records.is_empty() {
        return;
    }
    page.element("h2", "Evolution").element(
        "p class=\"dim\"",
        "Fitness is Eq. 5 on a few training photos, and lower is better; guards are training photos that decide what is kept. \
         Where a stage changed no Gaussian, nothing was better than what there was, or it was taken back. The band in a \
         chart is one standard deviation of the population around its mean.",
    );
    page.open("figure class=\"table\"").open("table").open("tr");
    let names =
        ["iteration", "stage", "Gaussians changed", "fitness", "PSNR of guards, dB", "renders", "seconds"];
    names.iter().for_each(|name| _ = page.element("th", name));
    page.close("tr");
    records.iter().for_each(|record| write_stage(page, record));
    page.close("table").close("figure");
    page.open("div class=\"row\"");
    let drawn = || stages.iter().filter(|stage| stage.best.len() > 1);
    drawn().take(STAGES_MAX).for_each(|stage| stage_chart(stage).write(page));
    page.close("div");
    if let Some(more) = drawn().count().checked_sub(STAGES_MAX).filter(|&more| more > 0) {
        page.element("p", &format!("The generations of {more} more stages are in log.jsonl."));
    }
}

fn write_stage(page: &mut Html, record: &StageRecord) {
    let guards = record.guard_psnr.map_or("-".into(), |[before, after]| format!("{before:.2} to {after:.2}"));
    // A control renders for its steps, and changes all that they move.
    let changed = if record.kind == StageKind::ExtraSteps { "-".into() } else { record.changed.to_string() };
    page.open("tr").element("th", &record.iteration.to_string()).element("td", record.kind.name());
    page.element("td", &changed);
    page.element("td", &format!("{:.5} to {:.5}", record.fitness_before, record.fitness_after));
    page.element("td", &guards).element("td", &record.renders.to_string());
    page.element("td", &format!("{:.1}", record.seconds)).close("tr");
}

fn stage_chart(stage: &Stage) -> Chart {
    let best = Series { name: "best so far".into(), points: stage.best.clone(), spread: Vec::new() };
    let mean = Series {
        name: "mean of the population".into(),
        points: stage.mean.clone(),
        spread: stage.spread.clone(),
    };
    let last = stage.best.last().map_or(stage.base, |point| point[1]);
    Chart {
        caption: format!("Iteration {}, {}: {:.6} to {last:.6}", stage.iteration, stage.kind, stage.base),
        x_name: "generation".into(),
        series: vec![best, mean],
    }
}

/// How to come by the same result.
pub fn write_repeat(page: &mut Html, command: &str) {
    page.element("h2", "Repeat").element("pre class=\"command\"", command);
    let (version, os, architecture) =
        (env!("CARGO_PKG_VERSION"), std::env::consts::OS, std::env::consts::ARCH);
    page.element("p class=\"dim\"", &format!("genesplat {version}, {os} {architecture}"));
}

/// `words` as a line that a shell reads as these words.
pub fn command_line<'a>(words: impl IntoIterator<Item = &'a str>) -> String {
    let plain = |word: &str| {
        !word.is_empty() && word.chars().all(|c| c.is_ascii_alphanumeric() || "-_./=:,+".contains(c))
    };
    let quote =
        |word: &str| if plain(word) { word.to_owned() } else { format!("'{}'", word.replace('\'', "'\\''")) };
    words.into_iter().map(quote).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_survive_a_shell() {
        assert_eq!(
            command_line(["genesplat", "train", "my scene", "it's"]),
            "genesplat train 'my scene' 'it'\\''s'"
        );
    }
}
