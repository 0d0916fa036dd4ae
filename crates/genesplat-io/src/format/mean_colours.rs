//! Colours that a file rounds, or shows alike from everywhere, and that are right on average of the cameras.

use genesplat_core::spherical_harmonics::{C0, SH_DEGREE_MAX, SH_STRIDE, basis, coefficients, sh_index};
use genesplat_core::{Camera, Gaussians};
use glam::DVec3;
use rayon::prelude::*;

use super::{Format, Options, compressed_ply};

/// Cameras that are asked, at most, at even distances: more make no difference to a mean.
const CAMERAS: usize = 64;

type Harmonics = [f32; SH_STRIDE];

/// Moves base colours by what writing as `format` changes in the colours that `cameras` see, on average of
/// those that have a Gaussian in their picture; one that none has keeps its colour. (What own splats of fox,
/// fern and 32 photos of bonsai, at 160 px, lose without and with it: `.splat` 5.87, 4.90 and 0.51 dB, then
/// 5.17, 2.65 and 0.12; compressed `.ply` 0.17, 0.05 and 0.07, then 0.06, 0.01 and 0.03.)
pub fn keep_mean_colours(cloud: &mut Gaussians, format: Format, options: &Options, cameras: &[Camera]) {
    if !changes_colours(cloud, format, options) {
        return;
    }
    let degree = written_degree(format, options).min(cloud.sh_degree_in_use());
    let is_rounded = rounds_colours(format);
    let written = |row: &Harmonics| {
        let mut written = *row;
        let (kept, left_out) = written.split_at_mut(3 * coefficients(degree));
        left_out.fill(0.0);
        if is_rounded {
            kept[3..].iter_mut().for_each(|value| *value = compressed_ply::rounded_sh(*value));
        }
        written
    };
    keep_means(cloud, cameras, written);
}

/// Whether writing as `format` changes the colours that are seen, so that it counts from where.
pub fn changes_colours(cloud: &Gaussians, format: Format, options: &Options) -> bool {
    rounds_colours(format) || written_degree(format, options) < cloud.sh_degree_in_use()
}

fn written_degree(format: Format, options: &Options) -> u8 {
    if format == Format::Splat { 0 } else { options.sh_degree }
}

fn rounds_colours(format: Format) -> bool {
    format == Format::CompressedPly
}

/// `written` says what a file has of a Gaussian's harmonics above degree 0.
fn keep_means(cloud: &mut Gaussians, cameras: &[Camera], written: impl Fn(&Harmonics) -> Harmonics + Sync) {
    let step = cameras.len().div_ceil(CAMERAS).max(1);
    let eyes: Vec<Eye> = cameras.iter().step_by(step).map(Eye::of).collect();
    cloud.sh.par_iter_mut().zip(&cloud.positions).for_each(|(row, position)| {
        let lost = mean_loss(row, &written(row), DVec3::from(position.map(f64::from)), &eyes);
        for (channel, lost) in lost.into_iter().enumerate() {
            row[sh_index(channel, 0)] += (lost / C0) as f32;
        }
    });
}

/// A camera, and where it is.
struct Eye {
    camera: Camera,
    centre: DVec3,
}

impl Eye {
    fn of(camera: &Camera) -> Self {
        Self { camera: *camera, centre: camera.centre_in_world() }
    }

    fn has_in_picture(&self, point: DVec3) -> bool {
        let seen = self.camera.camera_from_world(point);
        let [x, y] = self.camera.pixel_from_camera(seen);
        let within = |at: f64, size: u32| (-0.5..f64::from(size) - 0.5).contains(&at);
        seen.z > self.camera.near && within(x, self.camera.width) && within(y, self.camera.height)
    }
}

/// By how much what cameras see is brighter before than after, a channel.
fn mean_loss(before: &Harmonics, after: &Harmonics, position: DVec3, eyes: &[Eye]) -> [f64; 3] {
    let (mut sum, mut seen_by) = ([0.0; 3], 0.0);
    for eye in eyes.iter().filter(|eye| eye.has_in_picture(position)) {
        let basis = basis(SH_DEGREE_MAX, (position - eye.centre).normalize_or_zero().to_array());
        // Base colours are the same in both. What is darker than black is black.
        let colour = |channel: usize, row: &Harmonics| -> f64 {
            let base = f64::from(before[sh_index(channel, 0)]) * C0 + 0.5;
            let rest = |k: usize| f64::from(row[sh_index(channel, k)]) * basis[k];
            ((1..basis.len()).map(rest).sum::<f64>() + base).max(0.0)
        };
        for (channel, sum) in sum.iter_mut().enumerate() {
            *sum += colour(channel, before) - colour(channel, after);
        }
        seen_by += 1.0;
    }
    sum.map(|sum| if seen_by > 0.0 { sum / seen_by } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A Gaussian before two cameras, one of which looks away, whose red depends on z.
    fn seen() -> (Gaussians, [Camera; 2]) {
        let mut cloud = Gaussians::zeros(2);
        cloud.positions = vec![[0.0, 0.0, 2.0], [0.0, 9.0, 2.0]];
        for row in &mut cloud.sh {
            row[sh_index(0, 2)] = 0.25;
            row[sh_index(1, 0)] = -0.5;
        }
        let ahead = Camera::at_origin(64, 64, 64.0);
        let mut behind = ahead;
        behind.camera_from_world_translation = DVec3::new(0.0, 0.0, -5.0);
        (cloud, [ahead, behind])
    }

    #[test]
    fn what_is_left_out_goes_into_the_base_colour_that_cameras_see() {
        let (whole, cameras) = seen();
        let mut cloud = whole.clone();
        keep_means(&mut cloud, &cameras, |_| [0.0; SH_STRIDE]);
        let red = basis(1, [0.0, 0.0, 1.0])[2] * 0.25;
        assert!((f64::from(cloud.sh[0][0]) * C0 - red).abs() < 1e-6, "{:?}", cloud.sh[0]);
        // Green does not depend on where it is seen from, and nobody sees the second.
        assert_eq!((cloud.sh[0][1], cloud.sh[1]), (-0.5, whole.sh[1]));
    }

    #[test]
    fn what_is_written_whole_keeps_its_colours() {
        let (whole, cameras) = seen();
        let mut cloud = whole.clone();
        keep_means(&mut cloud, &cameras, |row| *row);
        assert_eq!(cloud, whole);
    }
}
