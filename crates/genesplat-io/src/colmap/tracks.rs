//! Which photos see the points of a model: COLMAP's tracks, for who asks.
//!
//! They are read apart from the points, since most who load a scene need none, and they are the larger part.

use std::collections::BTreeMap;
use std::path::Path;

use super::{Form, ModelFolder, binary, points_file, read, text};
use crate::error::SceneError;
use crate::input;

/// The photos that see each point, by COLMAP's ids of photos; points are those that training keeps, in file
/// order.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Tracks {
    /// Where the photos of each point end.
    ends: Vec<usize>,
    photos: Vec<u32>,
}

impl Tracks {
    /// Adds the photo of one feature of the next point.
    pub(super) fn push_photo(&mut self, id: u32) {
        self.photos.push(id);
    }

    /// The next point has all of its photos; or they are dropped with it.
    pub(super) fn end_point(&mut self, is_kept: bool) {
        if is_kept {
            self.ends.push(self.photos.len());
        } else {
            self.photos.truncate(self.ends.last().copied().unwrap_or(0));
        }
    }

    /// Of each point, the photos of its features.
    pub(crate) fn points(&self) -> impl Iterator<Item = &[u32]> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        starts.zip(&self.ends).map(|(start, &end)| &self.photos[start..end])
    }

    /// The points that each photo sees, by its id: their places, rising.
    fn by_photo(&self) -> BTreeMap<u32, Vec<u32>> {
        let mut seen: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        for (point, photos) in (0u32..).zip(self.points()) {
            for &photo in photos {
                let points = seen.entry(photo).or_default();
                // A photo may have two features of a point.
                if points.last() != Some(&point) {
                    points.push(point);
                }
            }
        }
        seen
    }
}

/// The points that each photo of the model in `folder` sees, by the name that the model gives the photo:
/// their places among the points that [`super::read_model`] reads, rising. Empty where the model does not
/// say.
pub(super) fn read_seen(folder: &ModelFolder) -> Result<BTreeMap<String, Vec<u32>>, SceneError> {
    let points = points_file(folder);
    let form = match points.extension().and_then(|ending| ending.to_str()) {
        Some("bin") => Form::Binary,
        Some("txt") => Form::Text,
        _ => return Ok(BTreeMap::new()),
    };
    if !points.exists() {
        return Ok(BTreeMap::new());
    }
    let images = folder.form.file(&folder.path, "images");
    let names = parse_photo_ids(folder.form, &images, &read(&images)?)?;
    let mut seen = parse_tracks(form, &points, &read(&points)?)?.by_photo();
    Ok(names.into_iter().filter_map(|(id, name)| Some((name, seen.remove(&id)?))).collect())
}

/// The names of the photos in the `bytes` of `file`, by their ids. Where two have one id, nobody knows which
/// of them a track means, and neither is there.
pub(super) fn parse_photo_ids(
    form: Form,
    file: &Path,
    bytes: &[u8],
) -> Result<BTreeMap<u32, String>, SceneError> {
    let photos = match form {
        Form::Binary => binary::photo_ids(file, bytes),
        Form::Text => text::photo_ids(file, &input::as_utf8(bytes)),
    }?;
    let mut names: BTreeMap<u32, Option<String>> = BTreeMap::new();
    for (id, name) in photos {
        names.entry(id).and_modify(|known| *known = None).or_insert(Some(name));
    }
    Ok(names.into_iter().filter_map(|(id, name)| Some((id, name?))).collect())
}

/// The tracks of the points in the `bytes` of `file`.
pub(crate) fn parse_tracks(form: Form, file: &Path, bytes: &[u8]) -> Result<Tracks, SceneError> {
    match form {
        Form::Binary => binary::tracks(file, bytes),
        Form::Text => text::tracks(file, &input::as_utf8(bytes)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn photos_know_their_points_once_and_dropped_points_have_none() {
        let mut tracks = Tracks::default();
        for (photos, is_kept) in [(&[7, 9, 7][..], true), (&[7], false), (&[], true), (&[9], true)] {
            photos.iter().for_each(|&photo| tracks.push_photo(photo));
            tracks.end_point(is_kept);
        }
        assert_eq!(tracks.points().collect::<Vec<_>>(), [&[7, 9, 7][..], &[], &[9]]);
        assert_eq!(tracks.by_photo(), [(7, vec![0]), (9, vec![0, 2])].into());
    }

    #[test]
    fn photos_of_one_id_cannot_be_told_apart() {
        let lines = "1 1 0 0 0 0 0 0 1 a.png\n\n1 1 0 0 0 0 0 0 1 b.png\n\n3 1 0 0 0 0 0 0 1 c d.png\n\n";
        let ids = parse_photo_ids(Form::Text, Path::new("images.txt"), lines.as_bytes()).unwrap();
        assert_eq!(ids, [(3, "c d.png".to_owned())].into());
    }
}
