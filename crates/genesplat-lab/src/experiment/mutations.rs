//! Files of experiments with random changes: what is read is a whole experiment or a sentence.
//!
//! The command's own crate cannot be linked to `fuzz/`, so the changes are made here, by lines, values and
//! bytes. `GENESPLAT_MUTATIONS` is how many; without it, so many as a second takes.

use std::collections::HashSet;
use std::path::{Component, Path};

use genesplat::core::{Rng, Stream};

use super::file::ExperimentFile;
use super::plan::Experiment;
use super::preset::PRESETS;

const MUTATIONS: u32 = 2_000;
/// Values that a hand or a program might put in the place of another.
const VALUES: [&str; 20] = [
    "0",
    "1",
    "-1",
    "3",
    "0.5",
    "1e308",
    "nan",
    "-inf",
    "4294967296",
    "9223372036854775807",
    "true",
    "\"\"",
    "\"..\"",
    "\"off\"",
    "\"control\"",
    "\"a/b\"",
    "[]",
    "[\"off\", \"genetic\", \"control\"]",
    "{}",
    "{ genetic = {} }",
];
const LINES: [&str; 6] = [
    "[[arms]]\nname = \"x\"",
    "[[arms]]\nname = \"c\"\ncontrol_of = \"genetic\"",
    "search = [\"off\", \"genetic\", \"control\"]",
    "hold_out = { every = 3 }",
    "[config]\niterations = 12000",
    "control_steps = 7",
];

/// Random choices of one mutated file.
struct Draws {
    rng: Rng,
    file: u32,
    made: u32,
}

impl Draws {
    fn below(&mut self, bound: usize) -> usize {
        self.made += 1;
        self.rng.at(Stream::Test, self.file, self.made, 0).below(0, bound.max(1) as u32) as usize
    }

    fn of<'a>(&mut self, choices: &[&'a str]) -> &'a str {
        choices[self.below(choices.len())]
    }
}

fn mutated(draws: &mut Draws) -> String {
    let (_, seed) = PRESETS[draws.below(PRESETS.len())];
    let mut lines: Vec<String> = seed.lines().map(str::to_owned).collect();
    for _ in 0..=draws.below(4) {
        let at = draws.below(lines.len());
        match draws.below(6) {
            0 => drop(lines.remove(at)),
            1 => lines.insert(at, lines[draws.below(lines.len())].clone()),
            2 => lines.insert(at, draws.of(&LINES).to_owned()),
            3 | 4 => {
                let (key, _) = lines[at].split_once('=').unwrap_or(("title", ""));
                lines[at] = format!("{key}= {}", draws.of(&VALUES));
            }
            _ => {
                let mut bytes = std::mem::take(&mut lines[at]).into_bytes();
                bytes.insert(draws.below(bytes.len() + 1), draws.below(128) as u8);
                lines[at] = String::from_utf8_lossy(&bytes).into_owned();
            }
        }
        if lines.is_empty() {
            break;
        }
    }
    lines.join("\n")
}

/// What must hold of any experiment that is accepted.
fn check(experiment: &Experiment, text: &str) {
    let cells = experiment.cells();
    let folders: HashSet<_> = cells.iter().map(|&cell| experiment.folder(cell)).collect();
    assert_eq!(folders.len(), cells.len(), "a folder for each cell of\n{text}");
    for folder in &folders {
        let is_inside = folder.components().all(|part| matches!(part, Component::Normal(_)));
        assert!(is_inside, "{folder:?} leads elsewhere, by\n{text}");
    }
    for scene in 0..experiment.file.scenes.len() {
        let path = experiment.scene_path(scene, Some(Path::new("data")), Path::new("out"));
        assert!(path.file_name().is_some(), "{path:?} by\n{text}");
    }
    cells.iter().for_each(|&cell| assert!(experiment.iterations(cell) > 0, "{text}"));
    let written = toml::to_string(&experiment.file).expect("what is valid is written");
    let again = toml::from_str::<ExperimentFile>(&written).expect("and read again");
    assert_eq!(again, experiment.file, "{text}");
}

#[test]
fn a_changed_experiment_is_whole_or_a_sentence() {
    let mutations =
        std::env::var("GENESPLAT_MUTATIONS").map_or(MUTATIONS, |count| count.parse().expect("a count"));
    let (mut accepted, mut sentences) = (0, HashSet::new());
    for file in 0..mutations {
        let text = mutated(&mut Draws { rng: Rng::new(22), file, made: 0 });
        let read = toml::from_str::<ExperimentFile>(&text);
        match read
            .map_err(|error| error.to_string())
            .and_then(|file| Experiment::new(file).map_err(|e| e.to_string()))
        {
            Ok(experiment) => {
                accepted += 1;
                check(&experiment, &text);
            }
            Err(sentence) => {
                assert!(!sentence.trim().is_empty(), "an error says something of\n{text}");
                sentences.insert(sentence);
            }
        }
    }
    // Changes that all come to the same would test nothing.
    assert!(
        accepted > mutations / 20 && sentences.len() > 100,
        "{accepted} accepted, {} errors",
        sentences.len()
    );
}
