//! What a photo is taken to: straight lines, and the size that is asked for, in one view or in several.

use std::sync::{Mutex, MutexGuard, PoisonError};

use genesplat_core::{Camera, Photo};
use glam::{DQuat, DVec3};

use super::LoadOptions;
use super::view::SIDE_MIN_PX;
use crate::error::SceneError;
use crate::listing::{ListedPhoto, part_name};
use crate::photos::{self, Cut, Depths, Lens, Part, PhotoMask};
use crate::shown;

/// Pinholes that were found, by the camera without its pose, and its lens: photos of one camera share theirs.
#[derive(Default)]
pub(super) struct Pinholes(Mutex<Vec<(Camera, Lens, Option<Camera>)>>);

impl Pinholes {
    fn of(&self, camera: &Camera, lens: &Lens) -> Option<Camera> {
        let key = Camera {
            camera_from_world_rotation: DQuat::IDENTITY,
            camera_from_world_translation: DVec3::ZERO,
            ..*camera
        };
        let known = self.found().iter().find(|known| known.0 == key && known.1 == *lens).map(|known| known.2);
        let pinhole = known.unwrap_or_else(|| {
            let pinhole = photos::pinhole(&key, lens);
            self.found().push((key, *lens, pinhole));
            pinhole
        });
        let Camera { camera_from_world_rotation, camera_from_world_translation, .. } = *camera;
        pinhole.map(|pinhole| Camera { camera_from_world_rotation, camera_from_world_translation, ..pinhole })
    }

    /// A list is whole even where a thread has panicked.
    fn found(&self) -> MutexGuard<'_, Vec<(Camera, Lens, Option<Camera>)>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A view of a photo.
pub(super) struct Picture {
    pub(super) name: String,
    pub(super) camera: Camera,
    pub(super) photo: Photo,
    pub(super) mask: Option<PhotoMask>,
}

/// How a photo is taken to views.
pub(super) enum Frame<'a> {
    /// To one.
    Whole {
        /// At the photo's own size.
        camera: Camera,
        lens: Option<&'a Lens>,
        pinhole: Camera,
        /// Of the loaded photo, px.
        size: [u32; 2],
    },
    /// To several, of faces of this side, px.
    Parts { cut: Cut, side: u32, views: Vec<(Part, Camera)> },
}

impl<'a> Frame<'a> {
    /// That of a photo of `width` x `height` px.
    pub(super) fn of(
        listed: &'a ListedPhoto,
        (width, height): (u32, u32),
        options: &LoadOptions,
        pinholes: &Pinholes,
    ) -> Result<Self, SceneError> {
        let camera = camera_of_photo(listed, width, height)?;
        let lens = listed.lens.as_ref();
        if let Some(cut) = lens.and_then(|lens| Cut::of(&camera, lens)) {
            let (side, _) = options.size_of(cut.side(), cut.side());
            check_size(listed, [side; 2])?;
            return Ok(Self::Parts { cut, side, views: cut.views(side, SIDE_MIN_PX) });
        }
        let pinhole =
            lens.map_or(Some(camera), |lens| pinholes.of(&camera, lens)).ok_or_else(|| no_pinhole(listed))?;
        let size = options.size_of(pinhole.width, pinhole.height).into();
        check_size(listed, size)?;
        Ok(Self::Whole { camera, lens, pinhole, size })
    }

    /// The values of a depth map at the pixels of the view, the nearest ones; `None` for a photo of several
    /// views, each of which looks along another axis.
    pub(super) fn depths(&self, depths: &Depths) -> Option<Vec<f32>> {
        let Self::Whole { camera, lens, pinhole, size: [width, height] } = self else { return None };
        let fine = pinhole.resized(*width, *height);
        let value = |row: u32, column: u32| {
            let at = [column, row].map(|place| f64::from(place) + 0.5);
            match lens {
                Some(lens) => {
                    depths.at(photos::source_px(camera, lens, &fine, at), [camera.width, camera.height])
                }
                None => depths.at(at, [*width, *height]),
            }
        };
        Some(
            (0..*height)
                .flat_map(|row| (0..*width).map(move |column| (row, column)))
                .map(|(row, column)| value(row, column))
                .collect(),
        )
    }

    /// Hands each view of the photo on, one after the other.
    pub(super) fn each_view<E>(
        &self,
        listed: &ListedPhoto,
        photo: &Photo,
        mask: Option<&PhotoMask>,
        mut take: impl FnMut(Picture) -> Result<(), E>,
    ) -> Result<(), E> {
        match self {
            Self::Whole { camera, lens, pinhole, size } => {
                let [width, height] = *size;
                let straight = match lens {
                    Some(lens) => photos::undistort(photo, camera, lens, pinhole, *size),
                    None => photos::resize(photo, width, height),
                };
                let mask = mask.map(|mask| match lens {
                    Some(lens) => photos::undistort_mask(mask, camera, lens, pinhole, *size),
                    None => mask.resized(*size),
                });
                let (name, camera) = (listed.name.clone(), pinhole.resized(width, height));
                take(Picture { name, camera, photo: straight, mask })
            }
            Self::Parts { cut, side, views } => {
                let parts: Vec<Part> = views.iter().map(|(part, _)| *part).collect();
                let photos = cut.photos(photo, &parts, *side).zip(cut.masks(mask, &parts, *side));
                views.iter().zip(photos).try_for_each(|((part, camera), (photo, mask))| {
                    let name = part_name(&listed.name, part.name);
                    take(Picture { name, camera: *camera, photo, mask: Some(mask) })
                })
            }
        }
    }
}

/// How many pixels a photo has once it is loaded, as its list has it.
pub(super) fn loaded_pixels(listed: &ListedPhoto, options: &LoadOptions) -> u64 {
    let pixels = |(width, height): (u32, u32)| u64::from(width) * u64::from(height);
    let Some(cut) = listed.cut() else {
        return pixels(options.size_of(listed.camera.width, listed.camera.height));
    };
    let (side, _) = options.size_of(cut.side(), cut.side());
    let views = cut.views(side, SIDE_MIN_PX);
    views.iter().map(|(_, view)| pixels((view.width, view.height))).sum()
}

fn check_size(listed: &ListedPhoto, [width, height]: [u32; 2]) -> Result<(), SceneError> {
    if width.min(height) >= SIDE_MIN_PX {
        return Ok(());
    }
    let problem = format!(
        "would be loaded at {width}x{height} pixels, and both sides must have at least {SIDE_MIN_PX}; reduce it \
         less (--max-side, --downscale), or take a larger photo"
    );
    Err(SceneError::BadPhoto { photo: listed.path.clone(), problem })
}

fn no_pinhole(listed: &ListedPhoto) -> SceneError {
    SceneError::BadCamera {
        file: listed.list.to_path_buf(),
        camera: listed.name.clone(),
        problem: "has distortion coefficients that cannot be undone".into(),
    }
}

/// The listed camera at the photo's own size.
///
/// Published scenes calibrate on larger photos than they ship (Tanks and Temples: twice), rounded to whole
/// pixels. So a camera of the same shape is scaled, and a camera of another shape is an error.
fn camera_of_photo(listed: &ListedPhoto, width: u32, height: u32) -> Result<Camera, SceneError> {
    let camera = &listed.camera;
    if !is_same_shape([camera.width, camera.height], [width, height]) {
        let problem = format!(
            "is {width}x{height} pixels, but its camera in {} is {}x{}, which is another shape; use the photos that \
             the cameras were calibrated on",
            shown(&*listed.list),
            camera.width,
            camera.height
        );
        return Err(SceneError::BadPhoto { photo: listed.path.clone(), problem });
    }
    Ok(camera.resized(width, height))
}

/// Either side may have been rounded by a pixel before and after the reduction; 0.5 % covers large photos.
pub(super) fn is_same_shape(original: [u32; 2], [width, height]: [u32; 2]) -> bool {
    let expected_height = f64::from(original[1]) * f64::from(width) / f64::from(original[0]);
    (expected_height - f64::from(height)).abs() <= (0.005 * f64::from(height)).max(2.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shape_may_differ_by_half_a_percent_or_two_pixels() {
        let is_same = |height: u32| is_same_shape([2000, 2000], [1000, height]);
        assert_eq!([994, 996, 1004, 1006].map(is_same), [false, true, true, false]);
        assert!(is_same_shape([100, 100], [50, 48]) && !is_same_shape([100, 100], [50, 47]));
    }
}
