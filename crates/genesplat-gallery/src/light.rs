//! Light of the room, computed once: what every view sees is then the same, and a sample costs a look-up.
//!
//! Flat surfaces get two maps: direct light in a fine grid, one bounce in a coarse one (it varies slowly).
//! Curved ones get light from six directions at their middle, blended by the squared normal (an "ambient
//! cube", McTaggart, "Half-Life 2 source shading", GDC 2004). "Light" means radiance that a white matte
//! surface would send on: E / π.

use std::f32::consts::PI;

use glam::Vec3;
use rayon::prelude::*;

use crate::geometry::{Ray, Shape};
use crate::texture::smoothstep;
use crate::world::{Finish, Surface, World};

/// Cosines of the half angles at which a spot's cone ends and at which it is full.
const CONE: [f32; 2] = [0.86, 0.965];
/// Samples along each side of the skylight.
const SKY_SAMPLES: usize = 6;
/// A lamp's own body must not shade it: rays end this far before it, metres.
const LAMP_CLEARANCE: f32 = 0.08;
/// Spacing of direct light on flat surfaces, metres.
const FINE: f32 = 0.04;
/// Spacing of bounced light on flat surfaces, metres.
const COARSE: f32 = 0.2;
/// Directions of the bounce: this many squared.
const BOUNCE_SAMPLES: usize = 12;
/// Light of all further bounces, as a constant: about what a second bounce adds in this room.
const AMBIENT: Vec3 = Vec3::new(0.10, 0.095, 0.088);

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

#[derive(Clone, Debug)]
pub(crate) struct Lamps {
    pub(crate) skylight: Skylight,
    pub(crate) spots: Vec<Spot>,
}

#[derive(Clone, Debug)]
enum Field {
    Grid {
        columns: usize,
        rows: usize,
        size: [f32; 2],
        values: Vec<Vec3>,
    },
    /// From +x, −x, +y, −y, +z, −z.
    Cube([Vec3; 6]),
}

#[derive(Debug)]
pub(crate) struct Lighting {
    direct: Vec<Field>,
    bounced: Vec<Field>,
}

impl Lamps {
    /// Direct light at a point; `own` casts no shadow on itself.
    pub(crate) fn light(&self, world: &World, point: Vec3, normal: Vec3, own: Option<usize>) -> Vec3 {
        // The fraction of a lamp's light that arrives; `emission` is what goes against the direction towards
        // it.
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

impl Lighting {
    pub(crate) fn bake(world: &World, lamps: &Lamps, seed: u32) -> Self {
        let direct = fields(world, FINE, |point, normal, own| lamps.light(world, point, normal, own));
        let mut lighting = Self { direct, bounced: Vec::new() };
        lighting.bounced = fields(world, COARSE, |point, normal, own| {
            bounce(point, normal, |ray| lighting.scattered_back(world, ray, own, seed))
        });
        lighting
    }

    /// Light at a point of surface `index`, from all sides of its normal.
    pub(crate) fn at(&self, index: usize, uv: [f32; 2], normal: Vec3) -> Vec3 {
        self.direct[index].at(uv, normal) + self.bounced[index].at(uv, normal)
    }

    /// What the surface that `ray` hits scatters back along it.
    fn scattered_back(&self, world: &World, ray: &Ray, own: Option<usize>, seed: u32) -> Vec3 {
        let Some(hit) = world.trace(ray, own) else { return Vec3::ZERO };
        let (surface, point) = (&world.surfaces[hit.surface], ray.at(hit.distance));
        if matches!(surface.finish, Finish::Lamp(_)) {
            return Vec3::ZERO; // Counted as direct light.
        }
        let uv = surface.shape.uv(point);
        let light = self.direct[hit.surface].at(uv, surface.shape.normal(point)) + AMBIENT;
        surface.texture.albedo(uv, seed) * light
    }
}

impl Field {
    fn at(&self, uv: [f32; 2], normal: Vec3) -> Vec3 {
        match self {
            Self::Grid { columns, rows, size, values } => {
                let (column, right, x) = cell(uv[0], size[0], *columns);
                let (row, below, y) = cell(uv[1], size[1], *rows);
                let value = |column, row| values[row * columns + column];
                let first = value(column, row).lerp(value(right, row), x);
                first.lerp(value(column, below).lerp(value(right, below), x), y)
            }
            Self::Cube(sides) => {
                let weights = normal * normal;
                (0..3).map(|axis| weights[axis] * sides[2 * axis + usize::from(normal[axis] < 0.0)]).sum()
            }
        }
    }
}

/// The two cells of a grid between which `position` lies, and how far it is towards the second.
fn cell(position: f32, size: f32, cells: usize) -> (usize, usize, f32) {
    let at = (position / size * cells as f32 - 0.5).clamp(0.0, cells as f32 - 1.0);
    let first = at as usize;
    (first, (first + 1).min(cells - 1), at - first as f32)
}

/// `light(point, normal, own surface)` for every surface, at this spacing on flat ones.
fn fields(
    world: &World,
    spacing: f32,
    light: impl Fn(Vec3, Vec3, Option<usize>) -> Vec3 + Sync,
) -> Vec<Field> {
    let field = |(index, surface): (usize, &Surface)| match surface.shape {
        Shape::Rectangle { corner, u, v, size, normal } => {
            let [columns, rows] = size.map(|side| ((side / spacing).ceil() as usize).max(2));
            let point = |texel: usize| {
                let (a, b) = ((texel % columns) as f32 + 0.5, (texel / columns) as f32 + 0.5);
                corner + a / columns as f32 * size[0] * u + b / rows as f32 * size[1] * v
            };
            let texels = (0..columns * rows).into_par_iter();
            let values = texels.map(|texel| light(point(texel), normal, Some(index))).collect();
            Field::Grid { columns, rows, size, values }
        }
        Shape::Ellipsoid { .. } | Shape::Rod { .. } => {
            let sides = [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z];
            Field::Cube(sides.map(|side| light(surface.shape.centre(), side, Some(index))))
        }
    };
    world.surfaces.par_iter().enumerate().map(field).collect()
}

/// Mean of `incoming` over the hemisphere around `normal`, weighted by the cosine.
fn bounce(point: Vec3, normal: Vec3, incoming: impl Fn(&Ray) -> Vec3) -> Vec3 {
    let (tangent, bitangent) = normal.any_orthonormal_pair();
    let direction = |sample: usize| {
        let (a, b) = ((sample % BOUNCE_SAMPLES) as f32 + 0.5, (sample / BOUNCE_SAMPLES) as f32 + 0.5);
        // Uniform on the disc, lifted to the hemisphere (Malley's method).
        let radius = (a / BOUNCE_SAMPLES as f32).sqrt();
        let (sine, cosine) = (b / BOUNCE_SAMPLES as f32 * 2.0 * PI).sin_cos();
        let height = (1.0 - radius * radius).sqrt();
        radius * cosine * tangent + radius * sine * bitangent + height * normal
    };
    let samples = BOUNCE_SAMPLES * BOUNCE_SAMPLES;
    let sum: Vec3 =
        (0..samples).map(|sample| incoming(&Ray::leaving(point, normal, direction(sample)))).sum();
    sum / samples as f32
}
