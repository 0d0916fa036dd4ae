//! Which photos see the points of a model, and where: COLMAP's tracks and features, for who asks.
//!
//! They are read apart from the points, since most who load a scene need none, and they are the larger part.

use std::collections::BTreeMap;
use std::ops::Range;
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
    /// Which feature of the photo each is.
    features: Vec<u32>,
}

/// A point that a photo sees, by its place, and where the photo shows it, px of the listed camera; `None`
/// where the model does not say.
pub(super) type Seen = (u32, Option<[f32; 2]>);

/// The features of photos, px from the top-left corner, by the photos' ids.
pub(super) type Features = BTreeMap<u32, Vec<[f32; 2]>>;

impl Tracks {
    /// Adds one feature of the next point: of which photo, and which of its features.
    pub(super) fn push(&mut self, photo: u32, feature: u32) {
        self.photos.push(photo);
        self.features.push(feature);
    }

    /// The next point has all of its photos; or they are dropped with it.
    pub(super) fn end_point(&mut self, is_kept: bool) {
        if is_kept {
            self.ends.push(self.photos.len());
        } else {
            let end = self.ends.last().copied().unwrap_or(0);
            self.photos.truncate(end);
            self.features.truncate(end);
        }
    }

    /// Of each point, the photos of its features.
    pub(crate) fn points(&self) -> impl Iterator<Item = &[u32]> {
        self.ranges().map(|of_point| &self.photos[of_point])
    }

    /// Where the features of each point are.
    fn ranges(&self) -> impl Iterator<Item = Range<usize>> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        starts.zip(&self.ends).map(|(start, &end)| start..end)
    }

    /// The points that each photo sees, by its id: their places, rising, and where it shows them.
    fn by_photo(&self, features: &Features) -> BTreeMap<u32, Vec<Seen>> {
        let mut seen: BTreeMap<u32, Vec<Seen>> = BTreeMap::new();
        for (point, of_point) in (0u32..).zip(self.ranges()) {
            for (photo, feature) in self.photos[of_point.clone()].iter().zip(&self.features[of_point]) {
                let points = seen.entry(*photo).or_default();
                // A photo may have two features of a point.
                if points.last().is_none_or(|(last, _)| *last != point) {
                    let at = features.get(photo).and_then(|features| features.get(*feature as usize));
                    points.push((point, at.copied()));
                }
            }
        }
        seen
    }
}

/// The points that each photo of the model in `folder` sees, by the name that the model gives the photo:
/// their places among the points that [`super::read_model`] reads, rising. Empty where the model does not
/// say.
pub(super) fn read_seen(folder: &ModelFolder) -> Result<BTreeMap<String, Vec<Seen>>, SceneError> {
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
    let bytes = read(&images)?;
    let names = parse_photo_ids(folder.form, &images, &bytes)?;
    let features = parse_features(folder.form, &images, &bytes)?;
    let mut seen = parse_tracks(form, &points, &read(&points)?)?.by_photo(&features);
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

/// The features of the photos in the `bytes` of `file`.
pub(crate) fn parse_features(form: Form, file: &Path, bytes: &[u8]) -> Result<Features, SceneError> {
    match form {
        Form::Binary => binary::features(file, bytes),
        Form::Text => text::features(file, &input::as_utf8(bytes)),
    }
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
            (0..).zip(photos).for_each(|(feature, &photo)| tracks.push(photo, feature));
            tracks.end_point(is_kept);
        }
        assert_eq!(tracks.points().collect::<Vec<_>>(), [&[7, 9, 7][..], &[], &[9]]);
        let features = [(7, vec![[0.5, 1.5]]), (9, vec![[2.5, 3.5]])].into();
        let by_photo = [(7, vec![(0, Some([0.5, 1.5]))]), (9, vec![(0, None), (2, Some([2.5, 3.5]))])];
        assert_eq!(tracks.by_photo(&features), by_photo.into());
    }

    #[test]
    fn photos_of_one_id_cannot_be_told_apart() {
        let lines = "1 1 0 0 0 0 0 0 1 a.png\n\n1 1 0 0 0 0 0 0 1 b.png\n\n3 1 0 0 0 0 0 0 1 c d.png\n\n";
        let ids = parse_photo_ids(Form::Text, Path::new("images.txt"), lines.as_bytes()).unwrap();
        assert_eq!(ids, [(3, "c d.png".to_owned())].into());
    }
}
