//! `report.html` of an experiment.

use std::path::{Component, Path};

use genesplat::io::shown;
use genesplat::run::LOG;
use genesplat::run::numbers::{duration, number, thousands};
use genesplat::run::report::chart::Chart;
use genesplat::run::report::curves::{Curves, over_time};
use genesplat::run::report::html::{document, table};
use genesplat::run::report::picture;
use genesplat::run::report::run::repeat;
use maud::{Markup, html};

use super::file::ExperimentFile;
use super::plan::{CELLS, Cell, Experiment};
use super::qualitative::Page;
use super::results::Results;
use super::summary::Tables;

/// Pictures in the page itself; further ones are linked.
const PICTURES_MAX: usize = 24;
const SLIDER_PX: u32 = 800;

/// Over time, an arm a curve, for every scene and method: the first seed that each arm has finished.
fn charts(results: &Results<'_>, out: &Path) -> Vec<Chart> {
    let Experiment { file, arms } = results.experiment;
    let of_arm = |scene: usize, method: usize, arm: usize| {
        let cell = Cell { scene, method, arm, seed: results.first_seed(scene, method, &[arm])? };
        // A log that is lost costs a curve, and nothing else.
        let log = out.join(results.experiment.folder(cell)).join(LOG);
        Some((arms[arm].name.clone(), Curves::read(&log).ok()?))
    };
    let of_method = |scene: usize, method: usize| {
        let curves: Vec<_> = (0..arms.len()).filter_map(|arm| of_arm(scene, method, arm)).collect();
        let name = format!("{}, {}: ", results.experiment.scene_name(scene), file.methods[method]);
        over_time(&name, &curves)
    };
    let methods = 0..file.methods.len();
    let of_scene = |scene| methods.clone().flat_map(move |method| of_method(scene, method));
    (0..file.scenes.len()).flat_map(of_scene).collect()
}

/// The page of the experiment in the folder `out`; `command` repeats it.
pub(crate) fn to_html(
    results: &Results<'_>,
    out: &Path,
    tables: &Tables,
    pages: &[Page],
    command: &str,
) -> String {
    let (experiment, file) = (results.experiment, &results.experiment.file);
    let page = html! {
        h1 { (file.title) }
        p { (file.description) }
        p.dim { (results.finished()) " of " (experiment.cells().len()) " runs are finished." }
        @for table in tables.figures.iter().chain(&tables.costs) { (table) }
        (pictures(pages))
        h2 { "Over time" }
        p.dim { "The first seed of each arm." }
        div.row { @for chart in charts(results, out) { (chart) } }
        h2 { "Tests" }
        // A row for every comparison and metric: to be looked up, not to be scrolled past.
        details {
            summary { "Every comparison, and whether it may be chance" }
            @for table in &tables.tests { (table) }
        }
        h2 { "Runs" }
        details { summary { "Every run" } (every_run(results)) }
        (repeat(command))
        details { summary { "Experiment" } pre { (to_toml(file)) } }
    };
    document(&file.title, &page)
}

/// The figures of each run, with a link to its own page.
fn every_run(results: &Results<'_>) -> Markup {
    let row = |cell: Cell| {
        let (metrics, folder) = (results.get(cell)?, results.experiment.folder(cell));
        let name = shown(folder.strip_prefix(CELLS).unwrap_or(&folder));
        let [test, train] = [&metrics.test, &metrics.train].map(|scores| number(Some(scores.psnr), 2, ""));
        let cells = [test, train, thousands(metrics.gaussians), duration(metrics.seconds.training())];
        Some((html! { a href=(link(&folder.join("report.html"))) { (name) } }, cells.into()))
    };
    let rows: Vec<_> = results.experiment.cells().into_iter().filter_map(row).collect();
    table(&["run", "test PSNR, dB", "train PSNR, dB", "Gaussians", "time"], &rows)
}

/// For each pair of arms, both renders of the photo that gained most under one slider.
fn pictures(pages: &[Page]) -> Markup {
    let slider = |page: &Page| {
        picture::slider(page.renders.each_ref().map(|(name, render)| (name.as_str(), render)), SLIDER_PX)
    };
    html! {
        @if !pages.is_empty() {
            h2 { "What changed" }
            p {
                "Under each slider is the test photo that gained most. "
                "Drag the border, or move it with the arrow keys."
            }
            @for (index, page) in pages.iter().enumerate() {
                figure.sheet {
                    @if index < PICTURES_MAX { (slider(page)) }
                    figcaption {
                        "Where it changed most, in " a href=(link(&page.path)) { (shown(&page.path)) } ": "
                        (page.caption)
                    }
                }
            }
        }
    }
}

/// A relative path as a link, whatever separates its parts here; what is not plain is percent-encoded.
fn link(path: &Path) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte);
    let encode = |byte: u8| if plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") };
    let encoded =
        |part: Component| part.as_os_str().to_string_lossy().bytes().map(encode).collect::<String>();
    path.components().map(encoded).collect::<Vec<_>>().join("/")
}

/// The experiment as a file that repeats it.
pub(crate) fn to_toml(file: &ExperimentFile) -> String {
    toml::to_string(file).expect("an experiment came from TOML")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::plan::Experiment;

    #[test]
    fn hostile_names_stay_text_and_nothing_is_loaded() {
        let text = "title = \"<script>x</script>\"\ndescription = \"a & b\"\nscenes = [\"<script>\"]\nseeds = [0]\n\
                    search = [\"off\", \"genetic\"]";
        let experiment = Experiment::new(toml::from_str(text).unwrap()).unwrap();
        let results = Results::none(&experiment);
        let command = "genesplat-lab experiment '<img src=x>'";
        let page = to_html(&results, Path::new("nowhere"), &Tables::of(&results), &[], command);
        assert!(!page.contains("<script") && page.contains("&lt;script&gt;"), "{page}");
        assert!(!page.contains("<img") && !page.contains("http:") && !page.contains("https:"), "{page}");
        assert_eq!(link(Path::new("cells/<a b>/é")), "cells/%3Ca%20b%3E/%C3%A9");
        assert_eq!(toml::from_str::<ExperimentFile>(&to_toml(&experiment.file)).unwrap(), experiment.file);
    }
}
