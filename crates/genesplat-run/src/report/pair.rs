//! The page that compares two runs on one scene.

use std::path::Path;

use anyhow::Result;
use genesplat_core::Photo;
use maud::html;

use super::curves::{Curves, over_time};
use super::html::{document, figures};
use super::picture;
use super::run::repeat;
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
    let [before, after] = [without, with].map(|side| side.metrics.method_words());
    let pictures = [(before.as_str(), without.render), (after.as_str(), with.render)];
    let alt = &format!("The photo with the places framed, and each place enlarged: photo, {before}, {after}");
    let logs = sides
        .iter()
        .map(|Side { name, folder, .. }| Ok(((*name).to_owned(), Curves::read(&folder.join(LOG))?)));
    let page = html! {
        h1 { (title) }
        p {
            (before) " beside " (after) ", "
            (thousands(*iterations as usize)) " iterations each, seed " (seed)
        }
        (figures(&figures_of_both(without.metrics, with.metrics)))
        h2 { "The same photo, rendered by both" }
        p { (photo) ", which training never saw. Drag the border, or move it with the arrow keys." }
        (picture::slider(pictures, PICTURE_PX))
        h2 { "Where they differ most" }
        p { "The program chose the places. Green: where error fell most; red: where it rose most." }
        figure.sheet { (picture::sheet(sheet, SHEET_PX, alt)) }
        h2 { "Over time" }
        div.row {
            @for chart in over_time("", &logs.collect::<Result<Vec<_>>>()?) { (chart) }
        }
        h2 { "Each run" }
        ul {
            @for Side { name, .. } in sides { li { a href={ (name) "/report.html" } { "The run " (name) } } }
        }
        (repeat(command))
    };
    Ok(document(title, &page))
}

fn figures_of_both(without: &Metrics, with: &Metrics) -> [(&'static str, String, String); 4] {
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

#[cfg(test)]
mod tests {
    use genesplat_train::MethodName::{self, Genesplat, ThreeDgs};

    use super::*;

    fn metrics(method: MethodName, psnr: f64) -> Metrics {
        let scores = serde_json::json!({"psnr": psnr, "ssim": 0.9, "views": []});
        let metrics = serde_json::json!({"iterations": 7000, "gaussians": 4300, "test": scores, "train": scores,
            "seconds": {"gradient": 60.0, "evolution": 0.0}});
        Metrics { method, seed: 7, ..serde_json::from_value(metrics).unwrap() }
    }

    #[test]
    fn both_runs_have_their_figures_pictures_and_links() {
        let (photo, nowhere) = (Photo { width: 20, height: 10, rgb: vec![90; 600] }, Path::new("nowhere"));
        let (published, ours) = (metrics(ThreeDgs, 25.5), metrics(Genesplat, 26.25));
        let side = |name, metrics| Side { name, metrics, folder: nowhere, render: &photo };
        let sides = [side("3dgs", &published), side("<ours>", &ours)];
        let page = to_html("<fox>", &sides, "a.png", &photo, "genesplat demo").unwrap();
        let parts = [
            "<h1>&lt;fox&gt;</h1>",
            "3dgs beside genesplat, 7,000 iterations each, seed 7",
            "<dd>26.25 dB<small>25.50 dB with 3dgs</small></dd>",
            "<a href=\"&lt;ours&gt;/report.html\">The run &lt;ours&gt;</a>",
            "a.png, which training never saw",
        ];
        parts.iter().for_each(|part| assert!(page.contains(part), "{part}"));
        assert_eq!(page.matches("<img").count(), 3, "two under the slider, and the sheet");
    }
}
