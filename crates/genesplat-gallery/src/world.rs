//! All shapes of the room with their materials, and which of them a ray hits first (a bounding volume hierarchy).

use std::ops::{ControlFlow, Range};

use glam::Vec3;

use crate::bounds::Bounds;
use crate::geometry::{Ray, Shape};
use crate::texture::Texture;

/// How a surface reflects light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Finish {
    /// Scatters alike in all directions.
    Matte,
    /// Matte under a clear coat that mirrors a fraction of what Fresnel's law allows.
    Coated {
        /// That fraction, 1 for glass.
        specular: f32,
    },
    /// Mirrors, tinted.
    Metal(Vec3),
    /// Shines with this radiance.
    Lamp(Vec3),
}

/// A shape with its material.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surface {
    /// Where it is.
    pub(crate) shape: Shape,
    /// Its colour.
    pub(crate) texture: Texture,
    /// How it reflects light.
    pub(crate) finish: Finish,
}

/// Where a ray ends.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hit {
    /// Metres from the ray's origin.
    pub(crate) distance: f32,
    /// Index of the surface.
    pub(crate) surface: usize,
}

/// The room and everything in it, as a bounding volume hierarchy: a ray tries only the surfaces in boxes that it hits.
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
    /// Indices of surfaces.
    Leaf(Range<usize>),
    /// The first child follows its parent; this is the index of the second, and the axis on which they are apart.
    Fork { second: usize, axis: usize },
}

/// Longest side of a surface in the tree, metres.
const SIDE_MAX: f32 = 2.8;
/// Most surfaces of a leaf.
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
        let mut nearest = f32::INFINITY;
        let mut found = None;
        self.visit(ray, |index| {
            let distance = if Some(index) == ignored {
                None
            } else {
                self.surfaces[index].shape.intersect(ray, nearest)
            };
            if let Some(distance) = distance {
                nearest = distance;
                found = Some(Hit { distance, surface: index });
            }
            ControlFlow::Continue(nearest)
        });
        found
    }

    /// True when nothing but `ignored` lies on the ray before `distance`.
    pub(crate) fn is_clear(&self, ray: &Ray, distance: f32, ignored: Option<usize>) -> bool {
        let mut clear = true;
        self.visit(ray, |index| {
            if Some(index) != ignored && self.surfaces[index].shape.intersect(ray, distance).is_some() {
                clear = false;
                return ControlFlow::Break(());
            }
            ControlFlow::Continue(distance)
        });
        clear
    }

    /// Calls `each` with the surfaces near the ray, roughly front to back, until it breaks; boxes beyond the distance
    /// that it returns are passed over.
    fn visit(&self, ray: &Ray, mut each: impl FnMut(usize) -> ControlFlow<(), f32>) {
        let mut farthest = f32::INFINITY;
        for index in 0..self.large {
            match each(index) {
                ControlFlow::Continue(distance) => farthest = distance,
                ControlFlow::Break(()) => return,
            }
        }
        let mut stack = [0; STACK];
        let mut count = usize::from(!self.nodes.is_empty());
        while count > 0 {
            count -= 1;
            let at = stack[count];
            let node = &self.nodes[at];
            if !node.bounds.hit_before(ray, farthest) {
                continue;
            }
            match &node.content {
                Content::Leaf(members) => {
                    for index in members.clone() {
                        match each(index) {
                            ControlFlow::Continue(distance) => farthest = distance,
                            ControlFlow::Break(()) => return,
                        }
                    }
                }
                // The last on the stack is visited first: the child that the ray comes to first.
                Content::Fork { second, axis } => {
                    let forwards = ray.direction[*axis] > 0.0;
                    (stack[count], stack[count + 1]) =
                        if forwards { (*second, at + 1) } else { (at + 1, *second) };
                    count += 2;
                }
            }
        }
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
