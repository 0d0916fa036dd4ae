//! Plain coloured points, binary or ASCII: what a `transforms.json` may name as its point cloud.

use std::io::{BufRead, Read};
use std::path::Path;

use super::header::{Encoding, PlyHeader};
use super::{PlyError, open, parse_header, read_error, text};
use crate::colmap::{Finite, finite_points};
use crate::error::SceneError;
use crate::scene::Point;
use crate::shown;

const POSITION: [&str; 3] = ["x", "y", "z"];
/// What programs call colours.
pub(super) const COLOURS: [[&str; 3]; 3] =
    [["red", "green", "blue"], ["r", "g", "b"], ["diffuse_red", "diffuse_green", "diffuse_blue"]];

const POINTS: &str = "a cloud of points with x, y and z, or leave ply_file_path out";
/// Of a cloud without colours.
const GREY: u8 = 127;

/// Reads the points of `path`; positions are in the file's own frame, colours 0 to 255.
pub(crate) fn read_points(path: &Path) -> Result<Finite<Point>, SceneError> {
    let (file, size) = open(path)?;
    parse_points(path, file, size)
}

/// The same from the `size` bytes of `reader`; `path` is named in errors.
pub(crate) fn parse_points(
    path: &Path,
    reader: impl BufRead,
    size: u64,
) -> Result<Finite<Point>, SceneError> {
    let (header, reader) = parse_header(path, reader, size)?;
    let colour = COLOURS.into_iter().find(|names| header.has_all(*names));
    let names: Vec<&str> = POSITION.into_iter().chain(colour.into_iter().flatten()).collect();
    let rows = match header.encoding {
        Encoding::Binary => binary(&header, &names, reader, path)?,
        Encoding::Ascii => ascii(&header, &names, reader, path)?,
    };
    let full = colour.map(|names| full_colour(header.are_floats(names), rows.iter().map(|row| row[1])));
    let points = rows.into_iter().map(|[position, rgb]| Ok((position.map(f64::from), level(rgb, full))));
    let mut finite = finite_points(path, points)?;
    if colour.is_none() {
        let grey = format!("the points of {} have no colours, and start grey", shown(path));
        finite.notice = Some(finite.notice.map_or(grey.clone(), |notice| format!("{notice}; {grey}")));
    }
    Ok(finite)
}

/// The value that stands for a colour's 255: 1 in files that write colours as fractions, and 65,535 in those
/// of laser scanners, which the format leaves open.
pub(super) fn full_colour(are_floats: bool, colours: impl Iterator<Item = [f32; 3]>) -> f32 {
    match colours.flatten().fold(0.0, f32::max) {
        most if are_floats && most <= 1.0 => 1.0,
        most if most > 255.0 => 65_535.0,
        _ => 255.0,
    }
}

fn level(rgb: [f32; 3], full: Option<f32>) -> [u8; 3] {
    full.map_or([GREY; 3], |full| rgb.map(|value| (255.0 / full * value).round() as u8))
}

/// The named values of a row: position, and colour where there is one.
type Row = [[f32; 3]; 2];

fn row(value: impl Fn(usize) -> f32, count: usize) -> Row {
    [0, 3]
        .map(|first| std::array::from_fn(|axis| if first + axis < count { value(first + axis) } else { 0.0 }))
}

fn binary(
    header: &PlyHeader,
    names: &[&str],
    mut reader: impl Read,
    path: &Path,
) -> Result<Vec<Row>, PlyError> {
    let fields = names.iter().map(|name| header.field(name, path, POINTS));
    let fields = fields.collect::<Result<Vec<_>, _>>()?;
    let mut bytes = vec![0; header.row_bytes];
    (0..header.gaussians)
        .map(|_| {
            reader.read_exact(&mut bytes).map_err(|source| read_error(path, source))?;
            Ok(row(|property| fields[property].value(&bytes), fields.len()))
        })
        .collect()
}

fn ascii(
    header: &PlyHeader,
    names: &[&str],
    reader: impl BufRead,
    path: &Path,
) -> Result<Vec<Row>, PlyError> {
    let columns = names.iter().map(|name| header.column(name, path, POINTS));
    let columns = columns.collect::<Result<Vec<_>, _>>()?;
    let mut rows = Vec::with_capacity(header.gaussians as usize);
    text::read(header, reader, path, |_, values| {
        rows.push(row(|property| values[columns[property]], columns.len()));
    })?;
    Ok(rows)
}
