//! A scene before its photos are decoded.

use std::path::{Path, PathBuf};

use genesplat_core::Camera;

use super::sources::list;
use super::{LoadOptions, Point, SIDE_MIN_PX, split};
use crate::colmap::{ImageRecord, Intrinsics, Model};
use crate::error::SceneError;
use crate::listing::{ListedDepth, ListedPhoto, Listing, part_name};
use crate::offset::Offset;
use crate::photos::{Cut, Lens};
use crate::shown;

/// Where photos are and what took them, and the points of their reconstruction.
#[derive(Clone, Debug)]
pub struct SceneList {
    /// Photos for training and for testing, each part sorted by name.
    pub photos: Vec<ScenePhoto>,
    /// Points in the order of their file.
    pub points: Vec<Point>,
    /// What has been subtracted from the coordinates of the scene's source, if anything.
    pub offset: Option<Offset>,
    /// What the user should know: one sentence each.
    pub notices: Vec<String>,
}

impl SceneList {
    /// The name of the view that is called `asked`: by its name or by the end of its path, with or without
    /// its ending. Fails where none or several of `scene` are.
    pub fn view_name(&self, asked: &str, scene: &Path) -> Result<String, SceneError> {
        let views: Vec<(String, PathBuf)> = self.photos.iter().flat_map(ScenePhoto::views).collect();
        let cut = self.photos.iter().filter(|photo| photo.is_cut());
        if let Ok(photo) = split::view_name(asked, cut.map(|photo| (&*photo.name, &*photo.path)), scene) {
            let problem = format!(
                "has the photo {}, which is cut into views; name one of them, as {}",
                shown(photo),
                shown(part_name(photo, "front"))
            );
            return Err(SceneError::invalid(scene, problem));
        }
        split::view_name(asked, views.iter().map(|(name, path)| (&**name, &**path)), scene).map(str::to_owned)
    }
}

/// A photo that exists and is not decoded.
#[derive(Clone, Debug)]
pub struct ScenePhoto {
    /// That of its view: a file name that no other photo of the scene has.
    pub name: String,
    /// Its file.
    pub path: PathBuf,
    /// At the size that the scene states.
    pub camera: Camera,
    /// What bends it; `None` for a pinhole.
    pub lens: Option<Lens>,
    /// A picture that is black where the photo does not count.
    pub mask: Option<PathBuf>,
    /// How far away what it shows is.
    pub depth: Option<ListedDepth>,
    /// Whether it is held out.
    pub is_test: bool,
}

impl ScenePhoto {
    fn cut(&self) -> Option<Cut> {
        Cut::of(&self.camera, self.lens.as_ref()?)
    }

    /// Whether it shows more than a pinhole can, and is cut into views.
    pub fn is_cut(&self) -> bool {
        self.cut().is_some()
    }

    /// The names of its views, and what files of these names would be called.
    fn views(&self) -> Vec<(String, PathBuf)> {
        let Some(cut) = self.cut() else { return vec![(self.name.clone(), self.path.clone())] };
        let file = self.path.file_name().unwrap_or_default().to_string_lossy();
        let view =
            |part: &str| (part_name(&self.name, part), self.path.with_file_name(part_name(&file, part)));
        cut.views(cut.side(), SIDE_MIN_PX).iter().map(|(part, _)| view(part.name)).collect()
    }

    /// The pinholes that show it: one, or one for each view that it is cut into.
    pub fn pinholes(&self) -> Vec<Camera> {
        let Some(cut) = self.cut() else { return vec![self.camera] };
        cut.views(cut.side(), SIDE_MIN_PX).into_iter().map(|(_, camera)| camera).collect()
    }

    /// How far the lens moves what is in a corner, px, at the most; `None` where a pinhole would not show a
    /// corner.
    pub fn bend_px(&self) -> Option<f64> {
        let Some(lens) = self.lens else { return Some(0.0) };
        let Camera { width, height, focal_px: [fx, fy], principal_px: [cx, cy], .. } = self.camera;
        let (right, bottom) = (f64::from(width), f64::from(height));
        let corners = [[0.0, 0.0], [right, 0.0], [0.0, bottom], [right, bottom]];
        corners.iter().try_fold(0.0, |most: f64, [u, v]| {
            let shown = [(u - cx) / fx, (v - cy) / fy];
            let straight = lens.undistort(shown)?;
            Some(most.max((fx * (straight[0] - shown[0])).hypot(fy * (straight[1] - shown[1]))))
        })
    }
}

/// Lists the scene that [`super::load_scene`] would load; `options` say what is held out.
pub fn list_scene(path: &Path, options: &LoadOptions) -> Result<SceneList, SceneError> {
    let Listing { photos, points, moved, notices, doubts, .. } = list(path, options)?;
    let (train, test) = split::split(photos, &options.hold_out, path)?;
    let photo = |is_test: bool| {
        move |ListedPhoto { name, path, camera, lens, mask, depth, .. }: ListedPhoto| ScenePhoto {
            name,
            path,
            camera,
            lens,
            mask,
            depth,
            is_test,
        }
    };
    let photos = train.into_iter().map(photo(false)).chain(test.into_iter().map(photo(true))).collect();
    let problems = doubts.into_iter().map(|doubt| doubt.problem);
    let notices = notices.into_iter().chain(problems).collect();
    Ok(SceneList { photos, points, offset: moved.offset, notices })
}

/// COLMAP's model of `photos`, by the names of their views, with these points. Each photo has a camera of its
/// own.
pub fn model_of(photos: &[&ScenePhoto], points: Vec<Point>) -> Model {
    let mut model = Model { points, ..Model::default() };
    for (id, photo) in (1u32..).zip(photos) {
        let Camera {
            width,
            height,
            focal_px,
            principal_px,
            camera_from_world_rotation,
            camera_from_world_translation,
            ..
        } = photo.camera;
        let (q, lens) = (camera_from_world_rotation, photo.lens);
        model.cameras.insert(id, Intrinsics { width, height, focal_px, principal_px, lens });
        model.images.push(ImageRecord {
            name: photo.name.clone(),
            camera: id,
            rotation: [q.w, q.x, q.y, q.z],
            translation: camera_from_world_translation.to_array(),
        });
    }
    model
}
