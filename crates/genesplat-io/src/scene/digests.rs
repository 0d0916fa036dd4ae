//! What tells a scene apart from what it was: digests of its files and cameras, which hold at every size of
//! its photos.

use genesplat_core::{Camera, View};
use serde::{Deserialize, Serialize};

use super::Point;
use crate::digest::Digest;
use crate::listing::ListedPhoto;
use crate::offset::Offset;
use crate::photos::Lens;

/// Digests of all that a scene consists of.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SceneDigests {
    /// Of the photos that are trained on or held out, sorted by name; those that are hidden entirely are
    /// among them.
    pub photos: Vec<PhotoDigests>,
    /// Of the points in the scene's files, in their order; `None` where they were not loaded.
    pub points: Option<Digest>,
    /// What has been subtracted from the coordinates of the scene's source; `None` where it is near its
    /// origin.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub offset: Option<Offset>,
}

/// Those of one photo.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PhotoDigests {
    /// That of its view.
    pub name: String,
    /// Whether training must never see it.
    pub held_out: bool,
    /// Of its file.
    pub photo: Digest,
    /// Of the file of its mask, if it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mask: Option<Digest>,
    /// Of the file of its depth map, if it has one that training looks at.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth: Option<Digest>,
    /// Of where its camera stands and looks.
    pub pose: Digest,
    /// Of its camera's size, focal lengths, principal point and lens, as the scene has them.
    pub lens: Digest,
}

impl PhotoDigests {
    /// Those of a photo, a mask and a depth map of these files.
    pub(super) fn of(
        listed: &ListedPhoto,
        photo: Digest,
        mask: Option<Digest>,
        depth: Option<Digest>,
    ) -> Self {
        Self { mask, depth, ..Self::new(&listed.name, photo, &listed.camera, listed.lens.as_ref()) }
    }

    fn new(name: &str, photo: Digest, camera: &Camera, lens: Option<&Lens>) -> Self {
        let (pose, lens) = (pose(camera), intrinsics(camera, lens));
        Self { name: name.to_owned(), held_out: false, photo, mask: None, depth: None, pose, lens }
    }

    /// Those of a photo without a file, by its pixels.
    fn of_view(view: &View) -> Option<Self> {
        let photo = view.photo.read().ok()?;
        let mask = view
            .mask
            .as_ref()
            .map(|mask| mask.counts.iter().map(|counts| u8::from(*counts)).collect::<Vec<_>>());
        let mask = mask.map(|mask| Digest::of(&mask));
        Some(Self { mask, ..Self::new(&view.name, Digest::of(&photo.rgb), &view.camera, None) })
    }
}

impl SceneDigests {
    /// Of training photos and held-out ones.
    pub(super) fn of([train, test]: [Vec<PhotoDigests>; 2], points: Option<Digest>) -> Self {
        let held_out = test.into_iter().map(|photo| PhotoDigests { held_out: true, ..photo });
        let mut photos: Vec<PhotoDigests> = train.into_iter().chain(held_out).collect();
        photos.sort_by(|a, b| a.name.cmp(&b.name));
        Self { photos, points, offset: None }
    }

    /// The same of a scene that was moved.
    pub(super) fn moved(self, offset: Option<Offset>) -> Self {
        Self { offset, ..self }
    }

    /// Of training views and held-out ones that no files are behind. A photo that cannot be read has none.
    pub fn of_views(views: [&[View]; 2], points: &[Point]) -> Self {
        let of = |views: &[View]| views.iter().filter_map(PhotoDigests::of_view).collect();
        Self::of(views.map(of), Some(of_points(points)))
    }

    /// Those of the photo of this name.
    pub fn photo(&self, name: &str) -> Option<&PhotoDigests> {
        let at = self.photos.binary_search_by(|photo| photo.name.as_str().cmp(name)).ok()?;
        Some(&self.photos[at])
    }
}

pub(super) fn of_points(points: &[Point]) -> Digest {
    let bytes = |point: &Point| [&point.position.map(f32::to_le_bytes).concat()[..], &point.rgb].concat();
    Digest::of(&points.iter().flat_map(bytes).collect::<Vec<u8>>())
}

fn pose(camera: &Camera) -> Digest {
    let rotation = camera.camera_from_world_rotation.to_array();
    Digest::of_numbers(rotation.into_iter().chain(camera.camera_from_world_translation.to_array()))
}

fn intrinsics(camera: &Camera, lens: Option<&Lens>) -> Digest {
    let Camera { width, height, focal_px, principal_px, .. } = *camera;
    let size = [width, height].map(f64::from);
    let lens = lens.map_or(Vec::new(), Lens::numbers);
    Digest::of_numbers(size.into_iter().chain(focal_px).chain(principal_px).chain(lens))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn photos_are_found_by_name_and_what_is_held_out_is_told_apart() {
        let camera = Camera::at_origin(20, 10, 10.0);
        let of = |name: &str| PhotoDigests::new(name, Digest::of(name.as_bytes()), &camera, None);
        let scene = SceneDigests::of([vec![of("b"), of("c")], vec![of("a")]], None);
        let held_out = |name: &str| scene.photo(name).map(|photo| photo.held_out);
        assert_eq!(["a", "b", "c", "d"].map(held_out), [Some(true), Some(false), Some(false), None]);
    }

    #[test]
    fn every_number_of_a_camera_and_a_lens_counts() {
        let plain = Camera::at_origin(20, 10, 10.0);
        let changes: [fn(&mut Camera); 5] = [
            |camera| camera.width += 1,
            |camera| camera.height += 1,
            |camera| camera.focal_px[0] *= 2.0,
            |camera| camera.focal_px[1] *= 2.0,
            |camera| camera.principal_px[1] += 1.0,
        ];
        for (case, change) in changes.iter().enumerate() {
            let mut other = plain;
            change(&mut other);
            assert!(intrinsics(&plain, None) != intrinsics(&other, None), "{case}");
            assert_eq!(pose(&plain), pose(&other));
        }
        let mut moved = plain;
        moved.camera_from_world_translation.y += 0.1;
        assert!(pose(&plain) != pose(&moved) && intrinsics(&plain, None) == intrinsics(&moved, None));
        let mut bent = Lens::default();
        bent.polynomial.radial[1] = 0.1;
        assert!(intrinsics(&plain, Some(&bent)) != intrinsics(&plain, None));
        // The nearest depth is a setting, or follows from the poses.
        assert_eq!(intrinsics(&plain, None), intrinsics(&Camera { near: 3.0, ..plain }, None));
    }
}
