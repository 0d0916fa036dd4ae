//! From a listed photo to its views: check the header, decode, undistort, resize.

use std::io;
use std::path::Path;
use std::sync::Arc;

use genesplat_core::{Mask, Photo, StoredPhoto, View};

use super::depths::{self, Judge, Outcome};
use super::frame::{self, Frame, Picture, Pinholes, is_same_shape};
use super::{LoadOptions, LoadProgress, MaskUse, PhotoDigests, Spill, digests_of};
use crate::digest::Digest;
use crate::error::SceneError;
use crate::listing::ListedPhoto;
use crate::photos::{EncodedPhoto, PhotoError, PhotoFile, PhotoMask};

/// Least side of a loaded photo, px: SSIM's window alone has 11.
pub const SIDE_MIN_PX: u32 = 16;

/// A photo that was looked at.
pub(super) struct Opened {
    pub(super) digests: PhotoDigests,
    /// Or why it cannot be used: it is damaged, or no photo, or not that of its camera.
    pub(super) loaded: Result<Loaded, SceneError>,
}

/// The views of a photo, and what it hides.
pub(super) struct Loaded {
    /// That of the photo.
    pub(super) name: String,
    pub(super) views: Vec<View>,
    pub(super) is_masked: bool,
    pub(super) is_transparent: bool,
    pub(super) depth: Outcome,
}

/// Where loaded photos stay.
pub(super) struct PhotoStorage<'a>(Option<(Arc<PhotoFile>, &'a Path)>);

impl<'a> PhotoStorage<'a> {
    /// In a file where `photos` have more bytes than memory should hold.
    pub(super) fn new<'b>(
        photos: impl Iterator<Item = &'b ListedPhoto>,
        options: &'a LoadOptions,
    ) -> Result<Self, SceneError> {
        let planes = |photo: &ListedPhoto| if photo.depth.is_some() { 6 } else { 3 };
        let bytes = |photo: &ListedPhoto| planes(photo) * frame::loaded_pixels(photo, options);
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
    judge: &Judge,
    progress: &dyn LoadProgress,
) -> Result<Opened, SceneError> {
    let opened = match load_sound(listed, options, pinholes, storage, judge) {
        Err(error) if is_of_photo_alone(&error, &listed.path) => {
            Opened { digests: digests_of(listed)?, loaded: Err(error) }
        }
        sound => sound?,
    };
    progress.photo_done();
    Ok(opened)
}

/// Whether other photos may be used all the same.
fn is_of_photo_alone(error: &SceneError, file: &Path) -> bool {
    match error {
        SceneError::Photo(error @ PhotoError::Decode { .. }) => error.path() == file,
        SceneError::BadPhoto { photo, .. } => photo == file,
        _ => false,
    }
}

fn load_sound(
    listed: &ListedPhoto,
    options: &LoadOptions,
    pinholes: &Pinholes,
    storage: &PhotoStorage,
    judge: &Judge,
) -> Result<Opened, SceneError> {
    let photo = EncodedPhoto::open(&listed.path)?;
    let digest = photo.digest();
    let photo = photo.turned_like(listed.camera.width, listed.camera.height);
    let size = photo.size();
    let frame = Frame::of(listed, size, options, pinholes)?;
    // Before the room of the photo is taken: it has a room of its own.
    let mask = listed.mask.as_deref().map(|file| open_mask(file, size.into())).transpose()?;
    let (mask, mask_digest) = mask.unzip();
    // Whatever follows runs on this thread alone.
    let _room = photo.wait_for_room();
    let (mut photo, opaque) = photo.decode_with_opaque(options.background)?;
    let (is_masked, is_transparent) = (mask.is_some(), opaque.is_some());
    if let Some(mask) = mask.as_ref().filter(|_| options.mask == MaskUse::Transparent) {
        mask.paint(&mut photo, options.background);
    }
    let mask = hidden(mask, opaque, options.mask);
    let mut views = Vec::new();
    frame.each_view(listed, &photo, mask.as_ref(), |Picture { name, camera, photo, mask }| {
        // One that hides nothing is none.
        let mask = mask.map(Mask::from).filter(|mask| mask.counts.contains(&false)).map(Arc::new);
        views.push(View { name, camera, photo: storage.keep(photo)?, mask, depth: None });
        Ok::<_, SceneError>(())
    })?;
    let (depth, depth_digest) = depths::load(listed, &frame, views.first_mut(), judge, storage)?;
    let digests = PhotoDigests::of(listed, digest, mask_digest, depth_digest);
    let name = listed.name.clone();
    let loaded = Loaded { name, views, is_masked, is_transparent, depth };
    Ok(Opened { digests, loaded: Ok(loaded) })
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
    let read = || -> Result<_, PhotoError> {
        let encoded = EncodedPhoto::open(file)?;
        let digest = encoded.digest();
        Ok((PhotoMask::of(encoded)?, digest))
    };
    let (mask, digest) = read().map_err(|error| {
        let why = match error {
            PhotoError::Decode { reason, .. } => reason,
            other => other.to_string(),
        };
        let remedy = "make it anew, or go on without masks by --mask off";
        let problem = format!("is a mask that cannot be read ({why}); {remedy}");
        SceneError::BadPhoto { photo: file.to_owned(), problem }
    })?;
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
