//! The tables of the documents are what the committed runs say.

use std::fs;
use std::path::Path;

#[path = "../src/tables/add.rs"]
mod add;
#[path = "../src/tables/settings.rs"]
mod settings;
#[path = "../src/tables/tables.rs"]
mod tables;

fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

/// A document with one table, brought up to date from a CSV file with this text.
fn updated(document: &str, csv: &str) -> anyhow::Result<String> {
    let folder = tempfile::tempdir()?;
    fs::write(folder.path().join("real-size.csv"), csv)?;
    tables::update(document, folder.path())
}

const DOCUMENT: &str = "before\n<!-- table: results -->\nold\n<!-- /table -->\nafter\n";
const CSV: &str =
    "scene,max_side,iterations,seed,arm,psnr,gaussians,gradient_seconds,evolution_seconds,command
fox,480,7000,0,off,30.0,1234567,100,0,genesplat train fox
fox,480,7000,1,off,31.0,1234569,110,0,genesplat train fox
fox,480,7000,0,renew,30.5,900,100,20,genesplat train fox, twice
fox,480,7000,1,renew,31.1,902,100,20,genesplat train fox
";
/// Plain settings: with averages they are better, so ours is measured against those.
const STRONG: &str = "fox,480,7000,0,strong,30.1,900,90,0,genesplat train fox
fox,480,7000,0,strong-averaged,30.25,900,90,1,genesplat train fox
fox,480,7000,1,strong-averaged,31.2,902,90,1,genesplat train fox
";

#[test]
fn documents_agree_with_the_results() {
    let mut with_tables = 0;
    for path in tables::documents(root()).unwrap() {
        let text = fs::read_to_string(&path).unwrap();
        let expected = tables::update(&text, &root().join("lab/results")).unwrap();
        assert!(
            text == expected,
            "{} disagrees with lab/results: cargo run --release -p genesplat-lab -- tables",
            path.display()
        );
        with_tables += usize::from(text.contains("<!-- table: "));
    }
    assert!(with_tables >= 2, "README.md and docs/evolution.md have tables");
}

#[test]
fn every_setting_stands_in_the_document_as_the_code_explains_it() {
    let text = fs::read_to_string(root().join("docs").join(settings::NAME)).unwrap();
    let page = settings::page(root()).unwrap();
    assert!(text == page, "docs/{}: cargo run --release -p genesplat-lab -- tables", settings::NAME);
    for name in ["**`iterations`**", "## `[method]`", "**`crossover_rates`**", "**`hold_out`**"] {
        assert!(page.contains(name), "{name}");
    }
    // A default where a setting is the method's own, and nothing where it is not.
    let line =
        |setting: &str| page.lines().find(|line| line.starts_with(&format!("| `{setting}` |"))).unwrap();
    assert!(
        line("position_rate_start").starts_with(
            "| `position_rate_start` | 1.6e-4 | 1.6e-4 | 1.6e-4 | 1.6e-4 | 1.6e-4 | 4e-5 | Rate"
        )
    );
    assert!(line("opacity_rate").starts_with("| `opacity_rate` | 0.025 | 0.05 | 0.05 |"));
    assert!(
        line("noise").starts_with("| `noise` |  |  |  |  | 500000 |  | Exploration noise"),
        "{}",
        line("noise")
    );
    assert!(line("averaging").starts_with("| `averaging` | true | false |"));
    let is_setting = |line: &&str| line.starts_with("- **`") || line.starts_with("| `");
    let (of_methods, machine) = (["name"].len(), ["device", "threads"].len());
    let settings = page.lines().filter(is_setting).count() + of_methods + machine;
    assert!((40..=55).contains(&settings), "{settings} settings");
}

#[test]
fn no_result_is_typed_into_a_table() {
    for name in ["README.md", "docs/evolution.md"] {
        let text = fs::read_to_string(root().join(name)).unwrap();
        assert_eq!(typed_lines(&text), [""; 0], "{name}: commit the runs to lab/results and mark the table");
        let planted = text.replacen("\n\n", "\n\n| fox | 32.98 |\n\n", 1);
        assert_eq!(typed_lines(&planted), ["| fox | 32.98 |"]);
    }
}

/// Lines of tables that stand between no markers though a PSNR is in them: typed, and no run can be looked
/// up.
fn typed_lines(text: &str) -> Vec<&str> {
    let mut is_generated = false;
    let mut typed = Vec::new();
    for line in text.lines() {
        is_generated = line.starts_with("<!-- table: ") || is_generated && line != "<!-- /table -->";
        if line.starts_with('|') && !is_generated && has_psnr(line) {
            typed.push(line);
        }
    }
    typed
}

/// Two digits, a point, two digits: a PSNR or what looks like one.
fn has_psnr(line: &str) -> bool {
    let numbers = line.split(|c: char| !c.is_ascii_digit() && c != '.');
    numbers
        .filter_map(|number| number.split_once('.'))
        .any(|(whole, part)| whole.len() == 2 && part.len() == 2)
}

#[test]
fn single_runs_stand_line_by_line() {
    let csv = "study,line,arm,psnr,ssim,gaussians,command
growth,fox; seed 0,off,32.40,,,genesplat train fox
growth,fox; seed 0,strong; slow,32.80,0.9500,44000,genesplat train fox
growth,fox; seed 1,strong; slow,31.10,0.9400,43000,genesplat train fox
";
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("single-runs.csv"), csv).unwrap();
    let table = tables::update(&DOCUMENT.replace("results", "growth"), folder.path()).unwrap();
    let expected = "
| PSNR, dB, SSIM, Gaussians | off | strong, slow |
|---|---|---|
| fox, seed 0 | 32.40 | **32.80**, 0.9500, 44,000 |
| fox, seed 1 |  | **31.10**, 0.9400, 43,000 |
";
    assert!(table.contains(expected), "{table}");
    fs::write(folder.path().join("single-runs.csv"), format!("{csv}growth,fox; seed 0,off,1.0,,,again\n"))
        .unwrap();
    assert!(
        tables::update(&DOCUMENT.replace("results", "growth"), folder.path()).is_err(),
        "which of the two counts?"
    );
}

#[test]
fn a_figure_changed_by_hand_is_found() {
    let text = fs::read_to_string(root().join("docs/evolution.md")).unwrap();
    let planted = text.replacen(" ± 0.", " ± 1.", 1);
    assert_ne!(planted, text);
    assert_eq!(tables::update(&planted, &root().join("lab/results")).unwrap(), text);
}

#[test]
fn figures_are_means_over_pairs() {
    let expected = "before\n<!-- table: results -->
| 480 px, 7,000 iterations | pairs | 3DGS: PSNR, dB | ours | Gaussians: 3DGS/plain/ours/Improved-GS |
|---|---|---|---|---|
| fox | 2 | 30.50 | 30.80 | 1,234,568/-/901/- |
<!-- /table -->\nafter\n";
    assert_eq!(updated(DOCUMENT, CSV).unwrap(), expected);
    assert_eq!(updated(expected, CSV).unwrap(), expected, "a second time changes nothing");
}

#[test]
fn ours_is_credited_with_what_it_adds_to_the_better_of_plain_settings() {
    let table = updated(DOCUMENT, &format!("{CSV}{STRONG}")).unwrap();
    let cells = "| 30.50 | 30.73 | 30.80 | +0.08 ± 0.25 | 1,234,568/901/901/- |";
    assert!(table.contains(cells), "{table}");
}

/// Both directions; seed 0 alone has the shorter run.
#[test]
fn runs_with_as_many_seconds_stand_beside_those_of_other_lengths() {
    let longer = "fox,480,10000,0,strong-longer,30.4,900,120,0,genesplat train fox
fox,480,10000,1,strong-longer,31.3,900,120,0,genesplat train fox
";
    let sooner = "fox,480,5000,0,renew-sooner,30.3,900,90,0,genesplat train fox\n";
    let table = updated(DOCUMENT, &format!("{CSV}{STRONG}{sooner}")).unwrap();
    assert!(table.contains("| ours - plain | in as many seconds |"), "{table}");
    assert!(table.contains("| +0.08 ± 0.25 | +0.05 (of 1) |"), "{table}");
    let table = updated(DOCUMENT, &format!("{CSV}{STRONG}{longer}{sooner}")).unwrap();
    assert!(table.contains("| -0.05 ± 0.21 | -0.10 (of 1) |"), "the longer run is the best: {table}");
    let of_another_length = updated(DOCUMENT, &format!("{CSV}{}", sooner.replace("5000", "4000"))).unwrap();
    assert!(!of_another_length.contains("as many seconds"), "{of_another_length}");
}

#[test]
fn scenes_of_different_sizes_say_so() {
    let other: String = CSV.lines().skip(1).map(|line| line.replace("fox,480", "fern,960") + "\n").collect();
    let table = updated(DOCUMENT, &format!("{CSV}{other}")).unwrap();
    assert!(table.contains("| scene | pairs |"), "{table}");
    assert!(table.contains("| fox, 480 px, 7,000 iterations | 2 |"), "{table}");
    assert!(table.contains("| fern, 960 px, 7,000 iterations | 2 |"), "{table}");
}

#[test]
fn of_each_seed_the_best_plain_run_counts() {
    let table = updated(DOCUMENT, &format!("{CSV}{}", STRONG.replace("30.1,", "30.4,"))).unwrap();
    assert!(
        table.contains("| 30.80 | 30.80 | +0.00 ± 0.14 |"),
        "`strong` of one, averages of the other: {table}"
    );
}

#[test]
fn another_method_stands_beside_it() {
    let header = CSV.lines().next().unwrap();
    let of_3dgs =
        |line: &str| if line == header { format!("variant,{line}") } else { format!("3dgs,{line}") };
    let mut csv: Vec<String> = CSV.lines().map(of_3dgs).collect();
    for (seed, psnr) in [(0, 31.0), (1, 32.0)] {
        csv.push(format!("improved-gs,fox,480,7000,{seed},improved-gs,{psnr},900,150,0,genesplat train fox"));
    }
    let table = updated(DOCUMENT, &csv.join("\n")).unwrap();
    assert!(table.contains("| ours | ours - Improved-GS | Gaussians: 3DGS"), "{table}");
    assert!(table.contains("| 30.80 | **-0.70** ± 0.28 | 1,234,568/-/901/900 |"), "{table}");
    let of_one_seed = updated(DOCUMENT, &csv[..6].join("\n")).unwrap();
    assert!(of_one_seed.contains("| 30.80 | -0.50 (of 1) |"), "{of_one_seed}");
}

#[test]
fn runs_shorter_than_people_train_have_a_table_of_their_own() {
    let csv = format!(
        "{CSV}{}",
        CSV.lines().skip(1).map(|line| line.replace("7000", "3000") + "\n").collect::<String>()
    );
    let [long, short] =
        ["results", "short"].map(|table| updated(&DOCUMENT.replace("results", table), &csv).unwrap());
    assert!(long.contains("7,000 iterations") && !long.contains("3,000 iterations"), "{long}");
    assert!(short.contains("3,000 iterations") && !short.contains("7,000 iterations"), "{short}");
}

#[test]
fn runs_of_an_experiment_become_lines() {
    let folder = tempfile::tempdir().unwrap();
    for (arm, psnr) in [("off", 30.0), ("genesplat", 30.5)] {
        let run = folder.path().join("cells/fox/3dgs").join(arm).join("seed-7");
        fs::create_dir_all(&run).unwrap();
        fs::write(
            run.join("config.toml"),
            "iterations = 7000\nsteps_scale = 1.0\n[dataset]\nmax_side = 480\n",
        )
        .unwrap();
        let metrics = serde_json::json!({
            "method": "3dgs", "genetic": false, "seed": 7, "iterations": 7000, "gaussians": 900,
            "test": {"psnr": psnr, "ssim": 0.9, "lpips": null}, "train": {"psnr": 31.0}, "seconds": {"gradient": 10.0, "evolution": 0.5},
        });
        fs::write(run.join("metrics.json"), metrics.to_string()).unwrap();
    }
    let stopped = folder.path().join("cells/fox/3dgs/strong/seed-7");
    fs::create_dir_all(&stopped).unwrap();
    fs::write(
        stopped.join("config.toml"),
        "iterations = 7001\nsteps_scale = 1.0\n[dataset]\nmax_side = 480\n",
    )
    .unwrap();
    fs::copy(stopped.join("../../off/seed-7/metrics.json"), stopped.join("metrics.json")).unwrap();
    let made = |is_idle| add::Made { experiment: "study", commit: "abc", machine: "A", is_idle };
    let header = "scene,variant,max_side,iterations,seed,arm,psnr,ssim,lpips,train_psnr,gaussians,gradient_seconds,\
                  evolution_seconds,commit,machine,command\n";
    let timed = add::add(header, folder.path(), &made(true)).unwrap();
    assert!(
        timed.contains(
            "\nfox,3dgs,480,7000,7,off,30.0000,0.90000,,31.0000,900,10.0,0.5,abc,A,experiment study"
        ),
        "{timed}"
    );
    assert_eq!(timed.lines().count(), 3);
    let again = add::add(&timed, folder.path(), &made(false)).unwrap();
    assert_eq!(again, timed.replace("10.0,0.5", ","), "lines of the same runs are replaced");
    assert!(updated(DOCUMENT, &again).unwrap().contains("| 30.00 | 30.50 |"));
    let others = add::add(&timed, folder.path(), &add::Made { commit: "def", ..made(true) }).unwrap();
    let runs: Vec<_> = others.lines().skip(1).map(|line| line.split(',').collect::<Vec<_>>()).collect();
    let order: Vec<_> = runs.iter().map(|run| [run[5], run[13]]).collect();
    // In a file of before methods, ours is what it was called then.
    assert_eq!(
        order,
        [["renew", "abc"], ["renew", "def"], ["off", "abc"], ["off", "def"]],
        "arms stay together"
    );
    let new = add::add(&header.replace("variant", "method"), folder.path(), &made(true)).unwrap();
    assert!(new.contains("\nfox,3dgs,480,7000,7,genesplat,30.5000,"), "{new}");
    let without =
        |column: &str| add::add(&header.replace(column, "wishes"), folder.path(), &made(true)).unwrap_err();
    assert!(without("machine").to_string().contains("has not all of"));
    assert!(without("variant").to_string().contains("no column `method`"));
    assert!(format!("{:#}", without("lpips")).contains("no run has a column `wishes`"));
    let nothing = tempfile::tempdir().unwrap();
    assert!(add::add(header, nothing.path(), &made(true)).is_err());
}

#[test]
fn a_table_without_runs_says_so() {
    let header = CSV.lines().next().unwrap();
    assert!(updated(DOCUMENT, header).unwrap().contains("No committed run yet"));
}

#[test]
fn what_cannot_be_shown_is_an_error() {
    let unpaired = CSV.replace("fox,480,7000,1,off", "fox,480,7000,2,off");
    let twice = CSV.replace("fox,480,7000,1,off", "fox,480,7000,0,off");
    let torn = format!("{CSV}fox,480\n");
    for (csv, problem) in [(&unpaired, "no run `off`"), (&twice, "twice"), (&torn, "2 of 10 values")] {
        let error = format!("{:#}", updated(DOCUMENT, csv).unwrap_err());
        assert!(error.contains(problem), "{error}");
    }
    for (document, problem) in [
        ("<!-- table: wishes -->\n<!-- /table -->", "wishes"),
        ("<!-- table: results -->\n", "has no <!-- /table -->"),
    ] {
        let error = format!("{:#}", updated(document, CSV).unwrap_err());
        assert!(error.contains(problem), "{error}");
    }
}

/// Improved-GS has one of the two seeds, so that seed alone counts; MCMC has one run, and fox has seconds of
/// its own.
#[test]
fn methods_stand_beside_each_other_with_the_minutes_that_were_measured() {
    let header = CSV.lines().next().unwrap();
    let of_3dgs =
        |line: &str| if line == header { format!("variant,{line}") } else { format!("3dgs,{line}") };
    let mut csv: Vec<String> = CSV.lines().map(of_3dgs).collect();
    csv.push("improved-gs,fox,480,7000,1,improved-gs,30.9,900,150,0,genesplat train fox".to_owned());
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    write("real-size.csv", &csv.join("\n"));
    write(
        "single-runs.csv",
        "study,line,arm,psnr,gaussians\nmcmc,fox,MCMC,30.20,800\nmcmc,fern,MCMC,1.0,1\n",
    );
    let seconds =
        "scene,arm,device,gradient_seconds,evolution_seconds\nfox,renew,gpu,9,3\nfern,off,cpu,600,0\n";
    write("seconds.csv", seconds);
    let table = tables::update(&DOCUMENT.replace("results", "methods"), folder.path()).unwrap();
    let expected = "
| 480 px, 7,000 iterations | 3DGS | MCMC | Improved-GS | ours |
|---|---|---|---|---|
| fox | 31.00 dB, 1,234,569 (one run) | 30.20 dB, 800 (one run) | 30.90 dB, 900 (one run) | **31.10 dB**, 902 (one run) |
| minutes | CPU 1.8 |  | CPU 2.5 | CPU 2.0, GPU 0.20 |
";
    assert!(table.contains(expected), "{table}");
}

#[test]
fn the_search_stands_beside_as_many_seconds_of_gradient_steps() {
    let runs = |scene: &str, gain: f64| -> String {
        let line =
            |arm: &str, psnr: f64| format!("{scene},160,3000,0,{arm},{psnr},900,9,0,genesplat experiment\n");
        line("off", 30.0) + &line("paper", 30.0 + gain) + &line("control", 31.0)
    };
    let folder = tempfile::tempdir().unwrap();
    let header = CSV.lines().next().unwrap();
    fs::write(folder.path().join("ablations.csv"), format!("{header}\n{}", runs("fox", 0.25))).unwrap();
    fs::write(folder.path().join("fern-unpruned.csv"), format!("{header}\n{}", runs("fern", -0.5))).unwrap();
    let table = tables::update(&DOCUMENT.replace("results", "search"), folder.path()).unwrap();
    assert!(table.contains("\n| fox | 30.00 | +0.25 | +1.00 |\n"), "{table}");
    assert!(table.contains("\n| fern, nothing pruned by size | 30.00 | -0.50 | +1.00 |\n"), "{table}");
}

#[test]
fn long_runs_have_a_column_for_each_method() {
    let csv = "study,line,arm,psnr\nlong,fox,off,32.08\nlong,fox,renew,33.47\nlong,fox,renew without virtual views,33.3\n";
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("single-runs.csv"), csv).unwrap();
    let table = tables::update(&DOCUMENT.replace("results", "long-runs"), folder.path()).unwrap();
    let expected =
        "| 480 px, 30,000 iterations: PSNR, dB | 3DGS | ours |\n|---|---|---|\n| fox | 32.08 | 33.47 |\n";
    assert!(table.contains(expected), "{table}");
}
