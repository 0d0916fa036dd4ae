//! Blocks on the ground, and which of them a place belongs to.

use std::path::Path;

use anyhow::{Context, Result, anyhow, ensure};
use genesplat::io::{input, shown};
use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

use super::ground::Ground;
use crate::files::write_json;

/// In the folder of the blocks.
pub(crate) const BLOCKS: &str = "blocks.json";
/// Folders of the blocks' scenes and of their runs, in the folder of the blocks.
pub(super) const SCENES: &str = "scenes";
pub(super) const RUNS: &str = "runs";

/// How a scene was cut.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Grid {
    pub(super) ground: Ground,
    /// The scene that was cut, for whoever wonders.
    pub(super) scene: String,
    pub(super) blocks: Vec<Block>,
}

/// A rectangle of the ground.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Block {
    /// Its column and its row.
    pub(super) name: String,
    /// From and to along both axes of the ground, world units; `null` where it has no end.
    core: [[Option<f64>; 2]; 2],
}

impl Grid {
    /// `columns` strips of as many points each along the ground's first axis, every one of them cut into `rows` along the second.
    pub(super) fn cut(scene: &Path, ground: Ground, points: &[DVec3], [columns, rows]: [usize; 2]) -> Self {
        let on_ground: Vec<DVec2> = points.iter().map(|&point| ground.coordinates(point)).collect();
        let mut blocks = Vec::new();
        for (column, x) in strips(on_ground.iter().map(|point| point.x), columns).into_iter().enumerate() {
            let inside = on_ground.iter().filter(|point| holds(x, point.x));
            for (row, y) in strips(inside.map(|point| point.y), rows).into_iter().enumerate() {
                blocks.push(Block { name: format!("{column}-{row}"), core: [x, y] });
            }
        }
        Self { ground, scene: shown(scene), blocks }
    }

    /// Whether a place stands on the core of `block`; each stands on one.
    pub(super) fn owns(&self, block: &Block, position: DVec3) -> bool {
        block.is_on_core(self.ground.coordinates(position), 0.0)
    }

    /// Whether each of `points` stands on the core of `block`, or within `margin` of the core's sides beyond.
    pub(super) fn near(&self, block: &Block, points: &[DVec3], margin: f64) -> Vec<bool> {
        let on_ground: Vec<DVec2> = points.iter().map(|&point| self.ground.coordinates(point)).collect();
        let sides = block.sides(&on_ground);
        on_ground
            .iter()
            .map(|&point| (0..2).all(|axis| holds_within(block.core[axis], point[axis], margin * sides[axis])))
            .collect()
    }

    pub(super) fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(BLOCKS);
        ensure!(
            path.exists(),
            "{} has no {BLOCKS}, so it is no folder of blocks; give the --out of `genesplat split`",
            shown(folder)
        );
        let text = input::read_text(&path).map_err(|error| anyhow!("cannot read {}: {error}", shown(&path)))?;
        serde_json::from_str(&text).with_context(|| format!("{} is damaged; split the scene again", shown(&path)))
    }

    pub(super) fn write(&self, folder: &Path) -> Result<()> {
        write_json(&folder.join(BLOCKS), self)
    }
}

impl Block {
    fn is_on_core(&self, point: DVec2, margin: f64) -> bool {
        (0..2).all(|axis| holds_within(self.core[axis], point[axis], margin))
    }

    /// Lengths of the sides of what its points take of the core, which may have no end.
    fn sides(&self, points: &[DVec2]) -> DVec2 {
        let mut inside = points.iter().filter(|point| self.is_on_core(**point, 0.0));
        let Some(&first) = inside.next() else { return DVec2::ZERO };
        let (low, high) = inside.fold((first, first), |(low, high), point| (low.min(*point), high.max(*point)));
        high - low
    }
}

fn holds(strip: [Option<f64>; 2], value: f64) -> bool {
    holds_within(strip, value, 0.0)
}

fn holds_within([from, to]: [Option<f64>; 2], value: f64, margin: f64) -> bool {
    from.is_none_or(|from| value >= from - margin) && to.is_none_or(|to| value < to + margin)
}

/// `count` strips that cover the line, with as many of the values in each, and edges midway between two values.
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
    use genesplat::core::Camera;

    use super::*;

    /// Points of a slab, denser on one side.
    fn points() -> Vec<DVec3> {
        let at = |nth: u32| DVec3::new(f64::from(nth).powi(2), f64::from(nth % 3), f64::from(nth * 7 % 11));
        (0..60).map(at).collect()
    }

    fn grid(count: [usize; 2]) -> Grid {
        let camera = Camera::at_origin(10, 10, 10.0);
        Grid::cut(Path::new("scene"), Ground::below(&[camera], &points()), &points(), count)
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
        let (block, points) = (&grid.blocks[0], points());
        let own: Vec<bool> = points.iter().map(|&point| grid.owns(block, point)).collect();
        assert_eq!(grid.near(block, &points, 0.0), own);
        let near = grid.near(block, &points, 0.5);
        assert!(near.iter().zip(&own).all(|(near, own)| *near || !own));
        assert!((31..60).contains(&near.iter().filter(|near| **near).count()));
    }

    #[test]
    fn a_grid_is_written_and_read_back_and_what_is_none_is_a_sentence() {
        let (folder, grid) = (tempfile::tempdir().unwrap(), grid([2, 2]));
        let error = Grid::read(folder.path()).unwrap_err().to_string();
        assert!(error.contains("no folder of blocks"), "{error}");
        grid.write(folder.path()).unwrap();
        let read = Grid::read(folder.path()).unwrap();
        for (block, again) in grid.blocks.iter().zip(&read.blocks) {
            assert!(points().into_iter().all(|point| grid.owns(block, point) == read.owns(again, point)));
        }
        assert_eq!((grid.blocks.len(), &grid.scene), (read.blocks.len(), &read.scene));
        std::fs::write(folder.path().join(BLOCKS), "{}").unwrap();
        let error = Grid::read(folder.path()).unwrap_err().to_string();
        assert!(error.contains("split the scene again"), "{error}");
    }
}
