//! What the library says, for Python's `logging`.
//!
//! Workers never touch the interpreter: what they say is kept, and the thread that waits for them passes it
//! on, notices as warnings.

use std::sync::Mutex;

use anyhow::Result;
use genesplat::run::output::{Progress, Tell, Work, listen};
use genesplat::terminal::output::Terminal;
use pyo3::prelude::*;
use pyo3::types::PyAnyMethods;

/// Levels of Python's `logging`.
const DEBUG: u8 = 10;
const INFO: u8 = 20;
const WARNING: u8 = 30;

static SAID: Mutex<Vec<(u8, String)>> = Mutex::new(Vec::new());

struct Listener;

struct NoBar;

impl Progress for NoBar {
    fn set(&mut self, _position: u64, _note: &dyn Fn() -> String) {}
    fn wait(&mut self, _position: u64, _note: &dyn Fn() -> String) {}
}

impl Tell for Listener {
    fn print(&self, text: &str) -> Result<()> {
        say(INFO, text);
        Ok(())
    }

    fn tell(&self, text: &str) {
        match text.strip_prefix("notice: ") {
            Some(notice) => say(WARNING, notice),
            None => say(INFO, text),
        }
    }

    fn note(&self, text: &str) {
        self.tell(text);
    }

    fn detail(&self, text: &str) {
        say(DEBUG, text);
    }

    fn begin(&self, _work: &Work<'_>) -> Box<dyn Progress> {
        Box::new(NoBar)
    }

    fn without_drivers(&self, ask: &mut dyn FnMut()) {
        Terminal.without_drivers(ask);
    }
}

fn say(level: u8, text: &str) {
    SAID.lock().expect("no thread panics while it holds this").push((level, text.to_owned()));
}

/// Hears what is said from now on, unless the command in this process does already.
pub(crate) fn hear() {
    listen(Box::new(Listener));
}

/// Passes on what was said.
pub(crate) fn pass_on(py: Python<'_>) -> PyResult<()> {
    let said = std::mem::take(&mut *SAID.lock().expect("no thread panics while it holds this"));
    if said.is_empty() {
        return Ok(());
    }
    let logger = py.import("logging")?.call_method1("getLogger", ("genesplat",))?;
    for (level, text) in said {
        logger.call_method1("log", (level, "%s", text))?;
    }
    Ok(())
}
