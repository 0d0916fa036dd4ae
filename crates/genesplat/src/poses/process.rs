//! Programs of others: started, listened to, and ended when the user stops us.

use std::error::Error;
use std::fmt;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::Duration;

use anyhow::{Result, anyhow, bail, ensure};
use genesplat::io::{own, shown};
use genesplat::run::files::unwritable;

/// A program was ended by a signal that nobody sent: the fault is its own, and may not come again.
#[derive(Debug)]
pub(crate) struct Crashed(String);

impl fmt::Display for Crashed {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&self.0)
    }
}

impl Error for Crashed {}

const PAUSE: Duration = Duration::from_millis(100);

/// Runs `command` to its end and passes on each line that it writes to stdout or stderr; what it wrote is
/// kept in `log`, a file of ours: the program's name before each line, and what a terminal obeys as escapes,
/// since names of photos are in it. False where `stop` has ended it.
pub(crate) fn run(
    command: &mut Command,
    log: &Path,
    stop: &AtomicBool,
    mut on_line: impl FnMut(&str),
) -> Result<bool> {
    let program = PathBuf::from(command.get_program());
    let mut file = open_log(log).map_err(|error| unwritable(log, &error))?;
    let name = shown(program.file_name().unwrap_or_default());
    let mut child = start(command).map_err(|error| anyhow!("cannot start {}: {error}", shown(&program)))?;
    let (lines, listeners) = listen_to(&mut child).map_err(|error| {
        end(&mut child);
        anyhow!(
            "cannot start a thread that listens to {}: {error}; raise the limits of this process",
            shown(&program)
        )
    })?;
    let (mut last, mut error) = (String::new(), None);
    loop {
        if stop.load(Ordering::Relaxed) {
            end(&mut child);
            return Ok(false);
        }
        match lines.recv_timeout(PAUSE) {
            Ok(line) => {
                // The log is for people who look for a fault; a full disk shows elsewhere.
                let _ = writeln!(file, "{name}: {}", shown(&line));
                on_line(&line);
                if is_error(&line) {
                    error = Some(line);
                } else if !line.trim().is_empty() {
                    last = line;
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
    }
    listeners.into_iter().for_each(|listener| drop(listener.join()));
    let status = child.wait().map_err(|error| anyhow!("cannot wait for {}: {error}", shown(&program)))?;
    if !status.success() && !stop.load(Ordering::Relaxed) {
        let sentence = match shown(error.unwrap_or(last).trim()).as_str() {
            "" => {
                format!(
                    "{} has failed ({status}) and said nothing; the same command tries it again",
                    shown(&program)
                )
            }
            last if last.contains("database is locked") => format!(
                "{} has failed, because one of an earlier search still runs ({last}); wait for it, or end it, and give the same \
                 command again",
                shown(&program)
            ),
            last => format!("{} has failed ({last}); all that it said is in {}", shown(&program), shown(log)),
        };
        // Ended by a signal.
        ensure!(status.code().is_some(), Crashed(sentence));
        bail!(sentence);
    }
    Ok(status.success())
}

fn open_log(log: &Path) -> io::Result<File> {
    own::append(log.parent().unwrap_or(Path::new("")), log.file_name().unwrap_or_default())
}

/// Whether a line tells of an error in glog's way (`E20261127 ..`, `F1127 ..`), or in words.
fn is_error(line: &str) -> bool {
    let is_of_glog =
        line.strip_prefix(['E', 'F']).is_some_and(|rest| rest.starts_with(|c: char| c.is_ascii_digit()));
    is_of_glog || ["error", "database is locked"].iter().any(|word| line.to_lowercase().contains(word))
}

/// Its stdin is a pipe that nothing is written to: a program that listens to it learns when we are gone.
fn start(command: &mut Command) -> io::Result<Child> {
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    // Ctrl-C is ours to hear: the program is ended when there is a moment for it.
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(command, 0);
    command.spawn()
}

type Listeners = Vec<thread::JoinHandle<()>>;

/// The lines that a program writes, and the threads that pass them on.
fn listen_to(child: &mut Child) -> io::Result<(Receiver<String>, Listeners)> {
    let (sender, lines) = channel();
    let stdout = child.stdout.take().map(|stream| listen(stream, sender.clone())).transpose()?;
    let stderr = child.stderr.take().map(|stream| listen(stream, sender)).transpose()?;
    Ok((lines, stdout.into_iter().chain(stderr).collect()))
}

fn listen(stream: impl Read + Send + 'static, lines: Sender<String>) -> io::Result<thread::JoinHandle<()>> {
    thread::Builder::new().name("listener".into()).spawn(move || {
        let mut stream = BufReader::new(stream);
        let mut bytes = Vec::new();
        while stream.read_until(b'\n', &mut bytes).is_ok_and(|count| count > 0) {
            let line = String::from_utf8_lossy(&bytes).trim_end().to_owned();
            if lines.send(line).is_err() {
                return;
            }
            bytes.clear();
        }
    })
}

fn end(child: &mut Child) {
    // It has ended by itself where this fails.
    let _ = child.kill();
    let _ = child.wait();
}

#[cfg(all(test, unix))]
mod tests {
    use std::time::Instant;

    use super::*;

    fn shell(script: &str) -> Command {
        let mut command = Command::new("sh");
        command.args(["-c", script]);
        command
    }

    #[test]
    fn lines_are_passed_on_and_kept_and_a_failure_is_named() {
        let place = tempfile::tempdir().unwrap();
        let (log, never) = (place.path().join("log"), AtomicBool::new(false));
        let mut lines = Vec::new();
        assert!(
            run(&mut shell("echo one; echo two >&2"), &log, &never, |line| lines.push(line.to_owned()))
                .unwrap()
        );
        lines.sort();
        assert_eq!(lines, ["one", "two"]);
        let refused =
            run(&mut shell("echo no memory >&2; exit 3"), &log, &never, |_| {}).unwrap_err().to_string();
        assert!(refused.contains("no memory") && refused.contains("log"), "{refused}");
        let silent = run(&mut shell("exit 3"), &log, &never, |_| {}).unwrap_err().to_string();
        assert_eq!(
            silent,
            "sh has failed (exit status: 3) and said nothing; the same command tries it again"
        );
        let crashed = run(&mut shell("echo a fault >&2; kill -SEGV $$"), &log, &never, |_| {}).unwrap_err();
        assert!(crashed.is::<Crashed>() && crashed.to_string().contains("a fault"), "{crashed}");
        let told = "echo E20261127 no such camera; echo 'SQLite error: database is locked'; echo 'Matching block [1/1]'; exit 1";
        let locked = run(&mut shell(told), &log.with_extension("2"), &never, |_| {}).unwrap_err().to_string();
        assert!(
            locked.contains("an earlier search still runs (SQLite error: database is locked)"),
            "{locked}"
        );
        let kept = genesplat::io::input::read_text(&log).unwrap();
        assert_eq!(kept.lines().count(), 4);
        assert!(run(&mut shell(r"printf 'a\033[2J\rb\n'"), &log, &never, |_| {}).unwrap());
        let kept = genesplat::io::input::read_text(&log).unwrap();
        assert!(kept.lines().all(|line| line.starts_with("sh: ")), "{kept}");
        assert!(kept.ends_with("sh: a\\u{1b}[2J\\u{d}b\n"), "{kept}");
    }

    #[test]
    fn a_program_ends_when_it_is_stopped() {
        let place = tempfile::tempdir().unwrap();
        let (stop, began) = (AtomicBool::new(false), Instant::now());
        let mut sleeper = shell("echo begun; exec sleep 600");
        let ended =
            run(&mut sleeper, &place.path().join("log"), &stop, |_| stop.store(true, Ordering::Relaxed));
        assert!(!ended.unwrap() && began.elapsed() < Duration::from_secs(500));
    }
}
