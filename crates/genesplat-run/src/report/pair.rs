//! The page that compares two runs on one scene.

use std::path::Path;

use anyhow::Result;
use genesplat_core::Photo;

use super::curves::{Curves, over_time};
use super::html::{Html, document};
use super::picture;
use super::run::write_repeat;
use crate::LOG;
use crate::metrics::Metrics;
use crate::numbers::{duration, number, thousands};

/// Longer side of a picture under the slider, px.
const PICTURE_PX: u32 = 1000;
/// Longer side of the sheet of crops, px.
const SHEET_PX: u32 = 1600;

/// One of the two runs; its render is that of the photo that is shown.
pub struct Side<'a> {
    /// The name of its folder, beside the page.
    pub name: &'a str,
    /// Its figures.
    pub metrics: &'a Metrics,
    /// Its folder.
    pub folder: &'a Path,
    /// Its render of the photo.
    pub render: &'a Photo,
}

/// `photo` names the photo that is shown, `sheet` where the renders of it differ most, and `command` repeats
/// both runs.
pub fn to_html(
    title: &str,
    sides: &[Side<'_>; 2],
    photo: &str,
    sheet: &Photo,
    command: &str,
) -> Result<String> {
    let [without, with] = sides;
    let Metrics { seed, iterations, .. } = with.metrics;
    let iterations = thousands(*iterations as usize);
    let [before, after] = [without, with].map(|side| side.metrics.method_words());
    let mut page = Html::new();
    page.element("h1", title)
        .element("p", &format!("{before} beside {after}, {iterations} iterations each, seed {seed}"));
    page.figures(&figures(without.metrics, with.metrics));
    page.element("h2", "The same photo, rendered by both");
    let seen = format!("{photo}, which training never saw. Drag the border, or move it with the arrow keys.");
    page.element("p", &seen);
    let pictures = [(before.as_str(), without.render), (after.as_str(), with.render)];
    picture::write_slider(&mut page, pictures, PICTURE_PX);
    page.element("h2", "Where they differ most");
    page.element("p", "The program chose the places. Green: where error fell most; red: where it rose most.");
    page.open("figure class=\"sheet\"");
    let alt = &format!("The photo with the places framed, and each place enlarged: photo, {before}, {after}");
    picture::write_sheet(&mut page, sheet, SHEET_PX, alt);
    page.close("figure").element("h2", "Over time").open("div class=\"row\"");
    let logs = sides
        .iter()
        .map(|Side { name, folder, .. }| Ok(((*name).to_owned(), Curves::read(&folder.join(LOG))?)));
    over_time("", &logs.collect::<Result<Vec<_>>>()?).iter().for_each(|chart| chart.write(&mut page));
    page.close("div").element("h2", "Each run").open("ul");
    for Side { name, .. } in sides {
        page.open("li").open(&format!("a href=\"{name}/report.html\""));
        page.text(&format!("The run {name}")).close("a").close("li");
    }
    page.close("ul");
    write_repeat(&mut page, command);
    Ok(document(title, page))
}

fn figures(without: &Metrics, with: &Metrics) -> [(&'static str, String, String); 4] {
    let first = without.method_words();
    let both = |text: &dyn Fn(&Metrics) -> String| (text(with), format!("{} with {first}", text(without)));
    [
        ("PSNR of test photos", both(&|run| number(Some(run.test.psnr), 2, " dB"))),
        ("SSIM of test photos", both(&|run| number(Some(run.test.ssim), 4, ""))),
        ("Gaussians", both(&|run| thousands(run.gaussians))),
        ("Training time", both(&|run| duration(run.seconds.training()))),
    ]
    .map(|(name, (value, more))| (name, value, more))
}
