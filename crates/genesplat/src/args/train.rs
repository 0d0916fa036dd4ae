//! `genesplat train`: how long, by which method, with the genetic search or without; and how these flags
//! win over a configuration.

use std::path::{Path, PathBuf};

use anyhow::{Result, ensure};
use clap::Args;
use genesplat::flags::{LpipsArgs, MORE, MachineArgs, choice, scale};
use genesplat::io::archive::is_zip;
use genesplat::run::exposure::Corrections;
use genesplat::run::minutes::RANGE;
use genesplat::run::settings::{DepthUse, PhotosAsked, Training};
use genesplat::train::{Background, MethodConfig, MethodName, TrainConfig};

use super::choice::{BACKGROUNDS, CORRECTIONS, DEPTHS, METHODS, PRESETS};
use super::{PhotosArgs, SEEDS, TrainPageArgs};

#[derive(Debug, Args)]
pub(crate) struct TrainArgs {
    /// Folder of the scene: a COLMAP model in sparse/0 (cameras, images, points3D as .bin or .txt) and its
    /// photos in images; or a transforms.json of nerfstudio or instant-ngp, or Blender's
    /// transforms_train.json and transforms_test.json, and the photos that they name. A zip of one is
    /// unpacked into DIR/scene
    #[arg(required_unless_present = "data")]
    dataset: Option<PathBuf>,
    /// What other trainers call it.
    #[arg(long, hide = true, conflicts_with = "dataset")]
    data: Option<PathBuf>,
    /// The dataset is a folder or a zip of photos without cameras, or a video: find the cameras first, as
    /// `genesplat poses` does, and keep that scene in DIR/scene
    #[arg(long)]
    pub(crate) poses: bool,
    /// Folder for the results; made if it is missing. It will hold point_cloud.ply, report.html,
    /// metrics.json, config.toml, log.jsonl and test/*.png. Results of an earlier run there are never written
    /// over
    #[arg(long, value_name = "DIR", alias = "output")]
    pub(crate) out: PathBuf,
    /// Named settings; flags given here win over them
    #[arg(long, value_name = "PRESET", value_parser = choice(PRESETS), ignore_case = true)]
    #[arg(conflicts_with = "config")]
    pub(crate) preset: Option<&'static str>,
    #[command(flatten)]
    pub(crate) schedule: ScheduleArgs,
    #[command(flatten)]
    pub(crate) search: SearchArgs,
    #[command(flatten)]
    pub(crate) photos: PhotosArgs,
    /// Whether photos are brought to one exposure, white balance and contrast before training, each by four
    /// numbers that COLMAP's points tell, and cameras to where photos show that they stand [default: auto].
    /// Renders then show the mean exposure, and test photos are compared with renders at that of training
    /// photos nearby (docs/scenes.md)
    #[arg(long, value_name = "USE", value_parser = choice(CORRECTIONS), ignore_case = true)]
    pub(crate) corrections: Option<Corrections>,
    /// Whether depth maps train shapes, where the scene has them: depth_file_path of transforms.json, or
    /// COLMAP's stereo/depth_maps (docs/scenes.md) [default: auto]
    #[arg(long, value_name = "USE", value_parser = choice(DEPTHS), ignore_case = true)]
    pub(crate) depth: Option<DepthUse>,
    /// TOML file with settings (the config.toml of any run is one); flags given here win over it [default:
    /// none]
    #[arg(long, value_name = "FILE.toml")]
    pub(crate) config: Option<PathBuf>,
    /// Go on with the interrupted run in DIR, from its checkpoint; the result is the same as without the
    /// interruption
    #[arg(long)]
    pub(crate) resume: bool,
    /// With --resume: go on although photos, masks, cameras or points are not what the run began with. The
    /// result is then that of neither, and DIR/inputs.json says what has changed
    #[arg(long, requires = "resume", help_heading = MORE)]
    pub(crate) accept_changes: bool,
    #[command(flatten)]
    pub(crate) page: TrainPageArgs,
    /// Train although there is no hope of a good splat: fewer than 10 photos, cameras for less than half of
    /// them, masks that fit no photo
    #[arg(long, help_heading = MORE)]
    pub(crate) anyway: bool,
    /// Also write the curves of the run to DIR/tensorboard, for `tensorboard --logdir DIR` and its like
    #[arg(long)]
    pub(crate) tensorboard: bool,
    #[command(flatten)]
    pub(crate) machine: MachineArgs,
    #[command(flatten)]
    pub(crate) shown: ShownArgs,
    #[command(flatten)]
    pub(crate) old: OldArgs,
    #[command(flatten)]
    pub(crate) lpips: LpipsArgs,
}

/// The folder of a scene in that of its run.
pub(crate) const SCENE: &str = "scene";

impl TrainArgs {
    /// What was given as the scene.
    pub(crate) fn dataset(&self) -> &Path {
        let given = self.dataset.as_deref().or(self.data.as_deref());
        given.expect("clap has asked for one of them")
    }

    /// The folder of the scene, which `--poses` makes, and into which an archive is unpacked.
    pub(crate) fn scene(&self) -> PathBuf {
        let given = self.dataset();
        if self.poses || is_zip(given) { self.out.join(SCENE) } else { given.to_owned() }
    }

    /// What is asked for; `over` is [`Self::override_config`].
    pub(crate) fn asked<'a>(
        &'a self,
        over: &'a dyn Fn(&mut TrainConfig) -> Result<()>,
    ) -> Result<Training<'a>> {
        Ok(Training {
            scene: self.scene(),
            out: &self.out,
            resumes: self.resume,
            accepts_changes: self.accept_changes,
            config: self.config.as_deref(),
            preset: self.preset,
            photos: PhotosAsked { corrections: self.corrections, depth: self.depth, ..self.photos.asked()? },
            machine: self.machine.into(),
            over,
        })
    }

    /// Flags over the file. Fails where one does not go with the method that is trained.
    pub(crate) fn override_config(&self, train: &mut TrainConfig) -> Result<()> {
        self.schedule.override_config(train);
        // So many as are asked for, and not a tenth of them.
        if self.preset.is_some() && self.schedule.is_long_as_asked() && self.schedule.steps_scale.is_none() {
            train.steps_scale = 1.0;
        }
        self.search.override_config(train)?;
        self.shown.override_config(train);
        Ok(())
    }
}

/// What other trainers call `--iterations`.
pub(crate) const STEPS: [&str; 3] = ["steps", "max-steps", "max-num-iterations"];

/// How long, and what kind of training.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct ScheduleArgs {
    /// Method [default: genesplat]
    #[arg(long, value_name = "METHOD", value_parser = choice(METHODS), ignore_case = true)]
    method: Option<MethodName>,
    /// Training steps, one photo each [default: 30000]. More is slower and mostly better; with a few dozen
    /// photos 7000 may be as good. The schedule of genesplat fits into them; those of published methods are
    /// cut short
    #[arg(long, value_name = "N", aliases = STEPS, value_parser = clap::value_parser!(u32).range(1..))]
    iterations: Option<u32>,
    /// Train for about M minutes on this machine, loading and scoring included: as many iterations as fit, at
    /// most 30000, by what a few steps take here. The run's config.toml has their number, and repeats it
    #[arg(long, value_name = "M", value_parser = minutes, conflicts_with_all = ["iterations", "resume", "steps_scale"])]
    pub(crate) minutes: Option<f64>,
    /// Photos whose gradients are summed for one step of the optimiser [default: 1]. Rates grow by its square
    /// root; makes sense where many processes share a run, and steps are fewer
    #[arg(long, value_name = "B", value_parser = clap::value_parser!(u32).range(1..=1000), help_heading = MORE)]
    views_per_step: Option<u32>,
    /// Multiply every setting that counts steps by F, 0.001 to 1000 [default: 1]. 0.1 gives the whole
    /// schedule in a tenth of the steps; no interval gets shorter than 100
    #[arg(long, value_name = "F", value_parser = scale, help_heading = MORE)]
    steps_scale: Option<f64>,
    /// Seed of all random numbers [default: 0]. Same seed, same bytes, with one build on CPUs of one kind
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u64).range(SEEDS))]
    seed: Option<u64>,
    /// Train at most this many Gaussians, from the first step on [default: with genesplat the cloud grows to
    /// as many as the photos can determine, and a denser cloud of points is thinned; else no limit, but
    /// 1000000 with mcmc and improved-gs, which grow towards it on a curve of their own]. Bounds memory (2 to
    /// 2.5 KB a Gaussian) and time
    #[arg(long, value_name = "N", value_parser = positive)]
    max_gaussians: Option<usize>,
    /// Iterations between two checkpoints [default: 1000]; 0 for none but that of Ctrl-C and SIGTERM
    #[arg(long, value_name = "N", help_heading = MORE)]
    checkpoint_every: Option<u32>,
}

impl ScheduleArgs {
    /// How long a run is is asked for, in steps or in minutes.
    fn is_long_as_asked(&self) -> bool {
        self.iterations.is_some() || self.minutes.is_some()
    }

    fn override_config(&self, train: &mut TrainConfig) {
        if let Some(name) = self.method.filter(|&name| name != train.method.name) {
            // The settings of a file are those of its own method.
            train.method = MethodConfig::of(name);
        }
        replace(&mut train.iterations, self.iterations);
        replace(&mut train.steps_scale, self.steps_scale);
        replace(&mut train.views_per_step, self.views_per_step);
        replace(&mut train.seed, self.seed);
        train.max_gaussians = self.max_gaussians.or(train.max_gaussians);
        replace(&mut train.checkpoint_every, self.checkpoint_every);
    }
}

/// The published search.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct SearchArgs {
    /// Search after each opacity reset with the genetic algorithm of "An Evolutionary Boost to Gaussian
    /// Splatting Optimization", with any method that resets opacities
    #[arg(long)]
    pub(crate) genetic: bool,
    /// Generations of each search, at least 1 [default: 100]. Time grows in proportion
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), help_heading = MORE)]
    pub(crate) generations: Option<u32>,
    /// Individuals a generation, 1 to 10000 [default: 100]. Time grows in proportion
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000), help_heading = MORE)]
    pub(crate) population: Option<u32>,
}

impl SearchArgs {
    /// Flags over the file; without a search there is nothing to change. A tournament cannot draw more
    /// individuals than there are, so a small population shrinks it.
    pub(crate) fn override_config(&self, train: &mut TrainConfig) -> Result<()> {
        if self.genetic {
            ensure!(
                train.method.name.resets(),
                "--genetic searches after opacity resets, and {} has none; choose another --method, or leave it out",
                train.method.name
            );
            train.genetic.get_or_insert_default();
        }
        let is_asked = self.generations.is_some() || self.population.is_some();
        let Some(genetic) = &mut train.genetic else {
            ensure!(
                !is_asked,
                "--generations and --population are of --genetic; add that, or leave them out"
            );
            return Ok(());
        };
        replace(&mut genetic.generations, self.generations);
        if let Some(population) = self.population {
            genetic.population = population;
            genetic.tournament = genetic.tournament.min(population);
        }
        Ok(())
    }
}

/// How Gaussians are shown: options that users of other trainers know.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = MORE)]
pub(crate) struct ShownArgs {
    /// Colour behind the scene [default: black]. White suits objects cut out of their photos; random keeps
    /// them opaque
    #[arg(long, value_name = "COLOUR", value_parser = choice(BACKGROUNDS), ignore_case = true)]
    background: Option<Background>,
    /// Dim Gaussians smaller than a pixel instead of only widening them, so that views from afar do not
    /// swell. Not with --method mip-splatting, which has a filter of its own
    #[arg(long)]
    antialiasing: bool,
}

impl ShownArgs {
    fn override_config(&self, train: &mut TrainConfig) {
        replace(&mut train.background, self.background);
        train.antialiasing |= self.antialiasing;
    }
}

/// Flags of earlier versions, each with a sentence that names the new one.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct OldArgs {
    #[arg(long, hide = true, value_parser = variant_is_method)]
    variant: Option<String>,
    #[arg(long, hide = true, value_parser = evolve_is_method)]
    evolve: Option<String>,
    #[arg(long, hide = true, value_parser = signal_is_gone)]
    densify_signal: Option<String>,
}

fn variant_is_method(name: &str) -> Result<String, String> {
    Err(format!("it is --method {name} now; --method genesplat is what mode renew was"))
}

fn evolve_is_method(mode: &str) -> Result<String, String> {
    Err(match mode {
        "paper" => "it is --genetic now, with any --method that resets opacities".into(),
        "off" => "a published method has nothing beside it now: --method 3dgs, say".into(),
        _ => "it is --method genesplat now, which is the default".into(),
    })
}

fn signal_is_gone(_: &str) -> Result<String, String> {
    Err("each method has its own signal now; --method improved-gs and genesplat take absolute gradients"
        .into())
}

fn replace<T>(setting: &mut T, flag: Option<T>) {
    if let Some(value) = flag {
        *setting = value;
    }
}

fn minutes(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|minutes| RANGE.contains(minutes))
        .ok_or_else(|| "a number between 0.1 and 10000 is needed".into())
}

fn positive(text: &str) -> Result<usize, String> {
    text.parse()
        .ok()
        .filter(|&count: &usize| count > 0)
        .ok_or_else(|| "a whole number from 1 is needed".into())
}
