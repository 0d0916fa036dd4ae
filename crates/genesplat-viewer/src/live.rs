//! The page of one run: what its owner tells it, and the pictures that are due between two steps.

mod showing;

use std::time::Duration;

use genesplat_core::constants::NEAR_DEPTH;
use genesplat_core::memory::ensure_memory;
use genesplat_core::{BackendError, Camera, CloudRenderer, Device, Gaussians, Image, Photo, RenderSettings};
use serde::Serialize;

pub use showing::Keeper;

use crate::ViewerError;
use crate::budget::Budget;
use crate::clock::Clock;
use crate::curves::Curve;
use crate::gate::Address;
use crate::hub::{Hub, Picture, Topic};
use crate::message::{Look, PictureHeader, Pose, notice};
use crate::picture::{ERROR_MAX, error_picture};
use crate::render_mode::{RenderMode, derive, develop};
use crate::scene_views::SceneViews;
use crate::server::Server;

/// Pages are told of progress so often, seconds.
const STATE_EVERY: f64 = 0.25;
const CURVES_EVERY: f64 = 2.0;
/// The least time between two snapshots, seconds: each is a file of the size of the splat.
const SNAPSHOT_EVERY: f64 = 10.0;
/// A thread that waits for pages looks so often whether it shall end.
const WAIT: Duration = Duration::from_millis(100);
/// A page that asks for nothing new for so long does not move any more, seconds.
const QUIET: f64 = 0.3;
/// Between two of its pictures it is looked so often for the next.
const MOVE_WAIT: Duration = Duration::from_millis(10);

/// What a run is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Phase {
    /// Steps are made.
    Training,
    /// A page has asked it to wait.
    Paused,
    /// Photos are scored; pictures wait.
    Scoring,
    /// Its process ends.
    Ended,
    /// There is no run, or it has ended.
    Viewing,
    /// Another process trains; what it has saved last is shown.
    Following,
    /// The same, and nothing is saved yet.
    Waiting,
}

/// Who trains, and can be asked to save or to stop.
pub trait Owner {
    /// Saves the cloud; says in a sentence what has become of it.
    fn snapshot(&mut self, renderer: &mut CloudRenderer<'_>) -> String;
    /// Ends the run after this step.
    fn stop(&mut self);
    /// The run is about to end.
    fn is_stopped(&self) -> bool;
}

#[derive(Serialize)]
#[serde(tag = "type", rename = "state")]
struct State {
    phase: Phase,
    device: String,
    iteration: u32,
    iterations: u32,
    gaussians: usize,
    loss: Option<f32>,
    psnr: Option<f64>,
    /// Until training ends, as far as that can be reckoned.
    seconds_left: Option<f64>,
    /// The splat and a page to send can be had.
    can_download: bool,
    /// What is shown may be edited.
    can_edit: bool,
    /// How many edits can be undone, and what they have removed.
    edits: usize,
    removed: usize,
    /// Until the next snapshot may be saved, whole seconds.
    snapshot_wait: u32,
}

#[derive(Default, Serialize)]
#[serde(tag = "type", rename = "curves")]
struct Curves {
    loss: Curve,
    psnr: Curve,
    gaussians: Curve,
    stages: Vec<Stage>,
}

/// A stage of evolution that has ended.
#[derive(Serialize)]
struct Stage {
    iteration: u32,
    kind: String,
    /// What it proposed was better.
    kept: bool,
    /// Of the guards' PSNR, dB.
    gain: Option<f64>,
}

/// A page that is served while this lives. All methods are for the thread that trains, and return at once
/// where no page is open.
pub struct LiveView {
    server: Server,
    clock: Clock,
    budget: Budget,
    state: State,
    curves: Curves,
    /// When pages were last told of each.
    posted: [f64; 2],
    /// When the last snapshot was saved.
    saved: Option<f64>,
    /// Renders what the render modes make of a cloud.
    mode_device: Box<dyn Device>,
}

impl LiveView {
    /// Serves at `address`. Without `can_train` the page has no buttons that
    /// steer a run.
    pub fn start(
        address: impl Into<Address>,
        scene_views: SceneViews,
        can_train: bool,
        mode_device: Box<dyn Device>,
    ) -> Result<Self, ViewerError> {
        let phase = if can_train { Phase::Training } else { Phase::Viewing };
        let state = State {
            phase,
            device: String::new(),
            iteration: 0,
            iterations: 0,
            gaussians: 0,
            loss: None,
            psnr: None,
            seconds_left: None,
            can_download: false,
            can_edit: false,
            edits: 0,
            removed: 0,
            snapshot_wait: 0,
        };
        let server = Server::start(address.into(), scene_views, can_train)?;
        let (clock, budget, curves) = (Clock::start(), Budget::default(), Curves::default());
        let posted = [f64::NEG_INFINITY; 2];
        let mut view = Self { server, clock, budget, state, curves, posted, saved: None, mode_device };
        view.post(true);
        Ok(view)
    }

    /// Where a browser finds the page.
    pub fn url(&self) -> String {
        self.server.url()
    }

    /// A run of so many iterations begins.
    pub fn begin(&mut self, device: &str, gaussians: usize, iterations: u32) {
        (self.state.device, self.state.gaussians, self.state.iterations) =
            (device.to_owned(), gaussians, iterations);
        self.post(true);
    }

    /// A gradient step was made; the loss is known now and then.
    pub fn step(&mut self, iteration: u32, gaussians: usize, loss: Option<f32>) {
        (self.state.iteration, self.state.gaussians) = (iteration, gaussians);
        if let Some(loss) = loss {
            self.state.loss = Some(loss);
            self.curves.loss.push([iteration.into(), loss.into()]);
            self.curves.gaussians.push([iteration.into(), gaussians as f64]);
        }
        if self.hub().has_pages() {
            self.hub().cloud_has_changed();
        }
    }

    /// How long training will take from here, as far as that can be reckoned.
    pub fn set_seconds_left(&mut self, seconds: Option<f64>) {
        self.state.seconds_left = seconds;
    }

    /// What an earlier process, or another one, has logged so far: points of `[iteration, value]`.
    pub fn replay(&mut self, loss: &[[f64; 2]], psnr: &[[f64; 2]], gaussians: &[[f64; 2]]) {
        self.curves = Curves::default();
        let Curves { loss: a, psnr: b, gaussians: c, .. } = &mut self.curves;
        for (curve, points) in [(a, loss), (b, psnr), (c, gaussians)] {
            points.iter().for_each(|&point| curve.push(point));
        }
        self.state.loss = loss.last().map(|point| point[1] as f32);
        self.state.psnr = psnr.last().map(|point| point[1]);
        self.state.iteration = gaussians.last().map_or(0, |point| point[0] as u32);
    }

    /// The test photos were measured.
    pub fn test_score(&mut self, iteration: u32, psnr: f64) {
        self.state.psnr = Some(psnr);
        self.curves.psnr.push([iteration.into(), psnr]);
    }

    /// A stage of evolution has ended; `gain` is what guards gained, dB.
    pub fn stage(&mut self, iteration: u32, kind: &str, kept: bool, gain: Option<f64>) {
        self.curves.stages.push(Stage { iteration, kind: kind.to_owned(), kept, gain });
    }

    /// A sentence that pages show.
    pub fn notice(&self, text: &str) {
        self.hub().post(Topic::Notice, &notice(text));
    }

    /// The run does something else now.
    pub fn set_phase(&mut self, phase: Phase) {
        self.state.phase = phase;
        self.post(true);
    }

    /// Whether a page waits for something that may be done now. Where none is open it costs next to nothing.
    pub fn is_due(&mut self) -> bool {
        let (now, is_open) = (self.clock.seconds(), self.hub().has_pages());
        self.budget.tick(now, is_open);
        if !is_open {
            return self.hub().requests() != Default::default();
        }
        let encoding = self.hub().take_encoding_seconds();
        if encoding > 0.0 {
            self.budget.spend_on_encoding(encoding);
        }
        self.post(false);
        let is_asked = self.hub().requests() != Default::default();
        is_asked || self.is_picture_due(now)
    }

    fn is_picture_due(&self, now: f64) -> bool {
        (self.budget.allows_new() && self.hub().is_awaited(false))
            || (self.budget.allows_refresh(now) && self.hub().is_awaited(true))
    }

    /// Does what is due: pictures; what a page has asked of `owner`; and waits while pages want the run to
    /// wait.
    pub fn attend(&mut self, renderer: &mut CloudRenderer<'_>, owner: &mut dyn Owner) {
        self.follow_movements(renderer, owner);
        let began = self.clock.seconds();
        if self.budget.allows_refresh(began) && self.serve(renderer, true) {
            let now = self.clock.seconds();
            self.budget.spend(now, now - began);
        }
        self.grant(renderer, owner);
        if self.hub().requests().paused && !owner.is_stopped() {
            self.rest(renderer, owner);
        }
    }

    /// While somebody moves, pictures come one after the other, and training waits, as long as it may.
    fn follow_movements(&mut self, renderer: &mut CloudRenderer<'_>, owner: &mut dyn Owner) {
        let (mut before, mut moved) = (self.clock.seconds(), None);
        while self.budget.allows_new() && !owner.is_stopped() {
            let is_new = self.serve(renderer, false);
            let now = self.clock.seconds();
            if is_new {
                moved = Some(now);
            }
            let Some(moved) = moved else { return };
            self.budget.spend_on_movement(now, now - before);
            before = now;
            if now - moved > QUIET {
                return;
            }
            if !is_new {
                self.hub().wait(MOVE_WAIT);
            }
        }
    }

    /// Nothing is trained: pictures have all the time, until pages want the run to go on, or all of them are
    /// gone.
    fn rest(&mut self, renderer: &mut CloudRenderer<'_>, owner: &mut dyn Owner) {
        self.set_phase(Phase::Paused);
        while self.hub().requests().paused && !owner.is_stopped() && !self.hub().is_deserted() {
            if !self.serve(renderer, true) {
                self.hub().wait(WAIT);
            }
            self.grant(renderer, owner);
            self.post(false);
        }
        self.hub().change_requests(|requests| requests.paused = false);
        self.set_phase(Phase::Training);
    }

    fn grant(&mut self, renderer: &mut CloudRenderer<'_>, owner: &mut dyn Owner) {
        let requests = self.hub().take_requests();
        if requests.snapshot {
            let sentence = self.snapshot(renderer, owner);
            self.notice(&sentence);
        }
        if requests.stop {
            owner.stop();
        }
    }

    /// A page could ask for one after each step, and fill the disk.
    fn snapshot(&mut self, renderer: &mut CloudRenderer<'_>, owner: &mut dyn Owner) -> String {
        let wait = snapshot_wait(self.saved, self.clock.seconds());
        if wait > 0 {
            return format!(
                "no snapshot yet: one is saved in {SNAPSHOT_EVERY} seconds at most; try again in {wait}"
            );
        }
        let sentence = owner.snapshot(renderer);
        self.saved = Some(self.clock.seconds());
        self.post(true);
        sentence
    }

    /// Makes the picture that a page has waited for longest; false where none waits.
    fn serve(&mut self, renderer: &mut CloudRenderer<'_>, or_changed: bool) -> bool {
        let Some((id, look)) = self.hub().next_look(or_changed) else { return false };
        match self.take(&look, renderer) {
            Ok(pictures) => self.hub().deliver(id, pictures),
            Err(error) => self.notice(&format!("no picture: {error}")),
        }
        true
    }

    fn take(&mut self, look: &Look, renderer: &mut CloudRenderer<'_>) -> Result<Vec<Picture>, BackendError> {
        let began = self.clock.seconds();
        let Look { sequence, width, height, quality, .. } = *look;
        let camera = self.camera(&look.pose, look.camera, [width, height]);
        let (photo, range) = self.photograph(look.render_mode, &camera, renderer)?;
        let milliseconds = (1e3 * (self.clock.seconds() - began)) as f32;
        let header = PictureHeader { sequence, error: false, range, milliseconds };
        let scene_views = &self.server.shared.scene_views;
        let compared = look.camera.filter(|_| look.error).and_then(|index| scene_views.view(index));
        let error = |view| -> Result<Picture, BackendError> {
            let header = PictureHeader { error: true, range: Some([0.0, ERROR_MAX]), ..header };
            Ok(Picture { header, photo: error_picture(&photo, view)?, quality })
        };
        let error = compared.map(error).transpose()?;
        Ok([Picture { header, photo, quality }].into_iter().chain(error).collect())
    }

    /// The scene's camera of this index, else one at `pose`.
    fn camera(&self, pose: &Pose, index: Option<u32>, [width, height]: [u32; 2]) -> Camera {
        let scene_views = &self.server.shared.scene_views;
        let near = scene_views.camera(0).map_or(NEAR_DEPTH, |camera| camera.near);
        let known = index.and_then(|index| scene_views.camera(index));
        let free = || Camera { near, ..pose.camera(width, height) };
        known.map_or_else(free, |camera| camera.resized(width, height))
    }

    fn photograph(
        &mut self,
        mode: RenderMode,
        camera: &Camera,
        renderer: &mut CloudRenderer<'_>,
    ) -> Result<(Photo, Option<[f32; 2]>), BackendError> {
        if mode == RenderMode::Colour {
            return Ok((renderer.render(camera)?.to_photo(), None));
        }
        let settings = *renderer.settings();
        let cloud = renderer.cloud()?;
        ensure_memory(cloud.len() * Gaussians::BYTES_PER_ROW, "a render mode")?;
        let (derived, settings) = derive(mode, &cloud, camera, &settings);
        drop(cloud);
        Ok(develop(mode, &self.render_once(derived, camera, &settings)?))
    }

    /// What a render mode makes of a cloud, of which nothing stays: a run has other uses for the memory.
    fn render_once(
        &mut self,
        derived: Gaussians,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<Image, BackendError> {
        let device = &mut *self.mode_device;
        let ready = device.upload(derived.into()).and_then(|()| device.end_training());
        let render = ready.and_then(|()| device.render(camera, settings));
        // This frees the memory of views, which the next verb may need to be granted.
        device.end_training()?;
        device.upload(Gaussians::default().into())?;
        render
    }

    /// Tells pages of progress, where it is time.
    fn post(&mut self, at_once: bool) {
        let now = self.clock.seconds();
        if at_once || now - self.posted[0] >= STATE_EVERY {
            self.posted[0] = now;
            self.state.snapshot_wait = snapshot_wait(self.saved, now);
            self.hub()
                .post(Topic::State, &serde_json::to_string(&self.state).expect("numbers and texts are JSON"));
        }
        if at_once || now - self.posted[1] >= CURVES_EVERY {
            self.posted[1] = now;
            self.hub().post(Topic::Curves, &serde_json::to_string(&self.curves).expect("numbers are JSON"));
        }
    }

    fn hub(&self) -> &Hub {
        &self.server.shared.hub
    }
}

/// Whole seconds until one may be saved again after the last.
fn snapshot_wait(last: Option<f64>, now: f64) -> u32 {
    last.map_or(0, |last| (last + SNAPSHOT_EVERY - now).max(0.0).ceil() as u32)
}

impl Drop for LiveView {
    /// Pages are told that there is nothing more to see.
    fn drop(&mut self) {
        self.set_phase(Phase::Ended);
    }
}
