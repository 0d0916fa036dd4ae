//! Who finds the cameras: Python's pycolmap, or the program `colmap`, whichever this machine has.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::AtomicBool;

use anyhow::{Result, anyhow, bail, ensure};
use genesplat::io::shown;
use genesplat::run::numbers::thousands;
use serde::Deserialize;
use serde_json::{Value, json};

use super::database::{self, Version};
use super::process;
use super::stages::{Job, Pairing, Stage};
use super::summary::{Compared, none_found, pairs_of};
use crate::programs::Programs;

/// Names the Python to use.
const PYTHON: &str = "GENESPLAT_PYTHON";
/// One script, of parts that each know those before it.
const DRIVER: &str = concat!(
    include_str!("pairs.py"),
    include_str!("matching.py"),
    include_str!("cameras.py"),
    include_str!("sides.py"),
    include_str!("turned.py"),
    include_str!("driver.py")
);
/// How numpy is told of threads.
const NUMPY_THREADS: &str = "OPENBLAS_NUM_THREADS";
/// Features are looked for at this size, px: larger photos are reduced, which costs hardly a camera and saves
/// minutes.
const MAX_SIDE: u32 = 1600;
/// Most features of a photo, the largest of those that are found.
const MAX_FEATURES: u32 = 8192;
/// Square pixels and one coefficient of distortion. With a focal length for each direction (`OPENCV`), which
/// photos of an object on a turntable do not tell, a shoe was found at a quarter of its height.
const CAMERA_MODEL: &str = "SIMPLE_RADIAL";
/// Photos of all around have nothing to find, and four times as much of the world on a side.
const ROUND_MODEL: &str = "EQUIRECTANGULAR";
const ROUND_MAX_SIDE: u32 = 2 * MAX_SIDE;

/// Frames of a film before and after one that the program `colmap` compares with it.
const NEIGHBOURS: &str = "10";

/// What the program `colmap` says, and fails, where photos share too little.
const NO_MODEL: &str = "failed to create sparse model";

pub(crate) struct Engine {
    tool: Tool,
    programs: Programs,
}

/// What a line of an engine says; most lines say nothing of this.
#[derive(Debug, Default, PartialEq, Deserialize)]
#[serde(default)]
pub(crate) struct Said {
    /// What is counted: features, matches or cameras.
    pub(crate) what: Option<String>,
    pub(crate) done: Option<usize>,
    pub(crate) total: Option<usize>,
    /// Photos without a camera that are tried again, by so many `pairs`.
    pub(crate) retried: Option<usize>,
    pub(crate) pairs: usize,
    /// Photos of a group that most matches contradict, and cameras are looked for anew.
    pub(crate) doubted: Option<usize>,
    /// The same, where that has not helped.
    pub(crate) unsure: Option<usize>,
    /// What chose the pairs that are matched.
    pub(crate) chosen_by: Option<Vec<String>>,
    pub(crate) compared: Option<Compared>,
    /// Mean reprojection errors of models, px.
    pub(crate) errors_px: BTreeMap<String, f64>,
}

enum Tool {
    Pycolmap {
        python: PathBuf,
        version: String,
    },
    Colmap {
        program: PathBuf,
        version: Option<Version>,
        /// Since version 3.13, options of features are no longer those of SIFT.
        has_feature_options: bool,
    },
}

impl Engine {
    pub(crate) fn find(programs: Programs) -> Result<Self> {
        Ok(Self { tool: Tool::find(&programs)?, programs })
    }

    pub(crate) fn name(&self) -> String {
        match &self.tool {
            Tool::Pycolmap { version, .. } => format!("pycolmap {version}"),
            Tool::Colmap { program, .. } => shown(program),
        }
    }

    /// The Python that has pycolmap, with this `script`.
    pub(crate) fn python(&self, script: &str) -> Option<Command> {
        let Tool::Pycolmap { python, .. } = &self.tool else { return None };
        Some(self.programs.python(python, script))
    }

    pub(crate) fn command(&self, stage: Stage, job: &Job) -> Command {
        match &self.tool {
            Tool::Pycolmap { python, .. } => {
                let mut command = self.programs.python(python, DRIVER);
                command.arg(request(stage, job).to_string());
                if let Some(threads) = job.threads {
                    command.env(NUMPY_THREADS, threads.to_string());
                }
                command
            }
            Tool::Colmap { program, has_feature_options, .. } => {
                colmap_command(self.programs.command(program), *has_feature_options, stage, job)
            }
        }
    }

    pub(crate) fn hear(&self, stage: Stage, line: &str) -> Said {
        match &self.tool {
            Tool::Pycolmap { .. } => serde_json::from_str(line).unwrap_or_default(),
            Tool::Colmap { .. } => Said { done: colmap_progress(stage, line), ..Said::default() },
        }
    }

    /// Which pairs the program `colmap` compares, where that is certain; pycolmap counts them.
    pub(crate) fn compared(&self, job: &Job) -> Option<Compared> {
        let is_certain = matches!(self.tool, Tool::Colmap { .. }) && job.pairing != Pairing::Sequence;
        is_certain.then(|| Compared::all_of(job.photos))
    }

    /// What pycolmap does better, where it counts.
    pub(crate) fn notice(&self, job: &Job) -> Option<String> {
        let Tool::Colmap { .. } = self.tool else { return None };
        let what = match job.pairing {
            Pairing::All => return None,
            Pairing::Sequence => "frames with their neighbours alone".to_owned(),
            Pairing::Looks => {
                format!("all {} pairs of photos, which is slow", thousands(pairs_of(job.photos)))
            }
        };
        Some(format!(
            "notice: the program colmap compares {what}; pycolmap compares those that look alike (`pip install pycolmap`)"
        ))
    }

    /// Fails where photos of all around are beyond it.
    pub(crate) fn check_round(&self) -> Result<()> {
        let script = format!("import pycolmap; print(pycolmap.CameraModelId.{ROUND_MODEL})");
        let knows = self.python(&script).and_then(|mut python| output_of(&mut python)).is_some();
        ensure!(
            knows,
            "the photos show all around, and {} does not know cameras of such photos, as pycolmap 4.2 does; install it \
             (`pip install --upgrade pycolmap`)",
            self.name()
        );
        Ok(())
    }

    /// Why a stage has failed: the program `colmap` ends so where it finds no cameras, and it may be older
    /// than the one that the search has begun with.
    pub(crate) fn explained(&self, error: anyhow::Error, job: &Job) -> anyhow::Error {
        if error.to_string().contains(NO_MODEL) {
            return anyhow!(none_found(job.photos));
        }
        let own = match &self.tool {
            Tool::Pycolmap { version, .. } => database::version_in(version),
            Tool::Colmap { version, .. } => *version,
        };
        let (Some(own), Some(by)) = (own, database::written_by(&job.database)) else { return error };
        if own >= by {
            return error;
        }
        let ([own_major, own_minor], [major, minor]) = (own, by);
        anyhow!(
            "{} is COLMAP {own_major}.{own_minor}, and does not read what COLMAP {major}.{minor} has written, with which this search was \
             begun; go on with that one ({PYTHON} names a Python that has it), or choose another --out",
            self.name()
        )
    }

    /// Asks the program `colmap` for the errors that pycolmap has said already.
    pub(crate) fn measure(
        &self,
        job: &Job,
        log: &Path,
        stop: &AtomicBool,
        errors_px: &mut BTreeMap<String, f64>,
    ) -> Result<()> {
        let Tool::Colmap { program, .. } = &self.tool else { return Ok(()) };
        for model in std::fs::read_dir(&job.models)?.flatten() {
            let mut command = self.programs.command(program);
            command.arg("model_analyzer").arg("--path").arg(model.path());
            process::run(&mut command, log, stop, |line| {
                let error = line
                    .split("Mean reprojection error:")
                    .nth(1)
                    .map(|rest| rest.trim().trim_end_matches("px"));
                if let Some(error) = error.and_then(|error| error.parse().ok()) {
                    errors_px.insert(model.file_name().to_string_lossy().into_owned(), error);
                }
            })?;
        }
        Ok(())
    }
}

#[cfg(test)]
impl Engine {
    pub(super) fn of_python(python: &str) -> Self {
        let tool = Tool::Pycolmap { python: python.into(), version: "4".into() };
        Self { tool, programs: Programs::default() }
    }
}

impl Tool {
    /// The Python of `GENESPLAT_PYTHON`, else one on `PATH` that has pycolmap, else the program `colmap`
    /// there.
    fn find(programs: &Programs) -> Result<Self> {
        let install = "install it (`pip install pycolmap`, 40 MB, works offline)";
        if let Some(named) = std::env::var_os(PYTHON) {
            let found = programs.named(&named).and_then(|python| Self::pycolmap(python, programs));
            return found.ok_or_else(|| {
                anyhow!(
                    "{PYTHON} names {}, which has no pycolmap; {install}, or name another Python",
                    shown(named)
                )
            });
        }
        let pythons = ["python3", "python"].into_iter().filter_map(|name| programs.find(&[name]));
        if let Some(found) = pythons.into_iter().find_map(|python| Self::pycolmap(python, programs)) {
            return Ok(found);
        }
        if let Some(program) = programs.find(&["colmap"]) {
            let help =
                output_of(programs.command(&program).args(["feature_extractor", "-h"])).unwrap_or_default();
            return Ok(Self::Colmap {
                program,
                version: database::version_in(&help),
                has_feature_options: help.contains("--FeatureExtraction.use_gpu"),
            });
        }
        bail!(
            "cameras are found by pycolmap, and no Python on PATH has it; {install}, or put the program colmap on PATH; {PYTHON} names \
             a Python elsewhere"
        )
    }

    /// `python`, if it has pycolmap.
    fn pycolmap(python: PathBuf, programs: &Programs) -> Option<Self> {
        let said = output_of(&mut programs.python(&python, "import pycolmap; print(pycolmap.__version__)"))?;
        let version = Some(said.trim().to_owned()).filter(|version| !version.is_empty())?;
        Some(Self::Pycolmap { python, version })
    }
}

/// What a program writes to stdout, if it succeeds.
fn output_of(command: &mut Command) -> Option<String> {
    let ran = command.output().ok()?;
    ran.status.success().then(|| String::from_utf8_lossy(&ran.stdout).into_owned())
}

/// What the driver is told.
fn request(stage: Stage, job: &Job) -> Value {
    let text = |path: &Path| path.to_string_lossy().into_owned();
    json!({
        "stage": stage.name(),
        "images": text(&job.images),
        "masks": job.masks.as_deref().map(text),
        "database": text(&job.database),
        "models": text(&job.models),
        "photos": job.photos,
        "sizes": job.sizes,
        "single_camera": job.single_camera,
        "camera_model": if job.is_round { ROUND_MODEL } else { CAMERA_MODEL },
        "is_round": job.is_round,
        "max_distortion": max_distortion(job),
        "pairing": job.pairing,
        "threads": job.threads.map_or(-1, i32::from),
        "max_side": if job.is_round { ROUND_MAX_SIDE } else { MAX_SIDE },
        "max_features": MAX_FEATURES,
    })
}

/// COLMAP gives up the photos of a camera whose distortion is larger. The usual limit, 1, suits a focal
/// length of one photo's width; at ten of them, its longest, a coefficient of 100 bends as much. Photos that
/// one camera took correct what a few of them have made up.
fn max_distortion(job: &Job) -> f64 {
    if job.single_camera { 100.0 } else { 1.0 }
}

/// `colmap` with the arguments of a stage.
fn colmap_command(mut colmap: Command, has_feature_options: bool, stage: Stage, job: &Job) -> Command {
    let [extraction, matching] = match has_feature_options {
        true => ["FeatureExtraction", "FeatureMatching"],
        false => ["SiftExtraction", "SiftMatching"],
    };
    let threads = job.threads.map_or(-1, i32::from).to_string();
    match stage {
        Stage::Features => {
            colmap.arg("feature_extractor").arg("--image_path").arg(&job.images);
            colmap.arg("--database_path").arg(&job.database);
            if let Some(masks) = &job.masks {
                colmap.arg("--ImageReader.mask_path").arg(masks);
            }
            let single = i32::from(job.single_camera && job.sizes.is_empty()).to_string();
            colmap.args(["--ImageReader.single_camera", &single, "--ImageReader.camera_model", CAMERA_MODEL]);
            colmap.args([format!("--{extraction}.use_gpu"), "0".into()]);
            colmap.args([format!("--{extraction}.num_threads"), threads]);
            colmap.args([format!("--{extraction}.max_image_size"), MAX_SIDE.to_string()]);
            colmap.args(["--SiftExtraction.max_num_features", &MAX_FEATURES.to_string()]);
        }
        Stage::Matches => {
            let is_sequence = job.pairing == Pairing::Sequence;
            colmap.arg(if is_sequence { "sequential_matcher" } else { "exhaustive_matcher" });
            colmap.arg("--database_path").arg(&job.database);
            colmap.args([format!("--{matching}.use_gpu"), "0".into()]);
            colmap.args([format!("--{matching}.num_threads"), threads]);
            if is_sequence {
                // Since version 4, neighbours at distances of powers of two would take the place of the
                // others.
                colmap.args(["--SequentialMatching.overlap", NEIGHBOURS]);
                colmap.args(["--SequentialMatching.quadratic_overlap", "0"]);
            }
        }
        Stage::Cameras => {
            colmap.arg("mapper").arg("--database_path").arg(&job.database);
            colmap.arg("--image_path").arg(&job.images).arg("--output_path").arg(&job.models);
            colmap.args(["--Mapper.num_threads", &threads]);
            colmap.args(["--Mapper.max_extra_param", &max_distortion(job).to_string()]);
        }
    }
    colmap
}

/// `Processed file [3/50]`, or `Registering image #12 (7)`, in the words of several versions.
fn colmap_progress(stage: Stage, line: &str) -> Option<usize> {
    let number = |text: &str| {
        let digits: String = text.chars().take_while(char::is_ascii_digit).collect();
        digits.parse().ok()
    };
    match stage {
        Stage::Features => number(line.split("Processed file [").nth(1)?),
        Stage::Matches => None,
        Stage::Cameras => {
            let rest = line.split("Registering image #").nth(1)?.split_once('(')?.1;
            number(rest.trim_start_matches("num_reg_frames="))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn job() -> Job {
        let [images, database, models] = ["images", "database.db", "models"].map(PathBuf::from);
        Job {
            images,
            masks: Some("masks".into()),
            photos: 9,
            single_camera: true,
            sizes: Vec::new(),
            is_round: false,
            pairing: Pairing::Sequence,
            threads: Some(2),
            database,
            models,
        }
    }

    fn words(command: &Command) -> String {
        command.get_args().map(|word| word.to_string_lossy()).collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn the_program_is_told_what_pycolmap_is_told() {
        let of = |stage, new| words(&colmap_command(Command::new("colmap"), new, stage, &job()));
        let features = of(Stage::Features, false);
        assert!(
            features.starts_with("feature_extractor --image_path images --database_path database.db"),
            "{features}"
        );
        assert!(features.contains("--ImageReader.mask_path masks"), "{features}");
        assert!(
            features.contains("--SiftExtraction.use_gpu 0") && features.contains("single_camera 1"),
            "{features}"
        );
        assert!(of(Stage::Features, true).contains("--FeatureExtraction.max_image_size 1600"));
        assert!(of(Stage::Matches, true).starts_with("sequential_matcher --database_path database.db"));
        assert!(of(Stage::Matches, true).contains("overlap 10 --SequentialMatching.quadratic_overlap 0"));
        assert!(of(Stage::Cameras, true).contains("--output_path models"));
        assert!(of(Stage::Cameras, true).ends_with("--Mapper.max_extra_param 100"));
    }

    #[test]
    fn what_both_say_is_heard() {
        let tool =
            Tool::Colmap { program: "colmap".into(), version: Some([3, 13]), has_feature_options: true };
        let colmap = Engine { tool, programs: Programs::default() };
        let done = |engine: &Engine, stage, line: &str| engine.hear(stage, line).done;
        assert_eq!(done(&colmap, Stage::Features, "I2026 x.cc:1] Processed file [3/50]"), Some(3));
        assert_eq!(done(&colmap, Stage::Cameras, "Registering image #12 (7)"), Some(7));
        assert_eq!(done(&colmap, Stage::Cameras, "Registering image #12 (num_reg_frames=7)"), Some(7));
        let pycolmap = Engine::of_python("python3");
        let said = pycolmap.hear(Stage::Cameras, r#"{"what": "matches", "done": 4, "total": 36}"#);
        assert_eq!((said.what.as_deref(), said.done, said.total), (Some("matches"), Some(4), Some(36)));
        assert_eq!(pycolmap.hear(Stage::Matches, "I2026 matching.cc"), Said::default());
        let errors_px = pycolmap.hear(Stage::Cameras, r#"{"errors_px": {"0": 0.5}}"#).errors_px;
        assert_eq!(errors_px, [("0".to_owned(), 0.5)].into());
        let line = r#"{"compared": {"pairs": 9, "of": 36, "left_out_with_all": true}}"#;
        let compared = pycolmap.hear(Stage::Cameras, line).compared.unwrap();
        assert_eq!((compared.pairs, compared.of, compared.left_out_with_all), (9, 36, true));
    }

    #[test]
    fn the_program_compares_all_photos_and_says_that_this_is_slow() {
        let tool =
            Tool::Colmap { program: "colmap".into(), version: Some([3, 13]), has_feature_options: true };
        let colmap = Engine { tool, programs: Programs::default() };
        let unordered = Job { photos: 178, pairing: Pairing::Looks, ..job() };
        let notice = colmap.notice(&unordered).unwrap();
        assert!(notice.contains("all 15,753 pairs") && notice.contains("pip install pycolmap"), "{notice}");
        assert_eq!(colmap.compared(&unordered), Some(Compared::all_of(178)));
        assert!(colmap.notice(&job()).unwrap().contains("neighbours alone"));
        assert_eq!(colmap.compared(&job()), None);
        let pycolmap = Engine::of_python("python3");
        assert_eq!((pycolmap.notice(&unordered), pycolmap.compared(&unordered)), (None, None));
    }
}
