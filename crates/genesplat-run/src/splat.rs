//! Finished splats, from a file or from the folder of a run.

mod foreign;

use std::fmt::Display;
use std::io::Write;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail, ensure};
use genesplat_core::{Camera, Gaussians, RenderSettings, ScreenFilter, median};
use genesplat_io::format::{self, Format, Loaded};
use genesplat_io::{
    FormatError, LoadOptions, MaskUse, Offset, PhotoDigests, Scene, SceneDigests, SceneError, command_line,
    list_scene, offset, shown,
};
use genesplat_train::Background;

use crate::cameras::Cameras;
use crate::exposure::Exposure;
use crate::files::{remove_if_there, write_file};
use crate::inputs::{Inputs, notice_changes};
use crate::output;
use crate::preparing;
use crate::scene;
use crate::session::has_checkpoint;
use crate::settings::{ConfigFile, Dataset, PhotosAsked};
use crate::{CLOUD, CONFIG};

/// A cloud and how it is meant to be shown.
pub struct Splat {
    /// The Gaussians; all values are finite, unless it was opened unchecked.
    pub cloud: Gaussians,
    /// How it is rendered.
    pub settings: RenderSettings,
    /// What has been subtracted from the coordinates of what it shows, if anything.
    pub offset: Option<Offset>,
    /// Median step of a coordinate in its file, world units.
    pub step: f64,
    /// What its file is; `None` for the folder of a run.
    pub format: Option<Format>,
    /// The scene that it was trained on, and how; `None` for a bare file, which does not say.
    trained_on: Option<Dataset>,
    /// The folder of its run, and what the run began with, as far as that is known.
    began_with: Option<(PathBuf, Inputs)>,
}

impl Splat {
    /// The same, on another background where one is asked for.
    pub fn on(mut self, asked: Option<Background>) -> Self {
        let asked = asked.map(Background::fixed_colour);
        self.settings.background = asked.unwrap_or(self.settings.background);
        self
    }

    /// The folder of the scene: the one that is `given`, else that of the run.
    pub fn scene_path(&self, given: Option<&Path>) -> Result<PathBuf> {
        let of_run = self.trained_on.as_ref().map(|dataset| &*dataset.path);
        match (given, of_run) {
            (Some(given), _) => Ok(given.to_owned()),
            (None, Some(of_run)) if of_run.exists() => Ok(of_run.to_owned()),
            (None, Some(of_run)) => {
                bail!("the scene of the run, {}, is not there; give --data SCENE", shown(of_run))
            }
            (None, None) => bail!("a file does not say which scene it shows; give --data SCENE"),
        }
    }

    /// Loads the photos in `data` to compare it with, as it was trained on them unless asked otherwise; their
    /// exposure is their own.
    ///
    /// Of a run's splat, a fraction is one of the size that it was trained at, for multi-scale evaluation.
    pub fn load_scene(&self, data: &Path, asked: &PhotosAsked) -> Result<Scene> {
        let scene = self.load(data, asked, None)?;
        scene.doubts.iter().for_each(|doubt| output::tell(&format!("notice: {}", doubt.problem)));
        Ok(scene)
    }

    /// The same, without a word about its doubts, and with training photos at the exposure that training
    /// sees, if the run brought them to it.
    pub fn load_scene_to_train(&self, data: &Path, asked: &PhotosAsked) -> Result<Scene> {
        let mut scene = self.load(data, asked, None)?;
        if let Some(exposure) = self.exposure(&scene, asked) {
            exposure.bring(&mut scene, None)?;
        }
        Ok(scene)
    }

    /// At most so many photos in `data`, as [`Self::load_scene`] loads them.
    pub fn load_some(&self, data: &Path, asked: &PhotosAsked, most: NonZeroUsize) -> Result<Scene> {
        self.load(data, asked, Some(most))
    }

    fn load(&self, data: &Path, asked: &PhotosAsked, most: Option<NonZeroUsize>) -> Result<Scene> {
        let (dataset, divisor) = self.dataset(data, asked)?;
        let load = |offset| scene::load_to_look(&dataset, divisor, self.settings.background, offset, most);
        let mut scene = match load(self.frame().or(Some(Offset::default()))) {
            Err(error) if self.frame().is_none() && is_far(&error) => load(None),
            loaded => loaded,
        }?;
        // Photos of another folder are asked for as such.
        let began_with = self.began_with.as_ref().filter(|_| asked.images.is_none());
        began_with
            .into_iter()
            .for_each(|(folder, began)| notice_changes(&began.scene, folder, &scene.digests, &scene.name));
        if let Some(cameras) = self.moved_cameras(&scene, asked) {
            cameras.apply(&mut scene);
        }
        Ok(scene)
    }

    /// At most so many photos of the run's own scene, as it was trained on them; `None` for a file, and, with
    /// a notice, where they are not to be had.
    pub fn sample_scene(&self, most: NonZeroUsize) -> Option<Scene> {
        let dataset = self.trained_on.as_ref()?;
        let gone = |why: &dyn Display| {
            output::tell(&format!("notice: what is lost is not measured, since {why}"));
        };
        if !dataset.path.exists() {
            gone(&format!("the scene of the run, {}, is not there; give --data SCENE", shown(&dataset.path)));
            return None;
        }
        let sampled = scene::load_sample(dataset, self.settings.background, self.frame(), most);
        sampled.map_err(|error| gone(&error)).ok()
    }

    /// The exposure of those photos of `scene` that its run began with, if it brought its photos to one: that
    /// of a splat's renders. Photos of another folder are known by their names.
    pub fn exposure(&self, scene: &Scene, asked: &PhotosAsked) -> Option<Exposure> {
        let (_, began) = self.began_with.as_ref()?;
        let digest = |scene: &SceneDigests, name: &str| scene.photo(name).map(|photo| photo.photo);
        let is_known =
            |name: &str| asked.images.is_some() || digest(&began.scene, name) == digest(&scene.digests, name);
        Some(began.exposure.as_ref()?.only(is_known))
    }

    /// How its run moved the cameras of those photos of `scene` that it began with, and that stand where they
    /// stood then.
    fn moved_cameras(&self, scene: &Scene, asked: &PhotosAsked) -> Option<Cameras> {
        let (_, began) = self.began_with.as_ref()?;
        let is_known = |name: &str| {
            let [then, now] = [&began.scene, &scene.digests].map(|of| of.photo(name));
            let is_same = |(then, now): (&PhotoDigests, &PhotoDigests)| {
                then.pose == now.pose && (asked.images.is_some() || then.photo == now.photo)
            };
            then.zip(now).is_some_and(is_same)
        };
        Some(began.cameras.as_ref()?.only(is_known))
    }

    /// Whether it is that of a run which began with a photo of this scene.
    pub fn began_with(&self, scene: &Scene) -> bool {
        self.began_with.as_ref().is_some_and(|(_, began)| {
            let now = |name: &str| scene.digests.photo(name).map(|digests| digests.photo);
            began.scene.photos.iter().any(|photo| now(&photo.name) == Some(photo.photo))
        })
    }

    /// The cameras in `data`, or of the run's own scene; empty where that is not there.
    pub fn cameras(&self, data: Option<&Path>, asked: &PhotosAsked) -> Result<Vec<Camera>> {
        let own = || self.trained_on.as_ref().map(|dataset| &*dataset.path).filter(|path| path.is_dir());
        let Some(data) = data.or_else(own) else { return Ok(Vec::new()) };
        let listed = list_scene(data, &self.options(data, asked)?)?;
        Ok(listed.photos.iter().map(|photo| photo.camera).collect())
    }

    fn options(&self, data: &Path, asked: &PhotosAsked) -> Result<LoadOptions> {
        let options = self.dataset(data, asked)?.0.options();
        Ok(LoadOptions { with_points: false, offset: self.frame(), ..options })
    }

    /// Where a scene must lie for the splat to show it; `None` where that is not known: in the coordinates of
    /// its source, or, where these are too far to be those of the splat, where it is moved to.
    fn frame(&self) -> Option<Offset> {
        self.offset.or(self.trained_on.as_ref().map(|_| Offset::default()))
    }

    /// The name of the view in `data` that is called `name`.
    pub fn view_name(&self, name: &str, data: &Path, asked: &PhotosAsked) -> Result<String> {
        let options = self.options(data, asked)?;
        Ok(list_scene(data, &options)?.view_name(name, data)?)
    }

    /// What masks of those photos mean.
    pub fn mask(&self, data: &Path, asked: &PhotosAsked) -> Result<MaskUse> {
        Ok(self.dataset(data, asked)?.0.mask)
    }

    /// The photos in `data`, and what their sides are divided by.
    fn dataset(&self, data: &Path, asked: &PhotosAsked) -> Result<(Dataset, u32)> {
        let mut dataset = self.trained_on.clone().unwrap_or_default();
        let trained_size = (dataset.max_side, dataset.downscale);
        asked.override_dataset(&mut dataset);
        dataset.path = data.to_owned();
        let mut divisor = 1;
        if let (Some(_), Some(asked)) = (&self.trained_on, asked.downscale) {
            (dataset.max_side, dataset.downscale) = trained_size;
            divisor = asked;
        }
        Ok((dataset, divisor))
    }

    /// The scene in `data`; where none is named, that of the run, if it is still where it was.
    pub fn find_scene(&self, data: Option<&Path>, asked: &PhotosAsked) -> Result<Option<Scene>> {
        if let Some(data) = data {
            return self.load_scene(data, asked).map(Some);
        }
        let of_run = self.trained_on.as_ref().map(|dataset| dataset.path.as_path());
        let Some(data) = of_run else { return Ok(None) };
        if !data.is_dir() {
            output::tell(&format!(
                "notice: the page has no photos and cameras, since the scene of the run, {}, is not there; give --data SCENE",
                shown(data)
            ));
            return Ok(None);
        }
        match self.load_scene(data, asked) {
            Ok(scene) => Ok(Some(scene)),
            Err(error) => {
                output::tell(&format!("notice: the page has no photos and cameras, since {error}"));
                Ok(None)
            }
        }
    }
}

fn is_far(error: &anyhow::Error) -> bool {
    matches!(error.downcast_ref(), Some(SceneError::FarFromOrigin { .. }))
}

type Read = fn(&Path) -> Result<Loaded, FormatError>;

/// Opens a splat in a file, or that of the run in a folder.
pub fn open(path: &Path) -> Result<Splat> {
    open_by(format::read, path)
}

/// The same with Gaussians that [`open`] refuses, for who leaves them out.
pub fn open_unchecked(path: &Path) -> Result<Splat> {
    open_by(format::read_unchecked, path)
}

fn open_by(read: Read, path: &Path) -> Result<Splat> {
    let _preparing = preparing::begin();
    ensure!(path.exists(), "{} does not exist; give a splat's file or the folder of a run", shown(path));
    foreign::check(path)?;
    if path.is_dir() { open_run(read, path) } else { open_file(read, path) }
}

fn open_run(read: Read, folder: &Path) -> Result<Splat> {
    check_has_cloud(folder, &ConfigFile::of_run(folder)?)?;
    let Loaded { cloud, step, .. } = read_cloud(read, &folder.join(CLOUD))?;
    of_run(folder, cloud, step)
}

/// A state of the run in `folder`.
pub(crate) fn of_run(folder: &Path, cloud: Gaussians, step: f64) -> Result<Splat> {
    let config = ConfigFile::of_run(folder)?;
    let settings = config.train.resolve()?.render_settings();
    let inputs = Inputs::read(folder).unwrap_or_else(|error| {
        output::tell(&format!("notice: {error}"));
        None
    });
    let offset = inputs.as_ref().and_then(|inputs| inputs.scene.offset);
    let began_with = inputs.map(|inputs| (folder.to_owned(), inputs));
    Ok(Splat { cloud, settings, offset, step, format: None, trained_on: Some(config.dataset), began_with })
}

/// A run has its splat once it is stopped or done; the system's word for a missing file would leave open what
/// to do.
fn check_has_cloud(folder: &Path, config: &ConfigFile) -> Result<()> {
    let [dataset, out, saved] = [&config.dataset.path, folder, &folder.join(CONFIG)].map(shown);
    let words = ["genesplat", "train", &dataset, "--out", &out];
    let (more, what): (&[&str], _) = match has_checkpoint(folder) {
        true => (&["--resume"], "goes on with it"),
        false => (&["--config", &saved], "begins it anew"),
    };
    ensure!(
        folder.join(CLOUD).exists(),
        "the run in {out} is unfinished and has no splat yet; {} {what}",
        command_line(words.into_iter().chain(more.iter().copied()))
    );
    Ok(())
}

fn open_file(read: Read, path: &Path) -> Result<Splat> {
    let mut loaded = read_cloud(read, path)?;
    loaded.move_near();
    let declared = loaded.screen_filter.unwrap_or_default();
    let filter = if loaded.cloud.filter_3d.is_some() { ScreenFilter::Mip } else { declared };
    let settings = RenderSettings { sh_degree: loaded.sh_degree, filter, ..RenderSettings::default() };
    let beside = offset::read_beside(path).unwrap_or_else(|error| {
        output::tell(&format!("notice: {} cannot be used: {error}", shown(offset::file_beside(path))));
        None
    });
    if let Some(by) = loaded.offset {
        output::tell(&format!(
            "notice: {} is far from its origin, where single precision has coarse steps, so its coordinates are taken less the \
             offset {}",
            shown(path),
            offset::in_words(by)
        ));
    }
    let (offset, step, format) = (offset::sum(beside, loaded.offset), loaded.step, Some(loaded.format));
    Ok(Splat { cloud: loaded.cloud, settings, offset, step, format, trained_on: None, began_with: None })
}

fn read_cloud(read: Read, path: &Path) -> Result<Loaded> {
    let loaded = read(path)?;
    let is_empty = loaded.cloud.is_empty();
    ensure!(!is_empty, "{} holds no Gaussians, so there is nothing to see; give another splat", shown(path));
    if loaded.sh_degree_in_file > loaded.sh_degree {
        output::tell(&format!(
            "notice: {} has spherical harmonics of degree {}, which are read up to degree {}",
            shown(path),
            loaded.sh_degree_in_file,
            loaded.sh_degree
        ));
    }
    if loaded.is_2dgs {
        output::tell(&format!(
            "notice: the Gaussians of {} are flat (2DGS, without scale_2); here they are 1e-6 world units thick",
            shown(path)
        ));
    }
    Ok(loaded)
}

/// Writes what was subtracted from the coordinates of the splat in `out` beside it, and says so; where it is
/// nothing, what was written beside an earlier one is removed.
pub fn write_offset(out: &Path, offset: Option<Offset>) -> Result<()> {
    let beside = offset::file_beside(out);
    let there = offset::read_beside(out);
    let Some(by) = offset else {
        let (folder, name) =
            (beside.parent().unwrap_or(Path::new("")), beside.file_name().unwrap_or_default());
        return if matches!(there, Ok(Some(_))) { remove_if_there(folder, name) } else { Ok(()) };
    };
    ensure!(
        there.is_ok(),
        "{} is there already and holds no offset, and {} needs one beside it; remove it, and run the command again",
        shown(&beside),
        shown(out)
    );
    write_file(&beside, |file| file.write_all(offset::to_json(by).as_bytes()))?;
    output::tell(&format!(
        "notice: coordinates in {} are less the offset {}, which {} holds; `genesplat convert --georeferenced` adds it again",
        shown(out),
        offset::in_words(by),
        shown(&beside)
    ));
    Ok(())
}

/// What to say of coordinates with such steps, where these are larger than what they place.
pub fn coarse_steps(step: f64, cloud: &Gaussians) -> Option<String> {
    let every = cloud.len().div_ceil(SAMPLE).max(1);
    let longest = |row: usize| f64::from(cloud.log_scales[row].into_iter().fold(f32::MIN, f32::max).exp());
    let size = median((0..cloud.len()).step_by(every).map(longest))?;
    (step > size).then(|| {
        format!(
            "its coordinates have steps of {step:.3} world units, and half of its Gaussians are smaller than {size:.3}, so they lie \
             on a grid: Gaussians far away make steps large, so leave them out (`convert --crop`), or write it anew from a source in \
             double precision"
        )
    })
}

/// So many Gaussians tell a size.
const SAMPLE: usize = 1 << 14;

/// What the format has no place for.
pub fn tell_losses(format: Format, cloud: &Gaussians, filter: ScreenFilter) {
    let ending = format.ending();
    if format == Format::Splat && cloud.sh_degree_in_use() > 0 {
        output::tell(&format!("notice: {ending} holds no view-dependent colour, so highlights are lost"));
    }
    if format != Format::Ply && cloud.filter_3d.is_some() {
        output::tell(&format!(
            "notice: {ending} holds no 3D filter; it is baked in, and the file can be shown but not refined"
        ));
    }
    let is_exact = match format {
        Format::Ply | Format::CompressedPly => true,
        // One mark for both kinds of compensated opacity.
        Format::Spz | Format::Sog => filter != ScreenFilter::Mip,
        Format::Splat | Format::Glb => false,
    };
    if filter != ScreenFilter::Classic && !is_exact {
        output::tell(&format!(
            "notice: {ending} does not say how this splat is antialiased, so viewers show small Gaussians a little larger"
        ));
    }
}
