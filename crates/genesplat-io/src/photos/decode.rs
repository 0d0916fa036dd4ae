//! Decodes PNG and JPEG with limits, and refuses files that were cut off.

use std::io::Cursor;

use image::{DynamicImage, ImageFormat, ImageReader};

/// Most pixels of a photo: a few damaged bytes must not claim all memory.
const PIXELS_MAX: u64 = 1 << 28;
/// Four channels of 16 bits.
const PIXEL_BYTES_MAX: u64 = 8;

/// The picture in `bytes`, whatever the name of its file says; the reason where there is none.
pub(super) fn decode(bytes: &[u8]) -> Result<DynamicImage, String> {
    let open = || ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|error| error.to_string());
    let mut reader = open()?;
    let format = reader.format().ok_or("it is neither a PNG nor a JPEG")?;
    if format == ImageFormat::Jpeg && !jpeg_is_whole(bytes) {
        return Err("the file was cut off before the end of the picture".into());
    }
    let (width, height) = open()?.into_dimensions().map_err(|error| error.to_string())?;
    if u64::from(width) * u64::from(height) > PIXELS_MAX {
        return Err(format!("it has {width}x{height} pixels, and at most {PIXELS_MAX} in all are read"));
    }
    // The limit that counts is that of pixels.
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(PIXELS_MAX * PIXEL_BYTES_MAX);
    reader.limits(limits);
    reader.decode().map_err(|error| error.to_string())
}

/// True when an end-of-image marker follows the start of the scan data.
///
/// JPEG decoders fill what a truncated file lacks with grey, which would be trained on silently. Inside scan data a
/// byte 0xFF is always followed by 0x00 or a restart marker (ITU-T T.81, B.1.1.5), so the marker cannot occur by
/// chance.
fn jpeg_is_whole(bytes: &[u8]) -> bool {
    const START_OF_SCAN: u8 = 0xDA;
    const END_OF_IMAGE: [u8; 2] = [0xFF, 0xD9];
    let mut at = 2;
    while let Some(&[0xFF, marker, high, low]) = bytes.get(at..at + 4) {
        at += 2 + usize::from(u16::from_be_bytes([high, low]));
        if marker == START_OF_SCAN {
            return bytes.get(at..).is_some_and(|scan| scan.windows(2).any(|pair| pair == END_OF_IMAGE));
        }
    }
    // Fill bytes or an unusual header: leave the decision to the decoder.
    true
}
