//! The JSON of `transforms*.json`: one schema for Blender, instant-ngp and nerfstudio, which grew from each
//! other.

use std::path::Path;

use serde::Deserialize;

use super::number;
use crate::error::SceneError;
use crate::input;

#[derive(Debug, Deserialize)]
pub(super) struct Transforms {
    /// For all photos, unless a photo has its own.
    #[serde(flatten)]
    pub(super) intrinsics: OptionalIntrinsics,
    #[serde(default)]
    pub(super) frames: Vec<PhotoEntry>,
    /// A point cloud in the frame of the poses, relative to the file.
    pub(super) ply_file_path: Option<String>,
    /// What the values of depth maps are multiplied by; nerfstudio's default is thousandths.
    #[serde(default, deserialize_with = "number::optional")]
    pub(super) depth_unit_scale_factor: Option<f64>,
    /// What instant-ngp calls it.
    #[serde(default, deserialize_with = "number::optional")]
    integer_depth_scale: Option<f64>,
    /// Lists of paths that newer nerfstudio writes, and [`super::splits`] reads.
    pub(super) train_filenames: Option<Vec<String>>,
    pub(super) val_filenames: Option<Vec<String>>,
    pub(super) test_filenames: Option<Vec<String>>,
}

impl Transforms {
    /// Wherever it names a file, with the folder where such files usually are.
    pub(super) fn names_mut<'a>(&'a mut self) -> impl Iterator<Item = (&'static str, &'a mut String)> {
        let lists = [&mut self.train_filenames, &mut self.val_filenames, &mut self.test_filenames];
        let listed = lists.into_iter().flatten().flatten().map(|name| ("images", name));
        let of_entry = |entry: &'a mut PhotoEntry| {
            let mask = entry.mask_path.as_mut().map(|name| ("masks", name));
            let depth = entry.depth_file_path.as_mut().map(|name| ("depths", name));
            [("images", &mut entry.file_path)].into_iter().chain(mask).chain(depth)
        };
        let points = self.ply_file_path.as_mut().map(|name| ("", name));
        self.frames.iter_mut().flat_map(of_entry).chain(listed).chain(points)
    }
}

#[derive(Debug, Deserialize)]
pub(super) struct PhotoEntry {
    /// Relative to the file; Blender leaves the extension out.
    pub(super) file_path: String,
    /// `world_from_camera`, row by row; camera axes x right, y up, z backwards (OpenGL).
    #[serde(deserialize_with = "number::rows")]
    pub(super) transform_matrix: Vec<[f64; 4]>,
    /// Its mask, relative to the file.
    pub(super) mask_path: Option<String>,
    /// Its depth map, relative to the file.
    pub(super) depth_file_path: Option<String>,
    /// What instant-ngp calls it.
    depth_path: Option<String>,
    /// What differs from the file's.
    #[serde(flatten)]
    pub(super) intrinsics: OptionalIntrinsics,
}

#[derive(Clone, Debug, Default, Deserialize)]
pub(super) struct OptionalIntrinsics {
    /// Horizontal field of view, radians.
    #[serde(default, deserialize_with = "number::optional")]
    pub(super) camera_angle_x: Option<f64>,
    /// Vertical field of view, radians; without it and `fl_y`, pixels are square.
    #[serde(default, deserialize_with = "number::optional")]
    pub(super) camera_angle_y: Option<f64>,
    /// Focal lengths, px.
    #[serde(default, deserialize_with = "number::optional")]
    pub(super) fl_x: Option<f64>,
    #[serde(default, deserialize_with = "number::optional")]
    pub(super) fl_y: Option<f64>,
    /// Principal point, px from the top-left corner.
    #[serde(default, deserialize_with = "number::optional")]
    pub(super) cx: Option<f64>,
    #[serde(default, deserialize_with = "number::optional")]
    pub(super) cy: Option<f64>,
    /// Size, px; some writers use a decimal point.
    #[serde(default, deserialize_with = "number::optional")]
    pub(super) w: Option<f64>,
    #[serde(default, deserialize_with = "number::optional")]
    pub(super) h: Option<f64>,
    /// Radial coefficients, as nerfstudio has them ([`crate::photos::Lens`]).
    #[serde(default, deserialize_with = "number::optional")]
    pub(super) k1: Option<f64>,
    #[serde(default, deserialize_with = "number::optional")]
    pub(super) k2: Option<f64>,
    #[serde(default, deserialize_with = "number::optional")]
    pub(super) k3: Option<f64>,
    #[serde(default, deserialize_with = "number::optional")]
    pub(super) k4: Option<f64>,
    /// OpenCV's tangential coefficients.
    #[serde(default, deserialize_with = "number::optional")]
    pub(super) p1: Option<f64>,
    #[serde(default, deserialize_with = "number::optional")]
    pub(super) p2: Option<f64>,
    /// COLMAP's name of the model.
    pub(super) camera_model: Option<String>,
    /// instant-ngp's way to say OPENCV_FISHEYE.
    pub(super) is_fisheye: Option<bool>,
}

impl OptionalIntrinsics {
    /// This photo's values, completed by the file's. A focal length and a field of view say the same: where
    /// the photo has either, the file's other is not taken.
    pub(super) fn or(&self, file: &Self) -> Self {
        let has_x = self.fl_x.or(self.camera_angle_x).is_some();
        let has_y = self.fl_y.or(self.camera_angle_y).is_some();
        Self {
            camera_angle_x: self.camera_angle_x.or(file.camera_angle_x.filter(|_| !has_x)),
            camera_angle_y: self.camera_angle_y.or(file.camera_angle_y.filter(|_| !has_y)),
            fl_x: self.fl_x.or(file.fl_x.filter(|_| !has_x)),
            fl_y: self.fl_y.or(file.fl_y.filter(|_| !has_y)),
            cx: self.cx.or(file.cx),
            cy: self.cy.or(file.cy),
            w: self.w.or(file.w),
            h: self.h.or(file.h),
            k1: self.k1.or(file.k1),
            k2: self.k2.or(file.k2),
            k3: self.k3.or(file.k3),
            k4: self.k4.or(file.k4),
            p1: self.p1.or(file.p1),
            p2: self.p2.or(file.p2),
            camera_model: self.camera_model.clone().or_else(|| file.camera_model.clone()),
            is_fisheye: self.is_fisheye.or(file.is_fisheye),
        }
    }
}

pub(super) fn read(file: &Path) -> Result<Transforms, SceneError> {
    let text = input::read(file).map_err(|source| SceneError::Read { file: file.to_owned(), source })?;
    parse(file, &text)
}

pub(super) fn parse(file: &Path, text: &[u8]) -> Result<Transforms, SceneError> {
    let mut transforms: Transforms = serde_json::from_slice(&number::in_quotes(&input::as_utf8(text)))
        .map_err(|source| SceneError::Json { file: file.to_owned(), source })?;
    transforms.depth_unit_scale_factor =
        transforms.depth_unit_scale_factor.or(transforms.integer_depth_scale);
    for entry in &mut transforms.frames {
        entry.depth_file_path = entry.depth_file_path.take().or(entry.depth_path.take());
    }
    Ok(transforms)
}
