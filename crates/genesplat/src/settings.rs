//! Flags, configuration file and defaults become one resolved configuration.
//!
//! A flag wins over the file, the file over the default. What comes out is written to the run folder as `config.toml`,
//! which is itself such a file: the settings of training at the top level, and beside them `device`, `threads` and a
//! table `dataset`.

use std::fs;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow, bail, ensure};
use genesplat::io::PhotoSize;
use genesplat::train::{Resolved, TrainConfig};
use serde::de::Error;
use serde::{Deserialize, Serialize};

use crate::args::{
    DOWNSCALE, EvolutionArgs, MAX_SIDE, MachineArgs, ScheduleArgs, SizeArgs, THREADS, TrainArgs,
};
use crate::device::Device;
use crate::difference::essence;
use crate::run_folder::RunFolder;
use crate::{difference, same_scene};

/// Iterations between two checkpoints, where neither flag nor file says.
const CHECKPOINT_EVERY: u32 = 1000;

/// Everything that a run depends on.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The scene's folder and the size of its photos.
    pub dataset: Dataset,
    /// Never `Auto`.
    pub device: Device,
    /// Neither flag nor file chose the device.
    pub device_was_auto: bool,
    /// `None` for all cores.
    pub threads: Option<u16>,
    /// The settings of training, checked.
    pub train: Resolved,
}

/// Where the photos are and how large they are loaded.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Dataset {
    /// The scene's folder, as it was given.
    pub path: PathBuf,
    /// Longest side, px.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_side: Option<u32>,
    /// Divisor of both sides.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub downscale: Option<u32>,
}

impl Dataset {
    /// The size that photos are loaded at.
    pub fn size(&self) -> PhotoSize {
        SizeArgs { max_side: self.max_side, downscale: self.downscale }.size().unwrap_or_default()
    }

    fn override_size(&mut self, size: SizeArgs) {
        if size.size().is_some() {
            (self.max_side, self.downscale) = (size.max_side, size.downscale);
        }
    }
}

/// What a configuration file says.
#[derive(Clone, Debug, Default)]
pub struct ConfigFile {
    device: Option<Device>,
    threads: Option<u16>,
    /// The scene's folder and the size of its photos.
    pub dataset: Dataset,
    /// The settings of training.
    pub train: TrainConfig,
}

impl ConfigFile {
    /// Nothing but defaults.
    pub fn defaults() -> Self {
        let train = TrainConfig { checkpoint_every: CHECKPOINT_EVERY, ..TrainConfig::default() };
        Self { train, ..Self::default() }
    }

    /// The file in the folder of a run.
    pub fn of_run(folder: &Path) -> Result<Self> {
        RunFolder::check_is_run(folder)?;
        Self::read(&RunFolder::config_in(folder))
    }

    /// Settings of training that no file names, on a scene at the usual size.
    pub fn of_scene(path: PathBuf, train: TrainConfig) -> Self {
        Self { dataset: Dataset { path, ..Dataset::default() }, train, ..Self::default() }
    }

    /// What `genesplat train` is to do, checked as far as that is possible without a device.
    pub fn of_training(args: &TrainArgs) -> Result<Self> {
        let saved = args.resume.then(|| Self::of_run(&args.out)).transpose()?;
        let mut file = match (&args.config, &saved) {
            (Some(path), _) => Self::read(path)?,
            (None, Some(saved)) => saved.clone(),
            (None, None) => Self::defaults(),
        };
        file.dataset.path.clone_from(&args.dataset);
        file.dataset.override_size(args.size);
        override_schedule(&mut file.train, &args.schedule);
        args.method.override_method(&mut file.train);
        args.method.check(file.train.variant)?;
        override_evolution(&mut file.train, &args.evolution);
        file.check()?;
        if let Some(saved) = saved {
            check_same(&saved, &file, &args.out)?;
        }
        Ok(file)
    }

    /// Reads a file.
    pub fn read(path: &Path) -> Result<Self> {
        let text = fs::read_to_string(path)
            .map_err(|error| anyhow!("cannot read the configuration {}: {error}", path.display()))?;
        Self::parse(&text).map_err(|problem| {
            anyhow!("the configuration {} is not valid: {problem}; correct it there", path.display())
        })
    }

    fn parse(text: &str) -> Result<Self, toml::de::Error> {
        Self::from_table(text.parse()?).map_err(with_all_fields)
    }

    /// What a file with this content would say.
    pub fn from_table(mut table: toml::Table) -> Result<Self, toml::de::Error> {
        let (device, threads) = (take(&mut table, "device")?, take(&mut table, "threads")?);
        let dataset = take(&mut table, "dataset")?.unwrap_or_default();
        table.entry("checkpoint_every").or_insert(CHECKPOINT_EVERY.into());
        Ok(Self { device, threads, dataset, train: table.try_into()? })
    }

    /// The size that photos are loaded at; those of a run that is looked at were.
    pub fn size(&self) -> PhotoSize {
        self.dataset.size()
    }

    /// How many threads a run of this file has, where the flag does not say.
    pub fn threads(&self, machine: MachineArgs) -> Option<u16> {
        machine.threads.or(self.threads)
    }

    /// Fails where [`Self::resolve`] would, but for the device: to look for one takes a while, and drivers may write to stderr.
    pub fn check(&self) -> Result<()> {
        if self.dataset.path.to_str().is_none() {
            bail!(
                "the path of the scene, {}, is not UTF-8 text, and config.toml can hold no other; rename the folder, or give a link \
                 with another name",
                self.dataset.path.display()
            );
        }
        check_size(self.dataset.max_side, self.dataset.downscale)?;
        check_range("threads", self.threads.map(Into::into), THREADS)?;
        Ok(self.train.validate()?)
    }

    /// The settings of a run of this file; flags win over it.
    pub fn resolve(self, machine: MachineArgs) -> Result<Settings> {
        self.check()?;
        let (device, device_was_auto) = machine.device.or(self.device).unwrap_or_default().resolve()?;
        let threads = self.threads(machine);
        Ok(Settings { dataset: self.dataset, device, device_was_auto, threads, train: self.train.resolve()? })
    }

    /// What makes the result of a run of this file differ from that of a run with `settings`; `None` where nothing does.
    ///
    /// Scenes are the same where the last `parts` of their paths are: folders are moved, and named from here or there.
    pub fn difference(&self, settings: &Settings, parts: usize) -> Option<String> {
        let [there, here] = [&self.dataset.path, &settings.dataset.path].map(|path| end_of(path, parts));
        if there != here {
            return Some(format!("its scene is {} there and {} here", there.display(), here.display()));
        }
        let device = self.device.unwrap_or_default();
        if device != settings.device {
            return Some(format!("device is {} there and {} here", device.name(), settings.device.name()));
        }
        difference::first(
            &essence(&self.dataset, &self.train),
            &essence(&settings.dataset, settings.train.config()),
        )
    }
}

/// The last `parts` of a path.
fn end_of(path: &Path, parts: usize) -> PathBuf {
    let components: Vec<_> = path.components().collect();
    components[components.len().saturating_sub(parts)..].iter().collect()
}

impl Settings {
    /// As `config.toml` holds them.
    pub fn to_toml(&self) -> String {
        #[derive(Serialize)]
        struct Written<'a> {
            device: Device,
            #[serde(skip_serializing_if = "Option::is_none")]
            threads: Option<u16>,
            #[serde(flatten)]
            train: &'a TrainConfig,
            dataset: &'a Dataset,
        }
        let Self { dataset, device, threads, train, .. } = self;
        let written = Written { device: *device, threads: *threads, train: train.config(), dataset };
        toml::to_string(&written)
            .expect("settings are tables of numbers and text: resolve has checked the path")
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

fn check_range(name: &str, value: Option<i64>, range: RangeInclusive<i64>) -> Result<()> {
    let (from, to) = (range.start(), range.end());
    match value.filter(|value| !range.contains(value)) {
        Some(value) => {
            bail!("{name} is {value} in the file, and has to be from {from} to {to}; correct it there")
        }
        None => Ok(()),
    }
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
fn take<'a, T: Deserialize<'a>>(table: &mut toml::Table, key: &str) -> Result<Option<T>, toml::de::Error> {
    table.remove(key).map(toml::Value::try_into).transpose()
}

/// Flags over the file.
pub fn override_schedule(train: &mut TrainConfig, flags: &ScheduleArgs) {
    let ScheduleArgs { variant, iterations, steps_scale, seed, max_gaussians, checkpoint_every } = flags;
    replace(&mut train.variant, variant.map(Into::into));
    replace(&mut train.iterations, *iterations);
    replace(&mut train.steps_scale, *steps_scale);
    replace(&mut train.seed, *seed);
    train.max_gaussians = max_gaussians.or(train.max_gaussians);
    replace(&mut train.checkpoint_every, *checkpoint_every);
}

/// Flags over the file. A tournament cannot draw more individuals than there are, so a small population shrinks it.
pub fn override_evolution(train: &mut TrainConfig, flags: &EvolutionArgs) {
    let evolution = &mut train.evolution;
    replace(&mut evolution.mode, flags.evolve.map(Into::into));
    replace(&mut evolution.paper.generations, flags.generations);
    replace(&mut evolution.mosaic.generations, flags.generations);
    replace(&mut evolution.mosaic.mutants, flags.population);
    if let Some(population) = flags.population {
        evolution.paper.population = population;
        evolution.paper.tournament = evolution.paper.tournament.min(population);
    }
}

fn replace<T>(setting: &mut T, flag: Option<T>) {
    if let Some(value) = flag {
        *setting = value;
    }
}

/// A resumed run goes on with the settings that it began with, or its result would belong to neither.
fn check_same(saved: &ConfigFile, wanted: &ConfigFile, out: &Path) -> Result<()> {
    let [there, here] = [saved, wanted].map(|file| essence(&file.dataset, &file.train));
    if let Some(difference) = difference::first(&there, &here) {
        bail!(
            "--resume goes on with the settings in {}, and others were given ({difference}); leave them out, or train into \
             another folder",
            RunFolder::config_in(out).display()
        );
    }
    same_scene::check_folders(&saved.dataset.path, &wanted.dataset.path)
}
