//! Coordinates far from their origin, as maps and surveys have them (UTM, ECEF): single precision, in which
//! splats are trained and stored, has steps there that are not small beside what is shown. So scenes and
//! splats are moved by an offset, which is kept: a coordinate of the source is one of the result plus the
//! offset.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use genesplat_core::camera::mean_and_radius;
use genesplat_core::median;
use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::error::SceneError;
use crate::input;
use crate::listing::COORDINATE_MAX;

/// Steps of single precision at a coordinate, as a part of the radius of what is shown, beyond which it is
/// moved. Where the radius spans a thousand pixels of a photo, they are a hundredth of a pixel.
pub(crate) const FAR: f64 = 1e-5;

/// The same of a splat, whose coordinates are what its user knows: they are changed where details are lost.
const FAR_SPLAT: f64 = 1e-4;

/// Of the largest coordinate, so much is rounding even in double precision: what is no farther apart is in
/// one place.
const ONE_PLACE: f64 = 1e-12;

/// So many positions tell where a splat is.
const SAMPLE: usize = 1 << 14;

/// What is subtracted from the coordinates of a source, world units.
pub type Offset = [f64; 3];

/// The step of single precision at a coordinate, as a part of `radius`; `None` where cameras in one place say
/// nothing of the scene's size.
pub(crate) fn relative_step(distance: f64, radius: f64) -> Option<f64> {
    (radius > ONE_PLACE * distance).then(|| distance * f64::from(f32::EPSILON) / radius)
}

/// The largest coordinate, and the largest distance from the mean.
pub(crate) fn reach(centres: &[DVec3]) -> (f64, f64) {
    let distance = centres.iter().map(|centre| centre.abs().max_element()).fold(0.0, f64::max);
    (distance, mean_and_radius(centres).1)
}

/// The offset of a scene whose cameras are here, where it is far from its origin.
pub(crate) fn of_cameras(centres: &[DVec3]) -> Option<Offset> {
    let (mean, radius) = mean_and_radius(centres);
    of(mean, reach(centres).0, radius, FAR)
}

/// The same of a splat, by the medians of its positions and of their distances.
pub(crate) fn of_positions(count: usize, position: impl Fn(usize) -> [f64; 3] + Copy) -> Option<Offset> {
    let rows = || (0..count).step_by(count.div_ceil(SAMPLE).max(1)).map(position);
    let sample: Vec<DVec3> = rows().map(DVec3::from).filter(|position| position.is_finite()).collect();
    let middle = |axis: usize| median(sample.iter().map(|position| position[axis])).unwrap_or(0.0);
    let centre = DVec3::new(middle(0), middle(1), middle(2));
    let radius = median(sample.iter().map(|position| position.distance(centre))).unwrap_or(0.0);
    let by = of(centre, centre.abs().max_element(), radius, FAR_SPLAT)?;
    // What lies elsewhere must not get out of reach.
    let is_reached = |position: [f64; 3]| {
        (0..3).all(|axis| !position[axis].is_finite() || (position[axis] - by[axis]).abs() <= COORDINATE_MAX)
    };
    (0..count).all(|row| is_reached(position(row))).then_some(by)
}

/// `middle`, rounded to a power of ten below `radius`, where steps there are larger than `far`.
fn of(middle: DVec3, distance: f64, radius: f64, far: f64) -> Option<Offset> {
    relative_step(distance, radius).filter(|&step| step > far)?;
    let unit = 10f64.powi(radius.log10().floor() as i32);
    let offset = middle.to_array().map(|value| (value / unit).round() * unit + 0.0);
    offset.iter().all(|value| value.abs() <= COORDINATE_MAX).then_some(offset)
}

/// A position less `offset`, in single precision.
pub(crate) fn less(position: [f64; 3], offset: Offset) -> [f32; 3] {
    std::array::from_fn(|axis| (position[axis] - offset[axis]) as f32)
}

/// Both together; `None` where there is none.
pub fn sum(a: Option<Offset>, b: Option<Offset>) -> Option<Offset> {
    match (a, b) {
        (Some(a), Some(b)) => Some(std::array::from_fn(|axis| a[axis] + b[axis])),
        (one, other) => one.or(other),
    }
}

/// As people read it.
pub fn in_words([x, y, z]: Offset) -> String {
    format!("{x} {y} {z}")
}

/// What the file beside a splat holds.
#[derive(Debug, Serialize, Deserialize)]
struct Beside {
    /// For who opens it.
    #[serde(default)]
    about: String,
    offset: Offset,
}

const ABOUT: &str = "add this to the coordinates of the file beside it, to have those of the survey";

/// Most bytes of such a file that are read.
const BESIDE_BYTES_MAX: u64 = 1 << 12;

/// The file that holds the offset of the splat in `path`.
pub fn file_beside(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".offset.json");
    name.into()
}

/// The file in the folder of a scene that says what has been subtracted from its coordinates already: in it,
/// a part of a larger scene lies where the others do.
pub const OF_SCENE: &str = "offset.json";

/// As these files hold it.
pub fn to_json(offset: Offset) -> String {
    let beside = Beside { about: ABOUT.to_owned(), offset };
    serde_json::to_string_pretty(&beside).expect("text and numbers are always JSON") + "\n"
}

/// The offset in the bytes of such a file; the error is a clause.
pub fn parse(bytes: &[u8]) -> Result<Offset, String> {
    let Beside { offset, .. } = serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
    let is_believed = offset.iter().all(|value| value.is_finite() && value.abs() <= COORDINATE_MAX);
    is_believed.then_some(offset).ok_or_else(|| "an offset beyond 1e9 world units".into())
}

/// The offset in the file beside the splat in `path`, where there is one; the error is a sentence's part.
pub fn read_beside(path: &Path) -> Result<Option<Offset>, String> {
    read(&file_beside(path))
}

/// What has been subtracted from the coordinates of the scene in `folder` already, as it says itself.
pub(crate) fn of_scene(folder: &Path) -> Result<Option<Offset>, SceneError> {
    let file = folder.join(OF_SCENE);
    read(&file).map_err(|error| {
        let remedy = "correct it, or remove it if coordinates are those of the source";
        SceneError::invalid(&file, format!("is no offset of a scene ({error}); {remedy}"))
    })
}

fn read(file: &Path) -> Result<Option<Offset>, String> {
    use std::io::Read;

    let mut bytes = Vec::new();
    let read = input::open(file).and_then(|file| file.take(BESIDE_BYTES_MAX).read_to_end(&mut bytes));
    match read {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error.to_string()),
        Ok(_) => parse(&bytes).map(Some),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring(middle: DVec3) -> [DVec3; 3] {
        [DVec3::X, DVec3::NEG_X, DVec3::Y].map(|arm| middle + 3.0 * arm)
    }

    #[test]
    fn what_is_near_its_origin_is_not_moved() {
        for near in [DVec3::ZERO, DVec3::new(90.0, -120.0, 3.0)] {
            assert_eq!(of_cameras(&ring(near)), None, "{near}");
            assert_eq!(of_positions(3, |row| ring(near)[row].to_array()), None, "{near}");
        }
        assert_eq!((of_cameras(&[]), of_positions(0, |_| [0.0; 3])), (None, None));
        assert_eq!(of_cameras(&[DVec3::splat(5.4e6); 3]), None, "cameras in one place say nothing");
    }

    #[test]
    fn what_is_far_is_moved_by_round_numbers() {
        let utm = DVec3::new(431_250.5, 5_412_345.25, 312.0);
        assert_eq!(of_cameras(&ring(utm)), Some([431_251.0, 5_412_346.0, 312.0]));
        let [x, y, z] = of_positions(3, |row| ring(utm)[row].to_array()).unwrap();
        assert!((x - utm.x).abs() < 4.0 && (y - utm.y).abs() < 4.0 && z == 312.0, "{x} {y} {z}");
        assert!([x, y, z].iter().all(|value| value.fract() == 0.0));
    }

    #[test]
    fn the_file_beside_gives_back_what_was_written() {
        let offset = [431_250.0, -5_412_345.25, 0.1];
        assert_eq!(parse(to_json(offset).as_bytes()), Ok(offset));
        assert_eq!(file_beside(Path::new("a/b.spz")), Path::new("a/b.spz.offset.json"));
        for damaged in ["", "{}", r#"{"offset": [1, 2]}"#, r#"{"offset": [1, 2, 1e10]}"#] {
            assert!(parse(damaged.as_bytes()).is_err(), "{damaged}");
        }
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(read_beside(&folder.path().join("a.ply")), Ok(None));
    }
}
