//! Points far away, where photos show what no point of the reconstruction lies near: the sky, or what is
//! beyond. Without them training makes a background of Gaussians before the cameras.
//!
//! They lie on one sphere around the cameras, and have the colour that photos show there. What photos show
//! as plain background, or hide, gets none: a sky that is cut out stays transparent.

use std::f64::consts::PI;

use genesplat_core::{Camera, Photo, PhotoLost, View};
use genesplat_io::{Point, Scene};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Places on the sphere, evenly spread.
const PLACES: usize = 20_000;
/// Radius of the sphere, as a factor of the distance within which nearly all points lie.
const REACH: f64 = 3.0;
/// Nearly all.
const INNER: f64 = 0.99;
/// Most columns of cells of a photo. A cell with a point, or beside one, shows what is near.
const COLUMNS_MAX: f64 = 24.0;
/// Cells are as large as so many points of a photo take on average.
const POINTS_A_CELL: f64 = 8.0;
/// Most points that are looked at: more tell no more.
const POINTS_MAX: usize = 50_000;
/// Photos that must show nothing near at a place: so many, and so large a part of those that show the place.
const PHOTOS_MIN: u32 = 2;
const PART_MIN: f64 = 0.8;
/// Fewer places, as a part of those that photos show, are walls without texture rather than a background.
const WORTH: f64 = 0.03;

/// What photos show at a place.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Tally {
    shown: u32,
    /// Those that show nothing near there.
    empty: u32,
    /// Sum over them.
    rgb: [u32; 3],
}

impl Tally {
    fn plus(self, other: Self) -> Self {
        let rgb = [0, 1, 2].map(|channel| self.rgb[channel] + other.rgb[channel]);
        Self { shown: self.shown + other.shown, empty: self.empty + other.empty, rgb }
    }

    fn is_far(&self) -> bool {
        self.empty >= PHOTOS_MIN && f64::from(self.empty) >= PART_MIN * f64::from(self.shown)
    }
}

/// The far points of `scene`, on this `background`; none where photos hardly show anything far.
pub(crate) fn points(scene: &Scene, background: [u8; 3]) -> Result<Vec<Point>, PhotoLost> {
    let every = scene.points.len().div_ceil(POINTS_MAX).max(1);
    let near: Vec<DVec3> =
        scene.points.iter().step_by(every).map(|point| Vec3::from(point.position).as_dvec3()).collect();
    let places = places(&scene.train, &near);
    let tally = |view: &View| tally(view, &near, &places, background);
    let none = || Ok(vec![Tally::default(); places.len()]);
    let sum = |a: Result<Vec<Tally>, PhotoLost>, b: Result<Vec<Tally>, PhotoLost>| {
        Ok(a?.into_iter().zip(b?).map(|(a, b)| a.plus(b)).collect())
    };
    // Sums of whole numbers are the same in any order.
    let tallies: Vec<Tally> = scene.train.par_iter().map(tally).reduce(none, sum)?;
    let shown = tallies.iter().filter(|tally| tally.shown >= PHOTOS_MIN).count();
    let far: Vec<Point> = places
        .iter()
        .zip(&tallies)
        .filter(|(_, tally)| tally.is_far())
        .map(|(at, tally)| point(*at, tally))
        .collect();
    Ok(if far.len() as f64 >= WORTH * shown as f64 { far } else { Vec::new() })
}

fn point(place: DVec3, tally: &Tally) -> Point {
    Point { position: place.as_vec3().into(), rgb: tally.rgb.map(|sum| (sum / tally.empty) as u8) }
}

/// Places on the sphere around the cameras of `views`, beyond all that is `near`: a spiral.
fn places(views: &[View], near: &[DVec3]) -> Vec<DVec3> {
    let centre =
        views.iter().map(|view| view.camera.centre_in_world()).sum::<DVec3>() / views.len().max(1) as f64;
    let mut distances: Vec<f64> = near.iter().map(|point| point.distance(centre)).collect();
    let inner = (INNER * distances.len().saturating_sub(1) as f64) as usize;
    if distances.is_empty() {
        return Vec::new();
    }
    let (_, &mut reach, _) = distances.select_nth_unstable_by(inner, f64::total_cmp);
    let golden = PI * (1.0 + 5.0f64.sqrt());
    let place = |index: usize| {
        let height = 1.0 - (2.0 * index as f64 + 1.0) / PLACES as f64;
        let (sin, cos) = (golden * (index as f64 + 0.5)).sin_cos();
        let ring = (1.0 - height * height).sqrt();
        centre + REACH * reach * DVec3::new(ring * cos, ring * sin, height)
    };
    (0..PLACES).map(place).collect()
}

/// What a view shows at each of `places`.
fn tally(
    view: &View,
    near: &[DVec3],
    places: &[DVec3],
    background: [u8; 3],
) -> Result<Vec<Tally>, PhotoLost> {
    let (cells, photo) = (Cells::of(&view.camera, near), view.photo.read()?);
    let counts = |[x, y]: [u32; 2]| {
        view.mask.as_ref().is_none_or(|mask| mask.counts[(y * view.camera.width + x) as usize])
    };
    let at = |place: &DVec3| match pixel(&view.camera, *place).filter(|pixel| counts(*pixel)) {
        Some(pixel) => cells.tally(pixel, &photo, background),
        None => Tally::default(),
    };
    Ok(places.iter().map(at).collect())
}

/// The pixel where a camera shows a point, if it does.
fn pixel(camera: &Camera, point: DVec3) -> Option<[u32; 2]> {
    let in_camera = camera.camera_from_world(point);
    let [x, y] = camera.pixel_from_camera(in_camera).map(f64::round);
    let is_inside = |at: f64, side: u32| at >= 0.0 && at < f64::from(side);
    let is_shown = in_camera.z > camera.near && is_inside(x, camera.width) && is_inside(y, camera.height);
    is_shown.then_some([x as u32, y as u32])
}

/// Cells of a photo, and which show what is near.
struct Cells {
    side_px: f64,
    columns: usize,
    are_near: Vec<bool>,
}

impl Cells {
    fn of(camera: &Camera, near: &[DVec3]) -> Self {
        let pixels: Vec<[u32; 2]> = near.iter().filter_map(|point| pixel(camera, *point)).collect();
        let [width, height] = [camera.width, camera.height].map(f64::from);
        let of_points = (POINTS_A_CELL * width * height / pixels.len().max(1) as f64).sqrt();
        let side_px = (width / COLUMNS_MAX).max(of_points);
        let [columns, rows] = [width, height].map(|side| (side / side_px).ceil() as usize);
        let mut cells = Self { side_px, columns, are_near: vec![false; columns * rows] };
        for pixel in pixels {
            let [column, row] = cells.cell(pixel);
            for row in row.saturating_sub(1)..(row + 2).min(rows) {
                let first = row * columns;
                cells.are_near[first + column.saturating_sub(1)..first + (column + 2).min(columns)]
                    .fill(true);
            }
        }
        cells
    }

    fn cell(&self, pixel: [u32; 2]) -> [usize; 2] {
        pixel.map(|at| (f64::from(at) / self.side_px) as usize)
    }

    fn tally(&self, [x, y]: [u32; 2], photo: &Photo, background: [u8; 3]) -> Tally {
        let ([column, row], rgb) = (self.cell([x, y]), photo.pixel(x, y));
        match self.are_near[row * self.columns + column] || rgb == background {
            true => Tally { shown: 1, ..Tally::default() },
            false => Tally { shown: 1, empty: 1, rgb: rgb.map(u32::from) },
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use genesplat_core::Mask;
    use genesplat_io::HoldOut;

    use super::*;
    use crate::small_scene;

    const SIDE: u32 = 48;
    const SKY: [u8; 3] = [90, 140, 220];

    /// Six cameras in a row that look at a wall, whose points fill the lower half of their photos; above is
    /// `sky`.
    fn outdoors(sky: [u8; 3]) -> Scene {
        let mut scene = small_scene::gallery().into_scene(HoldOut::None);
        let view = |index: u32| {
            let camera = Camera {
                camera_from_world_translation: DVec3::new(-0.2 * f64::from(index), 0.0, 0.0),
                ..Camera::at_origin(SIDE, SIDE, f64::from(SIDE))
            };
            let colour = |at: u32| if at / SIDE < SIDE / 2 { sky } else { [60; 3] };
            let photo = Photo { width: SIDE, height: SIDE, rgb: (0..SIDE * SIDE).flat_map(colour).collect() };
            View { name: format!("{index}"), camera, photo: photo.into(), mask: None, depth: None }
        };
        scene.train = (0..6).map(view).collect();
        let wall = |at: usize| {
            let [x, y] = [at % 60, at / 60].map(|at| at as f32 / 10.0);
            Point { position: [x - 2.5, y, 5.0], rgb: [60; 3] }
        };
        scene.points = (0..60 * 30).map(wall).collect();
        scene
    }

    #[test]
    fn the_sky_gets_points_far_away_and_the_wall_none() {
        let far = points(&outdoors(SKY), [0; 3]).unwrap();
        assert!(far.len() > 100, "{}", far.len());
        for point in &far {
            let at = Vec3::from(point.position);
            assert!(at.length() > 12.0 && at.y < 0.0 && point.rgb == SKY, "{point:?}");
        }
        assert_eq!(far, points(&outdoors(SKY), [0; 3]).unwrap());
    }

    #[test]
    fn what_is_background_or_hidden_or_full_of_points_gets_none() {
        assert_eq!(points(&outdoors(SKY), SKY).unwrap(), [], "a sky that is cut out");
        let mut hidden = outdoors(SKY);
        let counts = (0..SIDE * SIDE).map(|at| at / SIDE >= SIDE / 2).collect();
        let mask = Arc::new(Mask { counts });
        hidden.train.iter_mut().for_each(|view| view.mask = Some(mask.clone()));
        assert_eq!(points(&hidden, [0; 3]).unwrap(), []);
        let mut indoors = outdoors(SKY);
        indoors.points.extend(outdoors(SKY).points.iter().map(|point| {
            let [x, y, z] = point.position;
            Point { position: [x, -y, z], ..*point }
        }));
        assert_eq!(points(&indoors, [0; 3]).unwrap(), []);
        indoors.points.clear();
        assert_eq!(points(&indoors, [0; 3]).unwrap(), [], "nothing says how far is far");
    }
}
