//! From a listed photo to a view: check the header, decode, undistort, resize.

use std::io;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use genesplat_core::{Camera, Mask, Photo, StoredPhoto, View};
use glam::{DQuat, DVec3};

use super::{LoadOptions, LoadProgress, MaskUse, PhotoDigests, Spill, digests_of};
use crate::digest::Digest;
use crate::error::SceneError;
use crate::listing::ListedPhoto;
use crate::photos::{self, EncodedPhoto, Lens, PhotoError, PhotoFile, PhotoMask};
use crate::shown;

/// Least side of a loaded photo, px: SSIM's window alone has 11.
pub const SIDE_MIN_PX: u32 = 16;

/// A photo that could be read.
pub(super) struct Opened {
    pub(super) digests: PhotoDigests,
    /// Or why its pixels cannot be had: the file is damaged, or no photo.
    pub(super) loaded: Result<Loaded, PhotoError>,
}

/// A view, and what its photo hides.
pub(super) struct Loaded {
    pub(super) view: View,
    pub(super) is_masked: bool,
    pub(super) is_transparent: bool,
}

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

/// Where loaded photos stay.
pub(super) struct PhotoStorage<'a>(Option<(Arc<PhotoFile>, &'a Path)>);

impl<'a> PhotoStorage<'a> {
    /// In a file where `photos` have more bytes than memory should hold.
    pub(super) fn new<'b>(
        photos: impl Iterator<Item = &'b ListedPhoto>,
        options: &'a LoadOptions,
    ) -> Result<Self, SceneError> {
        let bytes = |photo: &ListedPhoto| {
            let (width, height) = options.size_of(photo.camera.width, photo.camera.height);
            3 * u64::from(width) * u64::from(height)
        };
        let spill = options.spill.as_ref();
        Self::in_file(spill.filter(|spill| photos.map(bytes).sum::<u64>() > spill.memory_bytes))
    }

    /// In a new file, where it is said where.
    pub(super) fn in_file(spill: Option<&'a Spill>) -> Result<Self, SceneError> {
        let Some(Spill { folder, .. }) = spill else { return Ok(Self(None)) };
        let file = PhotoFile::create_in(folder).map_err(|source| cannot_keep(folder, source))?;
        Ok(Self(Some((file, folder))))
    }

    pub(super) fn keep(&self, photo: Photo) -> Result<StoredPhoto, SceneError> {
        match &self.0 {
            Some((file, folder)) => file.keep(&photo).map_err(|source| cannot_keep(folder, source)),
            None => Ok(photo.into()),
        }
    }
}

fn cannot_keep(folder: &Path, source: io::Error) -> SceneError {
    SceneError::CannotKeepPhotos { folder: folder.to_owned(), source }
}

pub(super) fn load(
    listed: &ListedPhoto,
    options: &LoadOptions,
    pinholes: &Pinholes,
    storage: &PhotoStorage,
    progress: &dyn LoadProgress,
) -> Result<Opened, SceneError> {
    let opened = match load_sound(listed, options, pinholes, storage) {
        Err(SceneError::Photo(error @ PhotoError::Decode { .. })) if error.path() == listed.path => {
            Opened { digests: digests_of(listed)?, loaded: Err(error) }
        }
        sound => sound?,
    };
    progress.photo_done();
    Ok(opened)
}

fn load_sound(
    listed: &ListedPhoto,
    options: &LoadOptions,
    pinholes: &Pinholes,
    storage: &PhotoStorage,
) -> Result<Opened, SceneError> {
    let photo = EncodedPhoto::open(&listed.path)?;
    let digest = photo.digest();
    let photo = photo.turned_like(listed.camera.width, listed.camera.height);
    let size = photo.size();
    let frame = Frame::of(listed, size, options, pinholes)?;
    // Before the room of the photo is taken: it has a room of its own.
    let mask = listed.mask.as_deref().map(|file| open_mask(file, size.into())).transpose()?;
    let (mask, mask_digest) = mask.unzip();
    let digests = PhotoDigests::of(listed, digest, mask_digest);
    // Whatever follows runs on this thread alone.
    let _room = photo.wait_for_room();
    let (mut photo, opaque) = photo.decode_with_opaque(options.background)?;
    let (is_masked, is_transparent) = (mask.is_some(), opaque.is_some());
    if let Some(mask) = mask.as_ref().filter(|_| options.mask == MaskUse::Transparent) {
        mask.paint(&mut photo, options.background);
    }
    let mask = hidden(mask, opaque, options.mask).map(|mask| frame.of_mask(&mask));
    let photo = frame.of_photo(&photo);
    let view = View {
        name: listed.name.clone(),
        camera: frame.pinhole.resized(frame.size[0], frame.size[1]),
        photo: storage.keep(photo)?,
        // One that hides nothing is none.
        mask: mask.map(Mask::from).filter(|mask| mask.counts.contains(&false)).map(Arc::new),
    };
    Ok(Opened { digests, loaded: Ok(Loaded { view, is_masked, is_transparent }) })
}

/// What a photo is taken to: straight lines, and the size that is asked for.
struct Frame<'a> {
    /// At the photo's own size.
    camera: Camera,
    lens: Option<&'a Lens>,
    pinhole: Camera,
    /// Of the loaded photo, px.
    size: [u32; 2],
}

impl<'a> Frame<'a> {
    /// That of a photo of `width` x `height` px.
    fn of(
        listed: &'a ListedPhoto,
        (width, height): (u32, u32),
        options: &LoadOptions,
        pinholes: &Pinholes,
    ) -> Result<Self, SceneError> {
        let camera = camera_of_photo(listed, width, height)?;
        let lens = listed.lens.as_ref();
        let pinhole =
            lens.map_or(Some(camera), |lens| pinholes.of(&camera, lens)).ok_or_else(|| no_pinhole(listed))?;
        let (width, height) = options.size_of(pinhole.width, pinhole.height);
        if width.min(height) < SIDE_MIN_PX {
            let problem = format!(
                "would be loaded at {width}x{height} pixels, and both sides must have at least {SIDE_MIN_PX}; reduce it \
                 less (--max-side, --downscale), or take a larger photo"
            );
            return Err(SceneError::BadPhoto { photo: listed.path.clone(), problem });
        }
        Ok(Self { camera, lens, pinhole, size: [width, height] })
    }

    fn of_photo(&self, photo: &Photo) -> Photo {
        match self.lens {
            Some(lens) => photos::undistort(photo, &self.camera, lens, &self.pinhole, self.size),
            None => photos::resize(photo, self.size[0], self.size[1]),
        }
    }

    fn of_mask(&self, mask: &PhotoMask) -> PhotoMask {
        match self.lens {
            Some(lens) => photos::undistort_mask(mask, &self.camera, lens, &self.pinhole, self.size),
            None => mask.resized(self.size),
        }
    }
}

/// What counts for nothing, if anything does.
fn hidden(mask: Option<PhotoMask>, opaque: Option<PhotoMask>, mask_use: MaskUse) -> Option<PhotoMask> {
    match mask_use {
        MaskUse::Usual | MaskUse::Off => mask,
        MaskUse::Transparent => None,
        MaskUse::Ignore => match (mask, opaque) {
            (Some(mask), Some(opaque)) => Some(mask.and(&opaque)),
            (mask, opaque) => mask.or(opaque),
        },
    }
}

/// The mask in `file`, at the size of its photo, and the digest of the file. Scenes that ship reduced photos
/// may have masks of the original ones.
fn open_mask(file: &Path, of_photo: [u32; 2]) -> Result<(PhotoMask, Digest), SceneError> {
    let encoded = EncodedPhoto::open(file)?;
    let digest = encoded.digest();
    let mask = PhotoMask::of(encoded)?;
    let ([width, height], [photo_width, photo_height]) = (mask.size(), of_photo);
    if mask.size() == of_photo {
        return Ok((mask, digest));
    }
    if is_same_shape(mask.size(), of_photo) {
        return Ok((mask.resized(of_photo), digest));
    }
    let advice = if is_same_shape([height, width], of_photo) {
        "turn it as its photo"
    } else {
        "make it as large as its photo"
    };
    let problem = format!(
        "is a mask of {width}x{height} pixels, and its photo has {photo_width}x{photo_height}; {advice}"
    );
    Err(SceneError::BadPhoto { photo: file.to_owned(), problem })
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
fn is_same_shape(original: [u32; 2], [width, height]: [u32; 2]) -> bool {
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
