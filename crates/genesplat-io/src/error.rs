//! Why a scene could not be loaded: one sentence each, that says what, where, and what to do.

use std::io;
use std::path::PathBuf;

use crate::photos::PhotoError;
use crate::ply::PlyError;

/// Why a scene could not be loaded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// Nothing at the path.
    #[error("{path} does not exist; give the folder that holds the scene")]
    Missing {
        /// What was asked for.
        path: PathBuf,
    },
    /// A folder of no known form.
    #[error(
        "{path} is not a scene that genesplat knows: expected a COLMAP model in sparse/0 (cameras, images and points3D \
         as .bin or .txt), a Blender transforms_train.json, or a nerfstudio transforms.json"
    )]
    Unrecognised {
        /// The folder.
        path: PathBuf,
    },
    /// A folder inside of a scene.
    #[error("{path} is a part of a scene; give {scene}, the folder that holds sparse and images")]
    PartOfScene {
        /// What was asked for.
        path: PathBuf,
        /// What was meant.
        scene: PathBuf,
    },
    /// The operating system refused.
    #[error("cannot read {file}: {source}")]
    Read {
        /// The file.
        file: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A binary file that ends too early.
    #[error("{file} ends in the middle of {record}; the file was cut off, so copy or export it again")]
    Truncated {
        /// The file.
        file: PathBuf,
        /// What was being read.
        record: &'static str,
    },
    /// A count that the file cannot back.
    #[error(
        "{file} claims {claimed} {records} where its bytes can hold at most {fits}; the file is damaged, so copy or \
         export it again"
    )]
    ImpossibleCount {
        /// The file.
        file: PathBuf,
        /// What it claims.
        claimed: u64,
        /// Of what.
        records: &'static str,
        /// How many records the rest of the file could hold.
        fits: usize,
    },
    /// A binary file that goes on where it should end.
    #[error(
        "{file} holds more than the {records} that it counts: something follows its end; the file is damaged, so \
         copy or export it again"
    )]
    Trailing {
        /// The file.
        file: PathBuf,
        /// What it holds.
        records: &'static str,
    },
    /// A text file that does not follow its grammar.
    #[error("{file}, line {line}: expected {expected}; repair the line or export the file again")]
    Syntax {
        /// The file.
        file: PathBuf,
        /// 1-based.
        line: usize,
        /// What should be there.
        expected: &'static str,
    },
    /// A JSON file that does not parse, or lacks a field.
    #[error("{file} is not a valid description of cameras: {source}; repair it or export it again")]
    Json {
        /// The file.
        file: PathBuf,
        /// Where and why.
        source: serde_json::Error,
    },
    /// A file name that is not text.
    #[error(
        "{file} lists a photo whose name is not UTF-8 ({name}); rename the photo and export the scene again"
    )]
    NameNotUtf8 {
        /// The file with the list.
        file: PathBuf,
        /// The name as far as it can be shown.
        name: String,
    },
    /// A photo name that leads out of the scene.
    #[error(
        "{file} lists the photo {name:?}, which is not a path inside the scene's image folder; correct the name"
    )]
    NameOutside {
        /// The file with the list.
        file: PathBuf,
        /// The name.
        name: String,
    },
    /// A point cloud whose name leads out of the scene, or is none.
    #[error(
        "{file} has the ply_file_path {name:?}, which is not a path inside the scene's folder; correct it, or remove \
         it to start from random points"
    )]
    PointsOutside {
        /// The file.
        file: PathBuf,
        /// As it is written there.
        name: String,
    },
    /// A point cloud that is absent.
    #[error(
        "the point cloud {points}, which the scene has as its ply_file_path, does not exist; put it there, or remove \
         ply_file_path to start from random points"
    )]
    PointsMissing {
        /// Where it should be.
        points: PathBuf,
    },
    /// Two entries for one photo.
    #[error("{file} lists the photo {name} twice; remove one of its entries")]
    ListedTwice {
        /// The file with the list.
        file: PathBuf,
        /// The photo.
        name: String,
    },
    /// Two entries, and one photo for both.
    #[error(
        "{file} lists {first} and {second}, and {folder} has one photo of that name for both; put them where the \
         list says"
    )]
    OneForTwo {
        /// The file with the list.
        file: PathBuf,
        /// One entry.
        first: String,
        /// The other.
        second: String,
        /// Where the photos are.
        folder: PathBuf,
    },
    /// A lens that is not a pinhole.
    #[error(
        "{file}: camera {camera} uses the model {model}, which bends straight lines; run COLMAP's image_undistorter on \
         the reconstruction and load its output folder"
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
        "{file} uses the camera model {model}, and genesplat reads only {}; undistort the photos first",
        crate::transforms::KNOWN_MODELS.join(", ")
    )]
    UnknownLens {
        /// The file.
        file: PathBuf,
        /// As the file names it.
        model: String,
    },
    /// Intrinsics that no camera has.
    #[error("{file}: camera {camera} {problem}; calibrate it again")]
    BadCamera {
        /// The file.
        file: PathBuf,
        /// Its id or the photo that it belongs to.
        camera: String,
        /// What is wrong.
        problem: &'static str,
    },
    /// Two cameras, and no way to tell which of them took a photo.
    #[error("{file} has two cameras with the ID {camera}; export the model again")]
    CameraTwice {
        /// The file.
        file: PathBuf,
        /// The ID.
        camera: u32,
    },
    /// A pose that is none.
    #[error(
        "{file}: the pose of photo {name} {problem}; remove the photo from the reconstruction or reconstruct again"
    )]
    BadPose {
        /// The file.
        file: PathBuf,
        /// The photo.
        name: String,
        /// What is wrong.
        problem: &'static str,
    },
    /// A photo that refers to a camera that is not there.
    #[error(
        "{file}: photo {name} refers to camera {camera}, which the model does not have; export the model again"
    )]
    NoSuchCamera {
        /// The file.
        file: PathBuf,
        /// The photo.
        name: String,
        /// The id.
        camera: u32,
    },
    /// A point that is nowhere.
    #[error("{file}: point {point} has a position that is not finite; remove it or reconstruct again")]
    BadPoint {
        /// The file.
        file: PathBuf,
        /// 1-based position in the file.
        point: usize,
    },
    /// Too little to start from.
    #[error(
        "{file} has {points} points, and training starts from at least {least}; the reconstruction failed, so run it \
         again"
    )]
    TooFewPoints {
        /// The file.
        file: PathBuf,
        /// How many there are.
        points: usize,
        /// How many are needed.
        least: usize,
    },
    /// A scene without photos.
    #[error("{file} lists no photos; the reconstruction failed, so run it again")]
    NoPhotos {
        /// The file.
        file: PathBuf,
    },
    /// A photo in a list of those to train or test on, and in none of the frames.
    #[error("{file} has {name} in its {key}, but none of its frames has that file_path; correct one of them")]
    ListedUnknown {
        /// The file.
        file: PathBuf,
        /// As it is written there.
        name: String,
        /// What the list is called.
        key: &'static str,
    },
    /// A photo that is to be trained on and held out.
    #[error(
        "{file} has {name} both in its train_filenames and in its val_filenames or test_filenames; remove it from \
         one of them, or its figures would be those of a photo that training saw"
    )]
    TrainedAndHeldOut {
        /// The file.
        file: PathBuf,
        /// The photo.
        name: String,
    },
    /// A split that leaves nothing to train on.
    #[error(
        "{path} has not enough photos: {photos}, of which {held_out} would be held out for testing and none is left \
         to train on; add photos"
    )]
    NotEnoughPhotos {
        /// The scene.
        path: PathBuf,
        /// Photos in all.
        photos: usize,
        /// Test photos.
        held_out: usize,
    },
    /// One listed photo is absent.
    #[error("the photo {photo}, which {list} lists, does not exist; put it back, or remove it from the list")]
    PhotoMissing {
        /// Where it should be.
        photo: PathBuf,
        /// The file with the list.
        list: PathBuf,
    },
    /// Every listed photo is absent.
    #[error("none of the {count} photos that {list} lists is in {folder}; put the photos there")]
    AllPhotosMissing {
        /// How many are listed.
        count: usize,
        /// The file with the list.
        list: PathBuf,
        /// Where they should be.
        folder: PathBuf,
    },
    /// A photo that its camera did not take.
    #[error(
        "the photo {photo} is {}x{} pixels, but its camera in {list} is {}x{}, which is another shape; use the \
         photos that the cameras were calibrated on",
        photo_size[0], photo_size[1], camera_size[0], camera_size[1]
    )]
    SizeMismatch {
        /// The photo.
        photo: PathBuf,
        /// Its width and height.
        photo_size: [u32; 2],
        /// The file with the camera.
        list: PathBuf,
        /// The camera's width and height.
        camera_size: [u32; 2],
    },
    /// A photo too small to learn from.
    #[error(
        "the photo {photo} would be loaded at {width}x{height} pixels, and both sides must have at least {least}; \
         reduce it less (--max-side, --downscale), or take a larger photo"
    )]
    PhotoTooSmall {
        /// The photo.
        photo: PathBuf,
        /// Loaded width.
        width: u32,
        /// Loaded height.
        height: u32,
        /// The least side.
        least: u32,
    },
    /// A photo that cannot be decoded.
    #[error(transparent)]
    Photo(#[from] PhotoError),
    /// A point cloud that cannot be read.
    #[error(transparent)]
    Points(#[from] PlyError),
}
