//! Every reader on bytes that are in no file: where the fuzzer comes in (`fuzz/` in the repository).

use std::collections::BTreeMap;
use std::io::{self, Cursor};
use std::path::{Path, PathBuf};

use genesplat_core::{Camera, Gaussians, Photo};

use crate::archive::{self, ArchiveError};
use crate::colmap::{self, Form, ImageRecord, Intrinsics};
use crate::format::{self, Format, FormatError, Loaded, Options};
use crate::offset::{self, Offset};
use crate::photos::{self, Cut, Depths, EncodedPhoto, PhotoError};
use crate::ply;
use crate::scene::Point;
use crate::{SceneError, transforms};

/// What errors call the bytes.
const NAME: &str = "bytes";

/// COLMAP's cameras.
pub fn cameras(form: Form, bytes: &[u8]) -> Result<BTreeMap<u32, Intrinsics>, SceneError> {
    colmap::parse_cameras(form, NAME.as_ref(), bytes)?
        .into_iter()
        .map(|(id, judged)| Ok((id, judged?)))
        .collect()
}

/// COLMAP's photos.
pub fn images(form: Form, bytes: &[u8]) -> Result<Vec<ImageRecord>, SceneError> {
    Ok(colmap::parse_images(form, NAME.as_ref(), bytes)?.records)
}

/// COLMAP's points.
pub fn points(form: Form, bytes: &[u8]) -> Result<Vec<Point>, SceneError> {
    Ok(colmap::parse_points(form, NAME.as_ref(), bytes, Offset::default())?.records)
}

/// COLMAP's tracks: the photos that see each point, by their ids.
pub fn tracks(form: Form, bytes: &[u8]) -> Result<Vec<Vec<u32>>, SceneError> {
    Ok(colmap::parse_tracks(form, NAME.as_ref(), bytes)?.points().map(<[u32]>::to_vec).collect())
}

/// COLMAP's frames: the photos of each, by their ids.
pub fn frames(form: Form, bytes: &[u8]) -> Result<Vec<Vec<u32>>, SceneError> {
    colmap::parse_frames(form, NAME.as_ref(), bytes)
}

/// A `transforms.json`.
pub fn transforms(bytes: &[u8]) -> Result<Vec<Camera>, SceneError> {
    transforms::parse_cameras(NAME.as_ref(), bytes)
}

/// A splat of this format.
pub fn splat(format: Format, bytes: &[u8]) -> Result<Loaded, FormatError> {
    format::parse(NAME.as_ref(), format, bytes)
}

/// What a file of this format holds.
pub fn written(format: Format, cloud: &Gaussians, options: &Options) -> Result<Vec<u8>, FormatError> {
    format::to_bytes(NAME.as_ref(), format, cloud, options, &())
}

/// The file beside a splat that holds its offset; the error is a clause.
pub fn offset(bytes: &[u8]) -> Result<Offset, String> {
    offset::parse(bytes)
}

/// A cloud of points as PLY.
pub fn point_cloud(bytes: &[u8]) -> Result<Vec<Point>, SceneError> {
    Ok(ply::parse_points(NAME.as_ref(), bytes, bytes.len() as u64, Offset::default())?.records)
}

/// The files that a zip archive unpacks to, and how many bytes each has.
pub fn unpacked(bytes: &[u8]) -> Result<Vec<(PathBuf, u64)>, ArchiveError> {
    let (archive, mut files) = (Path::new(NAME), Vec::new());
    archive::each_entry(archive, Cursor::new(bytes), bytes.len() as u64, |file, content| {
        // What its reader finds wrong ends it.
        files.push((file.to_owned(), io::copy(content, &mut io::sink()).unwrap_or_default()));
        Ok(())
    })?;
    Ok(files)
}

/// A photo of at most `pixels_max` pixels: larger ones are decoded, too, but not often enough in a second.
pub fn photo(bytes: &[u8], pixels_max: u64) -> Result<Option<Photo>, PhotoError> {
    let photo = EncodedPhoto::of(NAME.as_ref(), bytes.to_vec())?;
    photo.lens_tags();
    let (width, height) = photo.size();
    let is_small = u64::from(width) * u64::from(height) <= pixels_max;
    is_small.then(|| photo.decode_on_black()).transpose()
}

/// A depth map, as the file of COLMAP's dense reconstruction that says the same.
pub fn depths(bytes: &[u8]) -> Result<Vec<u8>, PhotoError> {
    Ok(Depths::of(NAME.as_ref(), bytes.to_vec())?.to_dense())
}

/// A grey photo of `camera`, as a pinhole takes it, or the last of several; `None` where the lens cannot be
/// undone, or the photo is larger than `side_max`.
pub fn undistorted(camera: &Intrinsics, side_max: u32) -> Option<Photo> {
    let Intrinsics { width, height, focal_px, principal_px, lens } = *camera;
    let lens = lens.filter(|_| width.max(height) <= side_max)?;
    let camera = Camera { focal_px, principal_px, ..Camera::at_origin(width, height, focal_px[0]) };
    let photo = Photo { width, height, rgb: vec![128; 3 * (width * height) as usize] };
    if let Some(cut) = Cut::of(&camera, &lens) {
        let side = cut.side().min(side_max);
        let parts: Vec<_> = cut.views(side, 1).into_iter().map(|(part, _)| part).collect();
        return cut.photos(&photo, &parts, side).last();
    }
    let pinhole = photos::pinhole(&camera, &lens)?;
    let size = [pinhole.width.min(width), pinhole.height.min(height)];
    Some(photos::undistort(&photo, &camera, &lens, &pinhole, size))
}
