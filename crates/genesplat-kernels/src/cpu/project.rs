//! Stage `project`: a cloud becomes the splats of one view. 16 Gaussians at a time, one a lane.
//!
//! [`Geometry`] holds what the forward and the backward pass share: the backward pass computes it again rather than
//! reading hundreds of bytes a Gaussian from memory. Formulas: 3DGS, section 4 and appendix A; Zwicker et al. 2001.

use fearless_simd::{Level, Simd, dispatch, prelude::*};
use genesplat_core::constants::{
    ALPHA_MIN, ANTIALIAS_RATIO_MIN, DISCRIMINANT_MIN, JACOBIAN_LIMIT, MIP_EPSILON, NEAR_DEPTH,
};
use genesplat_core::{Camera, Gaussians, Genes, RenderSettings, ScreenFilter};
use rayon::prelude::*;

use super::bin::LOG2_255;
use super::simd::{LANES, LOG2_E, V, array, exp, keep, lanes_of, sigmoid};
use super::{bytes_of, colour};

/// Rows that one task projects; also the unit of the backward pass. A constant, so that results do not depend on the
/// number of threads.
pub const CHUNK: usize = 256;

/// Side of a tile, px.
pub const TILE: usize = 16;

/// A camera as the kernels want it: f32, rotation as rows.
#[derive(Clone, Copy, Debug)]
pub struct Pinhole {
    /// Rows of the rotation of `camera_from_world`.
    pub rotation: [[f32; 3]; 3],
    /// Translation of `camera_from_world`.
    pub translation: [f32; 3],
    /// Camera centre, world.
    pub centre: [f32; 3],
    /// `[fx, fy]`, px.
    pub focal: [f32; 2],
    /// Pixel coordinate that the optical axis hits (pixel centres at integers).
    pub axis_px: [f32; 2],
    /// Largest `|x/z|` and `|y/z|` that the Jacobian sees.
    pub limit: [f32; 2],
    /// Image size, px.
    pub size: [u32; 2],
}

impl From<&Camera> for Pinhole {
    fn from(camera: &Camera) -> Self {
        let rotation = camera.rotation();
        let centre = camera.centre_in_world();
        let translation = camera.camera_from_world_translation;
        let tan = camera.tan_half_fov();
        Self {
            rotation: array(
                #[inline(always)]
                |row| rotation.row(row).to_array().map(|v| v as f32),
            ),
            translation: translation.to_array().map(|v| v as f32),
            centre: centre.to_array().map(|v| v as f32),
            focal: camera.focal_px.map(|v| v as f32),
            axis_px: camera.principal_px.map(|v| (v - 0.5) as f32),
            limit: tan.map(|v| (f64::from(JACOBIAN_LIMIT) * v) as f32),
            size: [camera.width, camera.height],
        }
    }
}

impl Pinhole {
    /// Tiles across and down.
    pub fn grid(&self) -> [usize; 2] {
        self.size.map(|pixels| (pixels as usize).div_ceil(TILE))
    }
}

/// One splat of one view: a cache line.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
pub struct Splat {
    /// Mean, px.
    pub mean: [f32; 2],
    /// `[−½·A, −B, −½·C] · log2(e)` of the inverse covariance `[A B; B C]`: the exponent comes out in powers of two.
    pub conic_log2: [f32; 3],
    /// `log2` of the effective opacity.
    pub log2_opacity: f32,
    /// Colour, not below 0.
    pub rgb: [f32; 3],
    /// Camera z, world units.
    pub depth: f32,
    /// Half extent of the ellipse `alpha ≥ 1/255`, px.
    pub half_extent: [f32; 2],
    /// Row of the cloud.
    pub global: u32,
    /// Bit `c` is set where channel `c` was clamped at 0.
    pub clamped: u32,
}

impl Splat {
    /// The same with its mean in px from `origin` (the corner of a tile).
    #[inline(always)]
    pub fn seen_from(&self, origin: [usize; 2]) -> Self {
        Self { mean: [self.mean[0] - origin[0] as f32, self.mean[1] - origin[1] as f32], ..*self }
    }
}

/// The splats of a view, where projection put them: those of a chunk of rows lie together, in row order, at the start of
/// the chunk's room. A splat's index is its place in that room, so nothing is moved or counted twice.
#[derive(Clone, Debug, Default)]
pub struct Splats {
    /// Room for one splat a row `[N]`.
    room: Vec<Splat>,
    /// Splats in each chunk's room.
    counts: Vec<u32>,
    /// A row's 3-sigma square meets a tile: what 3DGS's densification average counts `[N]`.
    seen: Vec<bool>,
}

impl Splats {
    /// The splat of an index.
    #[inline(always)]
    pub fn get(&self, index: u32) -> &Splat {
        &self.room[index as usize]
    }

    /// All splats with their indices, in row order.
    pub fn iter(&self) -> impl Iterator<Item = (u32, &Splat)> {
        self.room.chunks(CHUNK).zip(&self.counts).enumerate().flat_map(|(chunk, (room, &count))| {
            let first = (chunk * CHUNK) as u32;
            room[..count as usize].iter().enumerate().map(move |(k, splat)| (first + k as u32, splat))
        })
    }

    /// The splats of one chunk of rows; the first one's index is `chunk * CHUNK`.
    pub fn chunk(&self, chunk: usize) -> &[Splat] {
        &self.room[chunk * CHUNK..][..self.counts[chunk] as usize]
    }

    /// Geometric visibility of the rows of one chunk.
    pub fn seen(&self, chunk: usize) -> &[bool] {
        &self.seen[chunk * CHUNK..self.seen.len().min((chunk + 1) * CHUNK)]
    }

    /// Number of splats.
    pub fn len(&self) -> usize {
        self.counts.iter().map(|&count| count as usize).sum()
    }

    /// Above every index.
    pub fn capacity(&self) -> usize {
        self.room.len()
    }

    /// Bytes of memory.
    pub fn bytes(&self) -> usize {
        bytes_of(&self.room) + bytes_of(&self.counts) + bytes_of(&self.seen)
    }
}

/// Projects the whole cloud; the room is reused from call to call.
pub fn project(
    level: Level,
    cloud: &Gaussians,
    camera: &Pinhole,
    settings: &RenderSettings,
    out: &mut Splats,
) {
    let n = cloud.len();
    out.room.resize(n, Splat::default());
    out.seen.resize(n, false);
    out.counts.resize(n.div_ceil(CHUNK), 0);
    let rooms = out.room.par_chunks_mut(CHUNK).zip(out.seen.par_chunks_mut(CHUNK)).zip(&mut out.counts);
    rooms.enumerate().for_each(|(chunk, ((room, seen), count))| {
        let first_row = chunk * CHUNK;
        *count = dispatch!(level, simd => project_rows(simd, cloud, first_row, camera, settings, room, seen));
    });
}

/// Fills the room of the rows from `first_row` on and returns how many splats they have.
#[inline(always)]
fn project_rows<S: Simd>(
    simd: S,
    cloud: &Gaussians,
    first_row: usize,
    camera: &Pinhole,
    settings: &RenderSettings,
    room: &mut [Splat],
    seen: &mut [bool],
) -> u32 {
    let mut splats = 0;
    for (group, seen) in seen.chunks_mut(LANES).enumerate() {
        let first = first_row + group * LANES;
        let params = Params::load(simd, cloud, |lane| first + lane.min(seen.len() - 1));
        let lanes = Geometry::new(&params, camera, settings.filter).lanes();
        for (lane, seen) in seen.iter_mut().enumerate() {
            *seen = lanes.is_seen(lane, camera);
            let Some(splat) = lanes.splat(lane, camera) else { continue };
            let row = first + lane;
            let colour =
                colour::evaluate(&cloud.sh[row], cloud.positions[row], camera.centre, settings.sh_degree);
            if colour.is_number() {
                room[splats] =
                    Splat { rgb: colour.rgb, clamped: colour.clamped, global: row as u32, ..splat };
                splats += 1;
            }
        }
    }
    splats as u32
}

/// Projects `count` versions of rows, `version(index)` a row and its genes, as if each were a row of its own: a splat's
/// `global` is its version's index.
pub fn project_versions(
    level: Level,
    cloud: &Gaussians,
    count: usize,
    version: impl Fn(usize) -> (u32, Genes) + Sync,
    camera: &Pinhole,
    settings: &RenderSettings,
    out: &mut Splats,
) {
    out.seen.clear();
    out.room.resize(count, Splat::default());
    out.counts.resize(count.div_ceil(CHUNK), 0);
    let rooms = out.room.par_chunks_mut(CHUNK).zip(&mut out.counts);
    rooms.enumerate().for_each(|(chunk, (room, splats))| {
        let first = chunk * CHUNK;
        *splats =
            dispatch!(level, simd => project_group(simd, cloud, first, &version, camera, settings, room));
    });
}

/// Projects as many versions as `room` has places, from `first` on; returns how many splats that makes, which come first.
#[inline(always)]
fn project_group<S: Simd>(
    simd: S,
    cloud: &Gaussians,
    first: usize,
    version: &impl Fn(usize) -> (u32, Genes),
    camera: &Pinhole,
    settings: &RenderSettings,
    room: &mut [Splat],
) -> u32 {
    let versions: Vec<(u32, Genes)> = (first..first + room.len()).map(version).collect();
    let mut splats = 0;
    for (group, versions) in versions.chunks(LANES).enumerate() {
        let of_lane = |lane: usize| versions[lane.min(versions.len() - 1)];
        let params = Params::load_with(simd, cloud, |lane| of_lane(lane).0 as usize, |lane| of_lane(lane).1);
        let lanes = Geometry::new(&params, camera, settings.filter).lanes();
        for (lane, &(row, _)) in versions.iter().enumerate() {
            let Some(splat) = lanes.splat(lane, camera) else { continue };
            let position = [params.position[0][lane], params.position[1][lane], params.position[2][lane]];
            let colour =
                colour::evaluate(&cloud.sh[row as usize], position, camera.centre, settings.sh_degree);
            if colour.is_number() {
                let global = (first + group * LANES + lane) as u32;
                room[splats] = Splat { rgb: colour.rgb, clamped: colour.clamped, global, ..splat };
                splats += 1;
            }
        }
    }
    splats as u32
}

/// Raw parameters of 16 Gaussians.
pub struct Params<S: Simd> {
    pub position: [V<S>; 3],
    pub log_scale: [V<S>; 3],
    pub rotation: [V<S>; 4],
    pub opacity_logit: V<S>,
    /// Standard deviation of Mip-Splatting's 3D filter; 0 without one.
    pub filter_3d: V<S>,
}

impl<S: Simd> Params<S> {
    /// The rows that `row(lane)` names.
    #[inline(always)]
    pub fn load(simd: S, cloud: &Gaussians, row: impl Fn(usize) -> usize) -> Self {
        Self::load_with(simd, cloud, &row, |lane| cloud.genes(row(lane)))
    }

    /// The same with other genes than the cloud's.
    #[inline(always)]
    pub fn load_with(
        simd: S,
        cloud: &Gaussians,
        row: impl Fn(usize) -> usize,
        genes: impl Fn(usize) -> Genes,
    ) -> Self {
        let mut gene_lanes = [[0.0f32; LANES]; genesplat_core::GENES];
        let mut rotation_lanes = [[0.0f32; LANES]; 4];
        let mut filter = [0.0f32; LANES];
        for lane in 0..LANES {
            for (values, value) in gene_lanes.iter_mut().zip(genes(lane)) {
                values[lane] = value;
            }
            for (values, value) in rotation_lanes.iter_mut().zip(cloud.rotations[row(lane)]) {
                values[lane] = value;
            }
            if let Some(filter_3d) = &cloud.filter_3d {
                filter[lane] = filter_3d[row(lane)];
            }
        }
        let load = |values: &[f32; LANES]| V::simd_from(simd, *values);
        Self {
            position: array(
                #[inline(always)]
                |k| load(&gene_lanes[k]),
            ),
            log_scale: array(
                #[inline(always)]
                |k| load(&gene_lanes[3 + k]),
            ),
            rotation: array(
                #[inline(always)]
                |k| load(&rotation_lanes[k]),
            ),
            opacity_logit: load(&gene_lanes[6]),
            filter_3d: load(&filter),
        }
    }
}

/// Everything between the raw parameters and the screen, for 16 Gaussians.
pub struct Geometry<S: Simd> {
    /// 1 / length of the raw quaternion, and the unit quaternion `(w, x, y, z)`.
    pub inverse_length: V<S>,
    pub unit: [V<S>; 4],
    /// Rotation matrix, rows.
    pub r: [[V<S>; 3]; 3],
    /// Variances along the own axes without the 3D filter, and with it.
    pub variance_raw: [V<S>; 3],
    pub variance: [V<S>; 3],
    /// Mean in camera coordinates.
    pub t: [V<S>; 3],
    pub inverse_z: V<S>,
    /// `x/z`, `y/z`, and the same clamped for the Jacobian.
    pub ratio: [V<S>; 2],
    pub clamped_ratio: [V<S>; 2],
    /// `J · R_view` `[2, 3]`, and that times `R`.
    pub u: [[V<S>; 3]; 2],
    pub w: [[V<S>; 3]; 2],
    /// Projected covariance `[a, b, c]` before and after the screen filter, px².
    pub cov_raw: [V<S>; 3],
    pub cov: [V<S>; 3],
    pub det_raw: V<S>,
    pub det: V<S>,
    /// Factors on the opacity from the 3D filter and from the screen filter.
    pub factor_3d: V<S>,
    pub factor_2d: V<S>,
    /// Sigmoid of the logit, and the opacity that is blended.
    pub opacity: V<S>,
    pub opacity_effective: V<S>,
}

impl<S: Simd> Geometry<S> {
    /// Steps 1 to 5 of the projection.
    #[inline(always)]
    pub fn new(params: &Params<S>, camera: &Pinhole, filter: ScreenFilter) -> Self {
        let simd = params.opacity_logit.simd;
        let one = V::splat(simd, 1.0);

        // 1. Own axes: rotation matrix of the unit quaternion, variances with the 3D filter.
        let [qw, qx, qy, qz] = params.rotation;
        let length = (qw * qw + qx * qx + qy * qy + qz * qz).sqrt().max(1e-12);
        let inverse_length = one / length;
        let unit = array(
            #[inline(always)]
            |k| params.rotation[k] * inverse_length,
        );
        let r = rotation_matrix(unit);
        let variance_raw: [V<S>; 3] = array(
            #[inline(always)]
            |k| exp(params.log_scale[k] * 2.0),
        );
        let filter_variance = params.filter_3d * params.filter_3d;
        let variance = array(
            #[inline(always)]
            |k| variance_raw[k] + filter_variance,
        );

        // 2. Camera coordinates.
        let t: [V<S>; 3] = array(
            #[inline(always)]
            |row| {
                let m = camera.rotation[row];
                params.position[0] * m[0]
                    + params.position[1] * m[1]
                    + params.position[2] * m[2]
                    + camera.translation[row]
            },
        );
        let inverse_z = one / t[2];

        // 3. Jacobian of the projection, with x/z and y/z clamped.
        let ratio = [t[0] * inverse_z, t[1] * inverse_z];
        let clamped_ratio: [V<S>; 2] = array(
            #[inline(always)]
            |axis| ratio[axis].max(-camera.limit[axis]).min(camera.limit[axis]),
        );
        let u: [[V<S>; 3]; 2] = array(
            #[inline(always)]
            |axis| {
                let diagonal = inverse_z * camera.focal[axis];
                let third = -(diagonal * clamped_ratio[axis]);
                array(
                    #[inline(always)]
                    |k| diagonal * camera.rotation[axis][k] + third * camera.rotation[2][k],
                )
            },
        );

        // 4. Covariance on the screen: sum over the own axes of variance · w wᵀ.
        let w: [[V<S>; 3]; 2] = array(
            #[inline(always)]
            |axis| {
                array(
                    #[inline(always)]
                    |k| u[axis][0] * r[0][k] + u[axis][1] * r[1][k] + u[axis][2] * r[2][k],
                )
            },
        );
        let cov_raw = [
            weighted_dot(&variance, &w[0], &w[0]),
            weighted_dot(&variance, &w[0], &w[1]),
            weighted_dot(&variance, &w[1], &w[1]),
        ];
        let dilation = filter.dilation();
        let cov = [cov_raw[0] + dilation, cov_raw[1], cov_raw[2] + dilation];
        // As a sum of squares (Cauchy and Binet): `xx · yy − xy²` of a needle is a small difference of large numbers.
        let [xy, xz, yz] = [minor(&w, 0, 1), minor(&w, 0, 2), minor(&w, 1, 2)];
        let [vx, vy, vz] = variance;
        let det_raw = vx * vy * xy * xy + vx * vz * xz * xz + vy * vz * yz * yz;
        // `exp` makes something of a NaN, and a determinant of 0 nothing of the Gaussian. Infinities have a meaning.
        let [sx, sy, sz] = params.log_scale;
        let logit = params.opacity_logit;
        let sane = sx.simd_eq(sx) & sy.simd_eq(sy) & sz.simd_eq(sz) & logit.simd_eq(logit);
        let det = keep(sane, det_raw + (cov_raw[0] + cov_raw[2]) * dilation + dilation * dilation);

        // 5. Opacity, with what the filters take from it.
        let opacity = sigmoid(params.opacity_logit);
        let volume_ratio = (variance_raw[0] / variance[0])
            * (variance_raw[1] / variance[1])
            * (variance_raw[2] / variance[2]);
        let factor_3d = params.filter_3d.simd_gt(0.0).select(volume_ratio.sqrt(), one);
        let factor_2d = screen_factor(filter, det_raw, det);
        let opacity_effective = opacity * factor_3d * factor_2d;
        Self {
            inverse_length,
            unit,
            r,
            variance_raw,
            variance,
            t,
            inverse_z,
            ratio,
            clamped_ratio,
            u,
            w,
            cov_raw,
            cov,
            det_raw,
            det,
            factor_3d,
            factor_2d,
            opacity,
            opacity_effective,
        }
    }

    /// What single lanes need, as arrays.
    #[inline(always)]
    fn lanes(&self) -> Lanes {
        Lanes {
            t: lanes_of(&self.t),
            ratio: lanes_of(&self.ratio),
            cov: lanes_of(&self.cov),
            det: *self.det,
            opacity: *self.opacity_effective,
        }
    }
}

/// `Σ_k weight_k a_k b_k`.
#[inline(always)]
fn weighted_dot<S: Simd>(weight: &[V<S>; 3], a: &[V<S>; 3], b: &[V<S>; 3]) -> V<S> {
    weight[0] * a[0] * b[0] + weight[1] * a[1] * b[1] + weight[2] * a[2] * b[2]
}

/// Determinant of two columns.
#[inline(always)]
fn minor<S: Simd>(w: &[[V<S>; 3]; 2], j: usize, k: usize) -> V<S> {
    w[0][j] * w[1][k] - w[0][k] * w[1][j]
}

/// Factor on the opacity that keeps a splat's energy under the screen filter.
#[inline(always)]
fn screen_factor<S: Simd>(filter: ScreenFilter, det_raw: V<S>, det: V<S>) -> V<S> {
    let simd = det.simd;
    match filter {
        ScreenFilter::Classic => V::splat(simd, 1.0),
        ScreenFilter::Antialiased => (det_raw / det).max(ANTIALIAS_RATIO_MIN).sqrt(),
        ScreenFilter::Mip => {
            let vanishes = det_raw.simd_le(MIP_EPSILON) | det.simd_le(MIP_EPSILON);
            let ratio = det_raw.max(MIP_EPSILON) / (det.max(MIP_EPSILON) + MIP_EPSILON) + MIP_EPSILON;
            vanishes.select(V::splat(simd, 0.0), ratio.sqrt())
        }
    }
}

#[inline(always)]
fn rotation_matrix<S: Simd>([w, x, y, z]: [V<S>; 4]) -> [[V<S>; 3]; 3] {
    let one = V::splat(w.simd, 1.0);
    [
        [one - (y * y + z * z) * 2.0, (x * y - w * z) * 2.0, (x * z + w * y) * 2.0],
        [(x * y + w * z) * 2.0, one - (x * x + z * z) * 2.0, (y * z - w * x) * 2.0],
        [(x * z - w * y) * 2.0, (y * z + w * x) * 2.0, one - (x * x + y * y) * 2.0],
    ]
}

struct Lanes {
    t: [[f32; LANES]; 3],
    ratio: [[f32; LANES]; 2],
    cov: [[f32; LANES]; 3],
    det: [f32; LANES],
    opacity: [f32; LANES],
}

impl Lanes {
    /// In front of the near plane, with an invertible covariance; false for anything that is not finite.
    #[inline(always)]
    fn is_valid(&self, lane: usize) -> bool {
        self.t[2][lane] > NEAR_DEPTH && self.det[lane] > 0.0 && self.det[lane].is_finite()
    }

    #[inline(always)]
    fn mean(&self, lane: usize, camera: &Pinhole) -> [f32; 2] {
        array(
            #[inline(always)]
            |axis| camera.focal[axis] * self.ratio[axis][lane] + camera.axis_px[axis],
        )
    }

    /// 3DGS's rule: the square of `ceil(3 sqrt(λ_max))` px around the mean meets at least one tile.
    #[inline(always)]
    fn is_seen(&self, lane: usize, camera: &Pinhole) -> bool {
        if !self.is_valid(lane) {
            return false;
        }
        let middle = 0.5 * (self.cov[0][lane] + self.cov[2][lane]);
        let largest = middle + (middle * middle - self.det[lane]).max(DISCRIMINANT_MIN).sqrt();
        let radius = (3.0 * largest.sqrt()).ceil();
        let mean = self.mean(lane, camera);
        let grid = camera.grid();
        (0..2).all(|axis| {
            let first = ((mean[axis] - radius) / TILE as f32).trunc().clamp(0.0, grid[axis] as f32);
            let end = ((mean[axis] + radius + (TILE - 1) as f32) / TILE as f32)
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
        let reaches = self.is_valid(lane) && opacity > ALPHA_MIN;
        if !reaches {
            return None;
        }
        let mean = self.mean(lane, camera);
        // alpha ≥ 1/255 ⟺ dᵀ Σ'⁻¹ d ≤ 2 ln(255 o): half extents sqrt(2 ln(255 o) Σ'ₖₖ).
        let log2_opacity = opacity.log2();
        let reach = 2.0 * std::f32::consts::LN_2 * (log2_opacity + LOG2_255);
        let half_extent = [(reach * self.cov[0][lane]).sqrt(), (reach * self.cov[2][lane]).sqrt()];
        let inside = (0..2).all(|axis| {
            mean[axis] + half_extent[axis] >= 0.0
                && mean[axis] - half_extent[axis] <= (camera.size[axis] - 1) as f32
        });
        if !inside {
            return None;
        }
        let scale = LOG2_E / self.det[lane];
        Some(Splat {
            mean,
            conic_log2: [
                -0.5 * scale * self.cov[2][lane],
                scale * self.cov[1][lane],
                -0.5 * scale * self.cov[0][lane],
            ],
            log2_opacity,
            depth: self.t[2][lane],
            half_extent,
            ..Splat::default()
        })
    }
}
