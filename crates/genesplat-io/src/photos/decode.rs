//! Decodes PNG, JPEG and WebP: first the header, then the pixels within limits, and nothing of a file that
//! was cut off.

use std::fs::File;
use std::io::{BufReader, Cursor};

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};
use image_webp::WebPDecoder;

use crate::digest::Digest;

/// Most pixels of a photo: a few damaged bytes must not claim all memory.
const PIXELS_MAX: u64 = 1 << 28;
/// Four channels of 16 bits.
const PIXEL_BYTES_MAX: u64 = 8;
/// Most pixels that a byte of a file can stand for. Deflate repeats at most 258 bytes by 2 bits, and each may
/// hold 8 pixels of a PNG; a JPEG spends a bit on 64 pixels of the component that has most.
const PIXELS_PER_BYTE_MAX: u64 = 8 * 1032;
/// Three channels of 8 bits, as all photos are in the end.
const RGB_BYTES: u64 = 3;
const RGBA_BYTES: u64 = 4;
/// Three 16-bit coefficients a pixel, which a progressive JPEG takes in addition.
const COEFFICIENT_BYTES: u64 = 6;

/// Files up to this size, bytes, are read before their header is looked at.
const SMALL_FILE: u64 = 64 << 20;

/// Whether a large file may be read at all: a picture that is not compressed takes no more than its pixels
/// and some words about them.
pub(super) fn check_file(file: &File) -> Result<(), String> {
    let bytes = file.metadata().map_err(|error| error.to_string())?.len();
    if bytes <= SMALL_FILE {
        return Ok(());
    }
    let reader =
        ImageReader::new(BufReader::new(file)).with_guessed_format().map_err(|error| error.to_string())?;
    let (width, height) = reader.into_dimensions().map_err(|error| error.to_string())?;
    let pixels = (u64::from(width) * u64::from(height)).min(PIXELS_MAX);
    if bytes > SMALL_FILE + PIXEL_BYTES_MAX * pixels {
        return Err(format!("its {bytes} bytes are more than {width}x{height} pixels take"));
    }
    Ok(())
}

/// A picture in a file, of which the header is read.
pub(super) struct Encoded {
    bytes: Vec<u8>,
    format: ImageFormat,
    pub(super) width: u32,
    pub(super) height: u32,
    /// Of the picture as its file has it, decoded.
    decoded_bytes: u64,
    /// What turns its pixels upright, where they are to be turned.
    turn: Option<Orientation>,
}

/// Whether turning it swaps width and height.
pub(super) fn is_sideways(tag: Orientation) -> bool {
    use Orientation::{Rotate90, Rotate90FlipH, Rotate270, Rotate270FlipH};
    matches!(tag, Rotate90 | Rotate270 | Rotate90FlipH | Rotate270FlipH)
}

/// Phones write HEIC and cameras AVIF into files of any name.
fn not_read(bytes: &[u8]) -> &'static str {
    const BRANDS: [&[u8]; 6] = [b"heic", b"heix", b"hevc", b"mif1", b"msf1", b"avif"];
    let brand = bytes.get(4..8).filter(|word| *word == b"ftyp").and_then(|_| bytes.get(8..12));
    match brand.is_some_and(|brand| BRANDS.contains(&brand)) {
        true => "it is HEIC or AVIF inside, and only PNG, JPEG and WebP are read",
        false => "it is neither a PNG nor a JPEG nor a WebP",
    }
}

impl Encoded {
    /// The picture in `bytes`, whatever the name of its file says; the reason where there is none that can be
    /// decoded.
    pub(super) fn of(bytes: Vec<u8>) -> Result<Self, String> {
        let reader =
            ImageReader::new(Cursor::new(&bytes)).with_guessed_format().map_err(|error| error.to_string())?;
        let format = reader.format().ok_or_else(|| not_read(&bytes))?;
        if format == ImageFormat::Jpeg && !jpeg_is_whole(&bytes) {
            return Err("the file was cut off before the end of the picture".into());
        }
        let decoder = reader.into_decoder().map_err(|error| error.to_string())?;
        let ((width, height), decoded_bytes) = (decoder.dimensions(), decoder.total_bytes());
        drop(decoder);
        let encoded = Self { bytes, format, width, height, decoded_bytes, turn: None };
        encoded.check_pixels().map(|()| encoded)
    }

    pub(super) fn digest(&self) -> Digest {
        Digest::of(&self.bytes)
    }

    /// The same, turned upright if its tag says how.
    pub(super) fn upright(self) -> Self {
        let Some(tag) = self.tag() else { return self };
        let [width, height] =
            if is_sideways(tag) { [self.height, self.width] } else { [self.width, self.height] };
        Self { width, height, turn: Some(tag), ..self }
    }

    /// What turns it upright; `None` where it is.
    pub(super) fn tag(&self) -> Option<Orientation> {
        let tag = self.exif().and_then(|exif| Orientation::from_exif_chunk(&exif));
        tag.filter(|tag| *tag != Orientation::NoTransforms)
    }

    pub(super) fn exif(&self) -> Option<Vec<u8>> {
        let reader = ImageReader::with_format(Cursor::new(&self.bytes), self.format);
        reader.into_decoder().and_then(|mut decoder| decoder.exif_metadata()).ok().flatten()
    }

    /// Whether its pixels are not quite those that were written.
    pub(super) fn is_lossy(&self) -> bool {
        match self.format {
            ImageFormat::Jpeg => true,
            ImageFormat::WebP => {
                WebPDecoder::new(Cursor::new(&self.bytes)).is_ok_and(|mut decoder| decoder.is_lossy())
            }
            _ => false,
        }
    }

    pub(super) fn format(&self) -> ImageFormat {
        self.format
    }

    fn pixels(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }

    /// A header is believed as far as the bytes behind it reach.
    fn check_pixels(&self) -> Result<(), String> {
        let Self { width, height, .. } = self;
        if self.pixels() > PIXELS_MAX {
            return Err(format!("it has {width}x{height} pixels, and at most {PIXELS_MAX} in all are read"));
        }
        let bytes = self.bytes.len() as u64;
        if self.pixels() > PIXELS_PER_BYTE_MAX * bytes {
            return Err(format!("it claims {width}x{height} pixels, which its {bytes} bytes cannot hold"));
        }
        Ok(())
    }

    /// Most bytes that this photo takes at once while it is loaded: its file, what that holds, and an RGB
    /// copy.
    pub(super) fn loading_bytes(&self) -> u64 {
        let progressive = self.format == ImageFormat::Jpeg && jpeg_is_progressive(&self.bytes);
        let coefficients = if progressive { COEFFICIENT_BYTES } else { 0 };
        // Lossless WebP is decoded with an alpha that nobody asked for; what is turned is copied.
        let copy = if self.format == ImageFormat::WebP || self.turn.is_some() { RGBA_BYTES } else { 0 };
        self.bytes.len() as u64 + self.decoded_bytes + (RGB_BYTES + coefficients + copy) * self.pixels()
    }

    pub(super) fn decode(self) -> Result<DynamicImage, String> {
        let mut reader = ImageReader::with_format(Cursor::new(self.bytes), self.format);
        // The limit that counts is that of pixels.
        let mut limits = Limits::default();
        limits.max_alloc = Some(PIXELS_MAX * PIXEL_BYTES_MAX);
        reader.limits(limits);
        let mut image = reader.decode().map_err(|error| error.to_string())?;
        self.turn.into_iter().for_each(|turn| image.apply_orientation(turn));
        Ok(image)
    }
}

/// Start-of-scan marker: what follows it is no longer a list of segments.
const START_OF_SCAN: u8 = 0xDA;
/// Start of a frame whose coefficients come in several scans.
const PROGRESSIVE_FRAME: u8 = 0xC2;

/// The segments of a JPEG up to its first scan: each one's marker, and where it ends. Stops at fill bytes and
/// unusual headers.
fn jpeg_segments(bytes: &[u8]) -> impl Iterator<Item = (u8, usize)> {
    let mut at = 2;
    std::iter::from_fn(move || {
        let &[0xFF, marker, high, low] = bytes.get(at..at + 4)? else { return None };
        at += 2 + usize::from(u16::from_be_bytes([high, low]));
        Some((marker, at))
    })
}

/// True when an end-of-image marker follows the start of the scan data.
///
/// JPEG decoders fill what a truncated file lacks with grey, which would be trained on silently. Inside scan
/// data a byte 0xFF is always followed by 0x00 or a restart marker (ITU-T T.81, B.1.1.5), so the marker
/// cannot occur by chance.
fn jpeg_is_whole(bytes: &[u8]) -> bool {
    const END_OF_IMAGE: [u8; 2] = [0xFF, 0xD9];
    let scan = jpeg_segments(bytes).find(|(marker, _)| *marker == START_OF_SCAN);
    // Without a scan the decision is left to the decoder.
    scan.is_none_or(|(_, at)| {
        bytes.get(at..).is_some_and(|scan| scan.windows(2).any(|pair| pair == END_OF_IMAGE))
    })
}

fn jpeg_is_progressive(bytes: &[u8]) -> bool {
    let mut header = jpeg_segments(bytes).take_while(|(marker, _)| *marker != START_OF_SCAN);
    header.any(|(marker, _)| marker == PROGRESSIVE_FRAME)
}
