//! Casts the rays of a camera into the room: photos.

use std::f64::consts::{FRAC_PI_2, PI};

use genesplat_core::{Camera, Photo};
use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

use crate::geometry::Ray;
use crate::light::Lighting;
use crate::world::{Finish, World};

/// Where a pixel is sampled first, in eighths of its side: no two samples share a row or a column, and
/// turning the pattern by 90 degrees changes nothing, so edges of all directions are smooth.
const FIRST_SAMPLES: [[u8; 2]; 4] = [[0, 2], [5, 0], [7, 5], [2, 7]];
/// Where it is sampled besides, if the first samples differ: together no two share a row or a column.
const FURTHER_SAMPLES: [[u8; 2]; 4] = [[1, 3], [4, 1], [6, 4], [3, 6]];
/// Difference between samples, relative to the brightest and some stray light, that calls for further ones.
const SMOOTH: f32 = 0.03;
/// A mirror in a mirror is the last one that is followed.
const REFLECTIONS: u32 = 2;
/// Radiance that a sample is limited to: a lamp must not outshine the other samples of its pixel.
const BRIGHTEST: f32 = 4.0;
/// Factor of radiance before tone mapping.
const EXPOSURE: f32 = 1.25;

/// A lit room, ready to be photographed.
#[derive(Debug)]
pub(crate) struct RayCaster {
    pub(crate) world: World,
    pub(crate) lighting: Lighting,
    pub(crate) seed: u32,
}

impl RayCaster {
    /// The photo of `size` px that is taken along these rays; rows are computed in parallel.
    pub(crate) fn photograph(
        &self,
        [width, height]: [u32; 2],
        rays: &(impl Fn([f64; 2]) -> Ray + Sync),
    ) -> Photo {
        let columns = width as usize;
        let mut rgb = vec![0; 3 * columns * height as usize];
        rgb.par_chunks_mut(3 * columns).enumerate().for_each(|(row, values)| {
            for (column, value) in values.chunks_exact_mut(3).enumerate() {
                value.copy_from_slice(&tone_map(self.pixel(rays, [column as f64, row as f64])));
            }
        });
        Photo { width, height, rgb }
    }

    /// Depth along the axis of a camera of the centre of each pixel `[H, W]`, metres; infinite where there is
    /// nothing.
    pub(crate) fn depths(&self, camera: &Camera) -> Vec<f32> {
        let (rays, ahead) = (rays_of(camera), camera.rotation().row(2).as_vec3());
        let depth = |row: u32, column: u32| {
            let ray = rays([f64::from(column), f64::from(row)]);
            let distance = self.world.trace(&ray, None).map_or(f32::INFINITY, |hit| hit.distance);
            distance * ray.direction.dot(ahead)
        };
        (0..camera.height).flat_map(|row| (0..camera.width).map(move |column| depth(row, column))).collect()
    }

    /// Mean radiance of a pixel.
    fn pixel(&self, rays: &impl Fn([f64; 2]) -> Ray, [column, row]: [f64; 2]) -> Vec3 {
        let sample = |[x, y]: [u8; 2]| {
            let offset = |eighths: u8| (f64::from(eighths) - 3.5) / 8.0;
            self.radiance(&rays([column + offset(x), row + offset(y)]), 0).min(Vec3::splat(BRIGHTEST))
        };
        let first = FIRST_SAMPLES.map(sample);
        let sum: Vec3 = first.iter().sum();
        let (low, high) =
            first.iter().fold((first[0], first[0]), |(low, high), s| (low.min(*s), high.max(*s)));
        if (high - low).max_element() < SMOOTH * (0.2 + high.max_element()) {
            return sum / 4.0;
        }
        (sum + FURTHER_SAMPLES.map(sample).iter().sum::<Vec3>()) / 8.0
    }

    fn radiance(&self, ray: &Ray, reflections: u32) -> Vec3 {
        let Some(hit) = self.world.trace(ray, None) else { return Vec3::ZERO };
        let (surface, point) = (&self.world.surfaces[hit.surface], ray.at(hit.distance));
        let (normal, uv) = (surface.shape.normal(point), surface.shape.uv(point));
        let scattered = || surface.texture.albedo(uv, self.seed) * self.lighting.at(hit.surface, uv, normal);
        let facing = -ray.direction.dot(normal);
        let mirrored = || {
            let direction = ray.direction + 2.0 * facing * normal;
            self.radiance(&Ray::leaving(point, normal, direction), reflections + 1)
        };
        match surface.finish {
            Finish::Lamp(radiance) => radiance,
            Finish::Coated { specular } if reflections < REFLECTIONS => {
                scattered().lerp(mirrored(), specular * fresnel(0.04, facing))
            }
            Finish::Metal(tint) if reflections < REFLECTIONS => {
                mirrored() * tint.lerp(Vec3::ONE, fresnel(0.0, facing))
            }
            Finish::Matte | Finish::Coated { .. } | Finish::Metal(_) => scattered(),
        }
    }
}

/// The ray of `camera` through pixel coordinates `(u, v)`, pixel centres at integers.
pub(crate) fn rays_of(camera: &Camera) -> impl Fn([f64; 2]) -> Ray + Sync {
    let (centre, world_from_camera) = (camera.centre_in_world().as_vec3(), camera.rotation().transpose());
    let [focal_px, principal_px] = [camera.focal_px, camera.principal_px].map(DVec2::from);
    move |at| {
        let in_plane = (DVec2::from(at) + 0.5 - principal_px) / focal_px;
        let in_world = world_from_camera * in_plane.extend(1.0).normalize();
        Ray::new(centre, in_world.as_vec3())
    }
}

/// The rays from where `camera` stands through the pixels of a photo of all around, of so many rows.
pub(crate) fn rays_around(camera: &Camera, height: u32) -> impl Fn([f64; 2]) -> Ray + Sync {
    let (centre, world_from_camera) = (camera.centre_in_world().as_vec3(), camera.rotation().transpose());
    let radian_px = f64::from(height) / PI;
    move |at| {
        let [longitude, latitude] = at.map(|at| (at + 0.5) / radian_px);
        // The left rim lies behind, and the upper one above.
        let ((sin_longitude, cos_longitude), (sin, cos)) =
            ((longitude - PI).sin_cos(), (latitude - FRAC_PI_2).sin_cos());
        let in_camera = DVec3::new(cos * sin_longitude, sin, cos * cos_longitude);
        Ray::new(centre, (world_from_camera * in_camera).as_vec3())
    }
}

/// Fraction of light that a smooth surface mirrors (Schlick 1994).
fn fresnel(head_on: f32, cosine: f32) -> f32 {
    head_on + (1.0 - head_on) * (1.0 - cosine.clamp(0.0, 1.0)).powi(5)
}

/// Radiance to 8-bit sRGB, through the film curve of Narkowicz ("ACES filmic tone mapping curve", 2015).
fn tone_map(radiance: Vec3) -> [u8; 3] {
    let x = EXPOSURE * radiance;
    let film = (x * (2.51 * x + 0.03)) / (x * (2.43 * x + 0.59) + 0.14);
    let encode = |value: f32| {
        let value = value.clamp(0.0, 1.0);
        let srgb = if value <= 0.003_130_8 { 12.92 * value } else { 1.055 * value.powf(1.0 / 2.4) - 0.055 };
        (255.0 * srgb + 0.5) as u8
    };
    [encode(film.x), encode(film.y), encode(film.z)]
}
