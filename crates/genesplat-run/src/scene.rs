//! Scenes, as the command loads them.

use std::collections::HashSet;
use std::num::NonZeroUsize;
use std::path::Path;

use anyhow::{Result, bail, ensure};
use genesplat_core::View;
use genesplat_io::{Doubt, LoadOptions, Offset, PHOTO_ENDINGS, Point, Scene, Spill, load_scene, plural};
use genesplat_train::scene::initialise::ColouredPoint;
use genesplat_train::{MethodName, TrainConfig};

use crate::exposure::Corrections;
use crate::far;
use crate::output;
use crate::output::LoadBar;
use crate::preparing;
use crate::settings::{Dataset, DepthUse};

/// Bytes of photos that a process keeps in memory: as much as a million Gaussians take while they are
/// trained.
pub const PHOTO_MEMORY: u64 = 1 << 30;

/// Fewer photos show a scene from so few places that no splat of them shows it from others.
pub const PHOTOS_MIN: usize = 10;

/// Loads a scene to train on with a progress bar, and passes its notices on; `spill` says where photos go
/// that memory should not hold, and `offset` where the scene lay when its run began, if it goes on; depth maps
/// come along if they are wanted. Of its doubts, [`check_promising`] tells.
pub fn load(
    dataset: &Dataset,
    with_depth: bool,
    background: [f32; 3],
    seed: u64,
    spill: Option<Spill>,
    offset: Option<Offset>,
) -> Result<Scene> {
    let with_tracks = dataset.corrections != Corrections::Off;
    let options = LoadOptions { seed, spill, offset, with_tracks, with_depth, ..dataset.options() };
    let scene = told(read(&dataset.path, background, options))?;
    let is_asked = with_depth && dataset.depth == DepthUse::On;
    ensure!(
        !is_asked || scene.train.iter().any(|view| view.depth.is_some()),
        "no photo has a depth map that can be used; they are looked for under the depth_file_path of transforms.json and in \
         stereo/depth_maps; leave out --depth on"
    );
    Ok(scene)
}

/// Points far away that training starts from beside those of `scene`, and says so. Published methods have
/// none.
pub fn far_points(scene: &Scene, train: &TrainConfig) -> Result<Vec<Point>> {
    if train.method.name != MethodName::Genesplat {
        return Ok(Vec::new());
    }
    let far = far::points(scene, in_8_bit(train.background.fixed_colour()))?;
    if !far.is_empty() {
        let count = far.len();
        output::tell(&format!(
            "{count} points are added far away, where photos show sky or what is beyond all others"
        ));
    }
    Ok(far)
}

/// The same to inspect: notices are the caller's to tell.
pub fn load_to_inspect(dataset: &Dataset, with_depth: bool, seed: u64) -> Result<Scene> {
    let options = LoadOptions { seed, with_depth, ..dataset.options() };
    read(&dataset.path, [0.0; 3], options)
}

/// The same to look at a finished splat, without points, with both sides of the size divided by `divisor`. It
/// lies where the splat does, by this `offset`; of a `sample`, at most so many photos are loaded.
pub(crate) fn load_to_look(
    dataset: &Dataset,
    divisor: u32,
    background: [f32; 3],
    offset: Option<Offset>,
    sample: Option<NonZeroUsize>,
) -> Result<Scene> {
    let options = LoadOptions { divisor, offset, sample, with_points: false, ..dataset.options() };
    told(read(&dataset.path, background, options))
}

/// The same of at most so many photos, without notices.
pub(crate) fn load_sample(
    dataset: &Dataset,
    background: [f32; 3],
    offset: Option<Offset>,
    most: NonZeroUsize,
) -> Result<Scene> {
    let options = LoadOptions { sample: Some(most), offset, with_points: false, ..dataset.options() };
    read(&dataset.path, background, options)
}

/// Why to train on a scene makes no sense.
pub fn doubts(scene: &Scene) -> Vec<Doubt> {
    let views = scene.train.iter().chain(&scene.test);
    let photos = views.map(|view| scene.photo_of(&view.name)).collect::<HashSet<_>>().len();
    let few = (photos < PHOTOS_MIN).then(|| Doubt {
        problem: format!(
            "the scene has {photos} {} with cameras, and from fewer than {PHOTOS_MIN} no splat learns how it looks from elsewhere",
            plural(photos, "photo", "photos")
        ),
        remedy: "take more of them (30 to 200 are usual), or go on with --anyway".into(),
    });
    scene.doubts.iter().cloned().chain(few).collect()
}

/// Fails where to train on a scene makes no sense; `anyway`, that is a notice.
pub fn check_promising(scene: &Scene, anyway: bool) -> Result<()> {
    for doubt in doubts(scene) {
        if !anyway {
            bail!("{doubt}");
        }
        output::tell(&format!("notice: {}", doubt.problem));
    }
    Ok(())
}

/// Whether there is hope of a good splat.
pub(crate) fn is_promising(scene: &Scene) -> bool {
    doubts(scene).is_empty()
}

fn read(path: &Path, background: [f32; 3], options: LoadOptions) -> Result<Scene> {
    let _preparing = preparing::begin();
    let background = in_8_bit(background);
    Ok(load_scene(path, &LoadOptions { background, ..options }, &LoadBar::default())?)
}

fn in_8_bit(colour: [f32; 3]) -> [u8; 3] {
    colour.map(|value| (255.0 * value).round() as u8)
}

fn told(scene: Result<Scene>) -> Result<Scene> {
    scene.inspect(|scene| scene.notices.iter().for_each(|notice| output::tell(&format!("notice: {notice}"))))
}

/// The points of a scene, to begin with.
pub fn points(scene: &Scene) -> Vec<ColouredPoint> {
    coloured(&scene.points)
}

/// The same of points alone.
pub fn coloured(points: &[Point]) -> Vec<ColouredPoint> {
    points.iter().map(|point| (point.position, point.rgb)).collect()
}

/// The names of the pictures of these views.
pub fn picture_names(views: &[View]) -> Vec<String> {
    names_of_pictures(&views.iter().map(|view| view.name.as_str()).collect::<Vec<_>>())
}

/// Most bytes of a file's name (`NAME_MAX` of Linux and macOS, and less than Windows allows).
const NAME_BYTES_MAX: usize = 255;

/// The same for photos of these names: `0001.jpg` becomes `0001.png`. Where two photos differ in their ending
/// only, all names keep theirs (`0001.jpg.png`). Where that is too long, or differs in case only, which many
/// file systems do not tell apart, all names are shortened and numbered (`00000_0001.png`).
pub(crate) fn names_of_pictures(photos: &[&str]) -> Vec<String> {
    let short = photos.iter().map(|name| format!("{}.png", stem(name))).collect();
    let whole = photos.iter().map(|name| format!("{name}.png")).collect();
    [short, whole]
        .into_iter()
        .find(|names: &Vec<String>| fit_one_folder(names))
        .unwrap_or_else(|| numbered(photos))
}

fn fit_one_folder(names: &[String]) -> bool {
    let mut seen = HashSet::new();
    names.iter().all(|name| name.len() <= NAME_BYTES_MAX && seen.insert(name.to_lowercase()))
}

fn numbered(photos: &[&str]) -> Vec<String> {
    let name = |(index, photo): (usize, &&str)| {
        let (number, stem) = (format!("{index:05}_"), stem(photo));
        let rest = NAME_BYTES_MAX - number.len() - ".png".len();
        format!("{number}{}.png", &stem[..stem.floor_char_boundary(rest)])
    };
    photos.iter().enumerate().map(name).collect()
}

/// A photo's name without the ending of a picture format.
pub fn stem(name: &str) -> &str {
    match name.rsplit_once('.') {
        Some((stem, end)) if PHOTO_ENDINGS.iter().any(|known| end.eq_ignore_ascii_case(known)) => stem,
        _ => name,
    }
}

#[cfg(test)]
mod tests {
    use genesplat_core::{Camera, Photo};

    use super::*;

    fn view(name: &str) -> View {
        let camera = Camera::at_origin(1, 1, 1.0);
        View {
            name: name.into(),
            camera,
            photo: Photo { width: 1, height: 1, rgb: vec![0; 3] }.into(),
            mask: None,
            depth: None,
        }
    }

    #[test]
    fn pictures_are_named_after_photos_and_never_share_a_name() {
        assert_eq!(
            picture_names(&[view("a.JPG"), view("b.c.png"), view("r_0.5")]),
            ["a.png", "b.c.png", "r_0.5.png"]
        );
        assert_eq!(picture_names(&[view("a.webp")]), ["a.png"]);
        assert_eq!(picture_names(&[view("a.jpg"), view("a.png")]), ["a.jpg.png", "a.png.png"]);
        assert_eq!(picture_names(&[view("a.jpg"), view("A.png")]), ["a.jpg.png", "A.png.png"]);
        assert_eq!(picture_names(&[view("b.jpg"), view("B.JPG")]), ["00000_b.png", "00001_B.png"]);
    }

    #[test]
    fn names_of_pictures_fit_a_file_system() {
        let longest = format!("{}.jpg", "é".repeat(125) + "x");
        assert_eq!(longest.len(), NAME_BYTES_MAX);
        assert_eq!(picture_names(&[view(&longest)])[0].len(), NAME_BYTES_MAX);
        // Without an ending that is left out, or joined from several folders.
        for long in ["é".repeat(127) + "x", "x".repeat(900)] {
            let names = picture_names(&[view(&long), view("b.jpg")]);
            assert!(names.iter().all(|name| name.len() <= NAME_BYTES_MAX), "{names:?}");
            assert!(names[0].starts_with("00000_") && names[1] == "00001_b.png", "{names:?}");
        }
    }
}
