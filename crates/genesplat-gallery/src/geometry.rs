//! Shapes of the gallery, and where rays hit them.
//!
//! World axes: x to the right along the back wall, y towards it, z up; metres.

use glam::{Vec3, Vec3A};

#[derive(Clone, Copy, Debug)]
pub(crate) struct Ray {
    pub(crate) origin: Vec3,
    /// Unit vector.
    pub(crate) direction: Vec3,
    /// `origin`, for the test of boxes.
    start: Vec3A,
    /// One over each component of `direction`, for the test of boxes.
    inverse: Vec3A,
}

impl Ray {
    pub(crate) fn new(origin: Vec3, direction: Vec3) -> Self {
        Self { origin, direction, start: origin.into(), inverse: direction.recip().into() }
    }

    /// From a point just off a surface, so that the surface itself is not hit again.
    pub(crate) fn leaving(point: Vec3, normal: Vec3, direction: Vec3) -> Self {
        const CLEARANCE: f32 = 1e-3;
        Self::new(point + CLEARANCE * normal, direction)
    }

    pub(crate) fn at(&self, distance: f32) -> Vec3 {
        self.origin + distance * self.direction
    }
}

#[derive(Clone, Copy, Debug)]
pub(crate) enum Shape {
    /// See [`Shape::rectangle`].
    Rectangle { corner: Vec3, u: Vec3, v: Vec3, size: [f32; 2], normal: Vec3 },
    /// An ellipsoid with axes along the world's; radii are their half lengths.
    Ellipsoid { centre: Vec3, radii: Vec3 },
    /// A cylinder with round ends, around the axis between two points.
    Rod { from: Vec3, to: Vec3, radius: f32 },
}

impl Shape {
    /// A rectangle from `corner`, along orthogonal unit vectors, which is seen from its front, towards `u ×
    /// v`, only.
    pub(crate) fn rectangle(corner: Vec3, u: Vec3, v: Vec3, size: [f32; 2]) -> Self {
        Self::Rectangle { corner, u, v, size, normal: u.cross(v) }
    }

    /// Distance at which the ray hits the shape, if that is in front of it and before `farthest`.
    pub(crate) fn intersect(&self, ray: &Ray, farthest: f32) -> Option<f32> {
        match *self {
            Self::Rectangle { corner, u, v, size, normal } => {
                let (facing, height) = (ray.direction.dot(normal), (corner - ray.origin).dot(normal));
                // Both are negative in front of the face; distances are compared before the costlier
                // position.
                if facing >= 0.0 || height >= 0.0 || height <= farthest * facing {
                    return None;
                }
                let distance = height / facing;
                let inside = ray.at(distance) - corner;
                let within = |side: Vec3, length: f32| (0.0..=length).contains(&inside.dot(side));
                (within(u, size[0]) && within(v, size[1])).then_some(distance)
            }
            Self::Ellipsoid { centre, radii } => intersect_ellipsoid(ray, centre, radii),
            Self::Rod { from, to, radius } => intersect_rod(ray, from, to, radius),
        }
        .filter(|distance| (0.0..farthest).contains(distance))
    }

    pub(crate) fn normal(&self, point: Vec3) -> Vec3 {
        match *self {
            Self::Rectangle { normal, .. } => normal,
            Self::Ellipsoid { centre, radii } => ((point - centre) / (radii * radii)).normalize(),
            Self::Rod { from, to, radius } => {
                let axis = to - from;
                let along = ((point - from).dot(axis) / axis.length_squared()).clamp(0.0, 1.0);
                (point - from - along * axis) / radius
            }
        }
    }

    /// Coordinates on a rectangle, metres from its corner; (0, 0) on other shapes.
    pub(crate) fn uv(&self, point: Vec3) -> [f32; 2] {
        match *self {
            Self::Rectangle { corner, u, v, .. } => [(point - corner).dot(u), (point - corner).dot(v)],
            _ => [0.0; 2],
        }
    }

    pub(crate) fn centre(&self) -> Vec3 {
        match *self {
            Self::Rectangle { corner, u, v, size, .. } => corner + 0.5 * (size[0] * u + size[1] * v),
            Self::Ellipsoid { centre, .. } => centre,
            Self::Rod { from, to, .. } => 0.5 * (from + to),
        }
    }

    pub(crate) fn bounds(&self) -> Bounds {
        match *self {
            Self::Rectangle { corner, u, v, size, .. } => {
                let (along, up) = (size[0] * u, size[1] * v);
                Bounds::of(corner, corner + along + up).union(Bounds::of(corner + along, corner + up))
            }
            Self::Ellipsoid { centre, radii } => Bounds::of(centre - radii, centre + radii),
            Self::Rod { from, to, radius } => {
                let ball = |end: Vec3| Bounds::of(end - radius, end + radius);
                ball(from).union(ball(to))
            }
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    low: Vec3A,
    high: Vec3A,
}

impl Bounds {
    pub(crate) fn of(a: Vec3, b: Vec3) -> Self {
        Self { low: a.min(b).into(), high: a.max(b).into() }
    }

    pub(crate) fn union(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    pub(crate) fn longest_axis(&self) -> usize {
        (self.high - self.low).max_position()
    }

    pub(crate) fn longest_side(&self) -> f32 {
        (self.high - self.low).max_element()
    }

    /// True when the ray is inside the box somewhere before `farthest`.
    #[inline]
    pub(crate) fn hit_before(&self, ray: &Ray, farthest: f32) -> bool {
        let (a, b) = ((self.low - ray.start) * ray.inverse, (self.high - ray.start) * ray.inverse);
        let (enter, leave) = (a.min(b).max_element(), a.max(b).min_element());
        leave >= enter.max(0.0) && enter < farthest
    }
}

fn intersect_ellipsoid(ray: &Ray, centre: Vec3, radii: Vec3) -> Option<f32> {
    // In the space in which it is the unit sphere.
    let (origin, direction) = ((ray.origin - centre) / radii, ray.direction / radii);
    let (a, b) = (direction.length_squared(), origin.dot(direction));
    let discriminant = b * b - a * (origin.length_squared() - 1.0);
    (discriminant > 0.0).then(|| (-b - discriminant.sqrt()) / a)
}

fn intersect_rod(ray: &Ray, from: Vec3, to: Vec3, radius: f32) -> Option<f32> {
    let axis = to - from;
    let length_squared = axis.length_squared();
    let start = ray.origin - from;
    // Components across the axis: the cylinder is a circle there.
    let across = |v: Vec3| v - v.dot(axis) / length_squared * axis;
    let (direction, origin) = (across(ray.direction), across(start));
    let (a, b) = (direction.length_squared(), origin.dot(direction));
    let discriminant = b * b - a * (origin.length_squared() - radius * radius);
    if discriminant < 0.0 {
        return None;
    }
    let distance = (-b - discriminant.sqrt()) / a;
    let along = (start + distance * ray.direction).dot(axis) / length_squared;
    if distance.is_finite() && (0.0..=1.0).contains(&along) {
        return Some(distance);
    }
    let end = if along < 0.0 { from } else { to };
    intersect_ellipsoid(ray, end, Vec3::splat(radius))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ray(origin: [f32; 3], direction: [f32; 3]) -> Ray {
        Ray::new(origin.into(), Vec3::from(direction).normalize())
    }

    #[test]
    fn rays_hit_shapes_where_they_are() {
        let disc = Shape::Ellipsoid { centre: Vec3::new(0.0, 5.0, 0.0), radii: Vec3::new(2.0, 1.0, 2.0) };
        let rod = Shape::Rod { from: Vec3::new(-1.0, 3.0, 0.0), to: Vec3::new(1.0, 3.0, 0.0), radius: 0.5 };
        let wall = Shape::rectangle(Vec3::new(-1.0, 7.0, -1.0), Vec3::X, Vec3::Z, [2.0, 3.0]);
        let ahead = ray([0.0; 3], [0.0, 1.0, 0.0]);
        for (shape, distance) in [(disc, 4.0), (rod, 2.5), (wall, 7.0)] {
            assert!((shape.intersect(&ahead, 100.0).unwrap() - distance).abs() < 1e-5);
            assert!(shape.intersect(&ray([0.0, 0.0, 4.0], [0.0, 1.0, 0.0]), 100.0).is_none());
            assert!(shape.bounds().hit_before(&ahead, 100.0) && !shape.bounds().hit_before(&ahead, 1.0));
            let normal = shape.normal(ahead.at(distance));
            assert!((normal - Vec3::NEG_Y).length() < 1e-5, "{normal}");
        }
        // The round end of the rod reaches half a metre beyond its axis.
        let end = rod.intersect(&ray([1.4, 0.0, 0.0], [0.0, 1.0, 0.0]), 100.0).unwrap();
        assert!((end - 2.7).abs() < 1e-5);
    }
}
