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
        // The fraction of a lamp's light that arrives; `emission` is what goes against the direction towards it.
        let arriving = |lamp: Vec3, area: f32, emission: &dyn Fn(Vec3) -> f32| {
            let towards = lamp - point;
            let distance = towards.length();
            let ray = Ray::leaving(point, normal, towards / distance);
            let (cosine, emission) = (ray.direction.dot(normal), emission(ray.direction));
            let lit = cosine > 0.0 && emission > 0.0 && world.is_clear(&ray, distance - LAMP_CLEARANCE, own);
            if lit { cosine * emission * area / (distance * distance) } else { 0.0 }
        };
        let Skylight { corner, size, radiance } = self.skylight;
        let area = size[0] * size[1] / (SKY_SAMPLES * SKY_SAMPLES) as f32;
        let patch = |sample: usize| {
            let (a, b) = ((sample % SKY_SAMPLES) as f32 + 0.5, (sample / SKY_SAMPLES) as f32 + 0.5);
            let offset = Vec3::new(a * size[0], b * size[1], 0.0) / SKY_SAMPLES as f32;
            arriving(corner + offset, area, &|direction| direction.z)
        };
        let spot = |spot: &Spot| {
            let axis = (spot.target - spot.position).normalize();
            let cone = |direction: Vec3| smoothstep(CONE[0], CONE[1], -direction.dot(axis));
            spot.intensity / PI * arriving(spot.position, 1.0, &cone)
        };
        let sky = radiance / PI * (0..SKY_SAMPLES * SKY_SAMPLES).map(patch).sum::<f32>();
        sky + self.spots.iter().map(spot).sum::<Vec3>()
    }
}
