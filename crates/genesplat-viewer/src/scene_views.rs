//! What a page is told once: the scene's cameras, which way is up; and their photos, which it asks for one by
//! one.

use std::sync::OnceLock;

use genesplat_core::{Camera, Gaussians, Photo, View};
use serde::Serialize;

use crate::framing::Framing;
use crate::message::Pose;
use crate::picture::{css_gradient, encode_jpeg, resized};

/// Longest side of a thumbnail, px.
const THUMBNAIL_PX: u32 = 160;
/// Longest side of a photo that a page gets, px.
const PHOTO_PX: u32 = 1920;
const THUMBNAIL_QUALITY: u8 = 75;
const PHOTO_QUALITY: u8 = 90;

/// What a photo is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Split {
    /// Training sees it.
    Train,
    /// Training never sees it.
    Test,
}

struct SceneView {
    split: Split,
    view: View,
    /// Made when a page wants it.
    thumbnail: OnceLock<Vec<u8>>,
}

/// The cameras and photos of a scene.
pub struct SceneViews {
    title: String,
    framing: Framing,
    views: Vec<SceneView>,
}

#[derive(Serialize)]
#[serde(tag = "type", rename = "hello")]
struct Hello<'a> {
    title: &'a str,
    #[serde(flatten)]
    framing: Framing,
    can_train: bool,
    /// The colour scale, for legends.
    scale: String,
    cameras: Vec<CameraCard<'a>>,
}

#[derive(Serialize)]
struct CameraCard<'a> {
    name: &'a str,
    split: Split,
    width: u32,
    height: u32,
    #[serde(flatten)]
    pose: Pose,
}

impl<'a> CameraCard<'a> {
    fn of(scene_view: &'a SceneView) -> Self {
        let Camera { width, height, .. } = scene_view.view.camera;
        Self {
            name: &scene_view.view.name,
            split: scene_view.split,
            width,
            height,
            pose: Pose::of(&scene_view.view.camera),
        }
    }
}

impl SceneViews {
    /// A scene, photos in the order that they were taken in. `cloud` says what there is to turn around where
    /// there are no cameras.
    pub fn new(title: &str, train: &[View], test: &[View], cloud: Option<&Gaussians>) -> Self {
        let of = |split: Split, views: &[View]| -> Vec<SceneView> {
            views
                .iter()
                .map(|view| SceneView { split, view: view.clone(), thumbnail: OnceLock::new() })
                .collect()
        };
        let mut views = of(Split::Train, train);
        views.extend(of(Split::Test, test));
        views.sort_by(|a, b| a.view.name.cmp(&b.view.name));
        let cameras: Vec<Camera> = views.iter().map(|scene_view| scene_view.view.camera).collect();
        let of_cloud = || Framing::of_cloud(cloud.unwrap_or(&Gaussians::default()));
        Self { title: title.into(), framing: Framing::of_cameras(&cameras).unwrap_or_else(of_cloud), views }
    }

    pub(crate) fn hello(&self, can_train: bool) -> String {
        let cameras = self.views.iter().map(CameraCard::of).collect();
        let hello =
            Hello { title: &self.title, framing: self.framing, can_train, scale: css_gradient(), cameras };
        serde_json::to_string(&hello).expect("plain data with text keys is always JSON")
    }

    pub(crate) fn camera(&self, index: u32) -> Option<&Camera> {
        Some(&self.views.get(index as usize)?.view.camera)
    }

    pub(crate) fn view(&self, index: u32) -> Option<&View> {
        Some(&self.views.get(index as usize)?.view)
    }

    pub(crate) fn thumbnail_jpeg(&self, index: u32) -> Option<Vec<u8>> {
        let SceneView { view, thumbnail, .. } = self.views.get(index as usize)?;
        let made = || Some(fitted_jpeg(&*view.photo.read().ok()?, THUMBNAIL_PX, THUMBNAIL_QUALITY));
        thumbnail.get().cloned().or_else(|| made().map(|jpeg| thumbnail.get_or_init(|| jpeg).clone()))
    }

    pub(crate) fn photo_jpeg(&self, index: u32) -> Option<Vec<u8>> {
        Some(fitted_jpeg(&*self.view(index)?.photo.read().ok()?, PHOTO_PX, PHOTO_QUALITY))
    }
}

fn fitted_jpeg(photo: &Photo, side_px: u32, quality: u8) -> Vec<u8> {
    let factor = f64::from(side_px) / f64::from(photo.width.max(photo.height));
    if factor >= 1.0 {
        return encode_jpeg(photo, quality);
    }
    let fit = |side: u32| ((f64::from(side) * factor).round() as u32).max(1);
    encode_jpeg(&resized(photo, fit(photo.width), fit(photo.height)), quality)
}
