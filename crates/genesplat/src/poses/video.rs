//! Photos from a video: `ffmpeg` takes several frames for each that is wanted, and the sharpest of each
//! interval stays.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Result, anyhow, bail, ensure};
use genesplat::io::photos::read_photo;
use genesplat::io::shown;
use genesplat::run::files::{make_empty, resolved, unwritable, write_own_text};
use genesplat::run::output;
use genesplat::run::output::Bar;
use rayon::prelude::*;

use super::{IMAGES, process};
use crate::programs::Programs;
use crate::sharpness::laplacian_variance;

/// Below the folder of the stages: says that the frames are taken.
const MARK: &str = "frames.done";
/// Frames that are compared for each that stays.
const CANDIDATES: u32 = 3;
/// JPEG quality of ffmpeg, 2 to 31; the lower the better.
const QUALITY: &str = "2";

/// From light as HDR has it to what a JPEG means: white of 203 cd/m² (ITU-R BT.2408) is white, and what is
/// brighter is cut off.
const FROM_HDR: &str = ",zscale=t=linear:npl=203,format=gbrpf32le,zscale=p=bt709,tonemap=clip,\
                        zscale=t=iec61966-2-1:m=bt709:r=full,format=yuvj420p";
/// Names of HLG, which phones film in, and of PQ.
const HDR: [&str; 2] = ["arib-std-b67", "smpte2084"];

/// What `ffmpeg -i` says of a video.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Video {
    seconds: f64,
    frames_per_second: f64,
    is_hdr: bool,
    /// Width of a pixel by its height: anamorphic lenses and old formats have others than 1.
    pixel_aspect: f64,
}

/// What ffmpeg does to each frame, so that pixels are square, as cameras have them: none loses a row or a
/// column.
fn square(pixel_aspect: f64) -> String {
    match pixel_aspect {
        1.0 => String::new(),
        wide if wide > 1.0 => format!(",scale=2*round(iw*{wide}/2):ih,setsar=1"),
        tall => format!(",scale=iw:2*round(ih/{tall}/2),setsar=1"),
    }
}

/// Whether ffmpeg, if it is there, takes a file for a video; it looks at what is in it, whatever its name.
pub(crate) fn is_video(file: &Path) -> Option<bool> {
    let programs = Programs::beside(file);
    let ffmpeg = programs.find(&["ffmpeg"])?;
    Some(ask(&mut programs.command(&ffmpeg), file).ok()?.is_some())
}

/// Puts `frames` frames of `video`, or all if it has fewer, into `images`; false where `stop` has ended it.
pub(crate) fn take_frames(
    video: &Path,
    frames: u32,
    images: &Path,
    work: &Path,
    stop: &AtomicBool,
) -> Result<bool> {
    if work.join(MARK).exists() {
        return Ok(true);
    }
    let programs = Programs::beside(video);
    let Some(ffmpeg) = programs.find(&["ffmpeg"]) else {
        bail!(
            "frames of a video are taken by ffmpeg, which is not on PATH; install it, or give a folder of photos"
        );
    };
    let candidates = make_empty(work, "candidates")?;
    make_empty(images.parent().unwrap_or(images), IMAGES)?;
    let command = || programs.command(&ffmpeg);
    let about = probe(&mut command(), video)?;
    let rate = about.frames_per_second.min(f64::from(CANDIDATES * frames) / about.seconds);
    let from_hdr = if about.is_hdr { from_hdr(&mut command()) } else { "" };
    let filters = format!("fps={rate}{}{from_hdr}", square(about.pixel_aspect));
    let mut command = command();
    command.args(["-hide_banner", "-nostats", "-progress", "pipe:1", "-y", "-i"]).arg(resolved(video));
    // Its folder may have a % in its name, which would be a part of the pattern.
    command.args(["-vf", &filters, "-q:v", QUALITY, "%06d.jpg"]).current_dir(&candidates);
    let total = (rate * about.seconds).round().max(1.0) as u64;
    let mut bar = Bar::new("frames", total);
    let on_line = |line: &str| {
        if let Some(done) = line.strip_prefix("frame=").and_then(|done| done.trim().parse::<u64>().ok()) {
            bar.set(done.min(total), String::new);
        }
    };
    if !process::run(&mut command, &work.join("ffmpeg.log"), stop, on_line)? {
        return Ok(false);
    }
    drop(bar);
    let all = files_in(&candidates)?;
    ensure!(!all.is_empty(), "ffmpeg has found no frames in {}; convert the video to MP4", shown(video));
    let Some(kept) = sharpest(&all, frames as usize, stop)? else { return Ok(false) };
    for (number, frame) in (1..).zip(kept) {
        let place = images.join(format!("frame_{number:04}.jpg"));
        fs::rename(&frame, &place).map_err(|error| unwritable(&place, &error))?;
    }
    // Only litter, from now on.
    let _ = fs::remove_dir_all(&candidates);
    write_own_text(work, MARK, "").map(|()| true)
}

fn probe(ffmpeg: &mut Command, video: &Path) -> Result<Video> {
    ask(ffmpeg, video)?.ok_or_else(|| {
        let problem = match fs::metadata(video).is_ok_and(|file| file.len() == 0) {
            true => "is an empty file; copy it again",
            false => {
                "has no pictures of which ffmpeg can tell length and frame rate; copy it again, since it may be cut off, or convert \
                 it to MP4 with H.264"
            }
        };
        anyhow!("{} {problem}", shown(video))
    })
}

/// What ffmpeg says of a file; `None` where it finds no video in it.
fn ask(ffmpeg: &mut Command, file: &Path) -> Result<Option<Video>> {
    let ran = ffmpeg.args(["-hide_banner", "-i"]).arg(resolved(file)).output();
    // It complains that nothing is to be written; what it has found out comes before.
    let ran = ran.map_err(|error| anyhow!("cannot start {}: {error}", shown(ffmpeg.get_program())))?;
    Ok(parse(&String::from_utf8_lossy(&ran.stderr)))
}

/// What follows other filters for a video in HDR: nothing, and a notice, where this ffmpeg lacks what it
/// takes.
fn from_hdr(ffmpeg: &mut Command) -> &'static str {
    let ran = ffmpeg.args(["-hide_banner", "-filters"]).output();
    if ran.is_ok_and(|ran| String::from_utf8_lossy(&ran.stdout).contains(" zscale ")) {
        return FROM_HDR;
    }
    output::tell(
        "notice: the video is in HDR, and this ffmpeg lacks the filter zscale, so its frames are pale; install an ffmpeg with \
         zimg, or film in SDR",
    );
    ""
}

/// What ffmpeg takes for streams of pictures and is none: letters on a terminal, the cover of a song.
const NO_VIDEOS: [&str; 2] = ["Video: ansi", "(attached pic)"];

/// `Duration: 00:01:02.50, ...` and `..., 29.97 fps, ...`, and `SAR 4:3` where pixels are not square.
fn parse(said: &str) -> Option<Video> {
    let clock = said.split("Duration: ").nth(1)?.split(',').next()?;
    let seconds =
        clock.split(':').try_fold(0.0, |sum, part| Some(60.0 * sum + part.trim().parse::<f64>().ok()?))?;
    let is_video =
        |line: &&str| line.contains("Video:") && !NO_VIDEOS.iter().any(|other| line.contains(other));
    let stream = said.lines().find(is_video)?;
    let rate = stream.split(',').find_map(|part| part.trim().strip_suffix(" fps"))?.parse::<f64>().ok()?;
    let is_hdr = HDR.iter().any(|name| stream.contains(name));
    let pixel_aspect = pixel_aspect(stream).unwrap_or(1.0);
    (seconds > 0.0 && rate > 0.0).then_some(Video { seconds, frames_per_second: rate, is_hdr, pixel_aspect })
}

/// `None` where the stream does not say it, or says nonsense.
fn pixel_aspect(stream: &str) -> Option<f64> {
    let (width, rest) = stream.split("SAR ").nth(1)?.split_once(':')?;
    let height = rest.split(|char: char| !char.is_ascii_digit()).next()?;
    let aspect = width.parse::<f64>().ok()? / height.parse::<f64>().ok()?;
    (0.1..=10.0).contains(&aspect).then_some(aspect)
}

fn files_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = fs::read_dir(folder).map_err(|error| anyhow!("cannot read {}: {error}", shown(folder)))?;
    let mut files: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    files.sort();
    Ok(files)
}

/// The sharpest file of each of `count` equal intervals; all, where there are no more. `None` where `stop` is
/// set.
fn sharpest(files: &[PathBuf], count: usize, stop: &AtomicBool) -> Result<Option<Vec<PathBuf>>> {
    if files.len() <= count {
        return Ok(Some(files.to_vec()));
    }
    let score = |file: &PathBuf| match stop.load(Ordering::Relaxed) {
        true => Ok(0.0),
        false => read_photo(file).map(|photo| laplacian_variance(&photo)),
    };
    let scores: Vec<f64> = files.par_iter().map(score).collect::<Result<_, _>>()?;
    if stop.load(Ordering::Relaxed) {
        return Ok(None);
    }
    let best = |interval: usize| {
        let range = interval * files.len() / count..(interval + 1) * files.len() / count;
        range.max_by(|&a, &b| scores[a].total_cmp(&scores[b])).map(|index| files[index].clone())
    };
    Ok(Some((0..count).filter_map(best).collect()))
}

#[cfg(test)]
mod tests {
    use genesplat::core::Photo;
    use genesplat::io::photos::{resize, write_png};

    use super::*;

    #[test]
    fn length_and_rate_are_read_from_what_ffmpeg_says() {
        let said = "Input #0, mov\n  Duration: 00:01:02.50, start: 0.0, bitrate: 9 kb/s\n  \
                    Stream #0:1: Audio: aac, 48000 Hz\n  \
                    Stream #0:0(und): Video: h264 (High), yuv420p(tv, bt709), 1920x1080, 29.97 fps, 30 tbr\n";
        let video = Video { seconds: 62.5, frames_per_second: 29.97, is_hdr: false, pixel_aspect: 1.0 };
        assert_eq!(parse(said), Some(video));
        let of_phone = said.replace("tv, bt709", "tv, bt2020nc/bt2020/arib-std-b67, progressive");
        assert_eq!(parse(&of_phone), Some(Video { is_hdr: true, ..video }));
        for (words, pixel_aspect) in [
            ("1440x1080 [SAR 4:3 DAR 16:9]", 4.0 / 3.0),
            ("720x576 [SAR 16:15 DAR 4:3]", 16.0 / 15.0),
            ("720x480, SAR 8:9 DAR 4:3", 8.0 / 9.0),
            ("1920x1080 [SAR 1:1 DAR 16:9]", 1.0),
            ("1920x1080 [SAR 0:1 DAR 0:1]", 1.0),
        ] {
            let said = said.replace("1920x1080", words);
            assert_eq!(parse(&said), Some(Video { pixel_aspect, ..video }), "{words}");
        }
        assert_eq!(parse(&said.replace("h264 (High)", "ansi")), None, "a text");
        assert_eq!(parse(&said.replace("30 tbr", "30 tbr (attached pic)")), None, "a song");
        assert_eq!(parse("Duration: N/A, bitrate: N/A\nStream Video: h264, 25 fps,"), None);
        assert_eq!(parse(""), None);
    }

    #[test]
    fn frames_get_square_pixels_and_lose_none() {
        assert_eq!(square(1.0), "");
        assert_eq!(square(1.5), ",scale=2*round(iw*1.5/2):ih,setsar=1");
        assert_eq!(square(0.5), ",scale=iw:2*round(ih/0.5/2),setsar=1");
    }

    /// Whatever its name and that of its folder, a video is one, and its frames are as wide as they look.
    #[test]
    fn a_video_is_told_by_what_is_in_it() {
        let place = tempfile::tempdir().unwrap();
        let programs = Programs::beside(place.path());
        let Some(ffmpeg) = programs.find(&["ffmpeg"]) else {
            assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "CI has no ffmpeg");
            return;
        };
        let folder = place.path().join("50%d off");
        let [images, work] = ["scene/images", "scene/poses"].map(|name| folder.join(name));
        fs::create_dir_all(&images).unwrap();
        fs::create_dir_all(&work).unwrap();
        let source = ["-f", "lavfi", "-i", "testsrc=size=128x96:rate=5:duration=1", "-vf", "setsar=4/3"];
        for (format, ending, name) in
            [("mp4", "mpeg4", "film %02d.insv"), ("mpegts", "mpeg2video", "00001.x")]
        {
            let video = folder.join(name);
            let mut make = programs.command(&ffmpeg);
            make.args(source).args(["-c:v", ending, "-r", "25", "-f", format]).arg(&video);
            assert!(make.output().unwrap().status.success(), "{name}");
            assert_eq!(is_video(&video), Some(true), "{name}");
            fs::write(video.with_extension("abc"), "no film").unwrap();
            assert_eq!(is_video(&video.with_extension("abc")), Some(false));
            let _ = fs::remove_file(work.join(MARK));
            assert!(take_frames(&video, 2, &images, &work, &AtomicBool::new(false)).unwrap());
            let frames = files_in(&images).unwrap();
            let photo = read_photo(&frames[0]).unwrap();
            assert_eq!((frames.len(), photo.width, photo.height), (2, 170, 96), "{name}");
        }
    }

    #[test]
    fn the_sharpest_frame_of_each_interval_stays() {
        let place = tempfile::tempdir().unwrap();
        let value = |at: u32| if (at % 64 / 3 + at / 64 / 5).is_multiple_of(2) { 220 } else { 30 };
        let sharp =
            Photo { width: 64, height: 48, rgb: (0..64 * 48).flat_map(|at| [value(at); 3]).collect() };
        let blurred = resize(&resize(&sharp, 20, 15), 64, 48);
        let frames = (0..7).map(|index| {
            let file = place.path().join(format!("{index}.png"));
            write_png(&file, if [1, 3, 6].contains(&index) { &sharp } else { &blurred }).unwrap();
            file
        });
        let frames: Vec<PathBuf> = frames.collect();
        let never = AtomicBool::new(false);
        // Intervals of 2, 2 and 3 frames.
        let kept = sharpest(&frames, 3, &never).unwrap().unwrap();
        assert_eq!(kept, [1, 3, 6].map(|index| frames[index].clone()));
        assert_eq!(sharpest(&frames, 9, &never).unwrap().unwrap(), frames);
        assert_eq!(sharpest(&frames, 3, &AtomicBool::new(true)).unwrap(), None);
    }
}
