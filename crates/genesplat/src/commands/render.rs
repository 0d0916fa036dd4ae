//! `genesplat render`: a splat seen from the viewpoints of photos.

use std::io::Write;
use std::path::Path;
use std::sync::atomic::Ordering;

use anyhow::{Result, anyhow, ensure};
use genesplat::core::{Photo, View};
use genesplat::io::{PHOTO_ENDINGS, Scene, VIDEO_ENDINGS, ending, photos, plural, shown};
use genesplat::metrics::psnr_under;
use genesplat::run::exposure::{Exposure, Light};
use genesplat::run::files::check_folder;
use genesplat::run::output::Bar;
use genesplat::run::overwrite::{Content, check_file};
use genesplat::run::photos::check_test_photos;
use genesplat::run::splat::Splat;
use genesplat::run::{device, files, overwrite, scene, splat};
use genesplat::terminal::program::Ending;
use genesplat::terminal::{interrupt, output};

use super::another_scene::{Misses, every};
use super::next;
use super::render_path::{self, is_film};
use crate::args::{RenderArgs, RenderSplit};

/// Of 100: differs from the PNG by less than the eye sees.
const JPEG_QUALITY: u8 = 95;
/// For who has pressed Ctrl-C.
pub(super) const STOPPING: &str = "stopping after this picture; press Ctrl-C again to abort at once";

/// Fails where `--out` cannot be what is asked for, by its name or by what is there.
pub(crate) fn check_out(args: &RenderArgs) -> Result<()> {
    let (out, inputs) = (&args.out, [Some(&*args.splat.path), args.splat.photos.test_list()]);
    if args.image.is_some() {
        check_file(out, Content::Picture, &inputs)?;
        let is_picture = is_jpeg(out) || ending(out) == "png";
        ensure!(is_picture, "{} names no picture that is written; end it in .png or .jpg", shown(out));
        return Ok(());
    }
    if args.path.is_some() && is_film(out) {
        return check_file(out, Content::Figures, &inputs);
    }
    let is_file_name =
        PHOTO_ENDINGS.iter().chain(&VIDEO_ENDINGS).any(|known| ending(out) == *known) || is_film(out);
    let films = if args.path.is_some() { " (a film ends in .mp4 or .gif)" } else { "" };
    ensure!(
        !is_file_name,
        "{} is the name of a file, and many pictures need a folder{films}; give one",
        shown(out)
    );
    check_folder(out, "0001.png")
}

/// Renders one viewpoint into a file, or many into a folder.
pub(crate) fn run(args: &RenderArgs) -> Result<Ending> {
    if let Some(path) = &args.path {
        return render_path::run(args, path);
    }
    device::use_threads(args.splat.machine.threads)?;
    let stop = interrupt::stop_flag_saying(STOPPING);
    let splat = splat::open(&args.splat.path)?.on(args.splat.on.background);
    let data = splat.scene_path(args.data.as_deref())?;
    let scene = splat.load_scene(&data, &args.splat.photos.asked()?)?;
    let exposure = if args.as_photo { Some(own_exposure(args, &splat, &scene)?) } else { None };
    let light = exposure.as_ref().map(Light::finished);
    let (is_own, scene_name) = (splat.began_with(&scene), scene.name.clone());
    overwrite::check_photos(&scene, &args.out)?;
    if args.split == Some(RenderSplit::Test) {
        let has_some = !scene.test.is_empty();
        ensure!(has_some, "{} has no test photos; use --split train", shown(&data));
        check_test_photos(&args.splat.path, &scene)?;
    }
    let jobs = match &args.image {
        Some(name) => {
            let name = splat.view_name(name, &data, &args.splat.photos.asked()?)?;
            vec![(find(&scene, &name, &data)?, Place::Given(&args.out))]
        }
        None => {
            let views = chosen(scene, args.split.unwrap_or(RenderSplit::All));
            let names = scene::picture_names(&views);
            views.into_iter().zip(names).map(|(view, name)| (view, Place::In(&args.out, name))).collect()
        }
    };
    jobs.iter().try_for_each(|(_, place)| place.check())?;
    let mut backend = device::open(args.splat.machine.device().unwrap_or_default())?;
    backend.upload(splat.cloud.into())?;
    let mut bar = Bar::new("renders", jobs.len() as u64);
    let (mut done, mut misses, every) = (0, Misses::default(), every(jobs.len()));
    for (view, place) in &jobs {
        if stop.load(Ordering::Relaxed) {
            break;
        }
        let mut image = backend.render(&view.camera, &splat.settings)?;
        if let Some(light) = light {
            light.of_photo(&view.name).put_on(&mut image, &view.camera);
        }
        let picture = image.to_photo();
        if done % every == 0 {
            let psnr = psnr_under(view.mask.as_deref(), &picture, view.photo.read()?.as_ref())?;
            misses.count(view, psnr)?;
        }
        place.write(&picture)?;
        done += 1;
        bar.set(done as u64, String::new);
    }
    drop(bar);
    if !is_own {
        misses.notice(&args.splat.path, &scene_name);
    }
    let (pictures, out) = (plural(done, "picture", "pictures"), shown(&args.out));
    if done < jobs.len() {
        output::print(&format!("stopped; {done} {pictures} of {} written to {out}", jobs.len()))?;
        return Ok(Ending::Stopped);
    }
    output::print(&format!("{done} {pictures} written to {out}"))?;
    let splat = shown(&args.splat.path);
    next::tell(&[(&["render", &splat, "--path", "orbit", "--out", "orbit.mp4"], "a film around it")]);
    Ok(Ending::Whole)
}

/// That of the photos, which `--as-photo` asks for.
fn own_exposure(args: &RenderArgs, splat: &Splat, scene: &Scene) -> Result<Exposure> {
    splat.exposure(scene, &args.splat.photos.asked()?).ok_or_else(|| {
        anyhow!(
            "{} does not say what exposure photos have, as the folder of a run with --corrections on does; leave out --as-photo",
            shown(&args.splat.path)
        )
    })
}

fn is_jpeg(path: &Path) -> bool {
    ["jpg", "jpeg"].contains(&ending(path).as_str())
}

/// Where a picture goes.
enum Place<'a> {
    /// The user has given its name.
    Given(&'a Path),
    /// A name of ours, in the folder that the user has given.
    In(&'a Path, String),
}

impl Place<'_> {
    fn check(&self) -> Result<()> {
        match self {
            Self::Given(path) => overwrite::check_existing(path, Content::Picture, &[]),
            Self::In(folder, name) => {
                files::check_name(folder, name)?;
                overwrite::check_existing(&folder.join(name), Content::Picture, &[])
            }
        }
    }

    fn write(&self, picture: &Photo) -> Result<()> {
        match self {
            Self::Given(path) if is_jpeg(path) => {
                let jpeg = photos::encode_jpeg(picture, JPEG_QUALITY);
                files::write_file(path, |out| out.write_all(&jpeg))
            }
            Self::Given(path) => Ok(photos::write_png(path, picture)?),
            Self::In(folder, name) => Ok(photos::write_own_png(folder, name, picture)?),
        }
    }
}

/// The view called `name`, unless it is hidden.
fn find(scene: &Scene, name: &str, data: &Path) -> Result<View> {
    let view = scene.train.iter().chain(&scene.test).find(|view| view.name == name);
    view.cloned().ok_or_else(|| {
        anyhow!("the mask of {} in {} hides it entirely; choose another photo", shown(name), shown(data))
    })
}

fn chosen(scene: Scene, split: RenderSplit) -> Vec<View> {
    match split {
        RenderSplit::Test => scene.test,
        RenderSplit::Train => scene.train,
        RenderSplit::All => [scene.train, scene.test].concat(),
    }
}
