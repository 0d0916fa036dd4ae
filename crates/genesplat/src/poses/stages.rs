//! The stages of structure from motion, one after the other; one that is done is marked, and not done again.

use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use anyhow::Result;
use genesplat::io::photos::{lens_tags, photo_size};
use genesplat::run::files::{make_empty, write_own_text};
use genesplat::run::output;
use genesplat::run::output::Bar;
use rayon::prelude::*;

use super::engine::Engine;
use super::process::{self, Crashed};

/// Most photos of which each is matched with each other one; beyond, and for frames of a video, neighbours
/// are.
const EXHAUSTIVE_MAX: usize = 150;
/// Neighbours that a photo of a sequence is matched with; beside them, those at distances of powers of two.
const NEIGHBOURS: usize = 10;

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

/// What the stages work on.
pub(crate) struct Job {
    pub(crate) images: PathBuf,
    /// Folder of masks, black where no features are looked for.
    pub(crate) masks: Option<PathBuf>,
    pub(crate) photos: usize,
    /// One camera took all photos: they have one size, and their EXIF data one focal length.
    pub(crate) single_camera: bool,
    /// `None` where each photo is matched with each other one.
    pub(crate) neighbours: Option<usize>,
    pub(crate) threads: Option<u16>,
    pub(crate) database: PathBuf,
    pub(crate) models: PathBuf,
}

impl Job {
    pub(crate) fn new(
        images: &Path,
        work: &Path,
        names: &[String],
        is_video: bool,
        threads: Option<u16>,
    ) -> Result<Self> {
        let is_sequence = is_video || names.len() > EXHAUSTIVE_MAX;
        Ok(Self {
            images: images.to_owned(),
            masks: None,
            photos: names.len(),
            single_camera: is_one_camera(images, names)?,
            neighbours: is_sequence.then_some(NEIGHBOURS),
            threads,
            database: work.join("database.db"),
            models: work.join(MODELS),
        })
    }

    /// How many pairs of photos are matched.
    pub(crate) fn pairs(&self) -> usize {
        let Some(neighbours) = self.neighbours else { return self.photos * (self.photos - 1) / 2 };
        let powers = (0..neighbours).map(|power| 1usize << power).filter(|&distance| distance > neighbours);
        (1..=neighbours).chain(powers).map(|distance| self.photos.saturating_sub(distance)).sum()
    }

    fn total(&self, stage: Stage) -> usize {
        if stage == Stage::Matches { self.pairs() } else { self.photos }
    }
}

/// Lenses of a phone write photos of one size. Who says nothing of a lens may have used the others'.
fn is_one_camera(images: &Path, names: &[String]) -> Result<bool> {
    let photos = names.par_iter().map(|name| images.join(name));
    let said =
        photos.map(|photo| Ok((photo_size(&photo)?, lens_tags(&photo)))).collect::<Result<Vec<_>>>()?;
    let (sizes, lenses): (HashSet<_>, HashSet<_>) = said.into_iter().unzip();
    Ok(sizes.len() <= 1 && lenses.iter().flatten().count() <= 1)
}

/// Mean reprojection errors of the models that were found, px, by name; `None` where `stop` has ended a
/// stage.
pub(crate) fn run(
    engine: &Engine,
    job: &Job,
    work: &Path,
    stop: &AtomicBool,
) -> Result<Option<BTreeMap<String, f64>>> {
    let log = work.join("engine.log");
    let mut errors_px = BTreeMap::new();
    for stage in Stage::ALL {
        if work.join(stage.mark()).exists() {
            output::tell(&format!("{}: done already", stage.name()));
            continue;
        }
        begin(stage, work)?;
        let mut bar = Bar::new(stage.name(), job.total(stage) as u64);
        let mut on_line = |line: &str| {
            if let Some(done) = engine.progress(stage, line) {
                bar.set(done.min(job.total(stage)) as u64, String::new);
            }
            errors_px.extend(engine.reprojection_errors(line));
        };
        let mut ended = process::run(&mut engine.command(stage, job), &log, stop, &mut on_line);
        if ended.as_ref().is_err_and(|error| error.is::<Crashed>()) {
            output::tell(&format!("notice: the search for {} crashed, and is begun once more", stage.name()));
            begin(stage, work)?;
            ended = process::run(&mut engine.command(stage, job), &log, stop, &mut on_line);
        }
        if !ended? {
            return Ok(None);
        }
        bar.set(job.total(stage) as u64, String::new);
        // The last stage ends with the summary, which is its mark.
        if stage != Stage::Cameras {
            write_own_text(work, &stage.mark(), "")?;
        }
    }
    engine.measure(job, &log, stop, &mut errors_px)?;
    Ok(Some(errors_px))
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

    fn job(photos: usize, neighbours: Option<usize>) -> Job {
        let nowhere = PathBuf::new;
        let (images, database, models) = (nowhere(), nowhere(), nowhere());
        Job { images, masks: None, photos, single_camera: true, neighbours, threads: None, database, models }
    }

    /// A photo whose EXIF data have a focal length, as on 35 mm film.
    fn photo(file: &Path, mm: u8) {
        let exif = [
            b"Exif\0\0II*\0\x08\0\0\0".as_slice(),
            &[1, 0, 0x69, 0x87, 4, 0, 1, 0, 0, 0, 26, 0, 0, 0, 0, 0, 0, 0],
            &[1, 0, 0x05, 0xA4, 3, 0, 1, 0, 0, 0, mm, 0, 0, 0, 0, 0, 0, 0],
        ];
        let exif = exif.concat();
        let mut jpeg = encode_jpeg(&Photo { width: 8, height: 8, rgb: vec![90; 192] }, 90);
        jpeg.splice(2..2, [&[0xFF, 0xE1, 0, 2 + exif.len() as u8], &exif[..]].concat());
        fs::write(file, jpeg).unwrap();
    }

    #[test]
    fn photos_of_one_size_by_two_lenses_are_of_two_cameras() {
        let place = tempfile::tempdir().unwrap();
        let is_one = |lenses: &[u8]| {
            let named = lenses.iter().enumerate().map(|(index, mm)| (format!("{index}.jpg"), *mm));
            named.clone().for_each(|(name, mm)| photo(&place.path().join(name), mm));
            is_one_camera(place.path(), &named.map(|(name, _)| name).collect::<Vec<_>>()).unwrap()
        };
        assert!(is_one(&[26, 26, 26]) && !is_one(&[26, 26, 52]));
    }

    #[test]
    fn pairs_are_counted() {
        assert_eq!(job(50, None).pairs(), 1225);
        // Distances 1, 2, 3 and 4.
        assert_eq!(job(9, Some(3)).pairs(), 8 + 7 + 6 + 5);
        assert_eq!(job(3, Some(10)).pairs(), 2 + 1);
    }
}
