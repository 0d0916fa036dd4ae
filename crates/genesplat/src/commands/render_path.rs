//! `genesplat render --path`: a splat seen by a camera that moves, as PNGs, or as a film that ffmpeg makes of
//! them.

use std::ffi::OsStr;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Result, anyhow, bail, ensure};
use genesplat::core::{Camera, Photo};
use genesplat::io::atomic::Unfinished;
use genesplat::io::{Scene, ending, input, photos, shown};
use genesplat::run::files::unwritable;
use genesplat::run::output::Bar;
use genesplat::run::overwrite::{self, Content};
use genesplat::run::splat::Splat;
use genesplat::run::{device, files, splat};
use genesplat::terminal::program::Ending;
use genesplat::terminal::{interrupt, output};
use genesplat::viewer::path::CameraPath;

use super::next;
use super::render::STOPPING;
use crate::args::{PathChoice, RenderArgs};
use crate::programs::Programs;

/// Frames of a path where nobody asks for a number.
const FRAMES: u32 = 120;
/// Frames a second of a film.
const RATE: &str = "30";

pub(crate) fn run(args: &RenderArgs, choice: &PathChoice) -> Result<Ending> {
    device::use_threads(args.splat.machine.threads)?;
    let stop = interrupt::stop_flag_saying(STOPPING);
    let splat = splat::open(&args.splat.path)?.on(args.splat.on.background);
    let data = splat.scene_path(args.data.as_deref())?;
    let scene = splat.load_scene(&data, &args.splat.photos.asked()?)?;
    overwrite::check_photos(&scene, &args.out)?;
    let cameras = cameras(choice, &scene, args.frames.unwrap_or(FRAMES))?;
    let mut sink = Sink::open(&args.out, &cameras)?;
    if !render(args, splat, &cameras, &mut sink, &stop)? {
        output::print(&sink.stopped())?;
        return Ok(Ending::Stopped);
    }
    sink.finish()?;
    output::print(&format!("{} frames written to {}", cameras.len(), shown(&args.out)))?;
    next::after_splat(&args.splat.path);
    Ok(Ending::Whole)
}

/// False where `stop` has ended it.
fn render(
    args: &RenderArgs,
    splat: Splat,
    cameras: &[Camera],
    sink: &mut Sink,
    stop: &AtomicBool,
) -> Result<bool> {
    let mut backend = device::open(args.splat.machine.device().unwrap_or_default())?;
    backend.upload(splat.cloud.into())?;
    let mut bar = Bar::new("renders", cameras.len() as u64);
    for (done, camera) in (1..).zip(cameras) {
        if stop.load(Ordering::Relaxed) {
            return Ok(false);
        }
        sink.add(&backend.render(camera, &splat.settings)?.to_photo())?;
        bar.set(done, String::new);
    }
    Ok(true)
}

/// The cameras of all frames, of the size of the scene's first photo.
fn cameras(choice: &PathChoice, scene: &Scene, frames: u32) -> Result<Vec<Camera>> {
    let mut views: Vec<_> = scene.train.iter().chain(&scene.test).collect();
    views.sort_by(|a, b| a.name.cmp(&b.name));
    let known: Vec<Camera> = views.iter().map(|view| view.camera).collect();
    let path = match choice {
        PathChoice::Orbit => CameraPath::orbit(&known)?,
        PathChoice::Spiral => CameraPath::spiral(&known)?,
        PathChoice::Interpolate => CameraPath::through(&known)?,
        PathChoice::File(file) => {
            let bytes = input::read(file)
                .map_err(|error| anyhow!("cannot read the path {}: {error}", shown(file)))?;
            CameraPath::parse(&bytes).map_err(|error| anyhow!("{}: {error}", shown(file)))?
        }
    };
    let Camera { width, height, near, .. } = known[0];
    // Films have even sides.
    let cameras = path.cameras(frames, width & !1, height & !1);
    Ok(cameras.into_iter().map(|camera| Camera { near, ..camera }).collect())
}

/// Whether ffmpeg makes this file.
pub(crate) fn is_film(path: &Path) -> bool {
    ["mp4", "gif"].contains(&ending(path).as_str())
}

enum Sink {
    Folder { path: PathBuf, frames: u32 },
    Film(Film),
}

/// A film under way: ffmpeg writes beside its place, where it is moved once it is whole.
struct Film {
    ffmpeg: Child,
    /// Taken once it is whole.
    unfinished: Option<Unfinished>,
    path: PathBuf,
}

impl Sink {
    fn open(out: &Path, cameras: &[Camera]) -> Result<Self> {
        if !is_film(out) {
            for frame in 1..=cameras.len() as u32 {
                files::check_name(out, frame_name(frame))?;
                overwrite::check_existing(&out.join(frame_name(frame)), Content::Picture, &[])?;
            }
            let beyond = out.join(frame_name(cameras.len() as u32 + 1));
            ensure!(
                !beyond.exists(),
                "{} would be a frame of another path after those of this one; choose another --out, or remove it and those that follow",
                shown(&beyond)
            );
            return Ok(Self::Folder { path: out.to_owned(), frames: 0 });
        }
        let unfinished = Unfinished::of(out).map_err(|error| unwritable(out, &error))?;
        let Camera { width, height, .. } = cameras[0];
        let programs = Programs::default();
        let program = programs.find(&["ffmpeg"]).ok_or_else(|| {
            anyhow!(
                "there is no ffmpeg on the PATH, which makes {}; install it, or give --out a folder for PNGs",
                shown(out)
            )
        })?;
        let ffmpeg =
            ffmpeg(programs.command(&program), unfinished.temporary(), &ending(out), [width, height]);
        let ffmpeg =
            { ffmpeg }.spawn().map_err(|error| anyhow!("cannot start {}: {error}", shown(program)))?;
        Ok(Self::Film(Film { ffmpeg, unfinished: Some(unfinished), path: out.to_owned() }))
    }

    fn add(&mut self, picture: &Photo) -> Result<()> {
        match self {
            Self::Folder { path, frames } => {
                *frames += 1;
                Ok(photos::write_own_png(path, frame_name(*frames), picture)?)
            }
            Self::Film(film) => {
                let pipe = film.ffmpeg.stdin.as_mut().expect("it was opened");
                if pipe.write_all(&picture.rgb).is_err() {
                    bail!("{}", film.complaint());
                }
                Ok(())
            }
        }
    }

    /// What there is of it when it was stopped.
    fn stopped(&self) -> String {
        match self {
            Self::Folder { path, frames } => format!("stopped; {frames} frames are in {}", shown(path)),
            Self::Film(film) => format!("stopped; no {} was written", shown(&film.path)),
        }
    }

    fn finish(self) -> Result<()> {
        let Self::Film(mut film) = self else { return Ok(()) };
        // Its end is the film's.
        drop(film.ffmpeg.stdin.take());
        let complaint = film.complaint();
        ensure!(film.ffmpeg.wait().is_ok_and(|status| status.success()), "{complaint}");
        let whole = film.unfinished.take().map_or(Ok(()), Unfinished::finish);
        whole.map_err(|error| unwritable(&film.path, &error))
    }
}

impl Film {
    /// What ffmpeg has said, as a sentence.
    fn complaint(&mut self) -> String {
        let mut said = String::new();
        // What cannot be read is not said.
        let _ = self.ffmpeg.stderr.take().map(|mut stderr| stderr.read_to_string(&mut said));
        let said = said.lines().next().unwrap_or("no reason given").to_owned();
        format!("ffmpeg made no {}: {said}; give --out a folder for PNGs", shown(&self.path))
    }
}

impl Drop for Film {
    fn drop(&mut self) {
        // One that is finished has ended.
        let _ = self.ffmpeg.kill();
        let _ = self.ffmpeg.wait();
    }
}

fn frame_name(frame: u32) -> String {
    format!("{frame:04}.png")
}

/// Frames come as raw pixels. The film goes into the file `out`, which is there: `file:` and a format keep
/// ffmpeg from looking for a protocol, an option or a pattern in its name.
fn ffmpeg(mut command: Command, out: &Path, format: &str, [width, height]: [u32; 2]) -> Command {
    let size = format!("{width}x{height}");
    command.args([
        "-loglevel",
        "error",
        "-y",
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgb24",
        "-s",
        &size,
        "-r",
        RATE,
        "-i",
        "-",
    ]);
    if format == "gif" {
        command.args(["-filter_complex", "split[a][b];[a]palettegen[p];[b][p]paletteuse"]);
    } else {
        command.args(["-pix_fmt", "yuv420p", "-movflags", "+faststart"]);
    }
    let file = [OsStr::new("file:"), out.as_os_str()].join(OsStr::new(""));
    command.args(["-f", format]).arg(file).stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
    // Ctrl-C is ours to hear.
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    command
}
