//! Every reader on bytes that are in no file: where tests that mutate them come in. What is read counts, not what it says.

use std::path::Path;

use crate::colmap::{self, Form};
use crate::photos::{EncodedPhoto, PhotoError};
use crate::ply::{self, PlyError};
use crate::{SceneError, transforms};

/// What errors call the bytes.
const NAME: &str = "bytes";

/// COLMAP's cameras.
pub fn cameras(form: Form, bytes: &[u8]) -> Result<usize, SceneError> {
    colmap::parse_cameras(form, NAME.as_ref(), bytes).map(|cameras| cameras.len())
}

/// COLMAP's photos.
pub fn images(form: Form, bytes: &[u8]) -> Result<usize, SceneError> {
    colmap::parse_images(form, NAME.as_ref(), bytes).map(|images| images.len())
}

/// COLMAP's points.
pub fn points(form: Form, bytes: &[u8]) -> Result<usize, SceneError> {
    colmap::parse_points(form, NAME.as_ref(), bytes).map(|points| points.len())
}

/// A `transforms.json`.
pub fn transforms(bytes: &[u8]) -> Result<usize, SceneError> {
    transforms::parse_cameras(NAME.as_ref(), bytes).map(|cameras| cameras.len())
}

/// A splat as PLY, and what a command asks of it.
pub fn splat(bytes: &[u8]) -> Result<usize, PlyError> {
    let path = Path::new(NAME);
    let (_, cloud) = ply::parse_splat(path, bytes, bytes.len() as u64)?;
    ply::check_finite(path, &cloud).map(|()| cloud.len())
}

/// A cloud of points as PLY.
pub fn cloud(bytes: &[u8]) -> Result<usize, PlyError> {
    ply::parse_points(NAME.as_ref(), bytes, bytes.len() as u64).map(|points| points.len())
}

/// A photo of at most `pixels_max` pixels: larger ones are decoded, too, but not often enough in a second.
pub fn photo(bytes: &[u8], pixels_max: u64) -> Result<usize, PhotoError> {
    let photo = EncodedPhoto::of(NAME.as_ref(), bytes.to_vec())?;
    let (width, height) = photo.size();
    if u64::from(width) * u64::from(height) > pixels_max {
        return Ok(0);
    }
    photo.decode_on([0; 3]).map(|photo| photo.rgb.len())
}
