//! The text part of a PLY file: which properties a row holds, where, and of which type.

use std::io::{BufRead, Read};
use std::path::Path;

use genesplat_core::ScreenFilter;
use genesplat_core::spherical_harmonics::coefficients;

use super::field::{Field, Property, Scalar};
use super::{PlyError, PlyOptions};
use crate::shown;

/// What a PLY file says about itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlyHeader {
    /// Number of Gaussians.
    pub gaussians: u64,
    /// Highest degree of the spherical harmonics that are stored; those above 3 are not read.
    pub sh_degree: u8,
    /// True for Mip-Splatting's 3D filter.
    pub has_filter_3d: bool,
    /// True for flat Gaussians, which have two scales (2DGS).
    pub is_2dgs: bool,
    /// How a viewer should filter; `None` when the file does not say.
    pub screen_filter: Option<ScreenFilter>,
    /// Header comments in order; what is not UTF-8 in them is replaced.
    pub comments: Vec<String>,
    pub(super) encoding: Encoding,
    pub(super) properties: Vec<Property>,
    pub(super) row_bytes: usize,
    /// What the elements before the vertices take: bytes, or lines of an ASCII file.
    pub(super) before: u64,
    pub(super) ends_with_vertices: bool,
    /// The vertices are those of a mesh.
    has_faces: bool,
}

impl PlyHeader {
    /// Index of the property `name` in a row; where it is missing, `wanted` is what to give instead of the
    /// file.
    pub(super) fn column(&self, name: &str, path: &Path, wanted: &'static str) -> Result<usize, PlyError> {
        self.properties.iter().position(|property| property.name == name).ok_or_else(|| {
            PlyError::MissingProperty {
                path: path.to_owned(),
                what: self.kind(),
                property: name.into(),
                wanted,
            }
        })
    }

    pub(super) fn has_all(&self, names: [&str; 3]) -> bool {
        names.into_iter().all(|name| self.properties.iter().any(|property| property.name == name))
    }

    /// Whether all of these are floats.
    pub(super) fn are_floats(&self, names: [&str; 3]) -> bool {
        let is_float = |name| {
            let of_name = self.properties.iter().find(|property| property.name == name);
            of_name.is_some_and(|property| property.field.scalar.is_float())
        };
        names.into_iter().all(is_float)
    }

    /// What a file without Gaussians seems to be.
    fn kind(&self) -> &'static str {
        match self.has_all(["x", "y", "z"]) {
            _ if self.has_faces => "a mesh",
            true => "a point cloud",
            false => "not the kind of cloud that is needed here",
        }
    }

    /// Place of the property `name` in the bytes of a row; errors as [`PlyHeader::column`].
    pub(super) fn field(&self, name: &str, path: &Path, wanted: &'static str) -> Result<Field, PlyError> {
        Ok(self.properties[self.column(name, path, wanted)?].field)
    }

    /// Fewest bytes of a row: in ASCII a digit and a separator for each value, the last line's end being
    /// optional.
    pub(super) fn least_row_bytes(&self) -> u64 {
        match self.encoding {
            Encoding::Binary => self.row_bytes as u64,
            Encoding::Ascii => (2 * self.properties.len() as u64).saturating_sub(1).max(1),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Binary,
    /// Words, one row a line.
    Ascii,
}

/// What the text at the start of a file declares.
pub(crate) struct Preamble {
    encoding: Encoding,
    /// Of binary values, the highest byte comes first.
    is_big_endian: bool,
    pub(crate) comments: Vec<String>,
    /// In the order of the file.
    pub(crate) elements: Vec<Element>,
    /// Length of the text.
    pub(crate) bytes: u64,
}

/// One table of a file.
pub(crate) struct Element {
    pub(crate) name: String,
    pub(crate) count: u64,
    properties: Vec<Property>,
    pub(crate) row_bytes: usize,
    pub(crate) has_list: bool,
}

impl Preamble {
    /// False for a file whose rows are words, or have their highest bytes first.
    pub(crate) fn is_little_endian(&self) -> bool {
        self.encoding == Encoding::Binary && !self.is_big_endian
    }
}

impl Element {
    /// Where the property `name` lies in a row, and whether it is of the type that headers call `kind`.
    pub(crate) fn offset(&self, name: &str, kind: &str) -> Option<usize> {
        let is_wanted = |property: &&Property| {
            property.name == name && Scalar::parse(kind) == Some(property.field.scalar)
        };
        self.properties.iter().find(is_wanted).map(|property| property.field.offset)
    }

    /// Number of properties of a row.
    pub(crate) fn width(&self) -> usize {
        self.properties.len()
    }
}

/// Longest header that is believed: 59 properties take 2 KiB.
const HEADER_BYTES_MAX: u64 = 1 << 20;

/// Reads the header from the start of a file, and its length in bytes.
pub(super) fn read(reader: &mut impl BufRead, path: &Path) -> Result<(PlyHeader, u64), PlyError> {
    let preamble = preamble(reader, path)?;
    let (bytes, is_big_endian) = (preamble.bytes, preamble.is_big_endian);
    let bad = |problem: String| PlyError::Header { path: path.to_owned(), problem };
    let mut header = assemble(preamble).map_err(bad)?;
    header.properties.iter_mut().for_each(|property| property.field.is_big_endian = is_big_endian);
    Ok((header, bytes))
}

/// Reads the text at the start of a file.
pub(crate) fn preamble(reader: &mut impl BufRead, path: &Path) -> Result<Preamble, PlyError> {
    let bytes = header_bytes(reader, path)?;
    let bad = |problem: String| PlyError::Header { path: path.to_owned(), problem };
    // Comments have any bytes, as programs and people write them.
    let text = String::from_utf8_lossy(&bytes);
    let mut comments = Vec::new();
    let mut elements = Vec::new();
    let mut encoding = None;
    for line in text.lines().skip(1) {
        let (keyword, rest) = line.trim_end().split_once(' ').unwrap_or((line.trim_end(), ""));
        match keyword {
            "comment" | "obj_info" => comments.push(rest.to_owned()),
            "format" => encoding = Some(parse_encoding(rest).map_err(bad)?),
            "element" => elements.push(element(rest).map_err(bad)?),
            "property" => add_property(elements.last_mut(), rest).map_err(bad)?,
            "end_header" | "" => {}
            other => return Err(bad(format!("its header has the unknown keyword {other:?}"))),
        }
    }
    let (encoding, is_big_endian) = encoding.ok_or_else(|| bad("its header states no format".into()))?;
    Ok(Preamble { encoding, is_big_endian, comments, elements, bytes: bytes.len() as u64 })
}

/// Everything up to and including the line `end_header`.
fn header_bytes(reader: &mut impl BufRead, path: &Path) -> Result<Vec<u8>, PlyError> {
    let bad = |problem: &str| PlyError::Header { path: path.to_owned(), problem: problem.into() };
    let mut reader = reader.take(HEADER_BYTES_MAX);
    let mut bytes = Vec::new();
    loop {
        let start = bytes.len();
        let read = reader.read_until(b'\n', &mut bytes);
        let line = bytes[start..].trim_ascii_end();
        if start == 0 && line != b"ply" {
            return Err(bad("it does not begin with the line \"ply\""));
        }
        match read.map_err(|source| super::read_error(path, source))? {
            0 => return Err(bad("its header has no end")),
            _ if line == b"end_header" => return Ok(bytes),
            _ => {}
        }
    }
}

/// The encoding, and whether the highest bytes come first.
fn parse_encoding(format: &str) -> Result<(Encoding, bool), String> {
    match format.split(' ').next() {
        Some("binary_little_endian") => Ok((Encoding::Binary, false)),
        Some("binary_big_endian") => Ok((Encoding::Binary, true)),
        Some("ascii") => Ok((Encoding::Ascii, false)),
        _ => Err(format!("its format {format:?} is unknown")),
    }
}

fn element(rest: &str) -> Result<Element, String> {
    let (name, count) = rest.split_once(' ').ok_or("an element has no count")?;
    let count = count
        .trim()
        .parse()
        .map_err(|_| format!("element {} has the impossible count {count:?}", shown(name)))?;
    Ok(Element { name: name.into(), count, properties: Vec::new(), row_bytes: 0, has_list: false })
}

fn add_property(element: Option<&mut Element>, rest: &str) -> Result<(), String> {
    let element = element.ok_or("a property comes before any element")?;
    let (kind, name) = rest.split_once(' ').ok_or("a property has no name")?;
    if kind == "list" {
        element.has_list = true;
        return Ok(());
    }
    let scalar = Scalar::parse(kind)
        .ok_or_else(|| format!("property {} has the unknown type {kind:?}", shown(name)))?;
    let field = Field { scalar, offset: element.row_bytes, is_big_endian: false };
    element.properties.push(Property { name: name.trim().into(), field });
    element.row_bytes += scalar.bytes();
    Ok(())
}

fn assemble(preamble: Preamble) -> Result<PlyHeader, String> {
    let Preamble { mut elements, comments, encoding, .. } = preamble;
    let at = elements.iter().position(|element| element.name == "vertex").ok_or("it has no vertices")?;
    let before = before(&elements[..at], encoding)?;
    let has_faces = elements.iter().any(|element| element.name == "face");
    let ends_with_vertices = elements[at + 1..].iter().all(|element| element.count == 0);
    fixed_length(&elements[at])?;
    let vertex = elements.swap_remove(at);
    if vertex.row_bytes == 0 {
        return Err("its vertices have no properties".into());
    }
    let rest = vertex.properties.iter().filter(|property| property.name.starts_with("f_rest_")).count();
    let has = |name| vertex.properties.iter().any(|property| property.name == name);
    Ok(PlyHeader {
        gaussians: vertex.count,
        sh_degree: degree(rest)?,
        has_filter_3d: has("filter_3D"),
        is_2dgs: has("scale_0") && has("scale_1") && !has("scale_2"),
        screen_filter: screen_filter(&comments),
        comments,
        encoding,
        properties: vertex.properties,
        row_bytes: vertex.row_bytes,
        before,
        ends_with_vertices,
        has_faces,
    })
}

fn before(elements: &[Element], encoding: Encoding) -> Result<u64, String> {
    let size = |element: &Element| match encoding {
        Encoding::Binary => fixed_length(element).map(|bytes| element.count.checked_mul(bytes)),
        Encoding::Ascii => Ok(Some(element.count)),
    };
    elements.iter().try_fold(0u64, |sum, element| {
        let sum = size(element)?.and_then(|size| sum.checked_add(size));
        sum.ok_or_else(|| "its elements have impossible counts".into())
    })
}

/// Bytes of a row, where all rows have as many.
fn fixed_length(element: &Element) -> Result<u64, String> {
    if element.has_list {
        return Err(format!(
            "element {} holds a list, so its rows have no fixed length",
            shown(&element.name)
        ));
    }
    Ok(element.row_bytes as u64)
}

/// Degree of spherical harmonics with `rest` coefficients beyond the base colour: `3 (degree + 1)² − 3`.
fn degree(rest: usize) -> Result<u8, String> {
    /// Higher than any trainer goes.
    const DEGREE_MAX: u8 = 8;
    (0..=DEGREE_MAX).find(|&degree| 3 * coefficients(degree) - 3 == rest).ok_or_else(|| {
        format!(
            "it has {rest} f_rest properties, where spherical harmonics of degree 0 to 4 have 0, 9, 24, 45 or 72"
        )
    })
}

/// The header comment of `filter`, in words that viewers know. They have one for both kinds of compensated
/// opacity, so a second comment tells the classic dilation from Mip-Splatting's.
pub(crate) fn filter_comments(filter: ScreenFilter) -> &'static [&'static str] {
    match filter {
        ScreenFilter::Classic => &["SplatRenderMode: default"],
        ScreenFilter::Antialiased => &["SplatRenderMode: mip", "SplatDilation: 0.3"],
        ScreenFilter::Mip => &["SplatRenderMode: mip"],
    }
}

pub(crate) fn screen_filter(comments: &[String]) -> Option<ScreenFilter> {
    let value = |key| comments.iter().find_map(|comment| comment.strip_prefix(key)).map(str::trim);
    match (value("SplatRenderMode:")?, value("SplatDilation:")) {
        ("default", _) => Some(ScreenFilter::Classic),
        ("mip", Some("0.3")) => Some(ScreenFilter::Antialiased),
        ("mip", _) => Some(ScreenFilter::Mip),
        _ => None,
    }
}

/// The header of `cloud`.
pub(super) fn text(rows: usize, has_filter_3d: bool, options: &PlyOptions) -> String {
    let mut text = String::from("ply\nformat binary_little_endian 1.0\n");
    filter_comments(options.screen_filter).iter().for_each(|comment| text += &format!("comment {comment}\n"));
    text += &format!("element vertex {rows}\n");
    for name in super::rows::property_names(options.sh_degree, has_filter_3d) {
        text += &format!("property float {name}\n");
    }
    text + "end_header\n"
}
