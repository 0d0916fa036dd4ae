//! The page of one run.

use std::path::Path;

use anyhow::Result;
use genesplat_io::Scene;
use genesplat_io::photos::read_photo;
use genesplat_metrics::{Evaluation, ViewScore};
use genesplat_train::timeline::Timeline;
use maud::{Markup, html};

use super::chart::{Chart, Series};
use super::curves::{Curves, over_time};
use super::html::{document, figures, table};
use super::picture;
use super::{stages, timeline};
use crate::TEST;
use crate::metrics::Metrics;
use crate::numbers::{duration, memory, number, thousands};
use crate::scene::picture_names;

const PICTURE_PX: u32 = 800;

/// What a page is made of: the figures, the run over time, what was trained on, the run's folder and
/// `config.toml`, and what repeats it.
pub(crate) struct RunPage<'a> {
    pub(crate) metrics: &'a Metrics,
    pub(crate) curves: Curves,
    pub(crate) scene: &'a Scene,
    pub(crate) folder: &'a Path,
    pub(crate) config: &'a str,
    pub(crate) command: &'a str,
    pub(crate) timeline: &'a Timeline,
}

impl RunPage<'_> {
    pub(crate) fn into_html(self) -> Result<String> {
        let Metrics { dataset, seed, iterations, test, evolution, .. } = self.metrics;
        let method = self.metrics.method_words();
        let page = html! {
            h1 { (dataset) }
            p {
                (method) ", " (thousands(*iterations as usize)) " iterations, seed " (seed) "; "
                (self.scene.train.len()) " training photos, " (test.views.len()) " test photos"
            }
            (figures(&figures_of(self.metrics)))
            @for notice in &self.curves.notices { p.notice { (notice) } }
            h2 { "Photo and render" }
            (self.best_and_worst()?)
            h2 { "Over time" }
            (over_iterations(self.curves))
            (timeline::section(self.timeline))
            (stages::section(evolution))
            (all_figures(self.metrics))
            (repeat(self.command))
            details { summary { "Configuration" } pre { (self.config) } }
        };
        Ok(document(&format!("{dataset}: {method}, seed {seed}"), &page))
    }

    /// The best and the worst test photo, each with its render under a slider.
    fn best_and_worst(&self) -> Result<Markup> {
        let scores = &self.metrics.test.views;
        let by_psnr = |a: &usize, b: &usize| scores[*a].psnr.total_cmp(&scores[*b].psnr);
        let (best, worst) = ((0..scores.len()).max_by(by_psnr), (0..scores.len()).min_by(by_psnr));
        let (Some(best), Some(worst)) = (best, worst) else {
            return Ok(html! { p { "No photo was held out." } });
        };
        let shown = [("Best", best), ("Worst", worst)];
        Ok(html! {
            p { "Training never saw these photos. Drag the border, or move it with the arrow keys." }
            div.views {
                @for (word, at) in &shown[..if best == worst { 1 } else { 2 }] { (self.view(word, *at)?) }
            }
        })
    }

    fn view(&self, word: &str, at: usize) -> Result<Markup> {
        let ViewScore { name, psnr, ssim, .. } = &self.metrics.test.views[at];
        let photo = self.scene.test[at].photo.read()?;
        let render = read_photo(&self.folder.join(TEST).join(&picture_names(&self.scene.test)[at]))?;
        Ok(html! {
            figure {
                figcaption {
                    (word) ": " (name) ", " (number(Some(*psnr), 2, " dB"))
                    ", SSIM " (number(Some(*ssim), 4, ""))
                }
                (picture::slider([("photo", &photo), ("render", &render)], PICTURE_PX))
            }
        })
    }
}

/// The figures that matter; of the training photos where none was held out.
fn figures_of(metrics: &Metrics) -> [(&'static str, String, String); 4] {
    let Metrics { test, train, seconds, gaussians, .. } = metrics;
    let is_tested = !test.views.is_empty();
    let (scores, of) = if is_tested { (test, "of test photos") } else { (train, "of training photos") };
    let evolution = match seconds.evolution {
        0.0 => String::new(),
        evolution => format!("{} of it evolution", duration(evolution)),
    };
    [
        ("PSNR", number(Some(scores.psnr), 2, " dB"), of.to_owned()),
        ("SSIM", number(Some(scores.ssim), 4, ""), of.to_owned()),
        ("Gaussians", thousands(*gaussians), String::new()),
        ("Training time", duration(seconds.training()), evolution),
    ]
}

fn over_iterations(curves: Curves) -> Markup {
    let series = vec![Series { name: String::new(), points: curves.loss.clone() }];
    let loss = Chart { caption: "Training loss, of one photo at a time".into(), x_name: "iteration", series };
    let [psnr, gaussians] = over_time("", &[(String::new(), curves)]);
    html! { div.row { (psnr) (gaussians) (loss) } }
}

/// All scores, and where time went.
fn all_figures(metrics: &Metrics) -> Markup {
    let seconds = &metrics.seconds;
    let rows = [row("test", &metrics.test), row("train", &metrics.train)];
    html! {
        h2 { "All figures" }
        (table(&["", "photos", "PSNR, dB", "SSIM", "LPIPS"], &rows))
        p.dim {
            "Loading " (duration(seconds.load)) ", gradient steps " (duration(seconds.gradient))
            ", evolution " (duration(seconds.evolution)) ", scoring " (duration(seconds.evaluate)) "; "
            (duration(seconds.total)) " in all."
            @if let Some(bytes) = metrics.peak_memory_bytes { " At most " (memory(bytes)) " of memory." }
        }
        @if let Some(off) = metrics.test_depth_error {
            p.dim { "Depths of test photos are off by " (number(Some(100.0 * off), 1, " %")) "." }
        }
        @if !metrics.test.views.is_empty() {
            details { summary { "Every test photo" } (every_photo(&metrics.test.views)) }
        }
    }
}

/// A row for some photos: how many, and their scores.
fn row(name: &str, Evaluation { psnr, ssim, lpips, views }: &Evaluation) -> (Markup, Vec<String>) {
    (html! { (name) }, [&[views.len().to_string()], &scores(*psnr, *ssim, *lpips)[..]].concat())
}

fn every_photo(views: &[ViewScore]) -> Markup {
    let row = |ViewScore { name, psnr, ssim, lpips }: &ViewScore| {
        (html! { (name) }, scores(*psnr, *ssim, *lpips).into())
    };
    table(&["photo", "PSNR, dB", "SSIM", "LPIPS"], &views.iter().map(row).collect::<Vec<_>>())
}

fn scores(psnr: f64, ssim: f64, lpips: Option<f64>) -> [String; 3] {
    [number(Some(psnr), 2, ""), number(Some(ssim), 4, ""), number(lpips, 4, "")]
}

/// How to come by the same result.
pub fn repeat(command: &str) -> Markup {
    let (version, os, architecture) =
        (env!("CARGO_PKG_VERSION"), std::env::consts::OS, std::env::consts::ARCH);
    html! {
        h2 { "Repeat" }
        pre.command { (command) }
        p.dim { "genesplat " (version) ", " (os) " " (architecture) }
    }
}
