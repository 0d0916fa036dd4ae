//! What shines, and its direct light.

use std::f32::consts::PI;

use glam::Vec3;

use crate::geometry::Ray;
use crate::texture::smoothstep;
use crate::world::World;

/// A rectangle in the ceiling that shines downwards.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Skylight {
    /// Least x and y corner, at the ceiling.
    pub(crate) corner: Vec3,
    /// Sides along x and y, metres.
    pub(crate) size: [f32; 2],
    pub(crate) radiance: Vec3,
}

/// A lamp that shines in a cone.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spot {
    pub(crate) position: Vec3,
    pub(crate) target: Vec3,
    /// Radiance times area.
    pub(crate) intensity: Vec3,
}

/// All that shines.
#[derive(Clone, Debug)]
pub(crate) struct Lamps {
    pub(crate) skylight: Skylight,
    pub(crate) spots: Vec<Spot>,
}

/// Cosines of the half angles at which a spot's cone ends and at which it is full.
const CONE: [f32; 2] = [0.86, 0.965];
/// Samples along each side of the skylight.
const SKY_SAMPLES: usize = 6;
/// A lamp's own body must not shade it: rays end this far before it, metres.
const LAMP_CLEARANCE: f32 = 0.08;

impl Lamps {
    /// Direct light at a point; `own` casts no shadow on itself.
    pub(crate) fn light(&self, world: &World, point: Vec3, normal: Vec3, own: Option<usize>) -> Vec3 {
        let spots: Vec3 = self.spots.iter().map(|spot| spot.light(world, point, normal, own)).sum();
        self.skylight.light(world, point, normal, own) + spots
    }
}

impl Skylight {
    fn light(&self, world: &World, point: Vec3, normal: Vec3, own: Option<usize>) -> Vec3 {
        let patch = self.size[0] * self.size[1] / (SKY_SAMPLES * SKY_SAMPLES) as f32;
        let form_factor = |sample: usize| {
            let (a, b) = ((sample % SKY_SAMPLES) as f32 + 0.5, (sample / SKY_SAMPLES) as f32 + 0.5);
            let offset = Vec3::new(a * self.size[0], b * self.size[1], 0.0) / SKY_SAMPLES as f32;
            let towards = self.corner + offset - point;
            let distance = towards.length();
            let ray = Ray::leaving(point, normal, towards / distance);
            let (cosine, at_lamp) = (ray.direction.dot(normal), ray.direction.z);
            let lit = cosine > 0.0 && at_lamp > 0.0 && world.is_clear(&ray, distance - LAMP_CLEARANCE, own);
            if lit { cosine * at_lamp * patch / (distance * distance) } else { 0.0 }
        };
        self.radiance / PI * (0..SKY_SAMPLES * SKY_SAMPLES).map(form_factor).sum::<f32>()
    }
}

impl Spot {
    fn light(&self, world: &World, point: Vec3, normal: Vec3, own: Option<usize>) -> Vec3 {
        let towards = self.position - point;
        let distance = towards.length();
        let ray = Ray::leaving(point, normal, towards / distance);
        let axis = (self.target - self.position).normalize();
        let cone = smoothstep(CONE[0], CONE[1], -ray.direction.dot(axis));
        let cosine = ray.direction.dot(normal);
        if cone <= 0.0 || cosine <= 0.0 || !world.is_clear(&ray, distance - LAMP_CLEARANCE, own) {
            return Vec3::ZERO;
        }
        self.intensity / PI * (cone * cosine / (distance * distance))
    }
}
