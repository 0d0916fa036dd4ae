//! The stages of structure from motion, one after the other; one that is done is marked, and not done again.

use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use anyhow::Result;
use genesplat::io::photos::{lens_tags, photo_size};
use genesplat::io::{input, plural};
use genesplat::run::files::{make_empty, remove_if_there, write_own_text};
use genesplat::run::numbers::thousands;
use genesplat::run::output;
use genesplat::run::output::Bar;
use rayon::prelude::*;
use serde::Serialize;

use super::engine::{Engine, Said};
use super::process::{self, Crashed};
use super::round;
use super::summary::{Compared, SUMMARY, pairs_of};

/// Most photos of which each is matched with each other one.
const EXHAUSTIVE_MAX: usize = 150;

/// Below the folder of the stages.
const MODELS: &str = "models";

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stage {
    Features,
    Matches,
    Cameras,
}

impl Stage {
    const ALL: [Self; 3] = [Self::Features, Self::Matches, Self::Cameras];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Features => "features",
            Self::Matches => "matches",
            Self::Cameras => "cameras",
        }
    }

    /// An empty file of this name says that the stage is done.
    fn mark(self) -> String {
        format!("{}.done", self.name())
    }
}

/// Which photos are compared with which.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Pairing {
    /// Each with each.
    All,
    /// Frames of a film: neighbours, and those that look alike.
    Sequence,
    /// Those that look alike or were taken near each other; names may say nothing.
    Looks,
}

impl Pairing {
    /// Of photos with these names, or of frames.
    pub(crate) fn of(names: &[String], is_video: bool, all_pairs: bool) -> Self {
        match names.len() > EXHAUSTIVE_MAX {
            _ if all_pairs => Self::All,
            _ if is_video => Self::Sequence,
            true => Self::Looks,
            false => Self::All,
        }
    }
}

/// What the stages have found beside models.
#[derive(Debug, Default)]
pub(crate) struct Outcome {
    /// Mean reprojection errors of the models, px, by name.
    pub(crate) errors_px: BTreeMap<String, f64>,
    pub(crate) compared: Option<Compared>,
}

/// What the stages work on.
pub(crate) struct Job {
    pub(crate) images: PathBuf,
    /// Folder of masks, black where no features are looked for.
    pub(crate) masks: Option<PathBuf>,
    pub(crate) photos: usize,
    /// One camera took all photos: upright or on their side they have one size, and their EXIF data one focal
    /// length.
    pub(crate) single_camera: bool,
    /// Names of the photos of each size, where one camera took two.
    pub(crate) sizes: Vec<Vec<String>>,
    /// The photos show all around.
    pub(crate) is_round: bool,
    pub(crate) pairing: Pairing,
    pub(crate) threads: Option<u16>,
    pub(crate) database: PathBuf,
    pub(crate) models: PathBuf,
}

impl Job {
    pub(crate) fn new(
        images: &Path,
        work: &Path,
        names: &[String],
        pairing: Pairing,
        threads: Option<u16>,
    ) -> Result<Self> {
        let Lenses { single_camera, sizes } = lenses(images, names)?;
        Ok(Self {
            images: images.to_owned(),
            masks: None,
            photos: names.len(),
            single_camera,
            sizes,
            is_round: round::show_all_around(images, names)?,
            pairing,
            threads,
            database: work.join("database.db"),
            models: work.join(MODELS),
        })
    }

    /// Pieces of a stage, where an engine does not tell.
    fn total(&self, stage: Stage) -> usize {
        if stage == Stage::Matches { pairs_of(self.photos) } else { self.photos }
    }
}

/// How COLMAP is to share cameras among photos.
struct Lenses {
    single_camera: bool,
    sizes: Vec<Vec<String>>,
}

/// Lenses of a phone write photos of one size, upright or on their side. Who says nothing of a lens may have
/// used the others'.
fn lenses(images: &Path, names: &[String]) -> Result<Lenses> {
    let photos = names.par_iter().map(|name| images.join(name));
    let said =
        photos.map(|photo| Ok((photo_size(&photo)?, lens_tags(&photo)))).collect::<Result<Vec<_>>>()?;
    let lenses: HashSet<_> = said.iter().filter_map(|(_, lens)| lens.as_ref()).collect();
    let mut sizes = BTreeMap::<_, Vec<String>>::new();
    said.iter().zip(names).for_each(|((size, _), name)| sizes.entry(*size).or_default().push(name.clone()));
    let of_camera: HashSet<_> =
        sizes.keys().map(|&(width, height)| (width.max(height), width.min(height))).collect();
    let single_camera = of_camera.len() <= 1 && lenses.len() <= 1;
    let is_turned = single_camera && sizes.len() > 1;
    Ok(Lenses { single_camera, sizes: if is_turned { sizes.into_values().collect() } else { Vec::new() } })
}

/// What was found beside the models; `None` where `stop` has ended a stage.
pub(crate) fn run(engine: &Engine, job: &Job, work: &Path, stop: &AtomicBool) -> Result<Option<Outcome>> {
    let log = work.join("engine.log");
    let mut outcome = Outcome::default();
    for stage in Stage::ALL {
        if work.join(stage.mark()).exists() {
            output::tell(&format!("{}: done already", stage.name()));
            continue;
        }
        let mut listener =
            Listener { engine, stage, bar: None, outcome: &mut outcome, chosen_by: Vec::new() };
        let ended = listener.run(job, work, &log, stop);
        if !ended.map_err(|error| engine.explained(error, job))? {
            return Ok(None);
        }
        // The last stage ends with the summary, which is its mark.
        if stage != Stage::Cameras {
            write_own_text(work, &stage.mark(), &listener.chosen_by.join(" "))?;
        }
    }
    engine.measure(job, &log, stop, &mut outcome.errors_px)?;
    outcome.compared = outcome.compared.or_else(|| engine.compared(job));
    if let Some(compared) = &mut outcome.compared {
        compared.chosen_by = chosen_by(work);
    }
    Ok(Some(outcome))
}

/// Takes the mark from a search whose pairs were chosen, and from what came after it: all are to be compared.
/// Those that were are not compared again.
pub(crate) fn reopen(work: &Path) -> Result<()> {
    if chosen_by(work).is_empty() {
        return Ok(());
    }
    remove_if_there(work, Stage::Matches.mark())?;
    remove_if_there(work, SUMMARY)
}

/// What chose the pairs that were matched: their mark tells, also of an earlier start.
fn chosen_by(work: &Path) -> Vec<String> {
    let mark = input::read_text(&work.join(Stage::Matches.mark())).unwrap_or_default();
    mark.split_whitespace().map(str::to_owned).collect()
}

/// Listens to the engine during a stage.
struct Listener<'a> {
    engine: &'a Engine,
    stage: Stage,
    /// With its name and total.
    bar: Option<(String, usize, Bar)>,
    outcome: &'a mut Outcome,
    chosen_by: Vec<String>,
}

impl Listener<'_> {
    /// False where `stop` has ended the stage.
    fn run(&mut self, job: &Job, work: &Path, log: &Path, stop: &AtomicBool) -> Result<bool> {
        let mut ended = self.start(job, work, log, stop);
        if ended.as_ref().is_err_and(|error| error.is::<Crashed>()) {
            let name = self.stage.name();
            output::tell(&format!("notice: the search for {name} crashed, and is begun once more"));
            ended = self.start(job, work, log, stop);
        }
        if ended? {
            self.bar.iter_mut().for_each(|(_, total, bar)| bar.set(*total as u64, String::new));
            return Ok(true);
        }
        Ok(false)
    }

    fn start(&mut self, job: &Job, work: &Path, log: &Path, stop: &AtomicBool) -> Result<bool> {
        begin(self.stage, work)?;
        let (name, total) = (self.stage.name(), job.total(self.stage));
        self.show(name, 0, total);
        let (engine, stage) = (self.engine, self.stage);
        process::run(&mut engine.command(stage, job), log, stop, |line| {
            let said = engine.hear(stage, line);
            if let Some(done) = said.done {
                self.show(said.what.as_deref().unwrap_or(name), done, said.total.unwrap_or(total));
            }
            self.note(said);
        })
    }

    /// A bar for each piece of work: an engine may match more photos while it looks for cameras.
    fn show(&mut self, what: &str, done: usize, total: usize) {
        if self.bar.as_ref().is_none_or(|(name, of, _)| name != what || *of != total) {
            // One at a time has the terminal.
            self.bar = None;
            self.bar = Some((what.to_owned(), total, Bar::new(what, total as u64)));
        }
        self.bar.iter_mut().for_each(|(_, total, bar)| bar.set(done.min(*total) as u64, String::new));
    }

    fn note(&mut self, said: Said) {
        if let Some(photos) = said.retried {
            output::tell(&format!(
                "{photos} {} no camera so far and {} compared with more of the others ({} pairs)",
                plural(photos, "photo has", "photos have"),
                plural(photos, "is", "are"),
                thousands(said.pairs)
            ));
        }
        if let Some(photos) = said.doubted {
            output::tell(&format!(
                "most of what {photos} photos share with the others contradicts where they were found, as where sides look alike; \
                 cameras are looked for once more, without what misleads"
            ));
        }
        if let Some(photos) = said.unsure {
            output::tell(&format!(
                "notice: {photos} photos may be in a wrong place: most of what they share with the others contradicts it; take more \
                 photos where things that look alike are seen together, or leave some out"
            ));
        }
        self.chosen_by = said.chosen_by.unwrap_or_else(|| std::mem::take(&mut self.chosen_by));
        self.outcome.errors_px.extend(said.errors_px);
        self.outcome.compared = said.compared.or_else(|| self.outcome.compared.take());
    }
}

/// Models that an earlier search has left half done are no start for another.
fn begin(stage: Stage, work: &Path) -> Result<()> {
    if stage == Stage::Cameras { make_empty(work, MODELS).map(drop) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use genesplat::core::Photo;
    use genesplat::io::photos::encode_jpeg;

    use super::*;

    /// A photo whose EXIF data have a focal length, as on 35 mm film.
    fn photo(file: &Path, (width, height): (u32, u32), mm: u8) {
        let exif = [
            b"Exif\0\0II*\0\x08\0\0\0".as_slice(),
            &[1, 0, 0x69, 0x87, 4, 0, 1, 0, 0, 0, 26, 0, 0, 0, 0, 0, 0, 0],
            &[1, 0, 0x05, 0xA4, 3, 0, 1, 0, 0, 0, mm, 0, 0, 0, 0, 0, 0, 0],
        ];
        let exif = exif.concat();
        let rgb = vec![90; (3 * width * height) as usize];
        let mut jpeg = encode_jpeg(&Photo { width, height, rgb }, 90);
        jpeg.splice(2..2, [&[0xFF, 0xE1, 0, 2 + exif.len() as u8], &exif[..]].concat());
        fs::write(file, jpeg).unwrap();
    }

    fn lenses_of(photos: &[((u32, u32), u8)]) -> Lenses {
        let place = tempfile::tempdir().unwrap();
        let names: Vec<String> = (0..photos.len()).map(|index| format!("{index}.jpg")).collect();
        names.iter().zip(photos).for_each(|(name, (size, mm))| photo(&place.path().join(name), *size, *mm));
        lenses(place.path(), &names).unwrap()
    }

    #[test]
    fn a_search_that_compared_fewer_pairs_is_opened_again() {
        let place = tempfile::tempdir().unwrap();
        let [marks, summary] = ["matches.done", SUMMARY].map(|name| place.path().join(name));
        for (chosen_by, stays) in [("", true), ("looks order", false)] {
            fs::write(&marks, chosen_by).unwrap();
            fs::write(&summary, "{}").unwrap();
            reopen(place.path()).unwrap();
            assert_eq!((marks.exists(), summary.exists()), (stays, stays), "{chosen_by}");
        }
        reopen(place.path()).unwrap();
    }

    #[test]
    fn all_pairs_are_compared_of_few_photos_or_where_that_is_asked_for() {
        let names = |count: usize| vec![String::new(); count];
        assert_eq!(Pairing::of(&names(150), false, false), Pairing::All);
        assert_eq!(Pairing::of(&names(151), false, false), Pairing::Looks);
        assert_eq!(Pairing::of(&names(151), false, true), Pairing::All);
        assert_eq!(Pairing::of(&names(20), true, false), Pairing::Sequence);
        assert_eq!(Pairing::of(&names(20), true, true), Pairing::All);
    }

    #[test]
    fn photos_of_one_size_by_two_lenses_are_of_two_cameras() {
        assert!(lenses_of(&[26, 26, 26].map(|mm| ((8, 8), mm))).single_camera);
        assert!(!lenses_of(&[26, 26, 52].map(|mm| ((8, 8), mm))).single_camera);
        assert!(!lenses_of(&[((8, 16), 26), ((8, 24), 26)]).single_camera);
    }

    #[test]
    fn photos_upright_and_on_their_side_are_of_one_camera() {
        let both = lenses_of(&[((8, 16), 26), ((16, 8), 26), ((8, 16), 26)]);
        assert!(both.single_camera);
        assert_eq!(both.sizes, [vec!["0.jpg".to_owned(), "2.jpg".into()], vec!["1.jpg".into()]]);
        let one = lenses_of(&[((8, 16), 26), ((8, 16), 26)]);
        assert!(one.single_camera && one.sizes.is_empty());
    }
}
