//! Which photos several lenses of a rig took at one moment: COLMAP's frames. Their poses are those of the
//! photos, which the list of photos has.

use std::collections::BTreeMap;
use std::path::Path;

use super::tracks::parse_photo_ids;
use super::{Form, ModelFolder, binary, read, text};
use crate::error::SceneError;
use crate::input;

/// The moment of each photo that was not taken alone, by the name that the model in `folder` gives it.
pub(super) fn read_moments(folder: &ModelFolder) -> Result<BTreeMap<String, u32>, SceneError> {
    let file = folder.form.file(&folder.path, "frames");
    if !file.exists() {
        return Ok(BTreeMap::new());
    }
    let frames = parse_frames(folder.form, &file, &read(&file)?)?;
    let of_photos = (0u32..).zip(&frames).filter(|(_, photos)| photos.len() > 1);
    let moments: BTreeMap<u32, u32> =
        of_photos.flat_map(|(moment, photos)| photos.iter().map(move |photo| (*photo, moment))).collect();
    if moments.is_empty() {
        return Ok(BTreeMap::new());
    }
    let images = folder.form.file(&folder.path, "images");
    let names = parse_photo_ids(folder.form, &images, &read(&images)?)?;
    Ok(names.into_iter().filter_map(|(id, name)| Some((name, *moments.get(&id)?))).collect())
}

/// The ids of the photos of each frame in the `bytes` of `file`.
pub(crate) fn parse_frames(form: Form, file: &Path, bytes: &[u8]) -> Result<Vec<Vec<u32>>, SceneError> {
    match form {
        Form::Binary => binary::frames(file, bytes),
        Form::Text => text::frames(file, &input::as_utf8(bytes)),
    }
}
