//! The motion of one photo's camera by which a cloud looks most like the photo: a step of Gauss and Newton, of
//! which the derivatives are differences of renders.
//!
//! A photo is dealt out in squares, as a chessboard: what one half asks for is judged by the other, so that
//! noise moves no camera.

use genesplat_core::{BackendError, Camera, Image, Photo, RenderSettings, Renderer, View};

use super::motion::Motion;
use super::solve::Equations;

/// Side of a square, px.
const SQUARE: usize = 16;
/// Differences above this count by their amount: what moved, and what the cloud has not learnt yet.
const HUBER: f64 = 0.06;
/// Of the diagonal: turning and shifting look alike in a flat scene.
const DAMPING: f64 = 1e-3;
/// Renders that derivatives are told by differ by about so many pixels.
const STEP_PX: f64 = 0.5;
/// Steps of so many pixels at most.
const MOST_PX: f64 = 6.0;
/// Of a step that makes the judges' half worse, this part is tried.
const SHORTER: f64 = 0.4;

/// What moves a picture by about a pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pixel {
    /// Rad.
    pub(super) turn: f64,
    /// World units.
    pub(super) shift: f64,
}

impl Pixel {
    /// Of photos by `camera` of what is `depth` away.
    pub(super) fn of(camera: &Camera, depth: f64) -> Self {
        let turn = 1.0 / (camera.focal_px[0] * camera.focal_px[1]).sqrt();
        Self { turn, shift: depth * turn }
    }

    fn motion(self, pixels: [f64; 6]) -> Motion {
        let scale = [self.turn, self.turn, self.turn, self.shift, self.shift, self.shift];
        Motion::of(std::array::from_fn(|axis| pixels[axis] * scale[axis]))
    }
}

/// What was found for a photo.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Aligned {
    pub(super) step: Motion,
    /// Loss of the half that judges, before and after.
    pub(super) judged: [f64; 2],
}

/// Moves the one camera that took all of `views`.
pub(super) fn align(
    renderer: &mut dyn Renderer,
    views: &[View],
    settings: &RenderSettings,
    pixel: Pixel,
) -> Result<Aligned, BackendError> {
    let (mut equations, mut before) = (Equations::<6>::default(), [0.0; 2]);
    for view in views {
        let (photo, base) = (view.photo.read()?, renderer.render(&view.camera, settings)?);
        let mut moved = Vec::with_capacity(6);
        for axis in 0..6 {
            let step = std::array::from_fn(|at| if at == axis { STEP_PX } else { 0.0 });
            moved.push(renderer.render(&pixel.motion(step).of_camera(&view.camera), settings)?);
        }
        let picture = Picture { view, photo: &photo };
        picture.add_equations(&base, &moved, &mut equations);
        let losses = picture.losses(&base);
        before = [before[0] + losses[0], before[1] + losses[1]];
    }
    let Some(mut step) = equations.solved(DAMPING).map(clamped) else {
        return Ok(Aligned { judged: [before[1]; 2], ..Aligned::default() });
    };
    for _ in 0..2 {
        let motion = pixel.motion(step);
        let after = losses_of(renderer, views, settings, &motion)?;
        if after[0] < before[0] && after[1] < before[1] {
            return Ok(Aligned { step: motion, judged: [before[1], after[1]] });
        }
        step = step.map(|pixels| SHORTER * pixels);
    }
    Ok(Aligned { judged: [before[1]; 2], ..Aligned::default() })
}

fn clamped(step: [f64; 6]) -> [f64; 6] {
    let most = step.iter().fold(0.0f64, |most, pixels| most.max(pixels.abs()));
    step.map(|pixels| pixels * (MOST_PX / most).min(1.0))
}

fn losses_of(
    renderer: &mut dyn Renderer,
    views: &[View],
    settings: &RenderSettings,
    motion: &Motion,
) -> Result<[f64; 2], BackendError> {
    let mut sum = [0.0; 2];
    for view in views {
        let photo = view.photo.read()?;
        let render = renderer.render(&motion.of_camera(&view.camera), settings)?;
        let losses = Picture { view, photo: &photo }.losses(&render);
        sum = [sum[0] + losses[0], sum[1] + losses[1]];
    }
    Ok(sum)
}

/// A photo, and what of it counts.
struct Picture<'a> {
    view: &'a View,
    photo: &'a Photo,
}

impl Picture<'_> {
    /// The pixels that count, with their square's half.
    fn pixels(&self) -> impl Iterator<Item = (usize, usize)> {
        let width = self.photo.width as usize;
        let counts = |at: &usize| self.view.mask.as_ref().is_none_or(|mask| mask.counts[*at]);
        let half = move |at: usize| (at, (at % width / SQUARE + at / width / SQUARE) % 2);
        (0..width * self.photo.height as usize).filter(counts).map(half)
    }

    /// How much a render differs: of the half that asks, and of the half that judges.
    fn losses(&self, render: &Image) -> [f64; 2] {
        let plane = self.view.photo.pixels();
        let mut sums = [0.0; 2];
        for (at, half) in self.pixels() {
            for channel in 0..3 {
                sums[half] += huber(self.difference(render, plane, at, channel));
            }
        }
        sums
    }

    fn difference(&self, render: &Image, plane: usize, at: usize, channel: usize) -> f64 {
        f64::from(render.planes[channel * plane + at]) - f64::from(self.photo.rgb[3 * at + channel]) / 255.0
    }

    /// Those of the half that asks, in pixels of motion.
    fn add_equations(&self, base: &Image, moved: &[Image], equations: &mut Equations<6>) {
        let plane = self.view.photo.pixels();
        for (at, _) in self.pixels().filter(|(_, half)| *half == 0) {
            for channel in 0..3 {
                let difference = self.difference(base, plane, at, channel);
                let weight = (HUBER / difference.abs()).min(1.0);
                let value = f64::from(base.planes[channel * plane + at]);
                let slope = std::array::from_fn(|axis| {
                    (f64::from(moved[axis].planes[channel * plane + at]) - value) / STEP_PX
                });
                equations.add(slope, difference, weight);
            }
        }
    }
}

fn huber(difference: f64) -> f64 {
    let amount = difference.abs();
    if amount < HUBER { 0.5 * amount * amount } else { HUBER * (amount - 0.5 * HUBER) }
}
