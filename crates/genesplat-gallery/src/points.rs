//! Points as structure from motion would find them: on texture, seen by several cameras, off by a millimetre or two.

use genesplat_core::{Camera, Photo, Rng, Stream};
use glam::Vec3;
use rayon::prelude::*;

use crate::geometry::Ray;
use crate::render::{Lens, Stage};
use crate::world::Finish;
use genesplat_io::Point;

/// A photo and where it was taken from.
pub(crate) struct Shot<'a> {
    /// The camera.
    pub(crate) camera: &'a Camera,
    /// Its photo.
    pub(crate) photo: &'a Photo,
}

/// Fewest cameras that must see a point.
const LEAST_VIEWS: usize = 3;
/// Candidates for each point that is wanted; most fall on plain walls.
const CANDIDATES: u32 = 40;
/// Contrast with the neighbouring pixels, in 8-bit steps, that makes a candidate certain.
const CERTAIN_CONTRAST: f32 = 90.0;
/// Standard deviation of a point's error, as a share of its distance: half a pixel at 300 px focal length.
const ERROR: f32 = 0.5 / 300.0;
/// A camera sees a point if nothing lies before it, up to this many metres.
const TOLERANCE: f32 = 0.01;

/// At most `wanted` points.
pub(crate) fn sample(stage: &Stage, shots: &[Shot], wanted: u32, seed: u64) -> Vec<Point> {
    let rng = Rng::new(seed);
    let candidates = (0..wanted.saturating_mul(CANDIDATES)).into_par_iter();
    let mut points: Vec<Point> =
        candidates.filter_map(|index| candidate(stage, shots, &rng, index)).collect();
    points.truncate(wanted as usize);
    points
}

fn candidate(stage: &Stage, shots: &[Shot], rng: &Rng, index: u32) -> Option<Point> {
    let draw = rng.at(Stream::Gallery, 0, index, 0);
    let shot = &shots[draw.below(0, shots.len() as u32) as usize];
    // A pixel with neighbours on all sides.
    let (x, y) = (1 + draw.below(1, shot.photo.width - 2), 1 + draw.below(2, shot.photo.height - 2));
    if draw.uniform(3) * CERTAIN_CONTRAST > contrast(shot.photo, x, y) {
        return None;
    }
    let (ray, hit) = stage.look(&Lens::of(shot.camera), [f64::from(x), f64::from(y)])?;
    // Features on mirrors and lamps do not stay in place from view to view.
    let stays = matches!(stage.world.surfaces[hit.surface].finish, Finish::Matte | Finish::Coated { .. });
    let point = ray.at(hit.distance);
    if !stays
        || shots.iter().filter(|shot| sees(stage, shot.camera, point)).take(LEAST_VIEWS).count() < LEAST_VIEWS
    {
        return None;
    }
    let (noise, more) = (rng.at(Stream::Gallery, 1, index, 0), rng.at(Stream::Gallery, 1, index, 1));
    let [[a, b], [c, _]] = [noise.normals(0), more.normals(0)];
    let position = point + ERROR * hit.distance * Vec3::new(a, b, c);
    Some(Point { position: position.into(), rgb: shot.photo.pixel(x, y) })
}

/// Largest difference of a channel to the four neighbours.
fn contrast(photo: &Photo, x: u32, y: u32) -> f32 {
    let middle = photo.pixel(x, y);
    let neighbours = [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)].map(|(x, y)| photo.pixel(x, y));
    let differences = neighbours.iter().flatten().zip(middle.iter().cycle()).map(|(a, b)| a.abs_diff(*b));
    f32::from(differences.max().unwrap_or(0))
}

fn sees(stage: &Stage, camera: &Camera, point: Vec3) -> bool {
    let in_camera = camera.camera_from_world(point.as_dvec3());
    let [u, v] = camera.pixel_from_camera(in_camera);
    let inside = in_camera.z > 0.0
        && (0.0..f64::from(camera.width)).contains(&u)
        && (0.0..f64::from(camera.height)).contains(&v);
    let centre = camera.centre_in_world().as_vec3();
    let (towards, distance) = ((point - centre).normalize(), (point - centre).length());
    let ray = Ray::new(centre, towards);
    inside && stage.world.is_clear(&ray, distance - TOLERANCE, None)
}
