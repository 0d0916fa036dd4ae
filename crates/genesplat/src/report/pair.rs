//! The page that compares two runs on one scene, without and with evolution.

use std::path::Path;

use anyhow::Result;
use genesplat::core::Photo;

use super::chart::{Chart, Series};
use super::curves::{Curves, thinned};
use super::html::{Html, document};
use super::picture;
use super::run::{number, write_repeat};
use crate::run::LOG;
use crate::run::metrics::Metrics;
use crate::terminal::numbers::{duration, thousands};

/// Points of a curve.
const CURVE_POINTS: usize = 300;
/// Longer side of a picture under the slider, px.
const PICTURE_PX: u32 = 1000;
/// Longer side of the sheet of crops, px.
const SHEET_PX: u32 = 1600;

/// One of the two runs.
pub(crate) struct Side<'a> {
    /// `without` or `with`, which is its folder's name, too.
    pub(crate) name: &'static str,
    /// Its figures.
    pub(crate) metrics: &'a Metrics,
    /// Its folder.
    pub(crate) folder: &'a Path,
    /// Its render of the photo that is shown.
    pub(crate) render: &'a Photo,
}

/// What a page is made of.
pub(crate) struct PairPage<'a> {
    /// Name of the scene.
    pub(crate) title: &'a str,
    /// Without and with evolution.
    pub(crate) sides: [Side<'a>; 2],
    /// Name of the photo that is shown.
    pub(crate) photo: &'a str,
    /// Where the renders of it differ most ([`crate::report::sheet::comparison`]).
    pub(crate) sheet: &'a Photo,
    /// What repeats both runs.
    pub(crate) command: &'a str,
}

impl PairPage<'_> {
    /// The page.
    pub(crate) fn to_html(&self) -> Result<String> {
        let [without, with] = &self.sides;
        let Metrics { variant, evolve, seed, iterations, .. } = with.metrics;
        let iterations = thousands(*iterations as usize);
        let mut page = Html::new();
        page.element("h1", self.title).element(
            "p",
            &format!(
                "{variant} for {iterations} iterations, without and with evolution ({}), seed {seed}",
                evolve.name()
            ),
        );
        page.figures(&figures(without.metrics, with.metrics));
        page.element("h2", "The same photo, rendered by both");
        let words = format!(
            "{}, which training never saw. Drag the border, or move it with the arrow keys.",
            self.photo
        );
        page.element("p", &words);
        let pictures = [("without evolution", without.render), ("with evolution", with.render)];
        picture::write_slider(&mut page, pictures, PICTURE_PX);
        page.element("h2", "Where they differ most");
        page.element("p", "The program chose the places: those where evolution lowered the error most.");
        page.open("figure class=\"sheet\"");
        picture::write_sheet(
            &mut page,
            self.sheet,
            SHEET_PX,
            "The photo with the places framed, and each place enlarged: photo, without, with evolution",
        );
        page.close("figure");
        page.element("h2", "Over time").open("div class=\"row\"");
        self.charts()?.iter().for_each(|chart| chart.write(&mut page));
        page.close("div");
        page.element("h2", "Each run").open("ul");
        for Side { name, .. } in &self.sides {
            page.open("li")
                .open(&format!("a href=\"{name}/report.html\""))
                .text(&format!("The run {name} evolution"));
            page.close("a").close("li");
        }
        page.close("ul");
        write_repeat(&mut page, self.command);
        Ok(document(&format!("{}: without and with evolution", self.title), page))
    }

    /// What both runs had at the same iteration.
    fn charts(&self) -> Result<[Chart; 2]> {
        let mut logs = Vec::new();
        for Side { name, folder, .. } in &self.sides {
            logs.push((format!("{name} evolution"), Curves::read(&folder.join(LOG))?));
        }
        let chart = |caption: &str, points: fn(&Curves) -> &[[f64; 2]]| {
            let series = logs.iter().map(|(name, curves)| Series {
                name: name.clone(),
                points: thinned(points(curves), CURVE_POINTS),
                ..Series::default()
            });
            Chart { caption: caption.into(), x_name: "iteration".into(), series: series.collect() }
        };
        Ok([
            chart("PSNR of the test photos, dB", |curves| &curves.test_psnr),
            chart("Gaussians", |curves| &curves.gaussians),
        ])
    }
}

/// What evolution reached, and what there was without it.
fn figures(without: &Metrics, with: &Metrics) -> [(&'static str, String, String); 4] {
    let than = |text: String| format!("{text} without evolution");
    let score = |digits: usize, unit: &str, value: fn(&Metrics) -> f64| {
        (number(Some(value(with)), digits, unit), than(number(Some(value(without)), digits, unit)))
    };
    let (psnr, ssim) = (score(2, " dB", |run| run.test.psnr), score(4, "", |run| run.test.ssim));
    let time = |run: &Metrics| duration(run.seconds.gradient + run.seconds.evolution);
    [
        ("PSNR of test photos", psnr.0, psnr.1),
        ("SSIM of test photos", ssim.0, ssim.1),
        ("Gaussians", thousands(with.gaussians), than(thousands(without.gaussians))),
        ("Training time", time(with), than(time(without))),
    ]
}
