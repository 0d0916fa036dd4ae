//! A training that Python goes along with, step by step.
//!
//! It runs on a thread of its own, which waits after each step that Python wants until Python asks for the
//! next: the loop is that of the command, and so are the bytes. The thread is there while somebody iterates,
//! and at no other time. It never touches the interpreter.

use std::cell::RefCell;
use std::mem;
use std::panic;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, TryLockError};
use std::thread::{self, JoinHandle};

use genesplat::core::{CloudRenderer, Gaussians, RenderSettings};
use genesplat::run::reporter::Companion;
use genesplat::run::settings::ConfigFile;
use genesplat::train::observe::StepLog;
use pyo3::prelude::*;

use crate::cloud::Cloud;
use crate::error::{told, wrong};
use crate::listener;
use crate::plan::{Ended, Plan};
use crate::scene::{LoadedScene, settings_of};
use crate::waiting::receive;

/// What Python wants of a training that waits.
enum Ask {
    GoOn,
    Cloud(Sender<Result<(Gaussians, RenderSettings), String>>),
}

/// Goes along on the training's thread.
struct Along {
    every: u32,
    iterations: u32,
    step: RefCell<Option<StepLog>>,
    steps: Sender<StepLog>,
    asks: Receiver<Ask>,
    stop: Arc<AtomicBool>,
}

impl Companion for Along {
    fn wants(&self, iteration: u32) -> bool {
        iteration.is_multiple_of(self.every) || iteration == self.iterations
    }

    fn on_step(&self, step: &StepLog) {
        *self.step.borrow_mut() = Some(step.clone());
    }

    fn on_renders(&self, renderer: &mut CloudRenderer<'_>) {
        let step = self.step.take();
        let mut goes_on = step.is_some_and(|step| self.steps.send(step).is_ok());
        while goes_on {
            match self.asks.recv() {
                Ok(Ask::GoOn) => return,
                Ok(Ask::Cloud(reply)) => {
                    let settings = *renderer.settings();
                    let cloud = renderer.cloud().map(|cloud| (cloud.into_owned(), settings));
                    // Who asked may have been interrupted meanwhile.
                    let _ = reply.send(cloud.map_err(|error| error.to_string()));
                }
                Err(_) => goes_on = false,
            }
        }
        // Nobody goes along any more.
        self.stop.store(true, Ordering::Relaxed);
    }
}

/// The training's thread.
struct Worker {
    thread: JoinHandle<anyhow::Result<Ended>>,
    steps: Option<Receiver<StepLog>>,
    asks: Sender<Ask>,
    stop: Arc<AtomicBool>,
    /// It waits to be asked.
    is_paused: bool,
}

impl Worker {
    fn start(plan: &Arc<Plan>, every: u32, before: Option<Ended>) -> PyResult<Self> {
        let (stop, (steps, told_steps), (asks, heard_asks)) =
            (Arc::new(AtomicBool::new(false)), channel(), channel());
        let (plan, stops) = (Arc::clone(plan), Arc::clone(&stop));
        let work = move || {
            let iterations = plan.iterations()?;
            let along =
                Along { every, iterations, step: None.into(), steps, asks: heard_asks, stop: stops.clone() };
            plan.run(before, &along, &stops)
        };
        let thread = thread::Builder::new().name("genesplat-run".into()).spawn(work)?;
        Ok(Self { thread, steps: Some(told_steps), asks, stop, is_paused: false })
    }

    /// Waits for its end, without the interpreter's lock.
    fn join(self, py: Python<'_>) -> PyResult<Ended> {
        let Self { thread, asks, .. } = self;
        drop(asks);
        let joined = py.detach(|| thread.join());
        listener::pass_on(py)?;
        joined.unwrap_or_else(|panicked| panic::resume_unwind(panicked)).map_err(told)
    }
}

enum State {
    /// Nothing is under way; how the last part has ended, if there was one.
    Idle(Option<Ended>),
    UnderWay(Worker),
}

#[pyclass(frozen, module = "genesplat._native")]
pub(crate) struct Training {
    plan: Arc<Plan>,
    every: u32,
    state: Mutex<State>,
}

/// Iteration, the last iteration, Gaussians, degree of the spherical harmonics, loss.
type Step = (u32, u32, usize, u8, f32);

#[pymethods]
impl Training {
    /// One that begins with the points of the scene, or with `splats`; into a folder, if there is one. Of
    /// `minutes`, if given, instead of the iterations that the settings have.
    #[new]
    fn new(
        scene: &LoadedScene,
        settings: &str,
        minutes: Option<f64>,
        out: Option<PathBuf>,
        splats: Option<&Cloud>,
        every: u32,
    ) -> PyResult<Self> {
        let cloud = splats.map(|splats| Arc::clone(&splats.cloud));
        Self::of(Plan::new(scene, settings_of(settings)?, minutes, (out, false), cloud)?, every)
    }

    /// One that goes on with the run in `out`.
    #[staticmethod]
    fn resume(scene: &LoadedScene, out: PathBuf, every: u32) -> PyResult<Self> {
        let settings = ConfigFile::of_run(&out).map_err(told)?;
        Self::of(Plan::new(scene, settings, None, (Some(out), true), None)?, every)
    }

    /// Starts the thread, unless training is over.
    fn begin(&self) -> PyResult<()> {
        let mut state = self.state()?;
        listener::hear();
        let State::Idle(before) = &mut *state else {
            return Err(wrong("this training is under way already; end its other loop first"));
        };
        if before.as_ref().is_some_and(|before| before.is_whole) {
            return Ok(());
        }
        *state = State::UnderWay(Worker::start(&self.plan, self.every, before.take())?);
        Ok(())
    }

    /// The next step that is wanted; `None` where training is over.
    fn next(&self, py: Python<'_>) -> PyResult<Option<Step>> {
        let mut state = self.state()?;
        let State::UnderWay(worker) = &mut *state else { return Ok(None) };
        if mem::take(&mut worker.is_paused) {
            // Where it has ended, it is found below.
            let _ = worker.asks.send(Ask::GoOn);
        }
        let steps = worker.steps.take().expect("it was put back");
        match receive(py, steps, &worker.stop) {
            Ok(Some((step, steps))) => {
                (worker.steps, worker.is_paused) = (Some(steps), true);
                listener::pass_on(py)?;
                let loss = step.report.map_or(f32::NAN, |report| report.loss);
                Ok(Some((step.iteration, step.iterations, step.gaussians, step.sh_degree, loss)))
            }
            Ok(None) => end(&mut state, py).map(|()| None),
            Err(interrupt) => {
                // The interrupt is what is told; what else went wrong stands in the log.
                let _ = end(&mut state, py);
                Err(interrupt)
            }
        }
    }

    /// Ends the thread, which saves what it has.
    fn stop(&self, py: Python<'_>) -> PyResult<()> {
        let mut state = self.state()?;
        if let State::UnderWay(worker) = &*state {
            worker.stop.store(true, Ordering::Relaxed);
        }
        end(&mut state, py)
    }

    /// The splat as it is now.
    fn cloud(&self, py: Python<'_>) -> PyResult<Cloud> {
        let state = self.state()?;
        let offset = self.plan.scene.digests.offset;
        match &*state {
            State::UnderWay(worker) if worker.is_paused => {
                let (reply, answer) = channel();
                let _ = worker.asks.send(Ask::Cloud(reply));
                let (cloud, settings) = py.detach(move || answer.recv()).map_err(told)?.map_err(told)?;
                Ok(Cloud { cloud: cloud.into(), settings, offset })
            }
            State::Idle(Some(Ended { cloud: Some((cloud, settings)), .. })) => {
                Ok(Cloud { cloud: Arc::clone(cloud), settings: *settings, offset })
            }
            _ => Err(told("nothing is trained yet; iterate over the trainer first")),
        }
    }

    /// Iterations that are done; 0 before the first.
    fn iteration(&self) -> PyResult<u32> {
        match &*self.state()? {
            State::Idle(Some(ended)) => Ok(ended.iteration),
            _ => Ok(0),
        }
    }

    /// `metrics.json` of a run with a folder.
    fn metrics(&self) -> PyResult<Option<String>> {
        match &*self.state()? {
            State::Idle(Some(ended)) => Ok(ended.metrics.clone()),
            _ => Ok(None),
        }
    }
}

impl Training {
    fn of(plan: Plan, every: u32) -> PyResult<Self> {
        Ok(Self { plan: plan.into(), every, state: State::Idle(None).into() })
    }

    fn state(&self) -> PyResult<MutexGuard<'_, State>> {
        self.state.try_lock().map_err(|error| match error {
            TryLockError::WouldBlock => {
                wrong("another thread waits for this training; use it from one thread")
            }
            TryLockError::Poisoned(_) => told("training has failed"),
        })
    }
}

impl Drop for Training {
    fn drop(&mut self) {
        let state = mem::replace(
            self.state.get_mut().unwrap_or_else(|poisoned| poisoned.into_inner()),
            State::Idle(None),
        );
        if let State::UnderWay(Worker { thread, asks, stop, .. }) = state {
            stop.store(true, Ordering::Relaxed);
            drop(asks);
            // Nobody is left who could be told.
            let _ = thread.join();
        }
    }
}

/// Waits for the end of the thread, if there is one.
fn end(state: &mut State, py: Python<'_>) -> PyResult<()> {
    match mem::replace(state, State::Idle(None)) {
        State::UnderWay(worker) => *state = State::Idle(Some(worker.join(py)?)),
        idle @ State::Idle(_) => *state = idle,
    }
    Ok(())
}
