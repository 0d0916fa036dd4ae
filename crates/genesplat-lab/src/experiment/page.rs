//! `report.html` of an experiment.

use std::path::{Component, Path};

use genesplat::io::shown;
use genesplat::run::LOG;
use genesplat::run::numbers::{duration, number, thousands};
use genesplat::run::report::chart::Chart;
use genesplat::run::report::curves::{Curves, over_time};
use genesplat::run::report::html::{Html, document};
use genesplat::run::report::picture;
use genesplat::run::report::run::write_repeat;

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
    let cells = experiment.cells();
    let mut page = Html::new();
    page.element("h1", &file.title).element("p", &file.description);
    page.element("p class=\"dim\"", &format!("{} of {} runs are finished.", results.finished(), cells.len()));
    tables.figures.iter().chain(&tables.costs).for_each(|table| table.write_html(&mut page));
    write_pictures(&mut page, pages);
    page.element("h2", "Over time").element("p class=\"dim\"", "The first seed of each arm.");
    page.open("div class=\"row\"");
    charts(results, out).iter().for_each(|chart| chart.write(&mut page));
    page.close("div");
    // A row for every comparison and metric: to be looked up, not to be scrolled past.
    page.element("h2", "Tests").open("details");
    page.element("summary", "Every comparison, and whether it may be chance");
    tables.tests.iter().for_each(|table| table.write_html(&mut page));
    page.close("details");
    write_runs(&mut page, results);
    write_repeat(&mut page, command);
    page.open("details").element("summary", "Experiment").element("pre", &to_toml(file)).close("details");
    document(&file.title, page)
}

/// The figures of each run, with a link to its own page.
fn write_runs(page: &mut Html, results: &Results<'_>) {
    let experiment = results.experiment;
    page.element("h2", "Runs").open("details").element("summary", "Every run");
    page.open("figure class=\"table\"").open("table");
    page.headings(&["run", "test PSNR, dB", "train PSNR, dB", "Gaussians", "time"]);
    for cell in experiment.cells() {
        let Some(metrics) = results.get(cell) else { continue };
        let folder = experiment.folder(cell);
        page.open("tr").open("th").attribute_of("a", "href", &link(&folder.join("report.html")));
        page.text(&shown(folder.strip_prefix(CELLS).unwrap_or(&folder))).close("a").close("th");
        let psnr = [&metrics.test, &metrics.train].map(|scores| number(Some(scores.psnr), 2, ""));
        let more = [thousands(metrics.gaussians), duration(metrics.seconds.training())];
        psnr.iter().chain(&more).for_each(|cell| _ = page.element("td", cell));
        page.close("tr");
    }
    page.close("table").close("figure").close("details");
}

/// For each pair of arms, both renders of the photo that gained most under one slider.
fn write_pictures(page: &mut Html, pages: &[Page]) {
    if pages.is_empty() {
        return;
    }
    page.element("h2", "What changed");
    page.element(
        "p",
        "Under each slider is the test photo that gained most. Drag the border, or move it with the arrow keys.",
    );
    for (index, Page { path, caption, renders }) in pages.iter().enumerate() {
        let name = shown(path);
        page.open("figure class=\"sheet\"");
        if index < PICTURES_MAX {
            let pictures = renders.each_ref().map(|(name, render)| (name.as_str(), render));
            picture::write_slider(page, pictures, SLIDER_PX);
        }
        page.open("figcaption").text("Where it changed most, in ");
        page.attribute_of("a", "href", &link(path)).text(&name).close("a");
        page.text(&format!(": {caption}")).close("figcaption").close("figure");
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
