//! Blocks on the ground, and which of them a place belongs to.

use genesplat_core::Camera;
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::ground::Ground;

/// How a scene is cut.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Grid {
    ground: Ground,
    blocks: Vec<Block>,
}

/// A rectangle of the ground.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Block {
    /// Its column and its row.
    pub name: String,
    /// From and to along both axes of the ground, world units; `None` where it has no end.
    core: [[Option<f64>; 2]; 2],
}

impl Grid {
    /// `columns` strips of as many points each along the longer side of the ground below `cameras`, every one
    /// of them cut into `rows` along the shorter side.
    pub fn cut(cameras: &[Camera], points: &[DVec3], [columns, rows]: [usize; 2]) -> Self {
        let ground = Ground::below(cameras, points);
        let on_ground: Vec<DVec2> = points.iter().map(|&point| ground.coordinates(point)).collect();
        let mut blocks = Vec::new();
        for (column, x) in strips(on_ground.iter().map(|point| point.x), columns).into_iter().enumerate() {
            let inside = on_ground.iter().filter(|point| holds(x, point.x));
            for (row, y) in strips(inside.map(|point| point.y), rows).into_iter().enumerate() {
                blocks.push(Block { name: format!("{column}-{row}"), core: [x, y] });
            }
        }
        Self { ground, blocks }
    }

    /// Column after column.
    pub fn blocks(&self) -> &[Block] {
        &self.blocks
    }

    /// Whether a place stands on the core of `block`; each stands on one.
    pub fn owns(&self, block: &Block, position: DVec3) -> bool {
        block.is_on_core(self.ground.coordinates(position))
    }

    /// For each of `points`, the numbers of the blocks on whose core it stands, or within `margin` of the
    /// core's sides beyond.
    pub(super) fn near(&self, points: &[DVec3], margin: f64) -> Vec<Vec<usize>> {
        let on_ground: Vec<DVec2> = points.par_iter().map(|&point| self.ground.coordinates(point)).collect();
        let margins: Vec<DVec2> =
            self.blocks.par_iter().map(|block| margin * block.sides(&on_ground)).collect();
        let near = |point: &DVec2| {
            let blocks = self.blocks.iter().zip(&margins).enumerate();
            blocks
                .filter(|(_, (block, margins))| block.is_near(*point, **margins))
                .map(|(number, _)| number)
                .collect()
        };
        on_ground.par_iter().map(near).collect()
    }
}

impl Block {
    fn is_on_core(&self, point: DVec2) -> bool {
        self.is_near(point, DVec2::ZERO)
    }

    fn is_near(&self, point: DVec2, margins: DVec2) -> bool {
        (0..2).all(|axis| holds_within(self.core[axis], point[axis], margins[axis]))
    }

    /// Lengths of the sides of what its points take of the core, which may have no end.
    fn sides(&self, points: &[DVec2]) -> DVec2 {
        let mut inside = points.iter().filter(|point| self.is_on_core(**point));
        let Some(&first) = inside.next() else { return DVec2::ZERO };
        let (low, high) =
            inside.fold((first, first), |(low, high), point| (low.min(*point), high.max(*point)));
        high - low
    }
}

fn holds(strip: [Option<f64>; 2], value: f64) -> bool {
    holds_within(strip, value, 0.0)
}

fn holds_within([from, to]: [Option<f64>; 2], value: f64, margin: f64) -> bool {
    from.is_none_or(|from| value >= from - margin) && to.is_none_or(|to| value < to + margin)
}

/// `count` strips that cover the line, with as many of the values in each, and edges midway between two
/// values.
fn strips(values: impl Iterator<Item = f64>, count: usize) -> Vec<[Option<f64>; 2]> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    let edge = |nth: usize| {
        let at = nth * values.len() / count;
        let neighbours = values.get(at.checked_sub(1)?..=at)?;
        (nth < count).then(|| 0.5 * (neighbours[0] + neighbours[1]))
    };
    (0..count).map(|nth| [edge(nth), edge(nth + 1)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points of a slab, denser on one side.
    fn points() -> Vec<DVec3> {
        let at = |nth: u32| DVec3::new(f64::from(nth).powi(2), f64::from(nth % 3), f64::from(nth * 7 % 11));
        (0..60).map(at).collect()
    }

    fn grid(count: [usize; 2]) -> Grid {
        Grid::cut(&[Camera::at_origin(10, 10, 10.0)], &points(), count)
    }

    #[test]
    fn every_place_stands_on_one_core_and_points_are_dealt_out_evenly() {
        let grid = grid([3, 2]);
        let owners = |place: DVec3| grid.blocks.iter().filter(|block| grid.owns(block, place)).count();
        assert!(points().into_iter().all(|point| owners(point) == 1));
        assert_eq!(owners(DVec3::new(1e9, 1.0, -1e9)), 1, "also far outside");
        for block in &grid.blocks {
            let own = points().into_iter().filter(|&point| grid.owns(block, point)).count();
            assert!((8..=12).contains(&own), "{}: {own} of 60", block.name);
        }
    }

    #[test]
    fn near_is_the_core_and_its_margin() {
        let grid = grid([2, 1]);
        let own: Vec<bool> = points().into_iter().map(|point| grid.owns(&grid.blocks[0], point)).collect();
        let near = |margin: f64| -> Vec<bool> {
            grid.near(&points(), margin).iter().map(|blocks| blocks.contains(&0)).collect()
        };
        assert_eq!(near(0.0), own);
        let near = near(0.5);
        assert!(near.iter().zip(&own).all(|(near, own)| *near || !own));
        assert!((31..60).contains(&near.iter().filter(|near| **near).count()));
    }
}
