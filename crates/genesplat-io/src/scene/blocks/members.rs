//! Which photos and which points are of which block.

use std::sync::atomic::{AtomicU64, Ordering};

use genesplat_core::Camera;
use glam::DVec3;
use rayon::prelude::*;

use super::Grid;

/// A photo is of a block if this fraction of the points that it shows stands on the block or near it.
const SHARE: f64 = 0.1;

/// The photos and the points of each block, which overlap.
pub struct Members {
    /// By block, ascending.
    photos: Vec<Vec<usize>>,
    /// By block, a bit for each point.
    points: Vec<Vec<AtomicU64>>,
}

impl Members {
    /// Photos of these `cameras` that show enough of a block, where what stands within `margin` of its sides
    /// beyond counts, too, and all of `points` that they show.
    ///
    /// What hides what is not known, so that a photo also shows what is behind a wall.
    pub fn of(grid: &Grid, cameras: &[Camera], points: &[DVec3], margin: f64) -> Self {
        let (near, blocks) = (grid.near(points, margin), grid.blocks().len());
        let none = || (0..points.len().div_ceil(64)).map(|_| AtomicU64::new(0)).collect();
        let mut members =
            Self { photos: vec![Vec::new(); blocks], points: (0..blocks).map(|_| none()).collect() };
        let of_photo = |camera: &Camera| {
            let shown = shown_by(camera, points);
            let blocks = enough(&shown, &near, blocks);
            blocks.iter().for_each(|&block| members.add(block, &shown));
            blocks
        };
        let blocks: Vec<Vec<usize>> = cameras.par_iter().map(of_photo).collect();
        for (photo, blocks) in blocks.into_iter().enumerate() {
            blocks.into_iter().for_each(|block| members.photos[block].push(photo));
        }
        members
    }

    /// The numbers of the photos of the block of this number.
    pub fn photos(&self, block: usize) -> &[usize] {
        &self.photos[block]
    }

    /// The numbers of the points of the block of this number.
    pub fn points(&self, block: usize) -> impl Iterator<Item = usize> {
        let words = self.points[block].iter().enumerate();
        words.flat_map(|(at, word)| {
            let word = word.load(Ordering::Relaxed);
            (0..64).filter(move |bit| word >> bit & 1 == 1).map(move |bit| 64 * at + bit)
        })
    }

    fn add(&self, block: usize, points: &[usize]) {
        for point in points {
            self.points[block][point / 64].fetch_or(1 << (point % 64), Ordering::Relaxed);
        }
    }
}

/// Points in front of the camera and within its picture.
fn shown_by(camera: &Camera, points: &[DVec3]) -> Vec<usize> {
    let (rotation, size) = (camera.rotation(), [camera.width, camera.height].map(f64::from));
    let is_shown = |&index: &usize| {
        let point = rotation * points[index] + camera.camera_from_world_translation;
        let pixel = camera.pixel_from_camera(point);
        point.z > 0.0 && (0..2).all(|axis| (-0.5..size[axis] - 0.5).contains(&pixel[axis]))
    };
    (0..points.len()).filter(is_shown).collect()
}

/// The blocks that a photo shows enough of; `near` has the blocks of each point.
fn enough(shown: &[usize], near: &[Vec<usize>], blocks: usize) -> Vec<usize> {
    let mut counts = vec![0usize; blocks];
    shown.iter().flat_map(|&point| &near[point]).for_each(|&block| counts[block] += 1);
    let is_enough = |&block: &usize| counts[block] > 0 && counts[block] as f64 >= SHARE * shown.len() as f64;
    (0..blocks).filter(is_enough).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall of 200 x 3 points, a unit apart, and a hill behind its right end.
    fn points() -> Vec<DVec3> {
        let wall = (0..600).map(|nth| DVec3::new(f64::from(nth % 200), f64::from(nth / 200), 0.0));
        let hill = (0..50).map(|nth| DVec3::new(190.0, 1.0, 10.0 + f64::from(nth)));
        wall.chain(hill).collect()
    }

    /// Before the wall at `x`: shows 20 units of it.
    fn camera(x: f64) -> Camera {
        Camera {
            camera_from_world_translation: DVec3::new(-x, -1.0, 10.0),
            ..Camera::at_origin(100, 100, 50.0)
        }
    }

    fn members(places: &[f64], margin: f64) -> Members {
        let cameras: Vec<Camera> = places.iter().map(|&x| camera(x)).collect();
        Members::of(&Grid::cut(&cameras, &points(), [2, 1]), &cameras, &points(), margin)
    }

    #[test]
    fn photos_are_of_the_blocks_that_they_show_enough_of() {
        // The cut is at 108: half of the points are on either side.
        let places = [20.0, 60.0, 95.0, 98.5, 101.0, 117.0, 130.0, 190.0];
        let of = |margin: f64| [0, 1].map(|block| members(&places, margin).photos(block).to_vec());
        assert_eq!(of(0.0), [vec![0, 1, 2, 3, 4], vec![4, 5, 6, 7]]);
        assert_eq!(of(0.1), [vec![0, 1, 2, 3, 4, 5], vec![2, 3, 4, 5, 6, 7]]);
    }

    #[test]
    fn what_is_behind_a_camera_is_not_shown() {
        assert_eq!(shown_by(&Camera::at_origin(100, 100, 50.0), &[DVec3::NEG_Z, DVec3::Z]), [1]);
    }

    #[test]
    fn a_block_has_all_points_that_its_photos_show() {
        let places = [60.0, 101.0, 150.0];
        let members = members(&places, 0.0);
        for block in [0, 1] {
            let shown =
                members.photos(block).iter().flat_map(|&photo| shown_by(&camera(places[photo]), &points()));
            let mut expected: Vec<usize> = shown.collect();
            expected.sort_unstable();
            expected.dedup();
            assert!(expected.len() > 64);
            assert_eq!(members.points(block).collect::<Vec<_>>(), expected);
        }
        assert!(members.points(0).any(|point| points()[point].x > 109.0), "beyond its core");
        assert!(members.points(1).any(|point| points()[point].z > 50.0), "behind the wall");
    }
}
