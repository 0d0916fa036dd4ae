//! Why a scene could not be loaded: one sentence each, that says what, where, and what to do.

use std::io;
use std::path::{Path, PathBuf};

use crate::photos::PhotoError;
use crate::ply::PlyError;
use crate::{command_line, shown};

/// Why a scene could not be loaded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// Nothing at the path.
    #[error("{} does not exist; give the folder that holds the scene", shown(.0))]
    Missing(PathBuf),
    /// No room for photos that memory should not hold.
    #[error(
        "cannot keep the photos in a file in {}: {source}; make room there, or load them smaller (--max-side)",
        shown(.folder)
    )]
    CannotKeepPhotos {
        /// Where the file would be.
        folder: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A photo that was put into a file is not there any more.
    #[error(transparent)]
    PhotoLost(#[from] genesplat_core::PhotoLost),
    /// A folder of no known form.
    #[error(
        "{} is not a scene that genesplat knows: expected a COLMAP model in sparse/0 (cameras, images and points3D \
         as .bin or .txt), a Blender transforms_train.json, or a nerfstudio transforms.json",
        shown(.0)
    )]
    Unrecognised(PathBuf),
    /// Photos or a video, of which nothing says where they were taken from.
    #[error(
        "{} {what}, and training needs to know where each photo was taken from; find that out with `{} --out SCENE` and \
         train SCENE, or add --poses to train",
        shown(.path),
        command_line(["genesplat", "poses", &shown(.path)])
    )]
    NoCameras {
        /// What was asked for.
        path: PathBuf,
        /// What it is.
        what: String,
    },
    /// The operating system refused.
    #[error("cannot read {}: {source}", shown(.file))]
    Read {
        /// The file.
        file: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A binary file with more or fewer bytes than it says.
    #[error("{} {problem}, so copy or export it again", shown(.file))]
    Damaged {
        /// The file.
        file: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// A text file that does not follow its grammar.
    #[error("{}, line {line}: expected {expected}; repair the line or export the file again", shown(.file))]
    Syntax {
        /// The file.
        file: PathBuf,
        /// 1-based.
        line: usize,
        /// What should be there.
        expected: &'static str,
    },
    /// A JSON file that does not parse, or lacks a field.
    #[error("{} is not a valid description of cameras: {source}; repair it or export it again", shown(.file))]
    Json {
        /// The file.
        file: PathBuf,
        /// Where and why.
        source: serde_json::Error,
    },
    /// A file whose records cannot be used together: names that occur twice or lead out of the scene, lists
    /// that contradict each other, too few photos or points.
    #[error("{} {problem}", shown(.file))]
    Invalid {
        /// The file, or the folder of the scene.
        file: PathBuf,
        /// What is wrong, and what to do.
        problem: String,
    },
    /// A record that cannot be: a pose or a point that is not finite, a photo of no camera.
    #[error("{}: {problem}", shown(.file))]
    BadRecord {
        /// The file.
        file: PathBuf,
        /// Which record, what is wrong, and what to do.
        problem: String,
    },
    /// A camera model of COLMAP that is not known.
    #[error(
        "{}: camera {camera} uses the model {}, which genesplat does not know; run COLMAP's image_undistorter on the \
         reconstruction and load its output folder",
        shown(.file),
        shown(.model)
    )]
    DistortedCamera {
        /// The file.
        file: PathBuf,
        /// Its id.
        camera: u32,
        /// COLMAP's name of the model.
        model: String,
    },
    /// A lens model that genesplat cannot undo.
    #[error(
        "{} uses the camera model {}, and genesplat reads only {}; undistort the photos first",
        shown(.file),
        shown(.model),
        crate::transforms::KNOWN_MODELS.join(", ")
    )]
    UnknownLens {
        /// The file.
        file: PathBuf,
        /// As the file names it.
        model: String,
    },
    /// Intrinsics that no camera has.
    #[error("{}: camera {} {problem}; calibrate it again", shown(.file), shown(.camera))]
    BadCamera {
        /// The file.
        file: PathBuf,
        /// Its id or the photo that it belongs to.
        camera: String,
        /// What is wrong.
        problem: String,
    },
    /// Cameras where the steps of single precision are not small beside the scene.
    #[error(
        "{} has a scene far from its origin, so that single precision is lost: its cameras are within {radius:.3} units of \
         their middle, and have coordinates up to {distance:.0}; {}",
        shown(.file),
        crate::scene::precision::CENTRE
    )]
    FarFromOrigin {
        /// The file that lists the cameras.
        file: PathBuf,
        /// Largest coordinate of a camera, world units.
        distance: f64,
        /// Largest distance of a camera from their middle, world units.
        radius: f64,
    },
    /// Every listed photo is absent.
    #[error("none of the {count} photos that {} lists is in {}{remedy}", shown(.list), shown(.folder))]
    AllPhotosMissing {
        /// How many are listed.
        count: usize,
        /// The file with the list.
        list: PathBuf,
        /// Where they should be.
        folder: PathBuf,
        /// What else is there, if anything is, and what to do.
        remedy: String,
    },
    /// A photo of another shape than its camera's, or too small to learn from.
    #[error("the photo {} {problem}", shown(.photo))]
    BadPhoto {
        /// The photo.
        photo: PathBuf,
        /// What is wrong, and what to do.
        problem: String,
    },
    /// A photo that cannot be decoded.
    #[error(transparent)]
    Photo(#[from] PhotoError),
    /// A point cloud that cannot be read.
    #[error(transparent)]
    Points(#[from] PlyError),
}

impl SceneError {
    pub(crate) fn invalid(file: &Path, problem: impl Into<String>) -> Self {
        Self::Invalid { file: file.to_owned(), problem: problem.into() }
    }

    pub(crate) fn bad_record(file: &Path, problem: impl Into<String>) -> Self {
        Self::BadRecord { file: file.to_owned(), problem: problem.into() }
    }
}
