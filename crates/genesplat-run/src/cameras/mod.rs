//! Cameras that are not quite right, moved before training.
//!
//! Where the reconstruction says which points photos show, and where (COLMAP's features), a camera is moved to
//! where these points lie on its photo (`points.rs`); test cameras, too. Elsewhere training cameras are moved
//! to where photos and clouds agree (`photos.rs`), and test cameras stay: no test photo is looked at. Either is
//! done only where it explains much of what does not fit, so cameras that are right keep every bit.

mod align;
mod common;
mod motion;
mod photos;
mod points;
mod solve;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, Result};
use genesplat_core::View;
use genesplat_io::{LoadOptions, Point, Scene, ScenePhoto, colmap::write_model, list_scene, model_of, own};
use genesplat_train::TrainConfig;
use serde::{Deserialize, Serialize};

pub use motion::Motion;

use crate::device::Device;
use crate::exposure::by_photo;
use crate::output;
use photos::Pilot;

/// Points that lie nearer to where photos show them, px, on the median, are well enough.
const FINE_PX: f64 = 0.2;
/// Points move cameras where they end at most so far from where they are shown, of what it was.
const POINTS_WORTH: f64 = 0.5;
/// Photos move cameras where that explains this of how they differ from a cloud.
const PHOTOS_WORTH: f64 = 0.05;
/// Fewer photos agree by chance.
const PHOTOS_MIN: usize = 8;
/// Shorter runs have no time for it.
const ITERATIONS_MIN: f64 = 1500.0;

/// How cameras were moved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cameras {
    /// What has moved them.
    pub by: Evidence,
    /// By the names of photos. One that is not there stays.
    pub photos: BTreeMap<String, Motion>,
}

/// What moves cameras.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Evidence {
    /// The points that photos show.
    Points {
        /// How far they lay from where photos show them, px, on the median.
        before_px: f64,
        /// How far they do.
        after_px: f64,
    },
    /// What photos show.
    Photos {
        /// The share of how they differ from a cloud that a first motion explains: what one half of each photo
        /// asks for, judged by the other.
        explained: f64,
    },
}

/// How the points of `scene` move its cameras, if these do not stand where they should.
pub fn told_by_points(scene: &Scene) -> Option<Cameras> {
    let [train, test] = [&scene.train, &scene.test].map(|views| points::resect(scene, views));
    let [before_px, after_px] = points::median_errors_px(&train)?;
    if before_px < FINE_PX || after_px > POINTS_WORTH * before_px {
        return None;
    }
    let views = scene.train.iter().chain(&scene.test);
    let moved = views.zip(train.into_iter().chain(test));
    let photos = moved.filter_map(|(view, found)| Some((view.name.clone(), found?.motion))).collect();
    Some(Cameras { by: Evidence::Points { before_px, after_px }, photos })
}

/// Whether the points of `scene` say where cameras stand.
pub fn have_points(scene: &Scene) -> bool {
    scene.seen.values().flatten().any(|sight| sight.ray.is_some())
}

/// How the photos of `scene` move their cameras for a run with `config`, if these do not stand where they
/// should.
pub fn told_by_photos(
    scene: &Scene,
    config: &TrainConfig,
    device: &mut Device,
    stop: &AtomicBool,
) -> Result<Option<Cameras>> {
    let photos: Vec<&[View]> = by_photo(scene, &scene.train).collect();
    if photos.len() < PHOTOS_MIN {
        return Ok(None);
    }
    let mut pilot = Pilot::new(device, &photos, scene, config, stop)?;
    let explained = match pilot.worth() {
        Ok(explained) => explained,
        // The run itself says it better.
        Err(error) => {
            output::detail(&format!("whether cameras stand where they should is not told: {error:#}"));
            return Ok(None);
        }
    };
    output::detail(&format!(
        "a first motion of cameras explains {:.1} % of how photos differ from a cloud",
        100.0 * explained
    ));
    if explained < PHOTOS_WORTH || pilot.is_stopped() {
        return Ok(None);
    }
    output::tell("cameras do not stand where photos show it, and are moved");
    let motions = pilot.motions()?;
    let names = photos.iter().map(|views| scene.photo_of(&views[0].name).to_owned());
    let photos = names.zip(motions).collect();
    Ok((!pilot.is_stopped()).then_some(Cameras { by: Evidence::Photos { explained }, photos }))
}

/// Whether a run with `config` is long enough to look for it.
pub fn is_long_enough(config: &TrainConfig) -> bool {
    f64::from(config.iterations) * config.steps_scale >= ITERATIONS_MIN
}

impl Cameras {
    /// Moves those of `scene`.
    pub fn apply(&self, scene: &mut Scene) {
        let Scene { train, test, whole, .. } = scene;
        for view in train.iter_mut().chain(test) {
            let photo = whole.get(&view.name).unwrap_or(&view.name);
            if let Some(motion) = self.photos.get(photo) {
                view.camera = motion.of_camera(&view.camera);
            }
        }
    }

    /// Without the photos whose names `keeps` does not want.
    pub(crate) fn only(&self, keeps: impl Fn(&str) -> bool) -> Self {
        let mut only = self.clone();
        only.photos.retain(|name, _| keeps(name));
        only
    }

    /// What was done.
    pub fn told(&self) -> String {
        let mean = |of: fn(&Motion) -> f64| {
            self.photos.values().map(of).sum::<f64>() / self.photos.len().max(1) as f64
        };
        let (degrees, units) = (mean(Motion::angle).to_degrees(), mean(Motion::distance));
        let moved = format!(
            "{} cameras are moved, by {degrees:.2}° and {units:.3} units on average, to where",
            self.photos.len()
        );
        match self.by {
            Evidence::Points { before_px, after_px } => format!(
                "{moved} their photos show the points of the reconstruction: these were {before_px:.1} px away, and are {after_px:.1} px"
            ),
            Evidence::Photos { explained } => format!(
                "{moved} photos agree: a first motion explains {:.0} % of what half of each differs by, as the other half tells it",
                100.0 * explained
            ),
        }
    }

    /// Writes the moved cameras of the scene at `path` as COLMAP's model into `folder` of `run`, with the
    /// points that training starts from.
    pub fn write(
        &self,
        (run, folder): (&Path, &Path),
        path: &Path,
        options: &LoadOptions,
        points: &[Point],
    ) -> Result<()> {
        let list = list_scene(path, options)?;
        let moved = |photo: &ScenePhoto| match self.photos.get(&photo.name) {
            Some(motion) => ScenePhoto { camera: motion.of_camera(&photo.camera), ..photo.clone() },
            None => photo.clone(),
        };
        let photos: Vec<ScenePhoto> = list.photos.iter().map(moved).collect();
        let model = model_of(&photos.iter().collect::<Vec<_>>(), points.to_vec());
        let written = own::make_folder(run, folder).and_then(|folder| write_model(&folder, &model));
        written.with_context(|| format!("cannot write {}", genesplat_io::shown(run.join(folder))))
    }
}
