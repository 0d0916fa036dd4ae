//! `genesplat train`: how long, by which method, with which evolution; and how these flags win over a configuration.

use std::path::PathBuf;

use anyhow::{Result, ensure};
use clap::Args;
use genesplat::io::archive::is_zip;
use genesplat::train::config::Signal;
use genesplat::train::{Background, EvolutionMode, TrainConfig, Variant};

use super::choice::{BACKGROUNDS, EVOLUTION, PRESETS, SIGNALS, VARIANTS, choice};
use super::{LpipsArgs, MORE, MachineArgs, PhotosArgs, SEEDS, TrainPageArgs, scale};

#[derive(Debug, Args)]
pub(crate) struct TrainArgs {
    /// Folder of the scene: a COLMAP model in sparse/0 (cameras, images, points3D as .bin or .txt) and its photos in
    /// images; or a transforms.json of nerfstudio or instant-ngp, or Blender's transforms_train.json and
    /// transforms_test.json, and the photos that they name. A zip of one is unpacked into DIR/scene
    pub(crate) dataset: PathBuf,
    /// The dataset is a folder or a zip of photos without cameras, or a video: find the cameras first, as `genesplat poses` does, and
    /// keep that scene in DIR/scene
    #[arg(long)]
    pub(crate) poses: bool,
    /// Folder for the results; made if it is missing. It will hold point_cloud.ply, report.html, metrics.json,
    /// config.toml, log.jsonl and test/*.png. Results of an earlier run there are never written over
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// Named settings; flags given here win over them
    #[arg(long, value_name = "PRESET", value_parser = choice(PRESETS), conflicts_with = "config")]
    pub(crate) preset: Option<&'static str>,
    #[command(flatten)]
    pub(crate) schedule: ScheduleArgs,
    /// Evolution beside gradient descent [default: renew]
    #[arg(long, value_name = "MODE", value_parser = choice(EVOLUTION))]
    pub(crate) evolve: Option<EvolutionMode>,
    #[command(flatten)]
    pub(crate) search: SearchArgs,
    #[command(flatten)]
    pub(crate) photos: PhotosArgs,
    /// TOML file with settings (the config.toml of any run is one); flags given here win over it [default: none]
    #[arg(long, value_name = "FILE.toml")]
    pub(crate) config: Option<PathBuf>,
    /// Go on with the interrupted run in DIR, from its checkpoint; the result is the same as without the interruption
    #[arg(long)]
    pub(crate) resume: bool,
    /// With --resume: go on although photos, masks, cameras or points are not what the run began with. The result is then
    /// that of neither, and DIR/inputs.json says what has changed
    #[arg(long, requires = "resume", help_heading = MORE)]
    pub(crate) accept_changes: bool,
    #[command(flatten)]
    pub(crate) page: TrainPageArgs,
    /// Also write the curves of the run to DIR/tensorboard, for `tensorboard --logdir DIR` and its like
    #[arg(long)]
    pub(crate) tensorboard: bool,
    #[command(flatten)]
    pub(crate) machine: MachineArgs,
    #[command(flatten)]
    pub(crate) method: MethodArgs,
    #[command(flatten)]
    pub(crate) lpips: LpipsArgs,
}

impl TrainArgs {
    /// The folder of the scene, which `--poses` makes, and into which an archive is unpacked.
    pub(crate) fn scene(&self) -> PathBuf {
        if self.poses || is_zip(&self.dataset) { self.out.join("scene") } else { self.dataset.clone() }
    }

    /// Flags over the file. Fails where one does not go with the method that is trained.
    pub(crate) fn override_config(&self, train: &mut TrainConfig) -> Result<()> {
        self.schedule.override_config(train);
        // So many as are asked for, and not a tenth of them.
        if self.preset.is_some() && self.schedule.iterations.is_some() && self.schedule.steps_scale.is_none() {
            train.steps_scale = 1.0;
        }
        replace(&mut train.evolution.mode, self.evolve);
        self.search.override_config(train)?;
        self.method.override_config(train)
    }
}

/// How long, and what kind of training.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct ScheduleArgs {
    /// Method: the original, or one of four improvements on it [default: 3dgs]
    #[arg(long, value_name = "METHOD", value_parser = choice(VARIANTS))]
    variant: Option<Variant>,
    /// Training steps, one photo each [default: 30000]. More is slower and mostly better; with a few dozen photos 7000 may be
    /// as good. With --evolve renew the whole schedule fits into them; published trainers are cut short
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    iterations: Option<u32>,
    /// Photos whose gradients are summed for one step of the optimiser [default: 1]. Rates grow by its square root; makes
    /// sense where many processes share a run, and steps are fewer
    #[arg(long, value_name = "B", value_parser = clap::value_parser!(u32).range(1..=1000), help_heading = MORE)]
    views_per_step: Option<u32>,
    /// Multiply every setting that counts steps by F, 0.001 to 1000 [default: 1]. 0.1 gives the whole schedule in
    /// a tenth of the steps; no interval gets shorter than 100
    #[arg(long, value_name = "F", value_parser = scale, help_heading = MORE)]
    steps_scale: Option<f64>,
    /// Seed of all random numbers [default: 0]. Same seed, same bytes, with one build on CPUs of one kind
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u64).range(SEEDS))]
    seed: Option<u64>,
    /// Train at most this many Gaussians, from the first step on [default: the cloud grows to as many as the photos can
    /// determine, and starting points are kept; without --evolve renew no limit, but 1000000 with mcmc and improved-gs, which
    /// grow towards it on a curve of their own]. Bounds memory (2 to 4 KB a Gaussian) and time
    #[arg(long, value_name = "N", value_parser = positive)]
    max_gaussians: Option<usize>,
    /// Iterations between two checkpoints [default: 1000]; 0 for none but that of Ctrl-C and SIGTERM
    #[arg(long, value_name = "N", help_heading = MORE)]
    checkpoint_every: Option<u32>,
}

impl ScheduleArgs {
    fn override_config(&self, train: &mut TrainConfig) {
        replace(&mut train.variant, self.variant);
        replace(&mut train.iterations, self.iterations);
        replace(&mut train.steps_scale, self.steps_scale);
        replace(&mut train.views_per_step, self.views_per_step);
        replace(&mut train.seed, self.seed);
        train.max_gaussians = self.max_gaussians.or(train.max_gaussians);
        replace(&mut train.checkpoint_every, self.checkpoint_every);
    }
}

/// How much of mode paper.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct SearchArgs {
    /// Mode paper: generations of each search, at least 1 [default: 100]. Time grows in proportion
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), help_heading = MORE)]
    pub(crate) generations: Option<u32>,
    /// Mode paper: individuals a generation, 1 to 10000 [default: 100]. Time grows in proportion
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000), help_heading = MORE)]
    pub(crate) population: Option<u32>,
}

impl SearchArgs {
    /// Flags over the file, of another mode none. A tournament cannot draw more individuals than there are, so a small population
    /// shrinks it.
    pub(crate) fn override_config(&self, train: &mut TrainConfig) -> Result<()> {
        let is_asked = self.generations.is_some() || self.population.is_some();
        ensure!(
            !is_asked || train.evolution.mode == EvolutionMode::Paper,
            "--generations and --population are of --evolve paper; add that, or leave them out"
        );
        let paper = &mut train.evolution.paper;
        replace(&mut paper.generations, self.generations);
        if let Some(population) = self.population {
            paper.population = population;
            paper.tournament = paper.tournament.min(population);
        }
        Ok(())
    }
}

/// How Gaussians are shown, and what makes them grow: options that users of other trainers know.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = MORE)]
pub(crate) struct MethodArgs {
    /// Colour behind the scene [default: black]. White suits objects cut out of their photos; random keeps them opaque
    #[arg(long, value_name = "COLOUR", value_parser = choice(BACKGROUNDS))]
    background: Option<Background>,
    /// Dim Gaussians smaller than a pixel instead of only widening them, so that views from afar do not swell.
    /// Not with --variant mip-splatting, which has a filter of its own
    #[arg(long)]
    antialiasing: bool,
    /// Gradient that makes a Gaussian grow, for 3dgs and mip-splatting [default: published]
    #[arg(long, value_name = "SIGNAL", value_parser = choice(SIGNALS))]
    densify_signal: Option<Signal>,
}

impl MethodArgs {
    fn override_config(&self, train: &mut TrainConfig) -> Result<()> {
        replace(&mut train.background, self.background);
        replace(&mut train.densify.signal, self.densify_signal);
        train.antialiasing |= self.antialiasing;
        let variant = train.variant;
        let has_own_signal = matches!(variant, Variant::PixelGs | Variant::Mcmc | Variant::ImprovedGs);
        ensure!(
            !has_own_signal || self.densify_signal.is_none_or(|signal| signal == Signal::Published),
            "--densify-signal is for 3dgs and mip-splatting, and {variant} grows by a rule of its own; leave the flag out, or train \
             another --variant"
        );
        Ok(())
    }
}

fn replace<T>(setting: &mut T, flag: Option<T>) {
    if let Some(value) = flag {
        *setting = value;
    }
}

fn positive(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|&count: &usize| count > 0).ok_or_else(|| "a whole number from 1 is needed".into())
}
