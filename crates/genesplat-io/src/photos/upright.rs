//! Photos as files for programs that look past orientation tags: upright, and without such a tag.

use std::io::{self, Write};
use std::path::Path;

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::metadata::Orientation;
use image::{DynamicImage, ImageEncoder, ImageError, ImageFormat, ImageResult};

use super::decode::is_sideways;
use super::{EncodedPhoto, PhotoError, PhotoMask};
use crate::own;

/// Of a JPEG that is written anew: no loss that training sees.
const QUALITY: u8 = 97;

/// What turns a photo upright.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Turn(Orientation);

/// The turn that the tag of the photo at `path` asks for; `None` where it is upright, or is not read.
pub fn turn_of(path: &Path) -> Option<Turn> {
    EncodedPhoto::open(path).ok()?.encoded.tag().map(Turn)
}

/// The photo at `from`, upright, as `name` in `folder`: a JPEG if it was one, else a PNG with its
/// transparency and its depth. Its EXIF data come along. Whole or not at all.
pub fn write_upright(from: &Path, (folder, name): (&Path, &Path)) -> Result<(), PhotoError> {
    let EncodedPhoto { path, encoded } = EncodedPhoto::open(from)?;
    let (format, mut exif) = (encoded.format(), encoded.exif().unwrap_or_default());
    let photo = EncodedPhoto { path, encoded: encoded.upright() };
    // It is followed below.
    let _ = Orientation::remove_from_exif_chunk(&mut exif);
    let _room = photo.wait_for_room();
    let image = photo.decode()?;
    let mut bytes = Vec::new();
    let encoded = match format {
        ImageFormat::Jpeg => encode(JpegEncoder::new_with_quality(&mut bytes, QUALITY), &image, exif),
        _ => encode(PngEncoder::new(&mut bytes), &image, exif),
    };
    let write = |source| PhotoError::Write { path: folder.join(name), source };
    encoded.map_err(|error| write(io::Error::other(error)))?;
    own::write(folder, name, |out| out.write_all(&bytes)).map_err(write)
}

fn encode(mut encoder: impl ImageEncoder, image: &DynamicImage, exif: Vec<u8>) -> ImageResult<()> {
    if !exif.is_empty() {
        encoder.set_exif_metadata(exif).map_err(ImageError::Unsupported)?;
    }
    image.write_with_encoder(encoder)
}

/// The mask at `from` as a PNG of black and white, `name` in `folder`, turned as its photo, whose file has
/// `photo` px. A mask that is as large as the upright photo stays as it is.
pub fn write_mask(
    from: &Path,
    (folder, name): (&Path, &Path),
    photo: [u32; 2],
    turn: Option<Turn>,
) -> Result<(), PhotoError> {
    let mask = PhotoMask::open(from)?;
    let [width, height] = mask.size;
    let is_upright = |Turn(tag): &Turn| is_sideways(*tag) && [height, width] == photo && width != height;
    let levels = mask.counts.iter().map(|counts| if *counts { u8::MAX } else { 0 }).collect();
    let levels =
        image::GrayImage::from_raw(width, height, levels).expect("a mask has a value for each pixel");
    let mut image = DynamicImage::from(levels);
    turn.filter(|turn| !is_upright(turn)).into_iter().for_each(|Turn(tag)| image.apply_orientation(tag));
    let write = |source| PhotoError::Write { path: folder.join(name), source };
    let mut bytes = Vec::new();
    encode(PngEncoder::new(&mut bytes), &image, Vec::new())
        .map_err(|error| write(io::Error::other(error)))?;
    own::write(folder, name, |out| out.write_all(&bytes)).map_err(write)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photos::{Photo, encode_jpeg, photo_size, read_photo, write_png};

    const TO: &str = "b/a.jpg";

    /// Black but for a white corner, the left upper one.
    fn corner(width: u32, height: u32) -> Photo {
        let is_white = |index| index % width < 8 && index / width < 8;
        let rgb =
            (0..width * height).flat_map(|index| [if is_white(index) { u8::MAX } else { 0 }; 3]).collect();
        Photo { width, height, rgb }
    }

    /// A JPEG with an orientation and a model in its EXIF data.
    fn tagged(jpeg: &[u8], orientation: u8) -> Vec<u8> {
        let model = [0x10, 1, 2, 0, 4, 0, 0, 0, b'X', b'1', b'0', 0];
        let entry = [0x12, 1, 3, 0, 1, 0, 0, 0, orientation, 0, 0, 0];
        let tiff = [b"II*\0\x08\0\0\0\x02\0".as_slice(), &model, &entry, &[0; 4]].concat();
        let head = [0xFF, 0xD8, 0xFF, 0xE1, 0, 8 + tiff.len() as u8];
        [&head[..], b"Exif\0\0", &tiff, &jpeg[2..]].concat()
    }

    fn is_white(photo: &Photo, x: u32, y: u32) -> bool {
        photo.rgb[3 * (y * photo.width + x) as usize] > 200
    }

    #[test]
    fn a_photo_with_a_tag_is_written_upright_with_its_other_tags() {
        let place = tempfile::tempdir().unwrap();
        let [from, to] = ["a.jpg", TO].map(|name| place.path().join(name));
        let jpeg = encode_jpeg(&corner(32, 16), 95);
        for (orientation, size, [x, y]) in
            [(6, (16, 32), [15, 0]), (3, (32, 16), [31, 15]), (8, (16, 32), [0, 31])]
        {
            std::fs::write(&from, tagged(&jpeg, orientation)).unwrap();
            assert!(turn_of(&from).is_some());
            write_upright(&from, (place.path(), Path::new(TO))).unwrap();
            let (photo, turn) = (read_photo(&to).unwrap(), turn_of(&to));
            assert_eq!((photo.width, photo.height), size);
            assert!(is_white(&photo, x, y) && turn.is_none(), "{orientation}");
            let bytes = std::fs::read(&to).unwrap();
            assert!(bytes.windows(4).any(|bytes| bytes == b"X10\0"), "its camera");
        }
        std::fs::write(&from, tagged(&jpeg, 1)).unwrap();
        assert_eq!(turn_of(&from), None);
    }

    #[test]
    fn a_mask_is_turned_with_its_photo_unless_it_is_upright() {
        let place = tempfile::tempdir().unwrap();
        let [lying, upright, to] = ["lying.png", "upright.png", TO].map(|name| place.path().join(name));
        write_png(&lying, &corner(32, 16)).unwrap();
        write_png(&upright, &corner(16, 32)).unwrap();
        for (from, x) in [(lying, 15), (upright, 0)] {
            write_mask(&from, (place.path(), Path::new(TO)), [32, 16], Some(Turn(Orientation::Rotate90)))
                .unwrap();
            assert_eq!(photo_size(&to).unwrap(), (16, 32));
            let mask = read_photo(&to).unwrap();
            assert!(is_white(&mask, x, 0) && !is_white(&mask, 15 - x, 0));
        }
    }
}
