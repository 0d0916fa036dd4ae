//! Points as structure from motion would find them: on texture, seen by several cameras, off by a millimetre
//! or two.

use genesplat_core::{Camera, Photo, Rng, Stream, View};
use glam::Vec3;
use rayon::prelude::*;

use crate::geometry::Ray;
use crate::photo_of;
use crate::render::{RayCaster, rays_of};
use crate::world::Finish;
use genesplat_io::Point;

/// Least number of cameras that must see a point.
const VIEWS_MIN: usize = 3;
/// Candidates for each point that is wanted; most fall on plain walls.
const CANDIDATES: u32 = 40;
/// Contrast with the neighbouring pixels, in 8-bit steps, that makes a candidate certain.
const CERTAIN_CONTRAST: f32 = 90.0;
/// Standard deviation of a point's error, as a fraction of its distance: half a pixel at 300 px focal length.
const ERROR: f32 = 0.5 / 300.0;
/// A camera sees a point if nothing lies before it, up to this many metres.
const TOLERANCE: f32 = 0.01;

/// At most `wanted` points, and the places of the views that see each.
pub(crate) fn sample(caster: &RayCaster, views: &[View], wanted: u32, seed: u64) -> Vec<(Point, Vec<usize>)> {
    let rng = Rng::new(seed);
    let candidates = (0..wanted.saturating_mul(CANDIDATES)).into_par_iter();
    let mut points: Vec<_> = candidates.filter_map(|index| candidate(caster, views, &rng, index)).collect();
    points.truncate(wanted as usize);
    points
}

fn candidate(caster: &RayCaster, views: &[View], rng: &Rng, index: u32) -> Option<(Point, Vec<usize>)> {
    let draw = rng.at(Stream::Gallery, 0, index, 0);
    let view = &views[draw.below(0, views.len() as u32) as usize];
    // A pixel with neighbours on all sides.
    let photo = photo_of(view);
    let (x, y) = (1 + draw.below(1, photo.width - 2), 1 + draw.below(2, photo.height - 2));
    if draw.uniform(3) * CERTAIN_CONTRAST > contrast(&photo, x, y) {
        return None;
    }
    let ray = rays_of(&view.camera)([x, y].map(f64::from));
    let hit = caster.world.trace(&ray, None)?;
    // Features on mirrors and lamps do not stay in place from view to view.
    let stays = matches!(caster.world.surfaces[hit.surface].finish, Finish::Matte | Finish::Coated { .. });
    let point = ray.at(hit.distance);
    if !stays {
        return None;
    }
    let seen: Vec<usize> = (0..views.len()).filter(|&at| sees(caster, &views[at].camera, point)).collect();
    if seen.len() < VIEWS_MIN {
        return None;
    }
    let (noise, more) = (rng.at(Stream::Gallery, 1, index, 0), rng.at(Stream::Gallery, 1, index, 1));
    let [[a, b], [c, _]] = [noise.normals(0), more.normals(0)];
    let position = point + ERROR * hit.distance * Vec3::new(a, b, c);
    Some((Point { position: position.into(), rgb: photo.pixel(x, y) }, seen))
}

/// Largest difference of a channel to the four neighbours.
fn contrast(photo: &Photo, x: u32, y: u32) -> f32 {
    let middle = photo.pixel(x, y);
    let neighbours = [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)].map(|(x, y)| photo.pixel(x, y));
    let differences = neighbours.iter().flatten().zip(middle.iter().cycle()).map(|(a, b)| a.abs_diff(*b));
    f32::from(differences.max().unwrap_or(0))
}

fn sees(caster: &RayCaster, camera: &Camera, point: Vec3) -> bool {
    let in_camera = camera.camera_from_world(point.as_dvec3());
    let [u, v] = camera.pixel_from_camera(in_camera);
    let inside = in_camera.z > 0.0
        && (0.0..f64::from(camera.width)).contains(&u)
        && (0.0..f64::from(camera.height)).contains(&v);
    let centre = camera.centre_in_world().as_vec3();
    let (towards, distance) = ((point - centre).normalize(), (point - centre).length());
    let ray = Ray::new(centre, towards);
    inside && caster.world.is_clear(&ray, distance - TOLERANCE, None)
}
