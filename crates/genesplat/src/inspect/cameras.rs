//! Cameras that cannot be right: one that sees nothing, a scene before the near plane. Of one far from all
//! others the scene tells.

use genesplat::core::constants::NEAR_DEPTH;
use genesplat::core::{Camera, View, median};
use genesplat::io::Point;
use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::listed;

/// A photo that sees fewer points has a wrong pose or shows something else.
const POINTS_MIN: usize = 10;
/// Points that are looked at, at most.
const POINTS_MAX: usize = 20_000;
/// The scene is too small where less than this fraction of what is before the cameras is behind the near
/// plane.
const VISIBLE_MIN: f64 = 0.5;

/// What the cameras see of the points.
pub(super) struct PointsSeen {
    /// Points in each photo; of a scene with more than [`POINTS_MAX`] an estimate.
    pub(super) counts: Vec<usize>,
    /// Median depth of what is seen, world units.
    pub(super) depth: Option<f64>,
    /// Of the points in front of a camera the fraction that is drawn, beyond its near plane, over all
    /// cameras.
    drawn_fraction: f64,
    /// The near plane of all cameras, world units.
    near: f64,
}

pub(super) fn points_seen(views: &[&View], points: &[Point]) -> PointsSeen {
    let every = points.len().div_ceil(POINTS_MAX).max(1);
    let positions: Vec<DVec3> =
        points.iter().step_by(every).map(|point| Vec3::from(point.position).as_dvec3()).collect();
    let depths: Vec<Vec<f64>> =
        views.par_iter().map(|view| depths_in_photo(&view.camera, &positions)).collect();
    let near = views.first().map_or(NEAR_DEPTH, |view| view.camera.near);
    let is_visible = |depth: &&f64| **depth > near;
    let all: Vec<f64> = depths.iter().flatten().copied().collect();
    let visible = all.iter().filter(is_visible).count() as f64;
    PointsSeen {
        counts: depths.iter().map(|depths| every * depths.iter().filter(is_visible).count()).collect(),
        drawn_fraction: if all.is_empty() { 1.0 } else { visible / all.len() as f64 },
        depth: median(all),
        near,
    }
}

/// Depths of the points that a camera would show if it had no near plane.
fn depths_in_photo(camera: &Camera, positions: &[DVec3]) -> Vec<f64> {
    let inside = |at: f64, side: u32| at >= -0.5 && at < f64::from(side) - 0.5;
    let depth = |position: &DVec3| {
        let seen = camera.camera_from_world(*position);
        let [x, y] = camera.pixel_from_camera(seen);
        (seen.z > 0.0 && inside(x, camera.width) && inside(y, camera.height)).then_some(seen.z)
    };
    positions.iter().filter_map(depth).collect()
}

pub(super) fn warnings(views: &[&View], seen: &PointsSeen) -> Vec<String> {
    [too_small(seen), blind(views, seen)].into_iter().flatten().collect()
}

fn too_small(seen: &PointsSeen) -> Option<String> {
    let depth = seen.depth?;
    (seen.drawn_fraction < VISIBLE_MIN).then(|| {
        format!(
            "{:.0} % of what the photos show is nearer than the near plane at {} (half of it is nearer than {depth:.3}), and is \
             not drawn: give a smaller --near",
            100.0 * (1.0 - seen.drawn_fraction),
            seen.near
        )
    })
}

fn blind(views: &[&View], seen: &PointsSeen) -> Option<String> {
    let counts = views.iter().zip(&seen.counts);
    let names: Vec<&str> =
        counts.filter(|(_, points)| **points < POINTS_MIN).map(|(view, _)| view.name.as_str()).collect();
    (!names.is_empty() && seen.drawn_fraction >= VISIBLE_MIN).then(|| {
        format!(
            "{} of {} photos see fewer than {POINTS_MIN} points ({}): their poses are wrong, or they show something else",
            names.len(),
            views.len(),
            listed(&names)
        )
    })
}

#[cfg(test)]
pub(super) mod tests {
    use std::sync::Arc;

    use genesplat::core::Photo;

    use super::*;

    /// Looks along z.
    pub(in crate::inspect) fn camera_at(centre: [f64; 3]) -> Camera {
        Camera { camera_from_world_translation: -DVec3::from(centre), ..Camera::at_origin(20, 20, 20.0) }
    }

    fn views(centres: &[[f64; 3]]) -> Vec<View> {
        let photo = Arc::new(Photo { width: 20, height: 20, rgb: vec![0; 1200] });
        let view = |(number, centre): (usize, &[f64; 3])| View {
            name: format!("{number}.jpg"),
            camera: camera_at(*centre),
            photo: Arc::clone(&photo).into(),
            mask: None,
            depth: None,
        };
        centres.iter().enumerate().map(view).collect()
    }

    fn found(views: &[View], scale: f32) -> Vec<String> {
        let point = |at: u16| Point {
            position: [f32::from(at % 5), f32::from(at / 5), 20.0].map(|x| x * scale),
            rgb: [0; 3],
        };
        let points: Vec<Point> = (0..25).map(point).collect();
        let views: Vec<&View> = views.iter().collect();
        warnings(&views, &points_seen(&views, &points))
    }

    #[test]
    fn cameras_that_see_nothing_are_named() {
        let good = [[0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [3.0, 0.0, 0.0]];
        assert_eq!(found(&views(&good), 1.0), [] as [String; 0]);
        let blind = [&good[..], &[[4.0, 0.0, 30.0]]].concat();
        let warnings = found(&views(&blind), 1.0);
        assert!(warnings[0].contains("1 of 5 photos see fewer than 10 points (4.jpg)"), "{warnings:?}");
    }

    #[test]
    fn a_scene_before_the_near_plane_is_noticed() {
        let centres = [0.0, 0.001, 0.002].map(|x| [x, 0.0, 0.0]);
        let warnings = found(&views(&centres), 0.001);
        assert!(warnings.len() == 1 && warnings[0].contains("100 % of what the photos show"), "{warnings:?}");
    }
}
