//! Plain coloured points, binary or ASCII: what a `transforms.json` may name as its point cloud.

use std::io::{BufRead, Read};
use std::path::Path;

use super::header::{Encoding, PlyHeader};
use super::{PlyError, check_positions, open, parse_header, read_error, text};
use crate::scene::Point;

/// Properties that a point is read from; the last three are its colour.
const PROPERTIES: [&str; 6] = ["x", "y", "z", "red", "green", "blue"];

const POINTS: &str = "a cloud of points with x, y, z, red, green and blue, or leave ply_file_path out";

/// Reads the points of `path`; positions are in the file's own frame, colours 0 to 255.
pub(crate) fn read_points(path: &Path) -> Result<Vec<Point>, PlyError> {
    open(path).and_then(|(file, size)| parse_points(path, file, size))
}

/// The same from the `size` bytes of `reader`; `path` is named in errors.
pub(crate) fn parse_points(path: &Path, reader: impl BufRead, size: u64) -> Result<Vec<Point>, PlyError> {
    let (header, reader) = parse_header(path, reader, size)?;
    let rows = match header.encoding {
        Encoding::Binary => binary(&header, reader, path)?,
        Encoding::Ascii => ascii(&header, reader, path)?,
    };
    check_positions(path, rows.iter().map(|&[x, y, z, ..]| [x, y, z]))?;
    let full = full_colour(&header, &rows);
    Ok(rows.into_iter().map(|row| point(row, full)).collect())
}

/// The value that stands for a colour's 255: 1 in files that write colours as fractions, which the format
/// leaves open.
fn full_colour(header: &PlyHeader, rows: &[[f32; 6]]) -> f32 {
    let is_float = |name: &&str| {
        header.properties.iter().any(|property| property.name == *name && property.field.scalar.is_float())
    };
    let is_fraction = |[.., red, green, blue]: &[f32; 6]| red.max(*green).max(*blue) <= 1.0;
    if PROPERTIES[3..].iter().all(is_float) && rows.iter().all(is_fraction) { 1.0 } else { 255.0 }
}

fn point([x, y, z, red, green, blue]: [f32; 6], full: f32) -> Point {
    let level = |value: f32| (255.0 / full * value).round() as u8;
    Point { position: [x, y, z], rgb: [red, green, blue].map(level) }
}

fn binary(header: &PlyHeader, mut reader: impl Read, path: &Path) -> Result<Vec<[f32; 6]>, PlyError> {
    let fields = PROPERTIES.iter().map(|name| header.field(name, path, POINTS));
    let fields = fields.collect::<Result<Vec<_>, _>>()?;
    let mut row = vec![0; header.row_bytes];
    (0..header.gaussians)
        .map(|_| {
            reader.read_exact(&mut row).map_err(|source| read_error(path, source))?;
            Ok(std::array::from_fn(|property| fields[property].value(&row)))
        })
        .collect()
}

fn ascii(header: &PlyHeader, reader: impl BufRead, path: &Path) -> Result<Vec<[f32; 6]>, PlyError> {
    let columns = PROPERTIES.iter().map(|name| header.column(name, path, POINTS));
    let columns = columns.collect::<Result<Vec<_>, _>>()?;
    let mut rows = Vec::with_capacity(header.gaussians as usize);
    text::read(header, reader, path, |_, values| {
        rows.push(std::array::from_fn(|property| values[columns[property]]));
    })?;
    Ok(rows)
}
