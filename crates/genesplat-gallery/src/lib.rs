//! The bundled scene: a small art gallery, ray-cast here, so that everything can be tried without a download.
//!
//! The room (`room`, `exhibits`) is lit once (`light`), photographed from a path of cameras (`cameras`,
//! `render`) and given points as structure from motion would find them (`points`). The same options give the
//! same bytes on one machine, for any number of threads.

mod cameras;
mod exhibits;
mod geometry;
mod light;
mod painting;
mod points;
mod render;
mod room;
mod texture;
mod world;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use genesplat_core::{Camera, Photo, View};
use genesplat_io::colmap::{ImageRecord, Intrinsics, Model, write_model};
use genesplat_io::own;
use genesplat_io::photos::{PhotoError, write_own_png};
use genesplat_io::{HoldOut, Point, SIDE_MIN_PX, Scene, SceneDigests, Sight};
use glam::Vec3;
use render::{RayCaster, rays_around, rays_of};

/// How the gallery is photographed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GalleryOptions {
    /// Width of the photos, px; at least 16.
    pub width: u32,
    /// Height of the photos, px; at least 16.
    pub height: u32,
    /// Number of photos; at least 2.
    pub views: u32,
    /// Number of points at most.
    pub points: u32,
    /// Seed of patterns and points.
    pub seed: u64,
}

impl Default for GalleryOptions {
    fn default() -> Self {
        Self { width: 320, height: 214, views: 48, points: 3500, seed: 0 }
    }
}

/// Photos of the gallery, with their cameras, and points.
#[derive(Clone, Debug)]
pub struct Gallery {
    /// In the order of the path; names sort in that order.
    pub views: Vec<View>,
    /// Points that at least three views see.
    pub points: Vec<Point>,
    /// The places of the points that each view sees, rising.
    pub seen: Vec<Vec<u32>>,
}

/// Builds the room and photographs it.
///
/// # Panics
/// If a side is below 16 px or there are fewer than 2 views.
pub fn generate(options: &GalleryOptions) -> Gallery {
    let GalleryOptions { width, height, views, points, seed } = *options;
    assert!(width.min(height) >= SIDE_MIN_PX && views >= 2, "a gallery needs photos: {options:?}");
    let caster = build(seed);
    let views: Vec<View> = (cameras::path(views, width, height).into_iter().enumerate())
        .map(|(index, camera)| View {
            name: view_name(index, views),
            photo: caster.photograph([width, height], &rays_of(&camera)).into(),
            camera,
            mask: None,
            depth: None,
        })
        .collect();
    let (points, seen_by): (Vec<_>, Vec<_>) =
        points::sample(&caster, &views, points, seed).into_iter().unzip();
    let mut seen = vec![Vec::new(); views.len()];
    for (point, views) in (0u32..).zip(seen_by) {
        views.into_iter().for_each(|view| seen[view].push(point));
    }
    Gallery { views, points, seen }
}

/// How far away what each photo shows is, along the axis of its camera and through the centres of its pixels
/// `[views][H, W]`, metres.
pub fn depths(options: &GalleryOptions) -> Vec<Vec<f32>> {
    let caster = build(options.seed);
    let cameras = cameras::path(options.views, options.width, options.height);
    cameras.iter().map(|camera| caster.depths(camera)).collect()
}

/// What the cameras of this gallery would take of all around: columns are longitudes and rows latitudes, what
/// is ahead lies in the middle, and a photo is `2 height` x `height` px.
pub fn all_around(options: &GalleryOptions, height: u32) -> Vec<Photo> {
    let caster = build(options.seed);
    let cameras = cameras::path(options.views, options.width, options.height);
    cameras
        .iter()
        .map(|camera| caster.photograph([2 * height, height], &rays_around(camera, height)))
        .collect()
}

fn build(seed: u64) -> RayCaster {
    let seed = (seed ^ (seed >> 32)) as u32;
    let (world, lamps) = room::build(seed);
    let lighting = light::Lighting::bake(&world, &lamps, seed);
    RayCaster { world, lighting, seed }
}

/// Of as many digits as the last one has, so that names sort as numbers do.
fn view_name(index: usize, views: u32) -> String {
    let digits = (views - 1).to_string().len().max(3);
    format!("gallery_{index:0digits$}.png")
}

/// It is in memory.
fn photo_of(view: &View) -> Arc<Photo> {
    view.photo.read().expect("what was just made is there")
}

/// Where the model of a scene is.
const MODEL: &str = "sparse/0";

impl Gallery {
    /// As a scene, without files.
    pub fn into_scene(self, hold_out: HoldOut) -> Scene {
        let sights = |(view, points): (&View, &Vec<u32>)| {
            let sights = points.iter().map(|&point| self.sight(view, point)).collect();
            (view.name.clone(), sights)
        };
        let seen = self.views.iter().zip(&self.seen).map(sights).collect();
        let (train, test) = hold_out.split(self.views);
        let digests = SceneDigests::of_views([&train, &test], &self.points);
        let (photos, notices) = (Vec::new(), Vec::new());
        Scene {
            name: "gallery".into(),
            train,
            test,
            points: self.points,
            seen,
            whole: BTreeMap::new(),
            photos,
            digests,
            notices,
            doubts: Vec::new(),
        }
    }

    fn sight(&self, view: &View, point: u32) -> Sight {
        let position = Vec3::from(self.points[point as usize].position).as_dvec3();
        let in_camera = view.camera.camera_from_world(position);
        Sight { point, ray: Some([in_camera.x, in_camera.y].map(|along| (along / in_camera.z) as f32)) }
    }

    /// Writes a COLMAP scene into `folder`, which every trainer reads: `images/*.png` and `sparse/0/*.bin`.
    pub fn write_colmap(&self, folder: &Path) -> Result<(), PhotoError> {
        for view in &self.views {
            write_own_png(folder, Path::new("images").join(&view.name), &photo_of(view))?;
        }
        let written = own::make_folder(folder, MODEL).and_then(|model| write_model(&model, &self.model()));
        written.map_err(|source| PhotoError::Write { path: folder.join(MODEL), source })
    }

    fn model(&self) -> Model {
        let Camera { width, height, focal_px, principal_px, .. } = self.views[0].camera;
        let intrinsics = Intrinsics { width, height, focal_px, principal_px, lens: None };
        let image = |view: &View| {
            let [x, y, z, w] = view.camera.camera_from_world_rotation.to_array();
            let translation = view.camera.camera_from_world_translation.to_array();
            ImageRecord { name: view.name.clone(), camera: 1, rotation: [w, x, y, z], translation }
        };
        let images = self.views.iter().map(image).collect();
        Model { cameras: [(1, intrinsics)].into(), images, points: self.points.clone(), notices: Vec::new() }
    }
}

#[cfg(test)]
mod tests {
    use super::view_name;

    #[test]
    fn names_sort_in_the_order_of_the_path() {
        assert_eq!(view_name(7, 48), "gallery_007.png");
        for views in [48, 1000, 1001] {
            assert!((0..views as usize).map(|index| view_name(index, views)).is_sorted(), "{views}");
        }
    }
}
