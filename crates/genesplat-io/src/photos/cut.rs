//! Photos that show more than one pinhole can, cut into pinhole views: the six faces of a cube around the
//! camera, or what of them the photo shows. What a view shows beyond the photo's rim counts for nothing.
//!
//! A face spans 90 degrees, and its middle is as fine as the photo is there. All faces are reduced alike.

use std::f64::consts::{PI, TAU};

use genesplat_core::{Camera, Photo};
use glam::{DMat3, DQuat, DVec3};

use super::lens::{Lens, Projection};
use super::mask::PhotoMask;
use super::resize::{resize, resize_round, wrapped};
use super::undistort::{bicubic, floor, taps};

/// A photo is cut where it shows what lies so far from its axis, degrees, to either side, up or down: there
/// COLMAP's undistorter, too, leaves some of it out.
const WIDE_DEGREES: f64 = 75.0;
/// A view is as many of these parts of a face's side as the photo shows of it.
const PARTS_A_SIDE: u32 = 16;
/// So many columns of a photo that is round are repeated beyond either end: as many as a cubic takes.
const WRAP_PX: u32 = 3;

/// What a face is called, where it looks, and what is down in it, in the camera's frame.
const FACES: [(&str, DVec3, DVec3); 6] = [
    ("front", DVec3::Z, DVec3::Y),
    ("right", DVec3::X, DVec3::Y),
    ("back", DVec3::NEG_Z, DVec3::Y),
    ("left", DVec3::NEG_X, DVec3::Y),
    ("up", DVec3::NEG_Y, DVec3::Z),
    ("down", DVec3::Y, DVec3::NEG_Z),
];

/// What views may be called.
pub(crate) fn part_names() -> impl Iterator<Item = &'static str> {
    FACES.iter().map(|(name, ..)| *name)
}

/// A view that is cut out of a photo: a rectangle of a face.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Part {
    pub(crate) name: &'static str,
    /// Turns directions of the camera's frame into those of the view's.
    part_from_camera: DMat3,
    /// From and to, across and down, in [`PARTS_A_SIDE`]ths of the face's side.
    bounds: [[u32; 2]; 2],
}

impl Part {
    /// In a face of this side, its first column and row, and its width and height, px.
    fn place(&self, side: u32) -> [[u32; 2]; 2] {
        let at = |sixteenths: u32| (u64::from(sixteenths) * u64::from(side) / u64::from(PARTS_A_SIDE)) as u32;
        let [across, down] = self.bounds.map(|bounds| bounds.map(at));
        [[across[0], down[0]], [across[1] - across[0], down[1] - down[0]]]
    }

    /// The direction, in the camera's frame, of a point of the face: its middle is 0, its rim at 1.
    fn direction(&self, [x, y]: [f64; 2]) -> DVec3 {
        self.part_from_camera.transpose() * DVec3::new(x, y, 1.0)
    }

    /// The directions of its pixels, where whole faces have this side, `finer` times as fine.
    fn directions(&self, side: u32, finer: u32) -> impl Iterator<Item = DVec3> {
        let [[left, top], [width, height]] = self.place(side).map(|place| place.map(|px| finer * px));
        let on_face = move |at: u32| (2.0 * f64::from(at) + 1.0) / f64::from(finer * side) - 1.0;
        let pixels = (top..top + height).flat_map(move |row| (left..left + width).map(move |x| [x, row]));
        pixels.map(move |pixel| self.direction(pixel.map(on_face)))
    }
}

/// What cuts the photos of a camera.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cut {
    camera: Camera,
    lens: Lens,
    /// Up to here from its axis, radians, the lens shows everything once.
    angle_max: f64,
}

impl Cut {
    /// `None` where one pinhole shows what the photos of this camera show.
    pub(crate) fn of(camera: &Camera, lens: &Lens) -> Option<Self> {
        if lens.projection == Projection::Perspective {
            return None;
        }
        let cut = Self { camera: *camera, lens: *lens, angle_max: angle_max(lens) };
        let (aside, ahead) = WIDE_DEGREES.to_radians().sin_cos();
        let sides = [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y];
        sides.iter().any(|side| cut.pixel(*side * aside + DVec3::Z * ahead).is_some()).then_some(cut)
    }

    /// The side of a whole face, px.
    pub(crate) fn side(&self) -> u32 {
        let [fx, fy] = self.camera.focal_px;
        ((2.0 * (fx * fy).sqrt()).round() as u32).max(1)
    }

    /// What is cut out where whole faces have this `side`, but for what is narrower than `least` px; and the
    /// cameras that take it.
    pub(crate) fn views(&self, side: u32, least: u32) -> Vec<(Part, Camera)> {
        let views =
            FACES.iter().filter_map(|face| self.part(face)).map(|part| (part, self.view(&part, side)));
        views.filter(|(_, view)| view.width.min(view.height) >= least).collect()
    }

    /// What of a face the photo shows, if anything: all between corners of a grid, and a part beyond.
    fn part(&self, &(name, ahead, down): &(&'static str, DVec3, DVec3)) -> Option<Part> {
        let part_from_camera = DMat3::from_cols(down.cross(ahead), down, ahead).transpose();
        let whole = Part { name, part_from_camera, bounds: [[0, PARTS_A_SIDE]; 2] };
        let on_face = |at: u32| 2.0 * f64::from(at) / f64::from(PARTS_A_SIDE) - 1.0;
        let corners = (0..=PARTS_A_SIDE).flat_map(|row| (0..=PARTS_A_SIDE).map(move |column| [column, row]));
        let is_shown = |corner: &[u32; 2]| self.pixel(whole.direction(corner.map(on_face))).is_some();
        let shown: Vec<[u32; 2]> = corners.filter(is_shown).collect();
        let bounds = |axis: usize| {
            let along = || shown.iter().map(|corner| corner[axis]);
            Some([along().min()?.saturating_sub(1), (along().max()? + 1).min(PARTS_A_SIDE)])
        };
        Some(Part { bounds: [bounds(0)?, bounds(1)?], ..whole })
    }

    fn view(&self, part: &Part, side: u32) -> Camera {
        let ([first, [width, height]], middle) = (part.place(side), 0.5 * f64::from(side));
        let Camera { camera_from_world_rotation, camera_from_world_translation, near, .. } = self.camera;
        let turn = DQuat::from_mat3(&part.part_from_camera);
        Camera {
            principal_px: first.map(|first| middle - f64::from(first)),
            camera_from_world_rotation: (turn * camera_from_world_rotation).normalize(),
            camera_from_world_translation: part.part_from_camera * camera_from_world_translation,
            near,
            ..Camera::at_origin(width, height, middle)
        }
    }

    /// Where photos show what lies in this direction of the camera's frame, px from their corner; `None`
    /// where they do not.
    fn pixel(&self, direction: DVec3) -> Option<[f64; 2]> {
        let Camera { width, height, focal_px, principal_px, .. } = self.camera;
        let shown = self.lens.show(direction.into());
        let [u, v] = [0, 1].map(|axis| focal_px[axis] * shown[axis] + principal_px[axis]);
        let is_inside = (0.0..=f64::from(width)).contains(&u) && (0.0..=f64::from(height)).contains(&v);
        let is_once = || direction.angle_between(DVec3::Z) <= self.angle_max;
        (self.lens.is_round() || (is_inside && is_once())).then_some([u, v])
    }

    /// How many times as fine as they shall be faces are resampled, so that it does not blur them; those that
    /// are as fine as the photo are not.
    fn finer(&self, side: u32) -> u32 {
        if side < self.side() { 2 } else { 1 }
    }

    /// The cut of photos that are as fine as faces of this side.
    fn reduced(&self, side: u32) -> Self {
        let scale = (f64::from(side) / f64::from(self.side())).min(1.0);
        let reduced = |whole: u32| (f64::from(whole) * scale).round().max(f64::from(WRAP_PX)) as u32;
        let Camera { width, height, .. } = self.camera;
        Self { camera: self.camera.resized(reduced(width), reduced(height)), ..*self }
    }

    /// The `parts` of `photo` where whole faces have this side, each made when it is asked for.
    pub(crate) fn photos(&self, photo: &Photo, parts: &[Part], side: u32) -> impl Iterator<Item = Photo> {
        let finer = self.finer(side);
        let reduced = self.reduced(finer * side);
        let Camera { width, height, .. } = reduced.camera;
        let (photo, pad) = match self.lens.is_round() {
            true => (photo_wrapped(&resize_round(photo, width, height)), f64::from(WRAP_PX)),
            false => (resize(photo, width, height), 0.0),
        };
        parts.iter().map(move |part| {
            let pixel = |direction| {
                reduced.pixel(direction).map_or([0; 3], |[u, v]| bicubic(&photo, [u - 0.5 + pad, v - 0.5]))
            };
            let rgb = part.directions(side, finer).flat_map(pixel).collect();
            let [_, [width, height]] = part.place(side);
            resize(&Photo { width: finer * width, height: finer * height, rgb }, width, height)
        })
    }

    /// What counts of these views: what the photo shows, and `mask` does not hide.
    pub(crate) fn masks(
        &self,
        mask: Option<&PhotoMask>,
        parts: &[Part],
        side: u32,
    ) -> impl Iterator<Item = PhotoMask> {
        let finer = self.finer(side);
        let reduced = self.reduced(finer * side);
        let Camera { width, height, .. } = reduced.camera;
        let pad = if self.lens.is_round() { WRAP_PX } else { 0 };
        let mask = mask.map(|mask| match self.lens.is_round() {
            true => mask.resized_round([width, height], WRAP_PX),
            false => mask.resized([width, height]),
        });
        let counts = move |[u, v]: [f64; 2]| {
            let Some(mask) = &mask else { return true };
            let columns = taps(floor(u - 0.5) + i64::from(pad), width + 2 * pad);
            let rows = taps(floor(v - 0.5), height);
            rows.iter().all(|&row| columns.iter().all(|&column| mask.counts_at(column, row)))
        };
        parts.iter().map(move |part| {
            let [_, [width, height]] = part.place(side);
            let pixels = part.directions(side, finer).map(|direction| reduced.pixel(direction));
            let counts = pixels.map(|pixel| pixel.is_some_and(&counts)).collect();
            PhotoMask { size: [finer * width, finer * height], counts }.resized([width, height])
        })
    }
}

/// The photo, with its ends repeated.
fn photo_wrapped(photo: &Photo) -> Photo {
    let rgb = wrapped(&photo.rgb, 3 * photo.width as usize, 3 * WRAP_PX as usize);
    Photo { width: photo.width + 2 * WRAP_PX, rgb, ..*photo }
}

/// Up to which angle from the axis, radians, a lens shows what is farther away farther from its middle.
fn angle_max(lens: &Lens) -> f64 {
    const STEPS: u32 = 180;
    const AZIMUTHS: u32 = 8;
    let radius = |azimuth: f64, step: u32| {
        let ((y, x), (aside, ahead)) = (azimuth.sin_cos(), angle(step).sin_cos());
        let [x, y] = lens.show([aside * x, aside * y, ahead]);
        x.hypot(y)
    };
    fn angle(step: u32) -> f64 {
        PI * f64::from(step) / f64::from(STEPS)
    }
    let last = |azimuth: u32| {
        let azimuth = TAU * f64::from(azimuth) / f64::from(AZIMUTHS);
        (1..STEPS).take_while(|&step| radius(azimuth, step) > radius(azimuth, step - 1)).last().unwrap_or(0)
    };
    angle((0..AZIMUTHS).map(last).min().unwrap_or(0))
}
