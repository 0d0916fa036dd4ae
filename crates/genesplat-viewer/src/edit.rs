//! Which Gaussians a box or a brush of the page removes, and how that is undone: functions of a cloud alone.

use std::collections::BTreeMap;

use genesplat_core::gaussians::sigmoid;
use genesplat_core::{Camera, Gaussians};
use glam::{DQuat, DVec3};
use serde::Deserialize;

use crate::message::{MessageError, Pose, check_place, check_rotation, check_size};
use crate::render_mode::SHOWN_OPACITY;

/// Most points of a stroke; a page leaves some out of a longer one.
pub const STROKE_POINTS_MAX: usize = 256;
/// Radii of a brush, px.
const RADIUS_PX: std::ops::RangeInclusive<f64> = 1.0..=500.0;
/// What is farther away than what is before it by this share belongs to another layer.
const LAYER_GAP: f64 = 0.1;

/// What a page wants to change of the cloud that it shows.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Edit {
    Crop(Crop),
    Erase(Stroke),
    Undo,
    Save,
}

/// A box, and what goes.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Crop {
    /// Its middle, world units.
    pub centre: [f64; 3],
    /// `world_from_box` as a quaternion `(w, x, y, z)`.
    pub rotation: [f64; 4],
    /// Half of its sides, world units.
    pub half_sizes: [f64; 3],
    /// Which side of its faces is removed.
    pub removes: Side,
}

/// A side of the faces of a box.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Side {
    /// Centres in the box.
    Inside,
    /// All others.
    Outside,
}

/// A line that was drawn with a round brush over a picture.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stroke {
    /// From where the picture was seen; of a scene's camera this is ignored.
    pub pose: Pose,
    /// Index of the scene's camera that was looked through.
    #[serde(default)]
    pub camera: Option<u32>,
    /// Width of the picture, px.
    pub width: u32,
    /// Its height, px.
    pub height: u32,
    /// Of the brush, px.
    pub radius: f64,
    /// Where its middle went, px from the left and the top.
    pub path: Vec<[f64; 2]>,
    /// It goes through everything, not through the front layer alone.
    #[serde(default)]
    pub through: bool,
}

impl Crop {
    pub(crate) fn check(&self) -> Result<(), MessageError> {
        check_place(&self.centre, "the middle of the box")?;
        check_rotation(&self.rotation)?;
        check_place(&self.half_sizes, "the size of the box")?;
        match self.half_sizes.iter().all(|&half| half > 0.0) {
            true => Ok(()),
            false => Err(MessageError::Range("the size of the box")),
        }
    }

    /// The rows that go, ascending.
    pub(crate) fn rows(&self, cloud: &Gaussians) -> Vec<u32> {
        let [w, x, y, z] = self.rotation;
        let box_from_world = DQuat::from_xyzw(x, y, z, w).normalize().conjugate();
        let (centre, half) = (DVec3::from(self.centre), DVec3::from(self.half_sizes));
        let is_inside = |row: &u32| {
            let offset = position(cloud, *row) - centre;
            (box_from_world * offset).abs().cmple(half).all()
        };
        let rows = 0..cloud.len() as u32;
        rows.filter(|row| is_inside(row) == (self.removes == Side::Inside)).collect()
    }
}

fn position(cloud: &Gaussians, row: u32) -> DVec3 {
    DVec3::from(cloud.positions[row as usize].map(f64::from))
}

/// A Gaussian whose centre is under a brush.
struct Touched {
    row: u32,
    /// Square of the picture, as wide as the brush's radius.
    cell: [i64; 2],
    depth: f64,
    is_shown: bool,
}

impl Stroke {
    pub(crate) fn check(&self) -> Result<(), MessageError> {
        check_size(self.width, self.height)?;
        self.pose.check()?;
        let reach = 2.0 * f64::from(self.width.max(self.height));
        let checks = [
            (RADIUS_PX.contains(&self.radius), "the radius of the brush"),
            ((1..=STROKE_POINTS_MAX).contains(&self.path.len()), "the length of the stroke"),
            (self.path.iter().flatten().all(|at| at.abs() <= reach), "a point of the stroke"),
        ];
        checks.iter().find(|(holds, _)| !holds).map_or(Ok(()), |(_, what)| Err(MessageError::Range(what)))
    }

    /// The rows that go, ascending: of the picture of `camera`, which has the stroke's size.
    pub(crate) fn rows(&self, cloud: &Gaussians, camera: &Camera) -> Vec<u32> {
        let touched = self.touched(cloud, camera);
        if self.through {
            return touched.iter().map(|touched| touched.row).collect();
        }
        let mut shown: BTreeMap<[i64; 2], Vec<f64>> = BTreeMap::new();
        for Touched { cell, depth, .. } in touched.iter().filter(|touched| touched.is_shown) {
            shown.entry(*cell).or_default().push(*depth);
        }
        let mut limits = BTreeMap::new();
        let mut is_in_front = |touched: &&Touched| {
            let cell = touched.cell;
            touched.depth <= *limits.entry(cell).or_insert_with(|| front_limit(&shown, cell))
        };
        touched.iter().filter(&mut is_in_front).map(|touched| touched.row).collect()
    }

    fn touched(&self, cloud: &Gaussians, camera: &Camera) -> Vec<Touched> {
        let of_row = |row: u32| {
            let centre = camera.camera_from_world(position(cloud, row));
            let place = camera.pixel_from_camera(centre);
            let is_touched = centre.z > camera.near && self.covers(place);
            let opacity = sigmoid(cloud.opacity_logits[row as usize]) * cloud.filter_dimming(row as usize);
            is_touched.then(|| Touched {
                row,
                cell: place.map(|at| (at / self.radius).floor() as i64),
                depth: centre.z,
                is_shown: opacity >= SHOWN_OPACITY,
            })
        };
        (0..cloud.len() as u32).filter_map(of_row).collect()
    }

    /// Whether a place of the picture is under the brush on its way.
    fn covers(&self, place: [f64; 2]) -> bool {
        let near = |from: [f64; 2], to: [f64; 2]| distance(place, from, to) <= self.radius;
        match self.path[..] {
            [only] => near(only, only),
            ref path => path.windows(2).any(|pair| near(pair[0], pair[1])),
        }
    }
}

/// From a place to the line between two others, px.
fn distance([x, y]: [f64; 2], [ax, ay]: [f64; 2], [bx, by]: [f64; 2]) -> f64 {
    let (dx, dy) = (bx - ax, by - ay);
    let length_2 = dx * dx + dy * dy;
    let along =
        if length_2 > 0.0 { (((x - ax) * dx + (y - ay) * dy) / length_2).clamp(0.0, 1.0) } else { 0.0 };
    (x - ax - along * dx).hypot(y - ay - along * dy)
}

/// Where the front layer ends around a cell: before the first gap behind what is nearest. Everything where
/// nothing is shown.
fn front_limit(shown: &BTreeMap<[i64; 2], Vec<f64>>, [column, row]: [i64; 2]) -> f64 {
    let around = (column - 1..=column + 1).flat_map(|x| (row - 1..=row + 1).map(move |y| [x, y]));
    let mut depths: Vec<f64> = around.filter_map(|cell| shown.get(&cell)).flatten().copied().collect();
    depths.sort_by(f64::total_cmp);
    let gap = depths.windows(2).find(|pair| pair[1] > pair[0] * (1.0 + LAYER_GAP));
    gap.map_or(f64::INFINITY, |pair| pair[0])
}

/// A cloud of which edits remove rows, and give them back.
pub(crate) struct Edits {
    original: Gaussians,
    /// Rows of the original that are left, ascending.
    kept: Vec<u32>,
    /// What each edit has removed, ascending.
    removed: Vec<Vec<u32>>,
}

impl Edits {
    pub(crate) fn of(original: Gaussians) -> Self {
        let kept = (0..original.len() as u32).collect();
        Self { original, kept, removed: Vec::new() }
    }

    /// What is left.
    pub(crate) fn cloud(&self) -> Gaussians {
        self.original.gather(&self.kept)
    }

    /// How many edits there are to undo.
    pub(crate) fn count(&self) -> usize {
        self.removed.len()
    }

    /// How many Gaussians all of them have removed.
    pub(crate) fn gone(&self) -> usize {
        self.original.len() - self.kept.len()
    }

    /// Removes rows of what is left, ascending.
    pub(crate) fn remove(&mut self, rows: &[u32]) {
        self.redo(rows.iter().map(|&row| self.kept[row as usize]).collect());
    }

    /// Gives back what the last edit has removed: these rows of the original.
    pub(crate) fn undo(&mut self) -> Option<Vec<u32>> {
        let back = self.removed.pop()?;
        self.kept.extend(&back);
        self.kept.sort_unstable();
        Some(back)
    }

    /// Removes rows of the original that are left, ascending.
    pub(crate) fn redo(&mut self, rows: Vec<u32>) {
        let mut going = rows.iter().peekable();
        self.kept.retain(|row| going.next_if_eq(&row).is_none());
        self.removed.push(rows);
    }
}

#[cfg(test)]
mod tests;
