//! Flags, configuration file and defaults become one resolved configuration.
//!
//! A flag wins over the file, the file over the default. The result is written to the run folder as `config.toml`,
//! which is itself such a file.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow, bail, ensure};
use genesplat::io::{HoldOut, LoadOptions, MaskUse, PhotoSize, input, shown};
use genesplat::train::{Background, Schedule, TrainConfig};
use serde::de::Error;
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

use crate::args::{DOWNSCALE, MAX_SIDE, MachineArgs, PhotosArgs, SizeArgs, TEST_EVERY, THREADS, TrainArgs, is_near};
use crate::device::DeviceChoice;
use crate::run::session::check_is_run;
use crate::run::{CONFIG, photos};

/// Iterations between two checkpoints, where neither flag nor file says.
const CHECKPOINT_EVERY: u32 = 1000;

#[derive(Clone, Debug)]
pub(crate) struct Settings {
    pub(crate) dataset: Dataset,
    /// Never `Auto`.
    pub(crate) device: DeviceChoice,
    /// `None` for all cores.
    pub(crate) threads: Option<u16>,
    pub(crate) schedule: Schedule,
}

/// Where the photos are and how large they are loaded.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Dataset {
    /// The scene's folder, as it was given.
    pub(crate) path: PathBuf,
    /// Folder of a COLMAP scene's photos, below `path` or anywhere; left out for `images`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) images: Option<PathBuf>,
    /// Longest side of the photos, px; larger ones are reduced. Default: only widths above 1600 px are reduced, to 1600.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) max_side: Option<u32>,
    /// Or their divisor: both sides are divided by it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) downscale: Option<u32>,
    /// Near plane of all cameras, world units; left out for the usual one, or a nearer one in a small scene.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) near: Option<f64>,
    /// What masks and transparency mean: `usual`, `ignore` or `transparent`.
    #[serde(skip_serializing_if = "is_default")]
    pub(crate) mask: MaskUse,
    /// Which photos are held out: left out for the scene's own or every eighth; or `{ every = 4 }`,
    /// `{ photos = ["a.jpg"] }`, `"none"`.
    #[serde(skip_serializing_if = "is_default")]
    pub(crate) hold_out: HoldOut,
}

pub(crate) fn is_default<T: Default + PartialEq>(setting: &T) -> bool {
    *setting == T::default()
}

impl Dataset {
    /// The scene at `path`, as it is asked for.
    pub(crate) fn of(path: &Path, asked: &PhotosArgs) -> Result<Self> {
        let mut dataset = Self { path: path.to_owned(), ..Self::default() };
        asked.override_dataset(&mut dataset)?;
        Ok(dataset)
    }

    pub(crate) fn size(&self) -> PhotoSize {
        SizeArgs { max_side: self.max_side, downscale: self.downscale }.size().unwrap_or_default()
    }

    /// How its scene is loaded.
    pub(crate) fn options(&self) -> LoadOptions {
        let (size, mask, near) = (self.size(), self.mask, self.near);
        let usual = LoadOptions::default();
        let image_folder = self.images.clone().unwrap_or(usual.image_folder);
        LoadOptions { size, mask, near, image_folder, hold_out: self.hold_out.clone(), ..usual }
    }
}

#[derive(Clone, Debug, Default)]
pub(crate) struct ConfigFile {
    device: Option<DeviceChoice>,
    threads: Option<u16>,
    pub(crate) dataset: Dataset,
    pub(crate) train: TrainConfig,
}

impl ConfigFile {
    pub(crate) fn defaults() -> Self {
        Self::from_table(Table::new()).expect("every setting has a default")
    }

    fn of_preset(text: &str) -> Self {
        text.parse().and_then(Self::from_table).expect("presets are configurations")
    }

    /// The file in the folder of a run.
    pub(crate) fn of_run(folder: &Path) -> Result<Self> {
        check_is_run(folder)?;
        Self::read(&folder.join(CONFIG))
    }

    /// Settings of training that no file names, on a scene at the usual size.
    pub(crate) fn of_scene(path: PathBuf, train: TrainConfig) -> Self {
        Self { dataset: Dataset { path, ..Dataset::default() }, train, ..Self::default() }
    }

    /// What `genesplat train` is to do, checked as far as that is possible without a device.
    pub(crate) fn of_training(args: &TrainArgs) -> Result<Self> {
        let saved = args.resume.then(|| Self::of_run(&args.out)).transpose()?;
        let mut file = match (&args.config, args.preset, &saved) {
            (Some(path), ..) => Self::read(path)?,
            (None, Some(preset), _) => Self::of_preset(preset),
            (None, None, Some(saved)) => saved.clone(),
            (None, None, None) => Self::defaults(),
        };
        // The run can be looked at from any folder.
        file.dataset.path = std::path::absolute(args.scene())?;
        args.photos.override_dataset(&mut file.dataset)?;
        file.threads = args.machine.threads.or(file.threads);
        file.device = args.machine.device.or(file.device);
        args.override_config(&mut file.train)?;
        file.check()?;
        if let Some(saved) = saved {
            file.check_goes_on_with(&saved, &args.out)?;
            if !args.accept_changes {
                photos::check_folders(&saved.dataset.path, &file.dataset.path)?;
            }
        }
        Ok(file)
    }

    pub(crate) fn read(path: &Path) -> Result<Self> {
        Self::read_over(path, Table::new())
    }

    /// The file over `defaults`, which say what the whole command does otherwise.
    pub(crate) fn read_over(path: &Path, defaults: Table) -> Result<Self> {
        let text = input::read_text(path)
            .map_err(|error| anyhow!("cannot read the configuration {}: {error}", shown(path)))?;
        let over = |file: Table| defaults.into_iter().chain(file).collect();
        let parsed = text.parse().map(over).and_then(Self::from_table).map_err(with_all_fields);
        parsed.map_err(|problem| anyhow!("the configuration {} is not valid: {problem}; correct it there", shown(path)))
    }

    /// What a file with this content would say.
    pub(crate) fn from_table(mut table: Table) -> Result<Self, toml::de::Error> {
        let (device, threads) = (take(&mut table, "device")?, take(&mut table, "threads")?);
        let dataset = take(&mut table, "dataset")?.unwrap_or_default();
        table.entry("checkpoint_every").or_insert(CHECKPOINT_EVERY.into());
        Ok(Self { device, threads, dataset, train: table.try_into()? })
    }

    pub(crate) fn threads(&self) -> Option<u16> {
        self.threads
    }

    /// Fails where [`Self::resolve`] would, but for the device, which takes a while to find.
    pub(crate) fn check(&self) -> Result<()> {
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
        ensure!(is_near(near), "near is {near} in the file, and has to be above 0 and at most 1e9; correct it there");
        check_hidden(self.dataset.mask, self.train.background)?;
        check_range("threads", self.threads.map(Into::into), THREADS)?;
        Ok(self.train.validate()?)
    }

    /// The settings of a run of this file; flags win over it.
    pub(crate) fn resolve(self, machine: MachineArgs) -> Result<Settings> {
        self.check()?;
        Ok(Settings {
            device: machine.device.or(self.device).unwrap_or_default().resolve()?,
            threads: machine.threads.or(self.threads),
            dataset: self.dataset,
            schedule: self.train.resolve()?,
        })
    }

    /// What makes the result of a run of this file differ from that of a run with `settings`, if anything. Scenes are
    /// the same where the last `parts` of their paths are, since folders are moved.
    pub(crate) fn difference(&self, settings: &Settings, parts: usize) -> Option<String> {
        let [there, here] = [&self.dataset.path, &settings.dataset.path].map(|path| end_of(path, parts));
        if there != here {
            return Some(format!("its scene is {} there and {} here", shown(there), shown(here)));
        }
        let (there, here) = (self.device.unwrap_or_default(), settings.device);
        if there != here {
            return Some(format!("device is {} there and {} here", there.name(), here.name()));
        }
        first_difference(
            &result_settings(&self.dataset, &self.train),
            &result_settings(&settings.dataset, settings.schedule.config()),
        )
    }

    /// A resumed run goes on with the settings that it began with, or its result would belong to neither.
    fn check_goes_on_with(&self, saved: &Self, out: &Path) -> Result<()> {
        let [there, here] = [saved, self].map(|file| result_settings(&file.dataset, &file.train));
        if let Some(difference) = first_difference(&there, &here) {
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
    pub(crate) fn to_toml(&self) -> String {
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
        toml::to_string(&written).expect("settings are tables of numbers and text: resolve has checked the path")
    }
}

impl Settings {
    /// All that the result of a run depends on, but for its scene and the kind of its device, as TOML.
    pub(crate) fn of_result(&self) -> String {
        result_settings(&self.dataset, self.schedule.config()).to_string()
    }
}

/// Fails where flags would: files have the same ranges.
pub(crate) fn check_size(max_side: Option<u32>, downscale: Option<u32>) -> Result<()> {
    ensure!(
        max_side.is_none() || downscale.is_none(),
        "max_side and downscale are both set in the file; keep one of them"
    );
    check_range("max_side", max_side.map(Into::into), MAX_SIDE)?;
    check_range("downscale", downscale.map(Into::into), DOWNSCALE)
}

/// Fails where hidden pixels would be a background that no photo can have.
pub(crate) fn check_hidden(mask: MaskUse, background: Background) -> Result<()> {
    ensure!(
        mask != MaskUse::Transparent || background != Background::Random,
        "hidden pixels cannot be the background (mask is transparent) where that is a new colour in every step (background is \
         random); change one of them"
    );
    Ok(())
}

/// The same of what is held out.
pub(crate) fn check_hold_out(hold_out: &HoldOut) -> Result<()> {
    let HoldOut::Every(interval) = hold_out else { return Ok(()) };
    check_range("hold_out.every", Some(interval.get().into()), TEST_EVERY)
}

fn check_range(name: &str, value: Option<i64>, range: RangeInclusive<i64>) -> Result<()> {
    let Some(value) = value.filter(|value| !range.contains(value)) else { return Ok(()) };
    let (from, to) = (range.start(), range.end());
    bail!("{name} is {value} in the file, and has to be from {from} to {to}; correct it there")
}

/// Where the settings of training are listed (no other list has `iterations`), what else may stand beside them is, too.
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

/// What the result of a run depends on, besides its scene and the kind of its device.
fn result_settings(dataset: &Dataset, train: &TrainConfig) -> Table {
    fn to_table(settings: &impl Serialize) -> Table {
        Table::try_from(settings).expect("settings are tables of numbers and text")
    }
    let mut table = to_table(&TrainConfig { checkpoint_every: 0, ..train.clone() });
    let size = Dataset { path: "".into(), ..dataset.clone() };
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
mod tests {
    use genesplat::train::EvolutionMode;

    use super::*;

    #[test]
    fn a_file_wins_over_what_a_command_does_without_it() {
        let folder = tempfile::tempdir().unwrap();
        let iterations = |text: &str| {
            let file = folder.path().join("config.toml");
            std::fs::write(&file, text).unwrap();
            let defaults = Table::from_iter([("iterations".to_owned(), Value::from(2000))]);
            ConfigFile::read_over(&file, defaults).unwrap().train.iterations
        };
        assert_eq!((iterations("seed = 1"), iterations("iterations = 7")), (2000, 7));
    }

    #[test]
    fn the_first_difference_is_named_with_both_values() {
        let (dataset, train) = (Dataset::default(), TrainConfig::default());
        let difference = |dataset: &Dataset, other: &TrainConfig| {
            first_difference(&result_settings(&Dataset::default(), &train), &result_settings(dataset, other))
        };
        let elsewhere = Dataset { path: "elsewhere".into(), ..Dataset::default() };
        let as_often = TrainConfig { checkpoint_every: 7, ..train.clone() };
        assert_eq!(difference(&elsewhere, &as_often), None);

        let small = Dataset { max_side: Some(64), ..dataset.clone() };
        let said = difference(&small, &train);
        assert_eq!(said.as_deref(), Some("dataset.max_side is not set there and 64 here"));
        let mut other = train.clone();
        other.evolution.mode = EvolutionMode::Off;
        let said = difference(&dataset, &other);
        assert_eq!(said.as_deref(), Some("evolution.mode is \"renew\" there and \"off\" here"));
        let other = TrainConfig { max_gaussians: Some(9), seed: 4, ..train.clone() };
        let said = difference(&dataset, &other);
        assert_eq!(said.as_deref(), Some("seed is 0 there and 4 here"));
    }
}
