//! The page of one run.

use std::path::Path;

use anyhow::Result;
use genesplat_core::Photo;
use genesplat_io::photos::read_photo;
use genesplat_io::{Scene, command_line};
use genesplat_metrics::{Evaluation, ViewScore};
use genesplat_train::timeline::Timeline;

use super::chart::{Chart, Series};
use super::curves::{Curves, over_time};
use super::html::{Html, document};
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
        let Metrics { dataset, seed, iterations, test, .. } = self.metrics;
        let method = self.metrics.method_words();
        let iterations = thousands(*iterations as usize);
        let mut page = Html::new();
        page.element("h1", dataset).element(
            "p",
            &format!(
                "{method}, {iterations} iterations, seed {seed}; {} training photos, {} test photos",
                self.scene.train.len(),
                test.views.len()
            ),
        );
        page.figures(&figures(self.metrics));
        self.curves.notices.iter().for_each(|notice| _ = page.element("p class=\"notice\"", notice));
        self.write_views(&mut page)?;
        write_curves(&mut page, self.curves);
        timeline::write(&mut page, self.timeline);
        stages::write(&mut page, &self.metrics.evolution);
        write_scores(&mut page, self.metrics);
        write_repeat(&mut page, self.command);
        page.open("details").element("summary", "Configuration").element("pre", self.config).close("details");
        Ok(document(&format!("{dataset}: {method}, seed {seed}"), page))
    }

    /// The best and the worst test photo, each with its render under a slider.
    fn write_views(&self, page: &mut Html) -> Result<()> {
        let scores = &self.metrics.test.views;
        let by_psnr = |a: &usize, b: &usize| scores[*a].psnr.total_cmp(&scores[*b].psnr);
        let (best, worst) = ((0..scores.len()).max_by(by_psnr), (0..scores.len()).min_by(by_psnr));
        page.element("h2", "Photo and render");
        let (Some(best), Some(worst)) = (best, worst) else {
            page.element("p", "No photo was held out.");
            return Ok(());
        };
        page.element(
            "p",
            "Training never saw these photos. Drag the border, or move it with the arrow keys.",
        );
        let names = picture_names(&self.scene.test);
        page.open("div class=\"views\"");
        for (word, at) in
            [("Best", best), ("Worst", worst)].into_iter().take(if best == worst { 1 } else { 2 })
        {
            let render = read_photo(&self.folder.join(TEST).join(&names[at]))?;
            write_view(page, word, &scores[at], &*self.scene.test[at].photo.read()?, &render);
        }
        page.close("div");
        Ok(())
    }
}

/// The figures that matter; of the training photos where none was held out.
fn figures(metrics: &Metrics) -> [(&'static str, String, String); 4] {
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

fn write_view(page: &mut Html, word: &str, score: &ViewScore, photo: &Photo, render: &Photo) {
    let caption = format!("{word}: {}, {:.2} dB, SSIM {:.4}", score.name, score.psnr, score.ssim);
    page.open("figure").element("figcaption", &caption);
    picture::write_slider(page, [("photo", photo), ("render", render)], PICTURE_PX);
    page.close("figure");
}

fn write_curves(page: &mut Html, curves: Curves) {
    let series = vec![Series { name: String::new(), points: curves.loss.clone() }];
    let loss = Chart { caption: "Training loss, of one photo at a time".into(), x_name: "iteration", series };
    page.element("h2", "Over time").open("div class=\"row\"");
    over_time("", &[(String::new(), curves)]).iter().chain([&loss]).for_each(|chart| chart.write(page));
    page.close("div");
}

/// All scores, and where time went.
fn write_scores(page: &mut Html, metrics: &Metrics) {
    let cells =
        |psnr, ssim, lpips| [number(Some(psnr), 2, ""), number(Some(ssim), 4, ""), number(lpips, 4, "")];
    page.element("h2", "All figures").open("figure class=\"table\"").open("table");
    page.headings(&["", "photos", "PSNR, dB", "SSIM", "LPIPS"]);
    for (name, Evaluation { psnr, ssim, lpips, views }) in
        [("test", &metrics.test), ("train", &metrics.train)]
    {
        page.row(name, &[&[views.len().to_string()], &cells(*psnr, *ssim, *lpips)[..]].concat());
    }
    page.close("table").close("figure");
    let seconds = &metrics.seconds;
    let [load, gradient, evolution, evaluate, total] =
        [seconds.load, seconds.gradient, seconds.evolution, seconds.evaluate, seconds.total].map(duration);
    let peak = metrics.peak_memory_bytes;
    let peak = peak.map_or(String::new(), |bytes| format!(" At most {} of memory.", memory(bytes)));
    page.element(
        "p class=\"dim\"",
        &format!("Loading {load}, gradient steps {gradient}, evolution {evolution}, scoring {evaluate}; {total} in all.{peak}"),
    );
    if metrics.test.views.is_empty() {
        return;
    }
    page.open("details").element("summary", "Every test photo");
    page.open("figure class=\"table\"").open("table").headings(&["photo", "PSNR, dB", "SSIM", "LPIPS"]);
    for ViewScore { name, psnr, ssim, lpips } in &metrics.test.views {
        page.row(name, &cells(*psnr, *ssim, *lpips));
    }
    page.close("table").close("figure").close("details");
}

/// How to come by the same result.
pub fn write_repeat(page: &mut Html, command: &str) {
    page.element("h2", "Repeat").element("pre class=\"command\"", command);
    let (version, os, architecture) =
        (env!("CARGO_PKG_VERSION"), std::env::consts::OS, std::env::consts::ARCH);
    page.element("p class=\"dim\"", &format!("genesplat {version}, {os} {architecture}"));
}

/// The command of this process, as its user may give it again.
pub fn this_command(program: &str) -> String {
    command_line(std::iter::once(program.into()).chain(std::env::args_os().skip(1)))
}
