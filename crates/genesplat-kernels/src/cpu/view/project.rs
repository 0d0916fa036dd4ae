//! Stage `project`: a cloud becomes the splats of one view, 16 Gaussians at a time (see [`super::geometry`]).

use fearless_simd::{Level, Simd, dispatch};
use genesplat_core::constants::{ALPHA_MIN, DISCRIMINANT_MIN};
use genesplat_core::spherical_harmonics::SH_STRIDE;
use genesplat_core::{Channels, Gaussians, Genes, RenderSettings, Splat};
use rayon::prelude::*;

use super::colour::{Colour, colour};
use super::geometry::{Geometry, Params};
use super::pinhole::{Pinhole, TILE};
use super::splats::{CHUNK, Splats};
use crate::cpu::bin::LOG2_255;
use crate::cpu::simd::{LANES, LOG2_E, array, lanes_of};

/// Where the colours of a chunk's rows are.
pub(crate) trait Colours {
    /// Those of a row of the cloud.
    fn of<S: Simd>(&mut self, simd: S, row: usize) -> &[f32; SH_STRIDE];
}

impl Colours for &[[f32; SH_STRIDE]] {
    #[inline(always)]
    fn of<S: Simd>(&mut self, _: S, row: usize) -> &[f32; SH_STRIDE] {
        &self[row]
    }
}

/// Projects the whole cloud; buffers are reused from call to call.
pub(crate) fn project(
    level: Level,
    cloud: &Gaussians,
    camera: &Pinhole,
    settings: &RenderSettings,
    out: &mut Splats,
) {
    let colours = vec![&cloud.sh[..]; cloud.len().div_ceil(CHUNK)];
    project_coloured(level, cloud, colours, camera, settings, out);
}

/// The same, each chunk with colours of its own; those of the cloud are not read.
pub(crate) fn project_coloured(
    level: Level,
    cloud: &Gaussians,
    colours: Vec<impl Colours + Send>,
    camera: &Pinhole,
    settings: &RenderSettings,
    out: &mut Splats,
) {
    out.seen.resize(cloud.len(), false);
    let version = |row: usize| (row as u32, cloud.genes(row));
    project_chunks(level, cloud, cloud.len(), version, colours, camera, settings, out);
}

/// Projects `count` versions of rows, `version(index)` a row and its genes, as if each were a row of its own:
/// a splat's `row` is its version's index.
pub(crate) fn project_versions(
    level: Level,
    cloud: &Gaussians,
    count: usize,
    version: impl Fn(usize) -> (u32, Genes) + Sync,
    camera: &Pinhole,
    settings: &RenderSettings,
    out: &mut Splats,
) {
    let colours = vec![&cloud.sh[..]; count.div_ceil(CHUNK)];
    project_chunks(level, cloud, count, version, colours, camera, settings, out);
}

fn project_chunks(
    level: Level,
    cloud: &Gaussians,
    count: usize,
    version: impl Fn(usize) -> (u32, Genes) + Sync,
    colours: Vec<impl Colours + Send>,
    camera: &Pinhole,
    settings: &RenderSettings,
    out: &mut Splats,
) {
    out.resize(count);
    let mut seen: Vec<&mut [bool]> = out.seen.chunks_mut(CHUNK).collect();
    seen.resize_with(out.counts.len(), Default::default);
    let chunks = out.slots.par_chunks_mut(CHUNK).zip(seen).zip(&mut out.counts).zip(colours);
    chunks.enumerate().for_each(|(chunk, (((slots, seen), count), mut colours))| {
        let first = chunk * CHUNK;
        *count = dispatch!(level, simd =>
            project_chunk(simd, cloud, first, &version, &mut colours, camera, settings, slots, seen));
    });
}

/// Projects as many versions as there are slots, from `first` on; `seen` is filled unless it is empty.
/// Returns how many splats that makes, which come first.
#[inline(always)]
fn project_chunk<S: Simd>(
    simd: S,
    cloud: &Gaussians,
    first: usize,
    version: &impl Fn(usize) -> (u32, Genes),
    colours: &mut impl Colours,
    camera: &Pinhole,
    settings: &RenderSettings,
    slots: &mut [Splat],
    seen: &mut [bool],
) -> u32 {
    let (versions, mut splats) = (slots.len(), 0);
    for group in (0..versions).step_by(LANES) {
        let count = LANES.min(versions - group);
        let of_lane: [(u32, Genes); LANES] = array!(lane => version(first + group + lane.min(count - 1)));
        let params = Params::load(simd, |lane| {
            let (row, genes) = (of_lane[lane].0 as usize, of_lane[lane].1);
            (genes, cloud.rotations[row], cloud.filter_3d.as_ref().map_or(0.0, |filter| filter[row]))
        });
        let lanes = Lanes::from(&Geometry::new(&params, camera, settings.filter));
        for (lane, (row, genes)) in of_lane[..count].iter().enumerate() {
            if let Some(seen) = seen.get_mut(group + lane) {
                *seen = lanes.is_seen(lane, camera);
            }
            let Some(splat) = lanes.splat(lane, camera) else { continue };
            let (sh, position) = (colours.of(simd, *row as usize), [genes[0], genes[1], genes[2]]);
            let colour = match settings.channels {
                Channels::Rgb => colour(sh, position, camera.centre_in_world, settings.sh_degree),
                Channels::InverseDepth { nearest } => {
                    Colour { rgb: [nearest / splat.depth, 1.0, 0.0], clamped: 0 }
                }
            };
            // NaN drops the Gaussian. (An infinite colour is drawn, so that the loss shows it.)
            if !colour.rgb.iter().any(|value| value.is_nan()) {
                let row = (first + group + lane) as u32;
                slots[splats] = Splat { rgb: colour.rgb, clamped: colour.clamped, row, ..splat };
                splats += 1;
            }
        }
    }
    splats as u32
}

/// What single lanes need of a [`Geometry`], as arrays.
struct Lanes {
    t: [[f32; LANES]; 3],
    ratio: [[f32; LANES]; 2],
    cov: [[f32; LANES]; 3],
    det: [f32; LANES],
    opacity: [f32; LANES],
}

impl<S: Simd> From<&Geometry<S>> for Lanes {
    #[inline(always)]
    fn from(geometry: &Geometry<S>) -> Self {
        Self {
            t: lanes_of(&geometry.t),
            ratio: lanes_of(&geometry.ratio),
            cov: lanes_of(&geometry.cov),
            det: *geometry.det,
            opacity: *geometry.opacity_effective,
        }
    }
}

impl Lanes {
    /// In front of the near plane, with an invertible covariance; false for anything that is not finite.
    #[inline(always)]
    fn is_valid(&self, lane: usize, camera: &Pinhole) -> bool {
        self.t[2][lane] > camera.near && self.det[lane] > 0.0 && self.det[lane].is_finite()
    }

    #[inline(always)]
    fn mean_px(&self, lane: usize, camera: &Pinhole) -> [f32; 2] {
        array!(axis => camera.focal_px[axis] * self.ratio[axis][lane] + camera.axis_px[axis])
    }

    /// 3DGS's rule: the square of `ceil(3 sqrt(λ_max))` px around the mean meets at least one tile.
    #[inline(always)]
    fn is_seen(&self, lane: usize, camera: &Pinhole) -> bool {
        if !self.is_valid(lane, camera) {
            return false;
        }
        let middle = 0.5 * (self.cov[0][lane] + self.cov[2][lane]);
        let largest = middle + (middle * middle - self.det[lane]).max(DISCRIMINANT_MIN).sqrt();
        let radius_px = (3.0 * largest.sqrt()).ceil();
        let mean_px = self.mean_px(lane, camera);
        let grid = camera.grid();
        (0..2).all(|axis| {
            let first = ((mean_px[axis] - radius_px) / TILE as f32).trunc().clamp(0.0, grid[axis] as f32);
            let end = ((mean_px[axis] + radius_px + (TILE - 1) as f32) / TILE as f32)
                .trunc()
                .clamp(0.0, grid[axis] as f32);
            end > first
        })
    }

    /// The splat without its colour and row; `None` when it reaches no pixel of the image.
    #[inline(always)]
    fn splat(&self, lane: usize, camera: &Pinhole) -> Option<Splat> {
        let opacity = self.opacity[lane];
        // `>` is false for NaN, so that a poisoned Gaussian disappears instead of spreading.
        let reaches = self.is_valid(lane, camera) && opacity > ALPHA_MIN;
        if !reaches {
            return None;
        }
        let mean_px = self.mean_px(lane, camera);
        // alpha ≥ 1/255 ⟺ dᵀ Σ'⁻¹ d ≤ 2 ln(255 o): half extents sqrt(2 ln(255 o) Σ'ₖₖ).
        let log2_opacity = opacity.log2();
        let reach = 2.0 * std::f32::consts::LN_2 * (log2_opacity + LOG2_255);
        let half_extent_px = [(reach * self.cov[0][lane]).sqrt(), (reach * self.cov[2][lane]).sqrt()];
        let inside = (0..2).all(|axis| {
            mean_px[axis] + half_extent_px[axis] >= 0.0
                && mean_px[axis] - half_extent_px[axis] <= (camera.size_px[axis] - 1) as f32
        });
        if !inside {
            return None;
        }
        let scale = LOG2_E / self.det[lane];
        Some(Splat {
            mean_px,
            conic_log2: [
                -0.5 * scale * self.cov[2][lane],
                scale * self.cov[1][lane],
                -0.5 * scale * self.cov[0][lane],
            ],
            log2_opacity,
            depth: self.t[2][lane],
            half_extent_px,
            ..Splat::default()
        })
    }
}
