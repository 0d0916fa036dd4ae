//! Compressed PLY, as PlayCanvas defined it and SuperSplat writes it.
//!
//! Three tables, little-endian. `chunk`: for each 256 rows the least and the largest position, log-scale and
//! base colour on each axis (18 floats). `vertex`: position and log-scale as fractions of the chunk's range
//! in 11, 10 and 11 bits; the rotation as 2 bits for the largest component and 10 for each of the others;
//! base colour as fractions of the range, and opacity, in 8 bits each. `sh`: a byte for each further
//! coefficient, channel after channel, from -4 to 4. A comment of the header says how a viewer should filter,
//! in the words of [`crate::ply`].
//!
//! Rows are sorted along a Morton curve, so that chunks are small.

use std::ops::Range;
use std::path::Path;

use genesplat_core::gaussians::sigmoid;
use genesplat_core::spherical_harmonics::{coefficients, dc_from_rgb, sh_index};
use genesplat_core::{Gaussians, ScreenFilter, morton_order};

use super::packing::{
    byte, component_of_fraction, fraction_of_component, from_smallest_three, opacity_logit, rgb_from_dc,
    smallest_three, word,
};
use super::{Decoded, FormatError, Options, ensure_memory};
use crate::ply::{Element, filter_comments, preamble, screen_filter};

const CHUNK_ROWS: usize = 256;

/// What a chunk has a range of, in the order of the file.
const RANGES: [[&str; 3]; 3] = [["x", "y", "z"], ["scale_x", "scale_y", "scale_z"], ["r", "g", "b"]];

const PACKED: [&str; 4] = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];

/// Bits of the three fractions of a position or a log-scale, from the highest.
const BITS: [u32; 3] = [11, 10, 11];

/// Half the range of the spherical harmonics in a file.
const SH_MAX: f32 = 4.0;

/// Smaller scales are written as this (2e-9 world units): one without a thickness would cost its whole chunk
/// its digits.
const LOG_SCALE_MIN: f32 = -20.0;

/// Least and largest value on three axes.
type Bounds = [[f32; 3]; 2];

pub(super) fn encode(cloud: &Gaussians, options: &Options) -> Vec<u8> {
    let mut cloud = cloud.gather(&morton_order(&cloud.positions));
    cloud.log_scales.as_flattened_mut().iter_mut().for_each(|value| *value = value.max(LOG_SCALE_MIN));
    let rest = coefficients(cloud.sh_degree_in_use()) - 1;
    let chunks: Vec<Range<usize>> = (0..cloud.len())
        .step_by(CHUNK_ROWS)
        .map(|first| first..(first + CHUNK_ROWS).min(cloud.len()))
        .collect();
    let mut bytes = header(cloud.len(), chunks.len(), 3 * rest, options.screen_filter).into_bytes();
    let ranges: Vec<[Bounds; 3]> = chunks.iter().map(|rows| ranges(&cloud, rows.clone())).collect();
    ranges.iter().for_each(|chunk| {
        chunk.iter().flatten().flatten().for_each(|value| bytes.extend(value.to_le_bytes()));
    });
    for (rows, ranges) in chunks.into_iter().zip(&ranges) {
        rows.for_each(|row| {
            pack(&cloud, row, ranges).iter().for_each(|word| bytes.extend(word.to_le_bytes()))
        });
    }
    for row in &cloud.sh {
        bytes.extend((0..3).flat_map(|channel| (1..=rest).map(move |k| sh_byte(row[sh_index(channel, k)]))));
    }
    bytes
}

fn header(rows: usize, chunks: usize, rest: usize, screen_filter: ScreenFilter) -> String {
    let mut text = String::from("ply\nformat binary_little_endian 1.0\n");
    filter_comments(screen_filter).iter().for_each(|comment| text += &format!("comment {comment}\n"));
    text += &format!("element chunk {chunks}\n");
    for axes in RANGES {
        for bound in ["min", "max"] {
            axes.iter().for_each(|axis| text += &format!("property float {bound}_{axis}\n"));
        }
    }
    text += &format!("element vertex {rows}\n");
    PACKED.iter().for_each(|name| text += &format!("property uint {name}\n"));
    if rest > 0 {
        text += &format!("element sh {rows}\n");
        (0..rest).for_each(|i| text += &format!("property uchar f_rest_{i}\n"));
    }
    text + "end_header\n"
}

fn base_colour(row: &[f32]) -> [f32; 3] {
    std::array::from_fn(|channel| rgb_from_dc(row[sh_index(channel, 0)]))
}

fn ranges(cloud: &Gaussians, rows: Range<usize>) -> [Bounds; 3] {
    let bounds = |values: &mut dyn Iterator<Item = [f32; 3]>| {
        values.fold([[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]], |[low, high], value| {
            [std::array::from_fn(|i| low[i].min(value[i])), std::array::from_fn(|i| high[i].max(value[i]))]
        })
    };
    [
        bounds(&mut cloud.positions[rows.clone()].iter().copied()),
        bounds(&mut cloud.log_scales[rows.clone()].iter().copied()),
        bounds(&mut cloud.sh[rows].iter().map(|row| base_colour(row))),
    ]
}

/// The four words of a row.
fn pack(cloud: &Gaussians, row: usize, [positions, log_scales, colours]: &[Bounds; 3]) -> [u32; 4] {
    let [r, g, b] = fractions(base_colour(&cloud.sh[row]), colours).map(byte);
    let (largest, three) = smallest_three(cloud.rotations[row]);
    let rotation = join(three.map(fraction_of_component), [10; 3]) | (largest as u32) << 30;
    [
        join(fractions(cloud.positions[row], positions), BITS),
        rotation,
        join(fractions(cloud.log_scales[row], log_scales), BITS),
        u32::from_be_bytes([r, g, b, byte(sigmoid(cloud.opacity_logits[row]))]),
    ]
}

/// Where a value lies in its range, 0 to 1.
fn fractions(value: [f32; 3], [low, high]: &Bounds) -> [f32; 3] {
    std::array::from_fn(|i| {
        let width = f64::from(high[i]) - f64::from(low[i]);
        if width > 0.0 { ((f64::from(value[i]) - f64::from(low[i])) / width) as f32 } else { 0.0 }
    })
}

/// Three fractions of 1 in as many bits of a word.
fn join(fractions: [f32; 3], bits: [u32; 3]) -> u32 {
    fractions.into_iter().zip(bits).fold(0, |word, (fraction, bits)| {
        let steps = (1u32 << bits) - 1;
        word << bits | ((fraction * steps as f32).round() as u32).min(steps)
    })
}

/// Inverse of [`join`].
fn split(word: u32, bits: [u32; 3]) -> [f32; 3] {
    let shifts = [bits[1] + bits[2], bits[2], 0];
    std::array::from_fn(|i| {
        let steps = (1u32 << bits[i]) - 1;
        (word >> shifts[i] & steps) as f32 / steps as f32
    })
}

fn sh_byte(value: f32) -> u8 {
    // A byte stands for the middle of its step, and the two outermost for the ends of the range.
    ((value / (2.0 * SH_MAX) + 0.5) * 256.0).floor() as u8
}

/// A coefficient as a file has it.
pub(super) fn rounded_sh(value: f32) -> f32 {
    sh_from_byte(sh_byte(value))
}

fn sh_from_byte(byte: u8) -> f32 {
    let fraction = match byte {
        0 => 0.0,
        255 => 1.0,
        _ => (f32::from(byte) + 0.5) / 256.0,
    };
    2.0 * SH_MAX * (fraction - 0.5)
}

/// A table of the file with its bytes.
struct Table<'a> {
    path: &'a Path,
    element: &'a Element,
    bytes: &'a [u8],
}

impl Table<'_> {
    fn rows(&self) -> impl Iterator<Item = &[u8]> {
        self.bytes.chunks_exact(self.element.row_bytes.max(1))
    }

    fn offsets<const K: usize>(&self, names: [String; K], kind: &str) -> Result<[usize; K], FormatError> {
        let mut offsets = [0; K];
        for (offset, name) in offsets.iter_mut().zip(&names) {
            *offset = self.element.offset(name, kind).ok_or_else(|| {
                let problem = format!("has no {kind} property {name} in its element {}", self.element.name);
                FormatError::damaged(self.path, problem)
            })?;
        }
        Ok(offsets)
    }
}

pub(super) fn decode(path: &Path, bytes: &[u8]) -> Result<Decoded, FormatError> {
    let text = preamble(&mut &bytes[..], path)?;
    if !text.is_little_endian() || text.elements.iter().any(|element| element.has_list) {
        return Err(FormatError::damaged(
            path,
            "is a compressed PLY with words or lists in it, or with its highest bytes first, and those have none",
        ));
    }
    let tables = tables(path, &text.elements, &bytes[text.bytes as usize..])?;
    let table = |name: &str| tables.iter().find(|table| table.element.name == name);
    let missing = |name: &str| FormatError::damaged(path, format!("has no element {name}"));
    let (chunk, vertex) =
        (table("chunk").ok_or_else(|| missing("chunk"))?, table("vertex").ok_or_else(|| missing("vertex"))?);
    let rows = vertex.element.count as usize;
    let expected = |table: &Table, count: usize| {
        let Element { name, count: found, .. } = table.element;
        let problem =
            format!("has {found} rows in its element {name} where {count} belong to {rows} Gaussians");
        if *found == count as u64 { Ok(()) } else { Err(FormatError::damaged(path, problem)) }
    };
    expected(chunk, rows.div_ceil(CHUNK_ROWS))?;
    // A row of these properties has bytes, so there are no more rows than bytes.
    let packed = vertex.offsets(PACKED.map(str::to_owned), "uint")?;
    let ranges = chunk_ranges(chunk)?;
    ensure_memory(path, 1, rows)?;
    let mut cloud = Gaussians::zeros(rows);
    unpack(&mut cloud, &ranges, vertex, packed);
    let mut sh_degree = 0;
    if let Some(sh) = table("sh") {
        expected(sh, rows)?;
        sh_degree = unpack_sh(&mut cloud, sh)?;
    }
    Ok(Decoded {
        cloud,
        sh_degree,
        screen_filter: screen_filter(&text.comments),
        is_2dgs: false,
        offset: None,
    })
}

/// The bytes of every element; together they must be all that there are.
fn tables<'a>(
    path: &'a Path,
    elements: &'a [Element],
    mut bytes: &'a [u8],
) -> Result<Vec<Table<'a>>, FormatError> {
    let mut tables = Vec::with_capacity(elements.len());
    for element in elements {
        let size = usize::try_from(element.count).ok().and_then(|count| count.checked_mul(element.row_bytes));
        let (own, rest) = size.and_then(|size| bytes.split_at_checked(size)).ok_or_else(|| {
            let problem = format!("ends before the {} rows of its element {}", element.count, element.name);
            FormatError::damaged(path, problem)
        })?;
        tables.push(Table { path, element, bytes: own });
        bytes = rest;
    }
    if bytes.is_empty() {
        Ok(tables)
    } else {
        Err(FormatError::damaged(path, "goes on after its last element"))
    }
}

fn chunk_ranges(table: &Table) -> Result<Vec<[Bounds; 3]>, FormatError> {
    // Files of older programs have no ranges of colours: they are fractions of 1 themselves.
    let with_colours = table.element.offset("min_r", "float").is_some();
    let mut offsets = [[[usize::MAX; 3]; 2]; 3];
    for (axes, offsets) in RANGES.iter().zip(&mut offsets).take(if with_colours { 3 } else { 2 }) {
        for (bound, offsets) in ["min", "max"].into_iter().zip(offsets) {
            *offsets = table.offsets(axes.map(|axis| format!("{bound}_{axis}")), "float")?;
        }
    }
    let bounds = |row: &[u8], offsets: [[usize; 3]; 2]| {
        offsets.map(|bound| bound.map(|at| f32::from_bits(word(row, at))))
    };
    let ranges = |row| {
        let colours = if with_colours { bounds(row, offsets[2]) } else { [[0.0; 3], [1.0; 3]] };
        [bounds(row, offsets[0]), bounds(row, offsets[1]), colours]
    };
    Ok(table.rows().map(ranges).collect())
}

fn unpack(
    cloud: &mut Gaussians,
    ranges: &[[Bounds; 3]],
    vertex: &Table,
    [position, rotation, scale, colour]: [usize; 4],
) {
    let at = |[low, high]: &Bounds, fractions: [f32; 3]| -> [f32; 3] {
        std::array::from_fn(|i| low[i] * (1.0 - fractions[i]) + high[i] * fractions[i])
    };
    for (row, bytes) in vertex.rows().enumerate() {
        let [positions, log_scales, colours] = &ranges[row / CHUNK_ROWS];
        let rotation = word(bytes, rotation);
        cloud.positions[row] = at(positions, split(word(bytes, position), BITS));
        cloud.log_scales[row] = at(log_scales, split(word(bytes, scale), BITS));
        cloud.rotations[row] = from_smallest_three(
            (rotation >> 30) as usize,
            split(rotation, [10; 3]).map(component_of_fraction),
        );
        let [r, g, b, alpha] = word(bytes, colour).to_be_bytes().map(|level| f32::from(level) / 255.0);
        cloud.sh[row][..3].copy_from_slice(&at(colours, [r, g, b]).map(dc_from_rgb));
        cloud.opacity_logits[row] = opacity_logit(alpha);
    }
}

/// Fills the further coefficients; returns their degree.
fn unpack_sh(cloud: &mut Gaussians, table: &Table) -> Result<u8, FormatError> {
    let width = table.element.width();
    let Some(degree) = (1..=3u8).find(|&degree| 3 * (coefficients(degree) - 1) == width) else {
        let problem =
            format!("has {width} spherical harmonics a Gaussian, and degrees 1 to 3 have 9, 24 or 45");
        return Err(FormatError::damaged(table.path, problem));
    };
    let rest = width / 3;
    let mut offsets = Vec::with_capacity(width);
    for i in 0..width {
        offsets.extend(table.offsets([format!("f_rest_{i}")], "uchar")?);
    }
    for (sh, bytes) in cloud.sh.iter_mut().zip(table.rows()) {
        for (i, &at) in offsets.iter().enumerate() {
            sh[sh_index(i / rest, 1 + i % rest)] = sh_from_byte(bytes[at]);
        }
    }
    Ok(degree)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_split_as_they_were_joined() {
        assert_eq!(join([1.0, 0.0, 0.0], BITS), 0x7ff << 21);
        assert_eq!(join([0.0, 1.0, 0.0], BITS), 0x3ff << 11);
        assert_eq!(join([0.0, 0.0, 1.0], BITS), 0x7ff);
        let fractions = [0.25, 0.5, 0.9f32];
        for (there, back) in fractions.into_iter().zip(split(join(fractions, BITS), BITS)) {
            assert!((there - back).abs() <= 0.5 / 1023.0, "{there} {back}");
        }
    }

    #[test]
    fn harmonics_are_rounded_to_the_nearest_step() {
        for value in [-3.9, -0.7, -0.01, 0.02, 1.3, 3.8f32] {
            assert!((sh_from_byte(sh_byte(value)) - value).abs() <= 4.0 / 256.0 + 1e-6, "{value}");
        }
        assert_eq!((sh_from_byte(sh_byte(9.0)), sh_from_byte(sh_byte(-9.0))), (4.0, -4.0));
    }
}
