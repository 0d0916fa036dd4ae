//! Photos in and out: decode, composite, undistort, resize, encode.
//!
//! What is decoded here is what the quality figures are measured against, so each rule follows the reference
//! trainer: sizes by its `-r` rule, resampling as Pillow's bicubic filter with antialiasing (two passes with
//! 8-bit values between them), and transparency composited on a background *before* the resize, truncated to
//! 8 bit.

mod cut;
mod decode;
mod depths;
mod exif;
mod file;
mod lens;
mod mask;
mod memory;
mod resize;
mod size;
mod undistort;
mod upright;

use std::io::{self, BufReader, Write};
use std::path::{Path, PathBuf};

use genesplat_core::Photo;
use image::{ColorType, DynamicImage, ImageEncoder, ImageReader};

pub(crate) use cut::{Cut, Part, part_names};
pub(crate) use depths::Depths;
pub use exif::{LensTags, lens_tags};
pub(crate) use file::PhotoFile;
pub use lens::Lens;
pub(crate) use lens::{Polynomial, Projection};
pub(crate) use mask::PhotoMask;
pub(crate) use memory::Room;
pub use resize::resize;
pub use size::PhotoSize;
pub(crate) use undistort::{pinhole, source_px, undistort, undistort_mask};
pub use upright::{Turn, turn_of, write_mask, write_upright};

use self::decode::Encoded;
use crate::atomic::write_atomically;
use crate::digest::Digest;
use crate::{input, own, shown};

/// Why a photo could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PhotoError {
    /// The operating system refused to read.
    #[error("cannot read the photo {}: {source}", shown(.path))]
    Read {
        /// The photo.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Not a picture, or a damaged one.
    #[error("cannot decode the photo {}: {reason}; export it again as PNG or JPEG", shown(.path))]
    Decode {
        /// The photo.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// The operating system refused to write.
    #[error("cannot write the picture {}: {source}", shown(.path))]
    Write {
        /// The picture.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

impl PhotoError {
    /// The file.
    pub(crate) fn path(&self) -> &Path {
        let (Self::Read { path, .. } | Self::Decode { path, .. } | Self::Write { path, .. }) = self;
        path
    }
}

/// A photo of which the header is read, and no pixel.
///
/// The format is told by the content, not by the name. Orientation tags are ignored, as COLMAP and the
/// reference trainer ignore them, unless a camera shows that it was calibrated on upright photos.
pub struct EncodedPhoto {
    path: PathBuf,
    encoded: Encoded,
}

impl EncodedPhoto {
    /// Reads the file at `path`, a PNG, JPEG or WebP.
    pub fn open(path: &Path) -> Result<Self, PhotoError> {
        let unreadable = |source| PhotoError::Read { path: path.to_owned(), source };
        let file = input::open(path).map_err(unreadable)?;
        decode::check_file(&file).map_err(|reason| undecodable(path, reason))?;
        Self::of(path, input::read(path).map_err(unreadable)?)
    }

    /// The photo in `bytes`, which are those of `path`.
    pub fn of(path: &Path, bytes: Vec<u8>) -> Result<Self, PhotoError> {
        let encoded = Encoded::of(bytes).map_err(|reason| undecodable(path, reason))?;
        Ok(Self { path: path.to_owned(), encoded })
    }

    /// Width and height, px, as the header claims them.
    pub fn size(&self) -> (u32, u32) {
        (self.encoded.width, self.encoded.height)
    }

    /// That of its file.
    pub(crate) fn digest(&self) -> Digest {
        self.encoded.digest()
    }

    /// The lens that took it; `None` where its EXIF data have no focal length.
    pub(crate) fn lens_tags(&self) -> Option<LensTags> {
        self.encoded.exif().and_then(exif::of_exif)
    }

    /// The same, turned upright by its orientation tag where only then it has the shape of `width` x `height`
    /// px: its camera was calibrated on the upright photo.
    pub(crate) fn turned_like(self, width: u32, height: u32) -> Self {
        let is_like = |(a, b): (u32, u32)| (a > b) == (width > height);
        if is_like(self.size()) || self.encoded.width == self.encoded.height || width == height {
            return self;
        }
        Self { encoded: self.encoded.upright(), ..self }
    }

    /// Memory for decoding and one copy; waits while other threads have too much of it.
    pub(crate) fn wait_for_room(&self) -> Room<'static> {
        memory::wait_for(self.encoded.loading_bytes())
    }

    /// The pixels; transparency is composited on black.
    pub fn decode_on_black(self) -> Result<Photo, PhotoError> {
        self.decode().map(|image| composite(image, [0; 3]))
    }

    /// The pixels on `background`, and what of the photo is opaque, where not all is.
    pub(crate) fn decode_with_opaque(
        self,
        background: [u8; 3],
    ) -> Result<(Photo, Option<PhotoMask>), PhotoError> {
        let image = self.decode()?;
        let opaque = PhotoMask::of_opaque(&image);
        Ok((composite(image, background), opaque))
    }

    fn decode(self) -> Result<DynamicImage, PhotoError> {
        self.encoded.decode().map_err(|reason| undecodable(&self.path, reason))
    }
}

fn undecodable(path: &Path, reason: String) -> PhotoError {
    PhotoError::Decode { path: path.to_owned(), reason }
}

/// Reads a PNG, JPEG or WebP; transparency is composited on black.
pub fn read_photo(path: &Path) -> Result<Photo, PhotoError> {
    let encoded = EncodedPhoto::open(path)?;
    let _room = encoded.wait_for_room();
    encoded.decode_on_black()
}

/// [`read_photo`], and what of the picture was discarded: a comparison of pictures does not see it.
pub fn read_photo_and_discarded(path: &Path) -> Result<(Photo, Discarded), PhotoError> {
    let encoded = EncodedPhoto::open(path)?;
    let _room = encoded.wait_for_room();
    let image = encoded.decode()?;
    let discarded = Discarded::of(&image);
    Ok((composite(image, [0; 3]), discarded))
}

/// What a picture has and a [`Photo`] cannot hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Discarded {
    /// More than 8 bits a channel.
    pub depth: bool,
    /// Pixels that are not opaque.
    pub transparency: bool,
}

impl Discarded {
    fn of(image: &DynamicImage) -> Self {
        let color = image.color();
        let transparency = color.has_alpha() && image.to_rgba8().pixels().any(|pixel| pixel.0[3] < u8::MAX);
        Self { depth: color.bytes_per_pixel() > color.channel_count(), transparency }
    }
}

/// Width and height of the photo at `path`, from its header alone.
pub fn photo_size(path: &Path) -> Result<(u32, u32), PhotoError> {
    let read = |source| PhotoError::Read { path: path.to_owned(), source };
    let file = input::open(path).map_err(read)?;
    let reader = ImageReader::new(BufReader::new(file)).with_guessed_format().map_err(read)?;
    reader
        .into_dimensions()
        .map_err(|error| PhotoError::Decode { path: path.to_owned(), reason: error.to_string() })
}

/// Writes `photo` as a PNG, whole or not at all, to a path that the user has given.
pub fn write_png(path: &Path, photo: &Photo) -> Result<(), PhotoError> {
    let write = |source| PhotoError::Write { path: path.to_owned(), source };
    let bytes = png_bytes(photo).map_err(write)?;
    write_atomically(path, |out| out.write_all(&bytes)).map_err(write)
}

/// The same to `name` in `folder`, a name of ours ([`crate::own`]).
pub fn write_own_png(folder: &Path, name: impl AsRef<Path>, photo: &Photo) -> Result<(), PhotoError> {
    let write = |source| PhotoError::Write { path: folder.join(&name), source };
    let bytes = png_bytes(photo).map_err(write)?;
    own::write(folder, &name, |out| out.write_all(&bytes)).map_err(write)
}

fn png_bytes(photo: &Photo) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    image::codecs::png::PngEncoder::new(&mut bytes)
        .write_image(&photo.rgb, photo.width, photo.height, ColorType::Rgb8.into())
        .map_err(io::Error::other)?;
    Ok(bytes)
}

/// `photo` as a JPEG of `quality` 1 to 100, for pages and previews.
///
/// # Panics
/// If a side is beyond 65,535 px, which the format cannot hold.
pub fn encode_jpeg(photo: &Photo, quality: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, quality)
        .write_image(&photo.rgb, photo.width, photo.height, ColorType::Rgb8.into())
        .expect("memory takes every picture that the format can hold");
    bytes
}

fn composite(image: DynamicImage, background: [u8; 3]) -> Photo {
    let (width, height) = (image.width(), image.height());
    if !image.color().has_alpha() {
        return Photo { width, height, rgb: image.into_rgb8().into_raw() };
    }
    let rgb = image.into_rgba8().pixels().flat_map(|pixel| over(pixel.0, background)).collect();
    Photo { width, height, rgb }
}

/// One straight-alpha pixel over `background`, truncated to 8 bit as the reference's Blender loader does.
fn over([r, g, b, alpha]: [u8; 4], background: [u8; 3]) -> [u8; 3] {
    let alpha = u32::from(alpha);
    let blend = |value: u8, behind: u8| (u32::from(value) * alpha + u32::from(behind) * (255 - alpha)) / 255;
    [blend(r, background[0]), blend(g, background[1]), blend(b, background[2])].map(|value| value as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_background_shows_through_truncated() {
        let on_white = |pixel| over(pixel, [255; 3]);
        assert_eq!((on_white([200, 100, 50, 255]), on_white([200, 100, 50, 0])), ([200, 100, 50], [255; 3]));
        // 200 * 128 / 255 = 100.39, 50.19 and 25.6, and 127 * 255 / 255 more.
        assert_eq!(on_white([200, 100, 51, 128]), [227, 177, 152]);
    }
}
