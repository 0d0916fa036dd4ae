//! Depth maps as their files have them: 16-bit PNG of nerfstudio and of phones, NumPy's `.npy`, and the maps
//! of COLMAP's dense reconstruction. All hold z, along the axis of the camera, not the length of the ray.

use std::path::Path;

use half::f16;
use image::DynamicImage;

use super::{EncodedPhoto, PhotoError, undecodable};

/// Most values of a map.
const VALUES_MAX: usize = 1 << 28;

/// The values of a file, in units of its own; what is not positive is not known.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Depths {
    /// Width and height.
    pub(crate) size: [u32; 2],
    /// `[H, W]`
    pub(crate) values: Vec<f32>,
}

impl Depths {
    /// What the file at `path`, of these bytes, holds, by its content.
    pub(crate) fn of(path: &Path, bytes: Vec<u8>) -> Result<Self, PhotoError> {
        let undecodable = |reason: String| undecodable(path, reason);
        if let Some(array) = bytes.strip_prefix(b"\x93NUMPY") {
            return of_numpy(array).map_err(undecodable);
        }
        if bytes.first().is_some_and(u8::is_ascii_digit) {
            return of_colmap(&bytes).map_err(undecodable);
        }
        if !bytes.starts_with(b"\x89PNG") {
            return Err(undecodable("it is neither a PNG of 16 bits nor .npy nor a map of COLMAP".into()));
        }
        of_picture(EncodedPhoto::of(path, bytes)?.decode()?).map_err(undecodable)
    }

    /// The value at a place in a picture of `of_size` px that shows the same, pixels from its corner: that of
    /// the nearest pixel, since between two surfaces there is none.
    pub(crate) fn at(&self, [u, v]: [f64; 2], of_size: [u32; 2]) -> f32 {
        let place = |at: f64, axis: usize| {
            let scaled = (at * f64::from(self.size[axis]) / f64::from(of_size[axis])).floor();
            (0.0..f64::from(self.size[axis])).contains(&scaled).then_some(scaled as usize)
        };
        let at = place(u, 0).zip(place(v, 1)).map(|(x, y)| y * self.size[0] as usize + x);
        at.map_or(0.0, |at| self.values[at])
    }

    /// A file as [`of_colmap`] reads it.
    pub(crate) fn to_dense(&self) -> Vec<u8> {
        let [width, height] = self.size;
        let values = self.values.iter().flat_map(|value| value.to_le_bytes());
        format!("{width}&{height}&1&").into_bytes().into_iter().chain(values).collect()
    }
}

fn of_picture(picture: DynamicImage) -> Result<Depths, String> {
    let size = [picture.width(), picture.height()];
    let values = match picture {
        DynamicImage::ImageLuma8(picture) => picture.into_raw().into_iter().map(f32::from).collect(),
        DynamicImage::ImageLuma16(picture) => picture.into_raw().into_iter().map(f32::from).collect(),
        _ => return Err("it has colours, and a depth map has one channel of 16 bits".into()),
    };
    Ok(Depths { size, values })
}

/// `width&height&channels&`, then f32 row after row.
fn of_colmap(bytes: &[u8]) -> Result<Depths, String> {
    let mut rest = bytes;
    let mut number = || {
        let end = rest.iter().take(12).position(|&byte| byte == b'&')?;
        let number = std::str::from_utf8(&rest[..end]).ok()?.parse::<u32>().ok()?;
        rest = &rest[end + 1..];
        Some(number)
    };
    let header = (|| Some([number()?, number()?, number()?]))();
    let [width, height, channels] = header.ok_or("it has not the first line of COLMAP's depth maps")?;
    if channels != 1 {
        return Err(format!("it has {channels} channels, and a depth map has one"));
    }
    of_bytes([width, height], rest, |bytes: [u8; 4]| f32::from_le_bytes(bytes))
}

/// What follows the magic of `.npy`: version, header, values.
fn of_numpy(bytes: &[u8]) -> Result<Depths, String> {
    let short = || "it was cut off before its values".to_owned();
    let (length, rest) = match bytes {
        [1, _, a, b, rest @ ..] => (usize::from(u16::from_le_bytes([*a, *b])), rest),
        [2 | 3, _, a, b, c, d, rest @ ..] => (u32::from_le_bytes([*a, *b, *c, *d]) as usize, rest),
        _ => return Err("it is of a version of .npy that is not read".into()),
    };
    let (header, values) = rest.split_at_checked(length).ok_or_else(short)?;
    let header = std::str::from_utf8(header).map_err(|_| short())?;
    let field = |name: &str| header.split_once(name)?.1.split_once(':').map(|(_, value)| value.trim_start());
    if field("'fortran_order'").is_none_or(|order| !order.starts_with("False")) {
        return Err("its array is in Fortran's order; save it in C's order".into());
    }
    let shape = field("'shape'").and_then(|shape| shape.strip_prefix('(')?.split_once(')'));
    let sides =
        shape.map_or("", |(shape, _)| shape).split(',').map(str::trim).filter(|side| !side.is_empty());
    let sides: Option<Vec<u32>> = sides.map(|side| side.parse().ok()).collect();
    let sides = sides.ok_or("the sides of its array are no numbers")?;
    let size = match sides[..] {
        [height, width] | [height, width, 1] => [width, height],
        _ => return Err(format!("its array has {} axes, and a depth map has two", sides.len())),
    };
    let kind = field("'descr'").and_then(|kind| kind.get(1..4));
    match kind {
        Some("<f2") => of_bytes(size, values, |bytes: [u8; 2]| f16::from_le_bytes(bytes).to_f32()),
        Some("<f4") => of_bytes(size, values, f32::from_le_bytes),
        Some("<f8") => of_bytes(size, values, |bytes: [u8; 8]| f64::from_le_bytes(bytes) as f32),
        Some("<u2") => of_bytes(size, values, |bytes: [u8; 2]| u16::from_le_bytes(bytes).into()),
        _ => Err("its values are neither f2, f4, f8 nor u2; save them as float32".into()),
    }
}

/// Values of `N` bytes each, as many as such a size has.
fn of_bytes<const N: usize>(
    size: [u32; 2],
    bytes: &[u8],
    value: impl Fn([u8; N]) -> f32,
) -> Result<Depths, String> {
    let count = size.map(|side| side as usize).into_iter().try_fold(1usize, usize::checked_mul);
    let count = count.filter(|count| (1..=VALUES_MAX).contains(count));
    let count = count.ok_or_else(|| format!("it claims to have {}x{} values", size[0], size[1]))?;
    if bytes.len() != N * count {
        let [width, height] = size;
        return Err(format!("{width}x{height} values take {} bytes, and it has {}", N * count, bytes.len()));
    }
    Ok(Depths { size, values: bytes.as_chunks::<N>().0.iter().map(|&bytes| value(bytes)).collect() })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(bytes: &[u8]) -> Result<Depths, String> {
        Depths::of(Path::new("map"), bytes.to_vec()).map_err(|error| error.to_string())
    }

    fn numpy(version: u8, header: &str, values: &[u8]) -> Vec<u8> {
        let length = if version == 1 {
            (header.len() as u16).to_le_bytes().to_vec()
        } else {
            (header.len() as u32).to_le_bytes().to_vec()
        };
        [&b"\x93NUMPY"[..], &[version, 0], &length, header.as_bytes(), values].concat()
    }

    #[test]
    fn every_form_of_a_map_is_read() {
        let values = [1.0f32, 2.5, 0.0, 4.0, 5.0, 6.0];
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        let expected = Depths { size: [3, 2], values: values.to_vec() };
        assert_eq!(of(&[&b"3&2&1&"[..], &bytes].concat()).unwrap(), expected);
        let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }\n";
        for version in [1, 2] {
            assert_eq!(of(&numpy(version, header, &bytes)).unwrap(), expected);
        }
        let doubles: Vec<u8> = values.iter().flat_map(|&value| f64::from(value).to_le_bytes()).collect();
        let header = header.replace("<f4", "<f8").replace("(2, 3)", "(2, 3, 1)");
        assert_eq!(of(&numpy(1, &header, &doubles)).unwrap(), expected);
        let mut png = Vec::new();
        let picture =
            image::ImageBuffer::<image::Luma<u16>, _>::from_raw(2, 1, vec![1500u16, 65535]).unwrap();
        picture.write_to(&mut std::io::Cursor::new(&mut png), image::ImageFormat::Png).unwrap();
        assert_eq!(of(&png).unwrap(), Depths { size: [2, 1], values: vec![1500.0, 65535.0] });
    }

    #[test]
    fn what_is_no_map_is_a_sentence() {
        let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }";
        let cases: [(Vec<u8>, &str); 11] = [
            (b"3&2&1&abc".to_vec(), "24 bytes"),
            (b"3&2&3&".to_vec(), "3 channels"),
            (b"3&2".to_vec(), "first line"),
            (b"4294967295&4294967295&1&".to_vec(), "claims"),
            (b"0&2&1&".to_vec(), "claims"),
            (numpy(1, header, &[0; 20]), "24 bytes"),
            (numpy(1, &header.replace("False", "True"), &[0; 24]), "Fortran"),
            (numpy(1, &header.replace("(2, 3)", "(6,)"), &[0; 24]), "1 axes"),
            (numpy(1, &header.replace("<f4", "<i4"), &[0; 24]), "float32"),
            (numpy(9, header, &[0; 24]), "version"),
            (numpy(1, &header.replace("(2, 3)", "(2, x, 3)"), &[0; 24]), "no numbers"),
        ];
        for (bytes, part) in cases {
            let sentence = of(&bytes).unwrap_err();
            assert!(sentence.contains(part), "{sentence}");
        }
        assert!(of(b"\x93NUMPY\x01\x00\xff\xff{").unwrap_err().contains("cut off"));
        assert!(of(b"").is_err() && of(b"\x89PNG").is_err());
        assert!(of(b"hello").unwrap_err().contains("nor a map of COLMAP"));
    }

    #[test]
    fn a_place_has_the_value_of_its_pixel() {
        let depths = Depths { size: [2, 2], values: vec![1.0, 2.0, 3.0, 4.0] };
        let at = |u: f64, v: f64| depths.at([u, v], [20, 10]);
        assert_eq!([at(0.0, 0.0), at(9.9, 4.9), at(10.1, 0.0), at(19.9, 9.9)], [1.0, 1.0, 2.0, 4.0]);
        assert_eq!([at(-0.1, 1.0), at(20.0, 1.0), at(f64::NAN, 1.0)], [0.0; 3]);
    }
}
