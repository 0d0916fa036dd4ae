//! All shapes of the room with their materials, and which of them a ray hits first (a bounding volume
//! hierarchy).

use std::ops::Range;

use glam::Vec3;

use crate::geometry::{Bounds, Ray, Shape};
use crate::texture::Texture;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Finish {
    /// Scatters alike in all directions.
    Matte,
    /// Matte under a clear coat that mirrors a fraction of what Fresnel's law allows: 1 for glass.
    Coated { specular: f32 },
    /// Mirrors, tinted.
    Metal(Vec3),
    /// Shines with this radiance.
    Lamp(Vec3),
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Surface {
    pub(crate) shape: Shape,
    pub(crate) texture: Texture,
    pub(crate) finish: Finish,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Hit {
    /// Metres from the ray's origin.
    pub(crate) distance: f32,
    /// Index of the surface.
    pub(crate) surface: usize,
}

/// The room and everything in it, as a bounding volume hierarchy: a ray tries only the surfaces in boxes that
/// it hits.
#[derive(Debug)]
pub(crate) struct World {
    /// First the large ones, then those of each leaf in a row.
    pub(crate) surfaces: Vec<Surface>,
    /// How many are large: their boxes would reach across the tree, so every ray tries them, and first.
    large: usize,
    /// The first is the root.
    nodes: Vec<Node>,
}

#[derive(Debug)]
struct Node {
    bounds: Bounds,
    content: Content,
}

#[derive(Debug)]
enum Content {
    Leaf(Range<usize>),
    /// The first child follows its parent; this is the index of the second, and the axis on which they are
    /// apart.
    Fork {
        second: usize,
        axis: usize,
    },
}

/// Longest side of a surface in the tree, metres.
const SIDE_MAX: f32 = 2.8;
const LEAF_MAX: usize = 2;
/// Nodes on the stack while a ray descends: one for each level, and a tree of halves has at most 64.
const STACK: usize = 64;

impl World {
    /// A world of these surfaces, which may be put into another order.
    pub(crate) fn new(surfaces: Vec<Surface>) -> Self {
        let is_large = |surface: &Surface| surface.shape.bounds().longest_side() > SIDE_MAX;
        let (mut surfaces, mut small): (Vec<_>, Vec<_>) = surfaces.into_iter().partition(is_large);
        let (large, mut nodes) = (surfaces.len(), Vec::new());
        if !small.is_empty() {
            build_tree(&mut small, large, &mut nodes);
        }
        surfaces.extend(small);
        Self { surfaces, large, nodes }
    }

    /// The first surface on the ray, other than `ignored`.
    pub(crate) fn trace(&self, ray: &Ray, ignored: Option<usize>) -> Option<Hit> {
        self.search(ray, f32::INFINITY, ignored, false)
    }

    /// True when nothing but `ignored` lies on the ray before `distance`.
    pub(crate) fn is_clear(&self, ray: &Ray, distance: f32, ignored: Option<usize>) -> bool {
        self.search(ray, distance, ignored, true).is_none()
    }

    /// The first surface before `farthest`, or `any` surface; boxes are tried roughly front to back.
    fn search(&self, ray: &Ray, mut farthest: f32, ignored: Option<usize>, any: bool) -> Option<Hit> {
        let mut found = None;
        let mut first_of = |members: Range<usize>, farthest: &mut f32| {
            for index in members.filter(|&index| Some(index) != ignored) {
                if let Some(distance) = self.surfaces[index].shape.intersect(ray, *farthest) {
                    *farthest = distance;
                    found = Some(Hit { distance, surface: index });
                    if any {
                        return true;
                    }
                }
            }
            false
        };
        let mut is_done = first_of(0..self.large, &mut farthest);
        let mut stack = [0; STACK];
        let mut count = usize::from(!self.nodes.is_empty());
        while !is_done && count > 0 {
            count -= 1;
            let at = stack[count];
            let node = &self.nodes[at];
            if !node.bounds.hit_before(ray, farthest) {
                continue;
            }
            match &node.content {
                Content::Leaf(members) => is_done = first_of(members.clone(), &mut farthest),
                // The last on the stack is visited first: the child that the ray comes to first.
                Content::Fork { second, axis } => {
                    let forwards = ray.direction[*axis] > 0.0;
                    (stack[count], stack[count + 1]) =
                        if forwards { (*second, at + 1) } else { (at + 1, *second) };
                    count += 2;
                }
            }
        }
        found
    }
}

/// Appends the tree of `surfaces`, of which the first has index `start` in the world.
fn build_tree(surfaces: &mut [Surface], start: usize, nodes: &mut Vec<Node>) {
    let bounds = surfaces.iter().map(|surface| surface.shape.bounds()).reduce(Bounds::union);
    let bounds = bounds.expect("a node holds at least one surface");
    if surfaces.len() <= LEAF_MAX {
        nodes.push(Node { bounds, content: Content::Leaf(start..start + surfaces.len()) });
        return;
    }
    let axis = bounds.longest_axis();
    let place = |surface: &Surface| surface.shape.centre()[axis];
    let half = surfaces.len() / 2;
    surfaces.select_nth_unstable_by(half, |a, b| place(a).total_cmp(&place(b)));
    let parent = nodes.len();
    nodes.push(Node { bounds, content: Content::Fork { second: 0, axis } });
    let (first, second) = surfaces.split_at_mut(half);
    build_tree(first, start, nodes);
    nodes[parent].content = Content::Fork { second: nodes.len(), axis };
    build_tree(second, start + half, nodes);
}

#[cfg(test)]
mod tests {
    use genesplat_core::{Rng, Stream};

    use super::*;

    fn vector(a: u32, b: u32) -> Vec3 {
        let draw = Rng::new(1).at(Stream::Test, a, b, 0);
        Vec3::new(draw.uniform(0), draw.uniform(1), draw.uniform(2)) - 0.5
    }

    #[test]
    fn the_tree_finds_what_a_search_of_all_surfaces_finds() {
        let surface = |i: u32| Surface {
            shape: match i % 3 {
                0 => Shape::Ellipsoid { centre: 4.0 * vector(0, i), radii: Vec3::splat(0.15) },
                1 => Shape::Rod { from: 4.0 * vector(0, i), to: 4.0 * vector(1, i), radius: 0.02 },
                _ => Shape::rectangle(4.0 * vector(0, i), Vec3::X, Vec3::Z, [0.4, 0.3]),
            },
            texture: Texture::Plain(Vec3::ONE),
            finish: Finish::Matte,
        };
        let world = World::new((0..100).map(surface).collect());
        let mut hits = 0;
        for i in 0..500 {
            let origin = 6.0 * vector(2, i).normalize();
            let ray = Ray::new(origin, (3.0 * vector(3, i) - origin).normalize());
            let all =
                world.surfaces.iter().filter_map(|surface| surface.shape.intersect(&ray, f32::INFINITY));
            let nearest = all.reduce(f32::min);
            assert_eq!(world.trace(&ray, None).map(|hit| hit.distance), nearest);
            assert_eq!(world.is_clear(&ray, 5.0, None), nearest.is_none_or(|distance| distance >= 5.0));
            hits += usize::from(nearest.is_some());
        }
        assert!(hits > 20, "{hits} of 500 rays hit anything");
    }
}
