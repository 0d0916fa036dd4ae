//! Cameras of photos without any: structure from motion by COLMAP, which runs as a process of its own.
//!
//! In `OUT`, `images/` and `sparse/0/` are an ordinary COLMAP scene. What the stages leave is in
//! `OUT/poses/`: a stage that is marked as done there is not done again, so a search that was stopped goes on
//! where it was.

mod database;
mod engine;
mod heic;
mod masks;
mod photos;
mod process;
mod round;
mod stages;
mod summary;
mod video;

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use anyhow::{Result, ensure};
use genesplat::io::{own, plural, shown};
use genesplat::run::files::{check_name, make_empty, make_own_folder, remove_leftovers_below, unwritable};
use genesplat::run::lock::Lock;
use genesplat::run::{output, preparing};

use crate::programs::Programs;
use engine::Engine;
use photos::Source;
use stages::{Job, Pairing};
pub use summary::{Compared, Summary};

/// Below `OUT`.
const WORK: &str = "poses";
const IMAGES: &str = "images";
const MODEL: &str = "sparse/0";
/// One of those in it.
const MODEL_FILE: &str = "sparse/0/images.bin";

/// Photos of a video, where nothing else is asked for.
pub(crate) const FRAMES: u32 = 120;
/// With fewer photos there is no depth to find.
const PHOTOS_MIN: usize = 3;

/// What is asked for.
pub struct Request<'a> {
    /// A folder of photos, or a video.
    pub photos: &'a Path,
    /// Folder for the scene.
    pub out: &'a Path,
    /// How many photos are taken from a video; `None` for 120.
    pub frames: Option<u32>,
    /// Each photo is compared with each other, however many there are.
    pub all_pairs: bool,
    /// Processor threads; `None` for all cores.
    pub threads: Option<u16>,
}

/// The cameras of the photos, found now or earlier; `None` where `stop` has ended the search, which can go
/// on.
///
/// # Errors
/// A sentence where the folder belongs to something else, nobody can find cameras here, or none are found.
pub fn find(request: &Request, stop: &AtomicBool) -> Result<Option<Summary>> {
    let Some(preparing) = preparing::begin_unless(stop) else { return Ok(None) };
    let source = Source::open(request.photos, request.frames)?;
    let work = claim(request.out, &source)?;
    own::check_entries(&work).map_err(|error| unwritable(&work, &error))?;
    let _lock = Lock::take(&work)?;
    [&work, &request.out.join(IMAGES), &request.out.join(masks::FOLDER)]
        .into_iter()
        .for_each(|f| remove_leftovers_below(f));
    // Whatever is there already is the user's, and stays.
    let is_new = !photos::is_begun(&work)
        && [IMAGES, masks::FOLDER].iter().all(|name| !request.out.join(name).exists());
    source.check_same(&work)?;
    if request.all_pairs {
        stages::reopen(&work)?;
    }
    if let Some(summary) = Summary::read(&work)? {
        return Ok(Some(summary));
    }
    drop(preparing);
    let prepared = Engine::find(Programs::beside(request.photos))
        .and_then(|engine| prepare(request, source, &work, engine, stop));
    if prepared.is_err() && is_new {
        photos::forget(request.out, &work);
    }
    let Some((engine, names, job)) = prepared? else { return Ok(None) };
    engine.notice(&job).iter().for_each(|notice| output::tell(notice));
    let Some(outcome) = stages::run(&engine, &job, &work, stop)? else { return Ok(None) };
    let summary = Summary::of_largest(&job.models, &names, &outcome)?;
    install(&job.models.join(&summary.model), request.out)?;
    summary.write(&work)?;
    Ok(Some(summary))
}

/// Puts the photos into the scene; `None` where `stop` has ended that.
fn prepare(
    request: &Request,
    source: Source,
    work: &Path,
    engine: Engine,
    stop: &AtomicBool,
) -> Result<Option<(Engine, Vec<String>, Job)>> {
    let images = request.out.join(IMAGES);
    let Some(preparing) = preparing::begin_unless(stop) else { return Ok(None) };
    let source = source.without_damaged()?;
    drop(preparing);
    source.make_folders_of_heic(request.out)?;
    if !heic::convert(&source.heic(&images), &engine, work, stop)? || !source.fill(&images, work, stop)? {
        return Ok(None);
    }
    let Some(_preparing) = preparing::begin_unless(stop) else { return Ok(None) };
    let names = photos::names_in(&images)?;
    ensure!(
        names.len() >= PHOTOS_MIN,
        "{} has {} {}, and cameras can be found for {PHOTOS_MIN} or more (30 to 200 are usual); take more of them",
        shown(request.photos),
        names.len(),
        plural(names.len(), "photo", "photos")
    );
    output::tell(&format!("{} photos; {} finds their cameras", names.len(), engine.name()));
    let masks = masks::usable(request.out, &images, &names)?;
    let pairing = Pairing::of(&names, source.is_video(), request.all_pairs);
    let job = Job { masks, ..Job::new(&images, work, &names, pairing, request.threads)? };
    if job.is_round {
        engine.check_round()?;
        output::tell(
            "the photos show all around: each is one camera, which training cuts into pinhole views",
        );
    }
    Ok(Some((engine, names, job)))
}

/// Folder of the stages below `out`, made if it is missing. Fails where `out` holds something else.
fn claim(out: &Path, source: &Source) -> Result<PathBuf> {
    let (work, shown) = (out.join(WORK), shown(out));
    ensure!(!source.is_in(out), "{shown} is the folder of the photos; choose another --out for the scene");
    let images = out.join(IMAGES);
    let is_foreign = out.join("sparse").exists() || (images.exists() && !source.is_in(&images));
    ensure!(
        photos::is_begun(&work) || !is_foreign,
        "{shown} holds a scene already, and would be written over; choose another --out"
    );
    ensure!(!out.is_file(), "{shown} is a file, and a scene is a folder; choose another --out");
    check_name(out, MODEL_FILE)?;
    make_own_folder(out, WORK)
}

/// Moves the model into the scene.
fn install(model: &Path, out: &Path) -> Result<()> {
    let place = make_empty(out, MODEL)?;
    let moved = fs::remove_dir(&place).and_then(|()| fs::rename(model, &place));
    moved.map_err(|error| unwritable(&place, &error))
}
