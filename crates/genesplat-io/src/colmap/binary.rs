//! The binary form: little-endian records behind a 64-bit count.

use std::collections::BTreeMap;
use std::path::Path;

use super::check::{self, Finite, Judged};
use super::cursor::Cursor;
use super::tracks::{Features, Tracks};
use super::{ImageRecord, models};
use crate::error::SceneError;
use crate::listing::position_problem;
use crate::offset::Offset;
use crate::scene::Point;

/// Least bytes of a camera: id, model, width, height, two parameters.
const CAMERA_BYTES: usize = 4 + 4 + 8 + 8 + 2 * 8;
/// Least bytes of an image: id, pose, camera id, an empty name's NUL, count of features.
const IMAGE_BYTES: usize = 4 + 7 * 8 + 4 + 1 + 8;
/// One feature of an image: `f64 x, y`, `i64` point id.
const FEATURE_BYTES: usize = 24;
/// Least bytes of a point: id, position, colour, error, length of the track.
const POINT_BYTES: usize = 8 + 3 * 8 + 3 + 8 + 8;
/// Least bytes of a frame: id, rig, pose, count of photos.
const FRAME_BYTES: usize = 4 + 4 + 7 * 8 + 4;
/// The kind of sensor that takes photos.
const CAMERA: i32 = 0;
/// One entry of a track: `i32` image id and feature index.
const TRACK_BYTES: usize = 8;

pub(super) fn cameras(file: &Path, bytes: &[u8]) -> Result<BTreeMap<u32, Judged>, SceneError> {
    let mut cursor = Cursor::new(file, bytes);
    let count = cursor.count("cameras", CAMERA_BYTES)?;
    let cameras = check::by_id(file, (0..count).map(|_| camera(file, &mut cursor)))?;
    cursor.end("cameras").map(|()| cameras)
}

fn camera(file: &Path, cursor: &mut Cursor) -> Result<(u32, Judged), SceneError> {
    const RECORD: &str = "a camera";
    let id = cursor.i32(RECORD)? as u32;
    let model = cursor.i32(RECORD)?;
    let size = [cursor.u64(RECORD)?, cursor.u64(RECORD)?];
    let Some(&(name, count)) = usize::try_from(model).ok().and_then(|model| models::MODELS.get(model)) else {
        let model = format!("with the number {model}");
        return Err(SceneError::DistortedCamera { file: file.to_owned(), camera: id, model });
    };
    let parameters: Vec<f64> =
        (0..count).map(|_| cursor.f64s::<1>(RECORD).map(|[value]| value)).collect::<Result<_, _>>()?;
    let parameters = models::parameters(file, id, name, &parameters);
    Ok((id, parameters.and_then(|parameters| check::intrinsics(file, id, size, parameters))))
}

/// `images.bin`; features are passed over.
pub(super) fn images(file: &Path, bytes: &[u8]) -> Result<Finite<ImageRecord>, SceneError> {
    let mut cursor = Cursor::new(file, bytes);
    let count = cursor.count("photos", IMAGE_BYTES)?;
    let images = check::images(file, (0..count).map(|_| image(&mut cursor).map(|(_, image)| image)))?;
    cursor.end("photos").map(|()| images)
}

/// The ids and names of the photos in `images.bin`.
pub(super) fn photo_ids(file: &Path, bytes: &[u8]) -> Result<Vec<(u32, String)>, SceneError> {
    let mut cursor = Cursor::new(file, bytes);
    let count = cursor.count("photos", IMAGE_BYTES)?;
    (0..count).map(|_| image(&mut cursor).map(|(id, image)| (id, image.name))).collect()
}

/// The features of the photos in `images.bin`.
pub(super) fn features(file: &Path, bytes: &[u8]) -> Result<Features, SceneError> {
    const RECORD: &str = "a photo's features";
    let mut cursor = Cursor::new(file, bytes);
    let count = cursor.count("photos", IMAGE_BYTES)?;
    let mut of_photos = Features::new();
    for _ in 0..count {
        let (id, _, features) = image_and_features(&mut cursor)?;
        let mut feature = || {
            let [x, y] = cursor.f64s::<2>(RECORD)?;
            cursor.u64(RECORD)?;
            Ok([x as f32, y as f32])
        };
        of_photos.insert(id, (0..features).map(|_| feature()).collect::<Result<_, SceneError>>()?);
    }
    Ok(of_photos)
}

/// With its id.
fn image(cursor: &mut Cursor) -> Result<(u32, ImageRecord), SceneError> {
    let (id, image, features) = image_and_features(cursor)?;
    cursor.skip("a photo's features", features, FEATURE_BYTES)?;
    Ok((id, image))
}

/// A photo up to its features, with its id, and how many these are.
fn image_and_features(cursor: &mut Cursor) -> Result<(u32, ImageRecord, usize), SceneError> {
    const RECORD: &str = "a photo's pose";
    let id = cursor.i32(RECORD)? as u32;
    let rotation = cursor.f64s(RECORD)?;
    let translation = cursor.f64s(RECORD)?;
    let camera = cursor.i32(RECORD)? as u32;
    let name = cursor.text("a photo's name")?.to_owned();
    let features = cursor.count("image features", FEATURE_BYTES)?;
    Ok((id, ImageRecord { name, camera, rotation, translation }, features))
}

pub(super) fn points(file: &Path, bytes: &[u8], offset: Offset) -> Result<Finite<Point>, SceneError> {
    let mut cursor = Cursor::new(file, bytes);
    let count = cursor.count("points", POINT_BYTES)?;
    let points = check::points(file, offset, (0..count).map(|_| point(&mut cursor)))?;
    cursor.end("points").map(|()| points)
}

fn point(cursor: &mut Cursor) -> Result<([f64; 3], [u8; 3]), SceneError> {
    let (position, rgb, features) = point_and_features(cursor)?;
    cursor.skip("a point's track", features, TRACK_BYTES)?;
    Ok((position, rgb))
}

/// A point up to its track, and how many features that has.
fn point_and_features(cursor: &mut Cursor) -> Result<([f64; 3], [u8; 3], usize), SceneError> {
    const RECORD: &str = "a point";
    cursor.u64(RECORD)?;
    let position = cursor.f64s(RECORD)?;
    let rgb = cursor.array(RECORD)?;
    cursor.f64s::<1>(RECORD)?;
    Ok((position, rgb, cursor.count("track entries", TRACK_BYTES)?))
}

/// The tracks of `points3D.bin`, of the points that are kept.
pub(super) fn tracks(file: &Path, bytes: &[u8]) -> Result<Tracks, SceneError> {
    const RECORD: &str = "a point's track";
    let mut cursor = Cursor::new(file, bytes);
    let count = cursor.count("points", POINT_BYTES)?;
    let mut tracks = Tracks::default();
    for _ in 0..count {
        let (position, _, features) = point_and_features(&mut cursor)?;
        for _ in 0..features {
            tracks.push(cursor.i32(RECORD)? as u32, cursor.i32(RECORD)? as u32);
        }
        tracks.end_point(position_problem(position).is_none());
    }
    cursor.end("points").map(|()| tracks)
}

/// The photos of each frame in `frames.bin`, by their ids.
pub(super) fn frames(file: &Path, bytes: &[u8]) -> Result<Vec<Vec<u32>>, SceneError> {
    let mut cursor = Cursor::new(file, bytes);
    let count = cursor.count("frames", FRAME_BYTES)?;
    let frames = (0..count).map(|_| frame(&mut cursor)).collect::<Result<_, _>>()?;
    cursor.end("frames").map(|()| frames)
}

fn frame(cursor: &mut Cursor) -> Result<Vec<u32>, SceneError> {
    const RECORD: &str = "a frame";
    cursor.skip(RECORD, 1, FRAME_BYTES - 4)?;
    let count = cursor.i32(RECORD)? as u32;
    let mut photos = Vec::new();
    for _ in 0..count {
        let kind = cursor.i32(RECORD)?;
        cursor.i32(RECORD)?;
        let id = u32::try_from(cursor.u64(RECORD)?).ok();
        photos.extend(id.filter(|_| kind == CAMERA));
    }
    Ok(photos)
}
