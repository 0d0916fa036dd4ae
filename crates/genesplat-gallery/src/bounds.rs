//! Axis-aligned boxes, and whether rays hit them.

use glam::{Vec3, Vec3A};

use crate::geometry::Ray;

/// An axis-aligned box.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    low: Vec3A,
    high: Vec3A,
}

impl Bounds {
    /// Of two points.
    pub(crate) fn of(a: Vec3, b: Vec3) -> Self {
        Self { low: a.min(b).into(), high: a.max(b).into() }
    }

    /// The least box around both.
    pub(crate) fn union(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    /// 0 for x, 1 for y, 2 for z.
    pub(crate) fn longest_axis(&self) -> usize {
        (self.high - self.low).max_position()
    }

    /// Metres.
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
