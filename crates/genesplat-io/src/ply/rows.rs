//! Rows of a PLY file from and to the columns of a cloud.

use std::io::{self, BufRead, Read, Write};
use std::ops::Range;
use std::path::Path;

use genesplat_core::Gaussians;
use genesplat_core::spherical_harmonics::{SH_DEGREE_MAX, coefficients, dc_from_rgb, sh_index};

use super::field::Field;
use super::header::{Encoding, PlyHeader};
use super::points::{COLOURS, full_colour};
use super::{PlyError, read_error, text};

const SPLAT: &str = "a splat, as trainers of Gaussians write it (point_cloud.ply)";

/// Logarithm of the thickness of flat Gaussians: 1e-6 world units, as SuperSplat has it. No camera sees that,
/// and one value for all rows costs compressed formats nothing.
const LOG_THICKNESS: f32 = -13.815_511;

const CHUNK_ROWS: usize = 4096;

/// Names of the properties in the order in which they are written.
pub(super) fn property_names(sh_degree: u8, filter_3d: bool) -> Vec<String> {
    let numbered =
        |stem: &str, count: usize| -> Vec<_> { (0..count).map(|i| format!("{stem}_{i}")).collect() };
    let named = |names: &[&str]| -> Vec<_> { names.iter().map(|&name| name.to_owned()).collect() };
    [
        named(&["x", "y", "z", "nx", "ny", "nz"]),
        numbered("f_dc", 3),
        numbered("f_rest", 3 * coefficients(sh_degree) - 3),
        named(&["opacity"]),
        numbered("scale", 3),
        numbered("rot", 4),
        named(if filter_3d { &["filter_3D"] } else { &[] }),
    ]
    .concat()
}

/// The cloud whose first row is next in `reader`; the caller has checked that the file holds as many as it
/// promises.
pub(super) fn read(
    header: &PlyHeader,
    reader: &mut impl BufRead,
    path: &Path,
) -> Result<Gaussians, PlyError> {
    let count = header.gaussians as usize;
    let zeros =
        || Gaussians { filter_3d: header.has_filter_3d.then(|| vec![0.0; count]), ..Gaussians::zeros(count) };
    let mut cloud = zeros();
    match header.encoding {
        Encoding::Binary => {
            let layout = Layout::of(header, |name| header.field(name, path, SPLAT))?;
            let read = layout.read_binary(header.row_bytes, reader, &mut cloud);
            read.map_err(|source| read_error(path, source))?;
        }
        Encoding::Ascii => {
            let layout = Layout::of(header, |name| header.column(name, path, SPLAT))?;
            text::read(header, reader, path, |row, values| {
                layout.set(row, |column| values[column], &mut cloud)
            })?;
        }
    }
    if let Some(names) = plain_colours(header) {
        let full = full_colour(header.are_floats(names), cloud.sh.iter().map(|sh| [sh[0], sh[1], sh[2]]));
        let base = cloud.sh.iter_mut().flat_map(|sh| &mut sh[..3]);
        base.for_each(|value| *value = dc_from_rgb(*value / full));
    }
    Ok(cloud)
}

/// The names of colours that stand in place of the base of the harmonics, as nerfstudio exports `rgb`.
fn plain_colours(header: &PlyHeader) -> Option<[&'static str; 3]> {
    let has_base = header.has_all(["f_dc_0", "f_dc_1", "f_dc_2"]);
    COLOURS.into_iter().find(|names| !has_base && header.has_all(*names))
}

/// Where each parameter lies in a row: a field of its bytes, or the number of its word.
struct Layout<Place> {
    position: [Place; 3],
    log_scale: [Place; 2],
    /// The third; `None` for flat Gaussians.
    log_thickness: Option<Place>,
    rotation: [Place; 4],
    opacity: Place,
    /// Index in a row of [`Gaussians::sh`], and the place that fills it.
    sh: Vec<(usize, Place)>,
    filter_3d: Option<Place>,
}

impl<Place: Copy> Layout<Place> {
    fn of(header: &PlyHeader, find: impl Fn(&str) -> Result<Place, PlyError>) -> Result<Self, PlyError> {
        let base = plain_colours(header).unwrap_or(["f_dc_0", "f_dc_1", "f_dc_2"]);
        let sh = sh_properties(header.sh_degree, base);
        Ok(Self {
            position: [find("x")?, find("y")?, find("z")?],
            opacity: find("opacity")?,
            log_scale: [find("scale_0")?, find("scale_1")?],
            log_thickness: (!header.is_2dgs).then(|| find("scale_2")).transpose()?,
            rotation: [find("rot_0")?, find("rot_1")?, find("rot_2")?, find("rot_3")?],
            sh: sh.map(|(slot, name)| Ok((slot, find(&name)?))).collect::<Result<_, _>>()?,
            filter_3d: header.has_filter_3d.then(|| find("filter_3D")).transpose()?,
        })
    }

    fn set(&self, row: usize, value: impl Fn(Place) -> f32, cloud: &mut Gaussians) {
        cloud.positions[row] = self.position.map(&value);
        let [x, y] = self.log_scale.map(&value);
        cloud.log_scales[row] = [x, y, self.log_thickness.map_or(LOG_THICKNESS, &value)];
        cloud.rotations[row] = self.rotation.map(&value);
        cloud.opacity_logits[row] = value(self.opacity);
        self.sh.iter().for_each(|&(slot, place)| cloud.sh[row][slot] = value(place));
        if let (Some(place), Some(filter)) = (self.filter_3d, &mut cloud.filter_3d) {
            filter[row] = value(place);
        }
    }
}

impl Layout<Field> {
    /// Fills every row of `cloud`.
    fn read_binary(&self, row_bytes: usize, reader: &mut impl Read, cloud: &mut Gaussians) -> io::Result<()> {
        let count = cloud.len();
        let mut chunk = vec![0; CHUNK_ROWS.min(count) * row_bytes];
        for first in (0..count).step_by(CHUNK_ROWS) {
            let bytes = &mut chunk[..CHUNK_ROWS.min(count - first) * row_bytes];
            reader.read_exact(bytes)?;
            for (row, bytes) in (first..).zip(bytes.chunks_exact(row_bytes)) {
                self.set(row, |field| field.value(bytes), cloud);
            }
        }
        Ok(())
    }
}

/// Each harmonic's index in a row of [`Gaussians::sh`], with the property that holds it in a file of
/// `degree`, where the first ones are called `base`.
fn sh_properties(degree: u8, base: [&str; 3]) -> impl Iterator<Item = (usize, String)> {
    let rest = coefficients(degree) - 1;
    let read = coefficients(degree.min(SH_DEGREE_MAX)) - 1;
    (0..3).flat_map(move |channel| {
        let dc = std::iter::once((sh_index(channel, 0), base[channel].to_owned()));
        dc.chain((0..read).map(move |k| (sh_index(channel, 1 + k), format!("f_rest_{}", channel * rest + k))))
    })
}

/// Writes some rows of `cloud` in the order of [`property_names`].
pub(super) fn write(
    cloud: &Gaussians,
    rows: Range<usize>,
    sh_degree: u8,
    out: &mut impl Write,
) -> io::Result<()> {
    const NORMAL: [f32; 3] = [0.0; 3];
    let mut bytes = Vec::new();
    for row in rows {
        let sh = &cloud.sh[row];
        let rest =
            (0..3).flat_map(|channel| (1..coefficients(sh_degree)).map(move |k| &sh[sh_index(channel, k)]));
        let values = (cloud.positions[row].iter())
            .chain(&NORMAL)
            .chain(&sh[..3])
            .chain(rest)
            .chain([&cloud.opacity_logits[row]])
            .chain(&cloud.log_scales[row])
            .chain(&cloud.rotations[row])
            .chain(cloud.filter_3d.as_ref().map(|filter| &filter[row]));
        bytes.clear();
        values.for_each(|value| bytes.extend(value.to_le_bytes()));
        out.write_all(&bytes)?;
    }
    Ok(())
}
