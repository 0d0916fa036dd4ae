//! The text form: one record a line (a photo takes two), `#` starts a comment.

use std::collections::BTreeMap;
use std::path::Path;
use std::str::FromStr;

use super::check::{self, Finite, Judged};
use super::tracks::{Features, Tracks};
use super::{ImageRecord, models};
use crate::error::SceneError;
use crate::listing::position_problem;
use crate::offset::Offset;
use crate::scene::Point;

const CAMERA: &str = "CAMERA_ID MODEL WIDTH HEIGHT PARAMETERS";
const IMAGE: &str = "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME";
const FEATURES: &str = "the features of the photo above (X Y POINT3D_ID ..., or an empty line)";
const POINT: &str = "POINT3D_ID X Y Z R G B ERROR TRACK";
const FRAME: &str = "FRAME_ID RIG_ID QW QX QY QZ TX TY TZ NUM_DATA_IDS (SENSOR_TYPE SENSOR_ID DATA_ID) ...";
const TRACK: &str = "the track of a point as IMAGE_ID POINT2D_IDX pairs, after its ERROR";

/// A line with its 1-based number.
#[derive(Clone, Copy)]
struct Line<'a> {
    file: &'a Path,
    number: usize,
    text: &'a str,
}

impl<'a> Line<'a> {
    fn error(&self, expected: &'static str) -> SceneError {
        SceneError::Syntax { file: self.file.to_owned(), line: self.number, expected }
    }

    /// A reader of this line's fields, which names the line in its errors.
    fn fields(self, expected: &'static str) -> Fields<'a> {
        Fields { line: self, words: self.text.split_whitespace(), expected }
    }
}

struct Fields<'a> {
    line: Line<'a>,
    words: std::str::SplitWhitespace<'a>,
    expected: &'static str,
}

impl<'a> Fields<'a> {
    fn word(&mut self) -> Result<&'a str, SceneError> {
        self.words.next().ok_or_else(|| self.line.error(self.expected))
    }

    fn next<T: FromStr>(&mut self) -> Result<T, SceneError> {
        let word = self.word()?;
        word.parse().map_err(|_| self.line.error(self.expected))
    }

    fn numbers<const K: usize>(&mut self) -> Result<[f64; K], SceneError> {
        let mut values = [0.0; K];
        for value in &mut values {
            *value = number(self.word()?).ok_or_else(|| self.line.error(self.expected))?;
        }
        Ok(values)
    }

    fn array<T: FromStr + Copy + Default, const K: usize>(&mut self) -> Result<[T; K], SceneError> {
        let mut values = [T::default(); K];
        for value in &mut values {
            *value = self.next()?;
        }
        Ok(values)
    }
}

/// Lines that are not comments; blank ones are kept, because a photo without features has a blank second
/// line.
fn lines<'a>(file: &'a Path, bytes: &'a [u8]) -> Result<impl Iterator<Item = Line<'a>>, SceneError> {
    let text = std::str::from_utf8(bytes).map_err(|error| {
        let number = 1 + bytes[..error.valid_up_to()].iter().filter(|&&byte| byte == b'\n').count();
        SceneError::Syntax { file: file.to_owned(), line: number, expected: "UTF-8 text" }
    })?;
    let numbered = text.lines().enumerate().map(move |(index, text)| Line { file, number: index + 1, text });
    Ok(numbered.filter(|line| !line.text.trim_start().starts_with('#')))
}

/// A number, or what programs for Windows write where there is none: `-nan(ind)`, `1.#IND`, `-1.#INF`.
fn number(word: &str) -> Option<f64> {
    let is_none = || {
        let word = word.trim_start_matches(['-', '+']).to_lowercase();
        word.starts_with("nan(") || word.starts_with("1.#")
    };
    word.parse().ok().or_else(|| is_none().then_some(f64::NAN))
}

pub(super) fn cameras(file: &Path, bytes: &[u8]) -> Result<BTreeMap<u32, Judged>, SceneError> {
    let lines = lines(file, bytes)?.filter(|line| !line.text.trim().is_empty());
    check::by_id(file, lines.map(camera))
}

fn camera(line: Line) -> Result<(u32, Judged), SceneError> {
    let mut fields = line.fields(CAMERA);
    let id = fields.next()?;
    let model = fields.word()?;
    let size = fields.array()?;
    let parameters: Vec<f64> =
        fields.words.map(|word| number(word).ok_or_else(|| line.error(CAMERA))).collect::<Result<_, _>>()?;
    let parameters = models::parameters(line.file, id, model, &parameters);
    Ok((id, parameters.and_then(|parameters| check::intrinsics(line.file, id, size, parameters))))
}

/// `images.txt`: a pose on one line, features on the next; of the latter it is only checked that they are
/// features.
pub(super) fn images(file: &Path, bytes: &[u8]) -> Result<Finite<ImageRecord>, SceneError> {
    check::images(file, each_image(file, bytes)?.map(|read| read.map(|(_, image)| image)))
}

/// The ids and names of the photos in `images.txt`; an id that COLMAP cannot have is that of no photo.
pub(super) fn photo_ids(file: &Path, bytes: &[u8]) -> Result<Vec<(u32, String)>, SceneError> {
    let named = |(id, image): (u64, ImageRecord)| u32::try_from(id).ok().map(|id| (id, image.name));
    each_image(file, bytes)?.filter_map(|read| read.map(named).transpose()).collect()
}

/// With their ids.
fn each_image<'a>(
    file: &'a Path,
    bytes: &'a [u8],
) -> Result<impl Iterator<Item = Result<(u64, ImageRecord), SceneError>> + 'a, SceneError> {
    let mut lines = lines(file, bytes)?;
    Ok(std::iter::from_fn(move || {
        let line = lines.find(|line| !line.text.trim().is_empty())?;
        let image = image(line);
        Some(lines.next().map_or(Ok(()), check_features).and(image))
    }))
}

/// Numbers in threes, or nothing: in a file without these lines, every other photo would be lost silently.
fn check_features(line: Line) -> Result<(), SceneError> {
    let mut count = 0;
    let mut words = line.text.split_whitespace().inspect(|_| count += 1);
    let are_numbers = words.all(|word| number(word).is_some());
    (are_numbers && count % 3 == 0).then_some(()).ok_or_else(|| line.error(FEATURES))
}

/// The features of the photos in `images.txt`, by their ids.
pub(super) fn features(file: &Path, bytes: &[u8]) -> Result<Features, SceneError> {
    let mut lines = lines(file, bytes)?;
    let mut of_photos = Features::new();
    while let Some(line) = lines.find(|line| !line.text.trim().is_empty()) {
        let id = line.fields(IMAGE).next::<u64>()?;
        let features = lines.next().map_or(Ok(Vec::new()), features_in)?;
        of_photos.extend(u32::try_from(id).ok().map(|id| (id, features)));
    }
    Ok(of_photos)
}

fn features_in(line: Line) -> Result<Vec<[f32; 2]>, SceneError> {
    let mut fields = line.fields(FEATURES);
    let mut found = Vec::new();
    while let Some(x) = fields.words.next() {
        let x = number(x).ok_or_else(|| line.error(FEATURES))?;
        let [y, _] = fields.numbers()?;
        found.push([x as f32, y as f32]);
    }
    Ok(found)
}

fn image(line: Line) -> Result<(u64, ImageRecord), SceneError> {
    let mut fields = line.fields(IMAGE);
    let id = fields.next::<u64>()?;
    let rotation = fields.numbers()?;
    let translation = fields.numbers()?;
    let camera = fields.next()?;
    let name = rest_after(line.text, 9).ok_or_else(|| line.error(IMAGE))?.to_owned();
    Ok((id, ImageRecord { name, camera, rotation, translation }))
}

/// What follows the first `count` words, which may itself hold spaces (a photo's name); `None` if nothing
/// does.
fn rest_after(text: &str, count: usize) -> Option<&str> {
    let mut rest = text.trim();
    for _ in 0..count {
        rest = rest.split_once(char::is_whitespace)?.1.trim_start();
    }
    (!rest.is_empty()).then_some(rest)
}

pub(super) fn points(file: &Path, bytes: &[u8], offset: Offset) -> Result<Finite<Point>, SceneError> {
    let lines = lines(file, bytes)?.filter(|line| !line.text.trim().is_empty());
    check::points(file, offset, lines.map(point))
}

fn point(line: Line) -> Result<([f64; 3], [u8; 3]), SceneError> {
    let (position, rgb, _) = point_and_rest(line)?;
    Ok((position, rgb))
}

/// A point up to its error, and what follows.
fn point_and_rest(line: Line<'_>) -> Result<([f64; 3], [u8; 3], Fields<'_>), SceneError> {
    let mut fields = line.fields(POINT);
    fields.next::<u64>()?;
    Ok((fields.numbers()?, fields.array()?, fields))
}

/// The tracks of `points3D.txt`, of the points that are kept; a point may have none.
pub(super) fn tracks(file: &Path, bytes: &[u8]) -> Result<Tracks, SceneError> {
    let mut tracks = Tracks::default();
    for line in lines(file, bytes)?.filter(|line| !line.text.trim().is_empty()) {
        let (position, _, mut fields) = point_and_rest(line)?;
        fields.words.next();
        while let Some(photo) = fields.words.next() {
            let photo = photo.parse().map_err(|_| line.error(TRACK))?;
            fields.expected = TRACK;
            tracks.push(photo, fields.next()?);
        }
        tracks.end_point(position_problem(position).is_none());
    }
    Ok(tracks)
}

/// The photos of each frame in `frames.txt`, by their ids.
pub(super) fn frames(file: &Path, bytes: &[u8]) -> Result<Vec<Vec<u32>>, SceneError> {
    lines(file, bytes)?.filter(|line| !line.text.trim().is_empty()).map(frame).collect()
}

fn frame(line: Line) -> Result<Vec<u32>, SceneError> {
    let mut fields = line.fields(FRAME);
    fields.array::<u32, 2>()?;
    fields.numbers::<7>()?;
    let count: u32 = fields.next()?;
    let mut photos = Vec::new();
    for _ in 0..count {
        let (kind, _, id) = (fields.word()?, fields.next::<u32>()?, fields.next::<u64>()?);
        photos.extend(u32::try_from(id).ok().filter(|_| kind == "CAMERA"));
    }
    Ok(photos)
}
