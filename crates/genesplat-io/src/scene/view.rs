//! From a listed photo to a view: check the header, decode, undistort, resize.

use std::path::Path;
use std::sync::Arc;

use genesplat_core::{Camera, Mask, View};

use super::{LoadOptions, LoadProgress, MaskUse};
use crate::error::SceneError;
use crate::listing::ListedPhoto;
use crate::photos::{self, EncodedPhoto, Lens, PhotoMask};
use crate::shown;

/// Least side of a loaded photo, px: SSIM's window alone has 11.
pub const SIDE_MIN_PX: u32 = 16;

/// A view, and what its photo hides.
pub(super) struct Loaded {
    pub(super) view: View,
    pub(super) is_masked: bool,
    pub(super) is_transparent: bool,
}

pub(super) fn load(
    listed: &ListedPhoto,
    options: &LoadOptions,
    progress: &dyn LoadProgress,
) -> Result<Loaded, SceneError> {
    let photo = EncodedPhoto::open(&listed.path)?.turned_like(listed.camera.width, listed.camera.height);
    let (photo_width, photo_height) = photo.size();
    let camera = camera_of_photo(listed, photo_width, photo_height)?;
    let pinhole = listed.lens.map_or(Ok(camera), |lens| pinhole_of(listed, &camera, &lens))?;
    let (width, height) = options.size_of(pinhole.width, pinhole.height);
    if width.min(height) < SIDE_MIN_PX {
        let problem = format!(
            "would be loaded at {width}x{height} pixels, and both sides must have at least {SIDE_MIN_PX}; reduce it \
             less (--max-side, --downscale), or take a larger photo"
        );
        return Err(SceneError::BadPhoto { photo: listed.path.clone(), problem });
    }
    // Before the room of the photo is taken: it has a room of its own.
    let mask = listed.mask.as_deref().map(|file| open_mask(file, [photo_width, photo_height])).transpose()?;
    // Whatever follows runs on this thread alone.
    let _room = photo.wait_for_room();
    let (mut photo, opaque) = photo.decode_with_opaque(options.background)?;
    let (is_masked, is_transparent) = (mask.is_some(), opaque.is_some());
    if let Some(mask) = mask.as_ref().filter(|_| options.mask == MaskUse::Transparent) {
        mask.paint(&mut photo, options.background);
    }
    let hidden = hidden(mask, opaque, options.mask);
    let (photo, mask) = match &listed.lens {
        Some(lens) => (
            photos::undistort(&photo, &camera, lens, &pinhole, [width, height]),
            hidden.map(|mask| photos::undistort_mask(&mask, &camera, lens, &pinhole, [width, height])),
        ),
        None => (photos::resize(&photo, width, height), hidden.map(|mask| mask.resized([width, height]))),
    };
    progress.photo_done();
    let view = View {
        name: listed.name.clone(),
        camera: pinhole.resized(width, height),
        photo: Arc::new(photo),
        // One that hides nothing is none.
        mask: mask.map(Mask::from).filter(|mask| mask.counts.contains(&false)).map(Arc::new),
    };
    Ok(Loaded { view, is_masked, is_transparent })
}

/// What counts for nothing, if anything does.
fn hidden(mask: Option<PhotoMask>, opaque: Option<PhotoMask>, mask_use: MaskUse) -> Option<PhotoMask> {
    match mask_use {
        MaskUse::Usual => mask,
        MaskUse::Transparent => None,
        MaskUse::Ignore => match (mask, opaque) {
            (Some(mask), Some(opaque)) => Some(mask.and(&opaque)),
            (mask, opaque) => mask.or(opaque),
        },
    }
}

/// The mask in `file`, at the size of its photo. Scenes that ship reduced photos may have masks of the original ones.
fn open_mask(file: &Path, of_photo: [u32; 2]) -> Result<PhotoMask, SceneError> {
    let mask = PhotoMask::open(file)?;
    let ([width, height], [photo_width, photo_height]) = (mask.size(), of_photo);
    if mask.size() == of_photo {
        return Ok(mask);
    }
    if is_same_shape(mask.size(), of_photo) {
        return Ok(mask.resized(of_photo));
    }
    let advice =
        if is_same_shape([height, width], of_photo) { "turn it as its photo" } else { "make it as large as its photo" };
    let problem =
        format!("is a mask of {width}x{height} pixels, and its photo has {photo_width}x{photo_height}; {advice}");
    Err(SceneError::BadPhoto { photo: file.to_owned(), problem })
}

/// The pinhole that takes the undistorted photo of `camera`.
fn pinhole_of(listed: &ListedPhoto, camera: &Camera, lens: &Lens) -> Result<Camera, SceneError> {
    photos::pinhole(camera, lens).ok_or_else(|| SceneError::BadCamera {
        file: listed.list.to_path_buf(),
        camera: listed.name.clone(),
        problem: "has distortion coefficients that cannot be undone",
    })
}

/// The listed camera at the photo's own size.
///
/// Published scenes calibrate on larger photos than they ship (Tanks and Temples: twice), rounded to whole pixels. So
/// a camera of the same shape is scaled, and a camera of another shape is an error.
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
fn is_same_shape(original: [u32; 2], [width, height]: [u32; 2]) -> bool {
    let expected_height = f64::from(original[1]) * f64::from(width) / f64::from(original[0]);
    (expected_height - f64::from(height)).abs() <= (0.005 * f64::from(height)).max(2.0)
}
