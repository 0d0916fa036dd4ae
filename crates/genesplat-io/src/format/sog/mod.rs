//! `.sog` ("Spatially Ordered Gaussians"), PlayCanvas's format, version 2: a ZIP file of lossless WebP
//! pictures with a pixel for each Gaussian, and `meta.json`.
//!
//! Positions have 16 bits an axis on a logarithmic scale, in two pictures. Log-scales and base colours are
//! indices into codebooks of 256 values. Rotations are their three smallest components in a byte each, with
//! the index of the largest in the fourth. Further harmonics are entries of a palette, whose coefficients
//! have a codebook of their own.
//!
//! Rows are sorted along a Morton curve, so that neighbouring pixels are alike.

mod codebook;
mod meta;
mod palette;
mod pictures;

use std::path::Path;

use genesplat_core::gaussians::sigmoid;
use genesplat_core::spherical_harmonics::{SH_STRIDE, coefficients};
use genesplat_core::{Gaussians, ScreenFilter, morton_order};
use rayon::prelude::*;

use self::codebook::Codebook;
use self::meta::{Coded, Means, Meta, Palette as PaletteMeta, Plain};
use self::pictures::{Archive, ArchiveWriter, Grid, Picture};
use super::packing::{
    byte, component_of_fraction, fraction_of_component, from_smallest_three, opacity_logit, smallest_three,
};
use super::{Decoded, FormatError, Options, WriteProgress, check_claim};
use crate::listing::COORDINATE_MAX;

/// Palette entries in a row of the picture that holds them.
const ENTRIES_PER_LINE: usize = 64;
/// Labels have 16 bits.
const ENTRIES_MAX: usize = 1 << 16;

/// A file has at most so many.
const PICTURES: usize = 7;

/// What a rotation's fourth byte adds to the index of its largest component.
const LARGEST_OFFSET: u8 = 252;

pub(super) fn encode(
    path: &Path,
    cloud: &Gaussians,
    options: &Options,
    progress: &dyn WriteProgress,
) -> Result<Vec<u8>, FormatError> {
    let mut cloud = cloud.gather(&morton_order(&cloud.positions));
    let grid = Grid::for_gaussians(cloud.len()).ok_or_else(|| {
        FormatError::unsupported(
            path,
            "would need larger pictures than WebP has; write a .ply, or fewer Gaussians",
        )
    })?;
    let (mut archive, entries) = (ArchiveWriter::default(), palette_size(cloud.len()));
    // Splits of the palette, and pictures.
    progress.start(entries + PICTURES);
    let antialias = options.screen_filter != ScreenFilter::Classic;
    let meta = Meta {
        version: meta::VERSION,
        count: cloud.len() as u64,
        antialias,
        model: antialias.then(|| meta::ANTIALIASED.to_owned()),
        means: write_means(&mut archive, grid, &cloud),
        scales: write_scales(&mut archive, grid, &cloud),
        quats: write_rotations(&mut archive, grid, &cloud),
        sh0: write_base_colours(&mut archive, grid, &cloud),
        sh_n: write_harmonics(&mut archive, grid, &mut cloud, entries, progress),
    };
    archive.finish(&meta, progress).map_err(|source| FormatError::Write { path: path.to_owned(), source })
}

/// Positions are on a scale that is linear around the origin and logarithmic far away.
fn log_position(value: f32) -> f32 {
    value.signum() * value.abs().ln_1p()
}

fn position_from_log(value: f32) -> f32 {
    value.signum() * value.abs().exp_m1()
}

fn write_means(archive: &mut ArchiveWriter, grid: Grid, cloud: &Gaussians) -> Means {
    let logs: Vec<[f32; 3]> = cloud.positions.iter().map(|position| position.map(log_position)).collect();
    let bound = |start: f32, pick: fn(f32, f32) -> f32| -> [f32; 3] {
        let of_axis = |axis: usize| logs.iter().map(|log| log[axis]).reduce(pick).unwrap_or(start);
        std::array::from_fn(of_axis)
    };
    // Rounded, the farthest position that is read would be beyond itself.
    let farthest = COORDINATE_MAX.ln_1p() as f32 - 1e-5;
    let [mins, maxs] = [bound(0.0, f32::min), bound(0.0, f32::max)]
        .map(|corner| corner.map(|log| log.clamp(-farthest, farthest)));
    let levels = |log: &[f32; 3]| -> [[u8; 2]; 3] {
        std::array::from_fn(|axis| {
            let width = f64::from(maxs[axis]) - f64::from(mins[axis]);
            let fraction =
                if width > 0.0 { (f64::from(log[axis]) - f64::from(mins[axis])) / width } else { 0.0 };
            ((65535.0 * fraction).round() as u16).to_le_bytes()
        })
    };
    let levels: Vec<[[u8; 2]; 3]> = logs.iter().map(levels).collect();
    let file = |archive: &mut ArchiveWriter, name: &str, half: usize| {
        archive.add(name, Picture::of(grid, levels.iter().map(|[x, y, z]| [x[half], y[half], z[half], 255])))
    };
    Means { mins, maxs, files: [file(archive, "means_l.webp", 0), file(archive, "means_u.webp", 1)] }
}

/// The step of a coordinate whose magnitude is `far`, world units.
pub(super) fn step(cloud: &Gaussians, far: f64) -> f64 {
    let width = |axis: usize| {
        let values = || cloud.positions.iter().map(|position| position[axis]);
        let ends = [values().fold(f32::MAX, f32::min), values().fold(f32::MIN, f32::max)];
        let [low, high] = ends.map(|end| f64::from(log_position(end)));
        high - low
    };
    (0..3).map(width).fold(0.0, f64::max) / 65535.0 * (1.0 + far)
}

fn write_scales(archive: &mut ArchiveWriter, grid: Grid, cloud: &Gaussians) -> Coded {
    let codebook = Codebook::of(cloud.log_scales.as_flattened());
    let pixels = cloud.log_scales.iter().map(|log_scale| {
        let [x, y, z] = log_scale.map(|value| codebook.index(value));
        [x, y, z, 255]
    });
    Coded { files: [archive.add("scales.webp", Picture::of(grid, pixels))], codebook: codebook.into_values() }
}

fn write_rotations(archive: &mut ArchiveWriter, grid: Grid, cloud: &Gaussians) -> Plain {
    let pixels = cloud.rotations.iter().map(|&rotation| {
        let (largest, three) = smallest_three(rotation);
        let [a, b, c] = three.map(|component| byte(fraction_of_component(component)));
        [a, b, c, LARGEST_OFFSET + largest as u8]
    });
    Plain { files: [archive.add("quats.webp", Picture::of(grid, pixels))] }
}

fn write_base_colours(archive: &mut ArchiveWriter, grid: Grid, cloud: &Gaussians) -> Coded {
    let colours: Vec<f32> = cloud.sh.iter().flat_map(|row| row[..3].iter().copied()).collect();
    let codebook = Codebook::of(&colours);
    let pixels = cloud.sh.iter().zip(&cloud.opacity_logits).map(|(row, &logit)| {
        let [r, g, b] = [0, 1, 2].map(|channel| codebook.index(row[channel]));
        [r, g, b, byte(sigmoid(logit))]
    });
    Coded { files: [archive.add("sh0.webp", Picture::of(grid, pixels))], codebook: codebook.into_values() }
}

/// One entry for each Gaussian, as far as labels reach.
fn palette_size(gaussians: usize) -> usize {
    gaussians.clamp(1, ENTRIES_MAX)
}

/// Takes the harmonics out of the cloud, of which only these are left to be written.
fn write_harmonics(
    archive: &mut ArchiveWriter,
    grid: Grid,
    cloud: &mut Gaussians,
    size: usize,
    progress: &dyn WriteProgress,
) -> Option<PaletteMeta> {
    let bands = cloud.sh_degree_in_use();
    let rest = coefficients(bands) - 1;
    if rest == 0 {
        return None;
    }
    let mut rows = std::mem::take(&mut cloud.sh);
    rows.par_iter_mut().for_each(|row| row[..3].fill(0.0));
    let palette = palette::build(&rows, size, progress);
    let values: Vec<&[f32]> = palette.entries.iter().map(|entry| &entry[3..3 * (rest + 1)]).collect();
    let codebook = Codebook::of(&values.concat());
    let lines =
        Grid { width: ENTRIES_PER_LINE * rest, height: palette.entries.len().div_ceil(ENTRIES_PER_LINE) };
    let entries = values.iter().flat_map(|entry| {
        entry.as_chunks::<3>().0.iter().map(|rgb| {
            let [r, g, b] = rgb.map(|value| codebook.index(value));
            [r, g, b, 255]
        })
    });
    let labels = palette.labels.iter().map(|&label| {
        let [low, high] = label.to_le_bytes();
        [low, high, 0, 255]
    });
    Some(PaletteMeta {
        count: palette.entries.len() as u64,
        bands,
        files: [
            archive.add("shN_centroids.webp", Picture::of(lines, entries)),
            archive.add("shN_labels.webp", Picture::of(grid, labels)),
        ],
        codebook: codebook.into_values(),
    })
}

pub(super) fn decode(path: &Path, bytes: &[u8]) -> Result<Decoded, FormatError> {
    let mut archive = Archive::open(path, bytes)?;
    let meta: Meta = archive.meta()?;
    if meta.version != meta::VERSION {
        let problem =
            format!("is a .sog of version {}, and genesplat reads version 2; export it again", meta.version);
        return Err(FormatError::unsupported(path, problem));
    }
    check_claim(path, meta.count, bytes.len())?;
    let count = meta.count as usize;
    let mut cloud = Gaussians {
        positions: read_means(&mut archive, &meta.means, count)?,
        log_scales: read_scales(&mut archive, &meta.scales, count)?,
        rotations: read_rotations(&mut archive, &meta.quats, count)?,
        opacity_logits: Vec::with_capacity(count),
        sh: Vec::with_capacity(count),
        filter_3d: None,
    };
    for [r, g, b, alpha] in archive.pixels(&meta.sh0.files[0], count)? {
        let mut row = [0.0; SH_STRIDE];
        for (value, index) in row.iter_mut().zip([r, g, b]) {
            *value = archive.decoded(&meta.sh0.codebook, index)?;
        }
        cloud.sh.push(row);
        cloud.opacity_logits.push(opacity_logit(f32::from(alpha) / 255.0));
    }
    if let Some(palette) = &meta.sh_n {
        read_harmonics(&mut archive, palette, &mut cloud)?;
    }
    let is_antialiased = meta.antialias || meta.model.as_deref() == Some(meta::ANTIALIASED);
    let screen_filter = if is_antialiased { ScreenFilter::Antialiased } else { ScreenFilter::Classic };
    let sh_degree = meta.sh_n.map_or(0, |palette| palette.bands);
    Ok(Decoded { cloud, sh_degree, screen_filter: Some(screen_filter), is_2dgs: false, offset: None })
}

fn read_means(archive: &mut Archive, means: &Means, count: usize) -> Result<Vec<[f32; 3]>, FormatError> {
    let [low, high] = [archive.pixels(&means.files[0], count)?, archive.pixels(&means.files[1], count)?];
    let position = |(low, high): ([u8; 4], [u8; 4])| -> [f32; 3] {
        std::array::from_fn(|axis| {
            let fraction = f32::from(u16::from_le_bytes([low[axis], high[axis]])) / 65535.0;
            position_from_log(means.mins[axis] + (means.maxs[axis] - means.mins[axis]) * fraction)
        })
    };
    Ok(low.into_iter().zip(high).map(position).collect())
}

fn read_scales(archive: &mut Archive, scales: &Coded, count: usize) -> Result<Vec<[f32; 3]>, FormatError> {
    let pixels = archive.pixels(&scales.files[0], count)?;
    let value = |index: u8| archive.decoded(&scales.codebook, index);
    pixels.into_iter().map(|[x, y, z, _]| Ok([value(x)?, value(y)?, value(z)?])).collect()
}

fn read_rotations(archive: &mut Archive, quats: &Plain, count: usize) -> Result<Vec<[f32; 4]>, FormatError> {
    let pixels = archive.pixels(&quats.files[0], count)?;
    let rotation = |(row, [a, b, c, largest]): (usize, [u8; 4])| {
        let Some(largest) = largest.checked_sub(LARGEST_OFFSET) else {
            return Err(archive
                .damaged(format!("has no valid rotation of Gaussian {row} ({largest} in its fourth byte)")));
        };
        let three = [a, b, c].map(|level| component_of_fraction(f32::from(level) / 255.0));
        Ok(from_smallest_three(usize::from(largest), three))
    };
    pixels.into_iter().enumerate().map(rotation).collect()
}

fn read_harmonics(
    archive: &mut Archive,
    palette: &PaletteMeta,
    cloud: &mut Gaussians,
) -> Result<(), FormatError> {
    let entries = usize::try_from(palette.count).ok().filter(|&count| count <= ENTRIES_MAX);
    let (Some(entries), 1..=3) = (entries, palette.bands) else {
        let problem = format!("has a palette of {} entries and {} bands", palette.count, palette.bands);
        return Err(archive.damaged(problem));
    };
    let rest = coefficients(palette.bands) - 1;
    let lines = archive.picture(&palette.files[0])?;
    if lines.grid.width != ENTRIES_PER_LINE * rest || lines.pixels.len() < entries * rest {
        let Grid { width, height } = lines.grid;
        let problem = format!(
            "has {width}x{height} pixels for a palette of {entries} entries with {rest} coefficients"
        );
        return Err(archive.damaged(problem));
    }
    let labels = archive.pixels(&palette.files[1], cloud.len())?;
    for (row, [low, high, ..]) in labels.into_iter().enumerate() {
        let label = usize::from(u16::from_le_bytes([low, high]));
        if label >= entries {
            return Err(
                archive.damaged(format!("gives Gaussian {row} the entry {label} of a palette of {entries}"))
            );
        }
        for (k, pixel) in lines.pixels[label * rest..(label + 1) * rest].iter().enumerate() {
            for channel in 0..3 {
                cloud.sh[row][3 * (k + 1) + channel] = archive.decoded(&palette.codebook, pixel[channel])?;
            }
        }
    }
    Ok(())
}
