//! Flags, configuration file and defaults become one resolved configuration.
//!
//! A flag wins over the file, the file over the default. The result is written to the run folder as
//! `config.toml`, which is itself such a file.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow, bail, ensure};
use genesplat_io::{HoldOut, LoadOptions, MaskUse, PhotoSize, input, shown};
use genesplat_train::{Background, MethodName, Schedule, TrainConfig};
use serde::de::Error;
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use crate::device::DeviceChoice;
use crate::exposure::Corrections;
use crate::session::check_is_run;
use crate::{CONFIG, photos};

/// Iterations between two checkpoints, where neither flag nor file says.
const CHECKPOINT_EVERY: u32 = 1000;

/// Longest sides that can be asked for, px.
pub const MAX_SIDE: RangeInclusive<i64> = 16..=u32::MAX as i64;
/// Divisors of both sides that can be asked for.
pub const DOWNSCALE: RangeInclusive<i64> = 1..=64;
/// Intervals of test photos that can be asked for: of every photo, none would be left to train on.
pub const TEST_EVERY: RangeInclusive<i64> = 2..=u32::MAX as i64;
/// Numbers of threads that can be asked for.
pub const THREADS: RangeInclusive<i64> = 1..=1024;

/// Keys of earlier versions, and what stands for them.
const OLD_KEYS: [(&str, &str); 6] = [
    ("variant", "the method is a table of its own, as in `[method] name = \"mcmc\"`"),
    (
        "evolution",
        "renew is `name = \"genesplat\"` in [method], paper is the table [genetic], off is any other method",
    ),
    ("densify", "its settings are those of the method, in [method] (docs/settings.md)"),
    ("optimiser", "rates are settings of the method, in [method] (docs/settings.md)"),
    ("mcmc", "its settings are those of the method, in [method] (docs/settings.md)"),
    ("extent", "the size of the scene is that of its cameras; leave it out"),
];

/// Whether a near plane may lie at this depth.
pub fn is_near(depth: f64) -> bool {
    depth > 0.0 && depth <= 1e9
}

/// Which machine power to use, where a file does not say or must not.
#[derive(Clone, Copy, Debug, Default)]
pub struct Machine {
    /// Where to compute.
    pub device: Option<DeviceChoice>,
    /// Processor threads.
    pub threads: Option<u16>,
}

/// What is asked for of photos, over what a file or a run says of them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PhotosAsked {
    /// Longest side, px.
    pub max_side: Option<u32>,
    /// Divisor of both sides.
    pub downscale: Option<u32>,
    /// Folder of a COLMAP scene's photos.
    pub images: Option<PathBuf>,
    /// Which are held out.
    pub hold_out: Option<HoldOut>,
    /// What masks and transparency mean.
    pub mask: Option<MaskUse>,
    /// Near plane of all cameras, world units.
    pub near: Option<f64>,
    /// Whether photos are brought to one exposure.
    pub corrections: Option<Corrections>,
    /// Whether depth maps train.
    pub depth: Option<DepthUse>,
}

impl PhotosAsked {
    /// What is asked for over what `dataset` says.
    pub(crate) fn override_dataset(&self, dataset: &mut Dataset) {
        if self.max_side.or(self.downscale).is_some() {
            (dataset.max_side, dataset.downscale) = (self.max_side, self.downscale);
        }
        dataset.images = self.images.clone().or(dataset.images.take());
        dataset.mask = self.mask.unwrap_or(dataset.mask);
        dataset.near = self.near.or(dataset.near);
        dataset.corrections = self.corrections.unwrap_or(dataset.corrections);
        dataset.depth = self.depth.unwrap_or(dataset.depth);
        if let Some(hold_out) = &self.hold_out {
            dataset.hold_out = hold_out.clone();
        }
    }
}

/// What somebody asks for who trains a scene.
pub struct Training<'a> {
    /// The folder of the scene.
    pub scene: PathBuf,
    /// The folder of the run.
    pub out: &'a Path,
    /// Whether an interrupted run goes on.
    pub resumes: bool,
    /// Whether it goes on with a scene that is not what it began with.
    pub accepts_changes: bool,
    /// A file with settings.
    pub config: Option<&'a Path>,
    /// Or their text.
    pub preset: Option<&'a str>,
    /// Which photos, and how large.
    pub photos: PhotosAsked,
    /// Which machine power.
    pub machine: Machine,
    /// What is asked for over the file.
    pub over: &'a dyn Fn(&mut TrainConfig) -> Result<()>,
}

/// All settings of a run, resolved.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Where the photos are, and how large they are loaded.
    pub dataset: Dataset,
    /// Never `Auto`.
    pub device: DeviceChoice,
    /// `None` for all cores.
    pub threads: Option<u16>,
    /// What is trained, and how.
    pub schedule: Schedule,
}

/// Whether depth maps train, where a scene has them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DepthUse {
    /// They do, with any method.
    On,
    /// They do with ours: published methods know photos alone.
    #[default]
    Auto,
    /// They are not looked for.
    Off,
}

impl DepthUse {
    /// Whether they train with this method.
    pub fn serves(self, method: MethodName) -> bool {
        match self {
            Self::On => true,
            Self::Auto => method == MethodName::Genesplat,
            Self::Off => false,
        }
    }
}

/// Where the photos are and how large they are loaded.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Dataset {
    /// The scene's folder, as it was given.
    pub path: PathBuf,
    /// Folder of a COLMAP scene's photos, below `path` or anywhere; left out for `images`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub images: Option<PathBuf>,
    /// Longest side of the photos, px; larger ones are reduced. Default: only widths above 1600 px are
    /// reduced, to 1600.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_side: Option<u32>,
    /// Or their divisor: both sides are divided by it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub downscale: Option<u32>,
    /// Near plane of all cameras, world units; left out for the usual one, or a nearer one in a small scene.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub near: Option<f64>,
    /// What masks and transparency mean: `usual`, `ignore`, `transparent` or `off`.
    #[serde(skip_serializing_if = "is_default")]
    pub mask: MaskUse,
    /// Whether photos are brought to one exposure before training, and cameras to where they stand: `on`,
    /// `off`, or `auto` for where that is worth it and the method is ours; left out for `auto`.
    #[serde(skip_serializing_if = "is_default")]
    pub corrections: Corrections,
    /// Whether depth maps train shapes, where the scene has them: `on`, `off`, or `auto` for where the method
    /// is ours; left out for `auto`.
    #[serde(skip_serializing_if = "is_default")]
    pub depth: DepthUse,
    /// Which photos are held out: left out for the scene's own or every eighth; or `{ every = 4 }`,
    /// `{ photos = ["a.jpg"] }`, `"none"`.
    #[serde(skip_serializing_if = "is_default")]
    pub hold_out: HoldOut,
}

/// Whether a setting says nothing.
pub fn is_default<T: Default + PartialEq>(setting: &T) -> bool {
    *setting == T::default()
}

impl Dataset {
    /// The scene at `path`, as it is asked for.
    pub fn of(path: &Path, asked: &PhotosAsked) -> Self {
        let mut dataset = Self { path: path.to_owned(), ..Self::default() };
        asked.override_dataset(&mut dataset);
        dataset
    }

    /// How large its photos are loaded.
    pub fn size(&self) -> PhotoSize {
        let side = self.max_side.map(PhotoSize::MaxSide);
        side.or(self.downscale.map(PhotoSize::Downscale)).unwrap_or_default()
    }

    /// How its scene is loaded.
    pub fn options(&self) -> LoadOptions {
        let (size, mask, near) = (self.size(), self.mask, self.near);
        let usual = LoadOptions::default();
        let image_folder = self.images.clone().unwrap_or(usual.image_folder);
        LoadOptions { size, mask, near, image_folder, hold_out: self.hold_out.clone(), ..usual }
    }
}

/// A file with settings, over the defaults.
#[derive(Clone, Debug, Default)]
pub struct ConfigFile {
    device: Option<DeviceChoice>,
    threads: Option<u16>,
    /// Where the photos are, and how large they are loaded.
    pub dataset: Dataset,
    /// What is trained, and how.
    pub train: TrainConfig,
}

impl ConfigFile {
    /// What is asked of the photos' exposure: a published method has photos as they are, unless somebody
    /// insists.
    pub fn corrections(&self) -> Corrections {
        match (self.dataset.corrections, self.train.method.name) {
            (Corrections::Auto, name) if name != MethodName::Genesplat => Corrections::Off,
            (asked, _) => asked,
        }
    }

    /// Whether depth maps train, where the scene has them.
    pub fn looks_at_depth(&self) -> bool {
        self.dataset.depth.serves(self.train.method.name)
    }

    /// What no file changes.
    pub fn defaults() -> Self {
        Self::from_table(Table::new()).expect("every setting has a default")
    }

    fn of_preset(text: &str) -> Self {
        text.parse().and_then(Self::from_table).expect("presets are configurations")
    }

    /// The file in the folder of a run.
    pub fn of_run(folder: &Path) -> Result<Self> {
        check_is_run(folder)?;
        Self::read(&folder.join(CONFIG))
    }

    /// Settings of training that no file names, on a scene at the usual size.
    pub fn of_scene(path: PathBuf, train: TrainConfig) -> Self {
        Self { dataset: Dataset { path, ..Dataset::default() }, train, ..Self::default() }
    }

    /// What a training is to do, checked as far as that is possible without a device.
    pub fn of_training(asked: &Training<'_>) -> Result<Self> {
        let saved = asked.resumes.then(|| Self::of_run(asked.out)).transpose()?;
        let mut file = match (asked.config, asked.preset, &saved) {
            (Some(path), ..) => Self::read(path)?,
            (None, Some(preset), _) => Self::of_preset(preset),
            (None, None, Some(saved)) => saved.clone(),
            (None, None, None) => Self::defaults(),
        };
        // The run can be looked at from any folder.
        file.dataset.path = std::path::absolute(&asked.scene)?;
        asked.photos.override_dataset(&mut file.dataset);
        file.threads = asked.machine.threads.or(file.threads);
        file.device = asked.machine.device.or(file.device);
        (asked.over)(&mut file.train)?;
        file.check()?;
        if let Some(saved) = saved {
            file.check_goes_on_with(&saved, asked.out)?;
            if !asked.accepts_changes {
                photos::check_folders(&saved.dataset.path, &file.dataset.path)?;
            }
        }
        Ok(file)
    }

    /// Reads a file with settings.
    pub fn read(path: &Path) -> Result<Self> {
        Self::read_over(path, Table::new())
    }

    /// The file over `defaults`, which say what the whole command does otherwise.
    pub fn read_over(path: &Path, defaults: Table) -> Result<Self> {
        let text = input::read_text(path)
            .map_err(|error| anyhow!("cannot read the configuration {}: {error}", shown(path)))?;
        let over = |file: Table| defaults.into_iter().chain(file).collect();
        let parsed = text.parse().map(over).and_then(Self::from_table).map_err(with_all_fields);
        parsed.map_err(|problem| {
            anyhow!("the configuration {} is not valid: {problem}; correct it there", shown(path))
        })
    }

    /// What a file with this content would say.
    pub fn from_table(mut table: Table) -> Result<Self, toml::de::Error> {
        if let Some((key, instead)) = OLD_KEYS.into_iter().find(|(key, _)| table.contains_key(*key)) {
            return Err(toml::de::Error::custom(format!("`{key}` is of an earlier version: {instead}")));
        }
        let (device, threads) = (take(&mut table, "device")?, take(&mut table, "threads")?);
        let dataset = take(&mut table, "dataset")?.unwrap_or_default();
        table.entry("checkpoint_every").or_insert(CHECKPOINT_EVERY.into());
        Ok(Self { device, threads, dataset, train: table.try_into()? })
    }

    /// Processor threads, where it says so.
    pub fn threads(&self) -> Option<u16> {
        self.threads
    }

    /// Fails where [`Self::resolve`] would, but for the device, which takes a while to find.
    pub fn check(&self) -> Result<()> {
        let paths = [Some(&self.dataset.path), self.dataset.images.as_ref()];
        if let Some(path) = paths.into_iter().flatten().find(|path| path.to_str().is_none()) {
            bail!(
                "the path {} is not UTF-8 text, and config.toml can hold no other; rename the folder, or give a link with another \
                 name",
                shown(path)
            );
        }
        check_size(self.dataset.max_side, self.dataset.downscale)?;
        check_hold_out(&self.dataset.hold_out)?;
        let near = self.dataset.near.unwrap_or(1.0);
        ensure!(
            is_near(near),
            "near is {near} in the file, and has to be above 0 and at most 1e9; correct it there"
        );
        check_hidden(self.dataset.mask, self.train.background)?;
        check_range("threads", self.threads.map(Into::into), THREADS)?;
        Ok(self.train.validate()?)
    }

    /// The settings of a run of this file; `machine` wins over it.
    pub fn resolve(self, machine: Machine) -> Result<Settings> {
        self.check()?;
        Ok(Settings {
            device: machine.device.or(self.device).unwrap_or_default().resolve()?,
            threads: machine.threads.or(self.threads),
            dataset: self.dataset,
            schedule: self.train.resolve()?,
        })
    }

    /// What makes the result of a run of this file differ from that of a run with `settings`, if anything.
    /// Scenes are the same where the last `parts` of their paths are, since folders are moved.
    pub fn difference(&self, settings: &Settings, parts: usize) -> Option<String> {
        let [there, here] = [&self.dataset.path, &settings.dataset.path].map(|path| end_of(path, parts));
        if there != here {
            return Some(format!("its scene is {} there and {} here", shown(there), shown(here)));
        }
        let (there, here) = (self.device.unwrap_or_default(), settings.device);
        if there != here {
            return Some(format!("device is {} there and {} here", there, here));
        }
        first_difference(
            &result_settings(&self.dataset, &self.train),
            &result_settings(&settings.dataset, settings.schedule.config()),
        )
    }

    /// A resumed run goes on with the settings that it began with, or its result would belong to neither.
    fn check_goes_on_with(&self, saved: &Self, out: &Path) -> Result<()> {
        let [there, here] = [saved, self].map(|file| result_settings(&file.dataset, &file.train));
        let corrections = || {
            let [there, here] = [saved, self].map(|file| file.dataset.corrections.name());
            (there != here).then(|| format!("dataset.corrections is {there} there and {here} here"))
        };
        if let Some(difference) = first_difference(&there, &here).or_else(corrections) {
            bail!(
                "--resume goes on with the settings in {}, and others were given ({difference}); leave them out, or train into \
                 another folder",
                shown(out.join(CONFIG))
            );
        }
        Ok(())
    }
}

fn end_of(path: &Path, parts: usize) -> PathBuf {
    let components: Vec<_> = path.components().collect();
    components[components.len().saturating_sub(parts)..].iter().collect()
}

impl Settings {
    /// As `config.toml` holds them.
    pub fn to_toml(&self) -> String {
        #[derive(Serialize)]
        struct Written<'a> {
            device: DeviceChoice,
            #[serde(skip_serializing_if = "Option::is_none")]
            threads: Option<u16>,
            #[serde(flatten)]
            train: &'a TrainConfig,
            dataset: &'a Dataset,
        }
        let Self { dataset, device, threads, schedule } = self;
        let written = Written { device: *device, threads: *threads, train: schedule.config(), dataset };
        toml::to_string(&written)
            .expect("settings are tables of numbers and text: resolve has checked the path")
    }
}

impl Settings {
    /// All that the result of a run depends on, but for its scene and the kind of its device, as TOML.
    pub(crate) fn of_result(&self) -> String {
        result_settings(&self.dataset, self.schedule.config()).to_string()
    }
}

/// Fails where flags would: files have the same ranges.
pub fn check_size(max_side: Option<u32>, downscale: Option<u32>) -> Result<()> {
    ensure!(
        max_side.is_none() || downscale.is_none(),
        "max_side and downscale are both set in the file; keep one of them"
    );
    check_range("max_side", max_side.map(Into::into), MAX_SIDE)?;
    check_range("downscale", downscale.map(Into::into), DOWNSCALE)
}

/// Fails where hidden pixels would be a background that no photo can have.
pub fn check_hidden(mask: MaskUse, background: Background) -> Result<()> {
    ensure!(
        mask != MaskUse::Transparent || background != Background::Random,
        "hidden pixels cannot be the background (mask is transparent) where that is a new colour in every step (background is \
         random); change one of them"
    );
    Ok(())
}

/// The same of what is held out.
pub fn check_hold_out(hold_out: &HoldOut) -> Result<()> {
    let HoldOut::Every(interval) = hold_out else { return Ok(()) };
    check_range("hold_out.every", Some(interval.get().into()), TEST_EVERY)
}

fn check_range(name: &str, value: Option<i64>, range: RangeInclusive<i64>) -> Result<()> {
    let Some(value) = value.filter(|value| !range.contains(value)) else { return Ok(()) };
    let (from, to) = (range.start(), range.end());
    bail!("{name} is {value} in the file, and has to be from {from} to {to}; correct it there")
}

/// Where the settings of training are listed (no other list has `iterations`), what else may stand beside
/// them is, too.
fn with_all_fields(error: toml::de::Error) -> toml::de::Error {
    let others = "expected one of `device`, `threads`, `dataset`,";
    let message = error.message();
    match message.contains("`iterations`,") {
        true => toml::de::Error::custom(message.replace("expected one of", others)),
        false => error,
    }
}

/// Removes an entry that is not one of training's.
fn take<'a, T: Deserialize<'a>>(table: &mut Table, key: &str) -> Result<Option<T>, toml::de::Error> {
    table.remove(key).map(Value::try_into).transpose()
}

/// What the result of a run depends on, besides its scene, the kind of its device and the exposure of its
/// photos: that is among what it begins with, once it is known.
fn result_settings(dataset: &Dataset, train: &TrainConfig) -> Table {
    fn to_table(settings: &impl Serialize) -> Table {
        Table::try_from(settings).expect("settings are tables of numbers and text")
    }
    let mut table = to_table(&TrainConfig { checkpoint_every: 0, ..train.clone() });
    let size = Dataset { path: "".into(), corrections: Corrections::default(), ..dataset.clone() };
    table.insert("dataset".into(), Value::Table(to_table(&size)));
    table
}

/// The first difference between what [`Settings::of_result`] was there and is here, if there is any.
pub(crate) fn difference_of_results(there: &str, here: &str) -> Option<String> {
    let table = |text: &str| {
        let file = text.parse().and_then(ConfigFile::from_table)?;
        Ok::<_, toml::de::Error>(result_settings(&file.dataset, &file.train))
    };
    match (table(there), table(here)) {
        (Ok(there), Ok(here)) => first_difference(&there, &here),
        (Err(error), _) => Some(format!("the settings there are of another version: {}", error.message())),
        (_, Err(error)) => Some(format!("the settings here cannot be read back: {}", error.message())),
    }
}

/// The first key, dotted, whose values differ, and both of them; `None` where the tables are the same.
fn first_difference(there: &Table, here: &Table) -> Option<String> {
    let new = here.keys().filter(|key| !there.contains_key(*key));
    let shown = |value: Option<&Value>| value.map_or("not set".into(), Value::to_string);
    there.keys().chain(new).find_map(|key| match (there.get(key), here.get(key)) {
        (there, here) if there == here => None,
        (Some(Value::Table(there)), Some(Value::Table(here))) => {
            first_difference(there, here).map(|difference| format!("{key}.{difference}"))
        }
        (there, here) => Some(format!("{key} is {} there and {} here", shown(there), shown(here))),
    })
}

#[cfg(test)]
mod tests;
