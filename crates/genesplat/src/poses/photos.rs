//! The photos that cameras are found for: those of a folder or of an archive, or frames of a video.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use anyhow::{Result, anyhow, bail, ensure};
use genesplat::io::archive::is_zip;
use genesplat::io::photos::{photo_size, turn_of, write_mask, write_upright};
use genesplat::io::{CONVERT, PHOTO_ENDINGS, UNREAD, VIDEO_ENDINGS, input, names, shown};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{FRAMES, IMAGES, heic, masks, video};
use crate::files::{link_or_copy, unwritable, write_json};
use crate::terminal::output;
use crate::unpacked;

/// COLMAP does not read these, so it gets them as PNG.
const WEBP: &str = "webp";
/// Below the folder of the stages: what an archive held.
const UNPACKED: &str = "unpacked";
/// In the same place: what the stages were made of.
const RECORD: &str = "source.json";

pub(crate) enum Source {
    Folder(Photos),
    Archive { path: PathBuf },
    Video { path: PathBuf, frames: u32 },
}

/// The photos of a folder.
pub(crate) struct Photos {
    path: PathBuf,
    /// Below `path`, sorted.
    names: Vec<String>,
    /// The same of those that [`super::heic`] puts into the scene.
    heic: Vec<String>,
    /// The mask of each photo that has one, by the photo's name.
    masks: Vec<(String, PathBuf)>,
}

/// What tells that the stages in a folder are those of the same photos.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Record {
    /// Name and size of each file.
    files: Vec<(String, u64)>,
    frames: Option<u32>,
}

impl Source {
    pub(crate) fn open(path: &Path, frames: Option<u32>) -> Result<Self> {
        let shown = shown(path);
        ensure!(path.exists(), "{shown} does not exist; give a folder of photos, or a video");
        if path.is_file() && !is_zip(path) {
            let is_video = has_ending(&path.to_string_lossy(), &VIDEO_ENDINGS);
            ensure!(
                is_video,
                "{shown} is neither a folder or a zip of photos nor a video ({})",
                VIDEO_ENDINGS.join(", ")
            );
            return Ok(Self::Video { path: path.to_owned(), frames: frames.unwrap_or(FRAMES) });
        }
        ensure!(frames.is_none(), "--frames is for a video, and {shown} holds photos; leave it out");
        if path.is_file() {
            return Ok(Self::Archive { path: path.to_owned() });
        }
        photos_of(path).map(Self::Folder)
    }

    pub(crate) fn path(&self) -> &Path {
        match self {
            Self::Folder(Photos { path, .. }) | Self::Archive { path } | Self::Video { path, .. } => path,
        }
    }

    pub(crate) fn is_video(&self) -> bool {
        matches!(self, Self::Video { .. })
    }

    /// Whether the photos lie in this folder.
    pub(crate) fn is_in(&self, folder: &Path) -> bool {
        match (folder.canonicalize(), self.path().canonicalize()) {
            (Ok(folder), Ok(photos)) => folder == photos,
            _ => false,
        }
    }

    /// Fails where the stages in `work` are those of other photos; else it is written down whose they are.
    pub(crate) fn check_same(&self, work: &Path) -> Result<()> {
        let (file, record) = (work.join(RECORD), self.record()?);
        let Ok(bytes) = input::read(&file) else { return write_json(&file, &record) };
        let same = serde_json::from_slice::<Record>(&bytes).is_ok_and(|there| there == record);
        // Photos that lie in the scene are the user's own, and all else there can be removed.
        let anew = match self.is_in(&work.with_file_name(IMAGES)) {
            true => format!(", or remove {} and {} to start anew", shown(work), shown(work.with_file_name("sparse"))),
            false => String::new(),
        };
        ensure!(
            same,
            "the search in {} was begun with other photos than {} holds now; choose another --out{anew}",
            shown(work),
            shown(self.path())
        );
        Ok(())
    }

    /// Fails where a file of a folder is no photo, by the name that its owner knows.
    pub(crate) fn check_photos(&self) -> Result<()> {
        let Self::Folder(Photos { path, names, .. }) = self else { return Ok(()) };
        Ok(names.par_iter().try_for_each(|name| photo_size(&path.join(name)).map(|_| ()))?)
    }

    fn record(&self) -> Result<Record> {
        let size = |name: &str, path: &Path| {
            let there = fs::metadata(path).map_err(|error| anyhow!("cannot read {}: {error}", shown(path)))?;
            Ok((name.to_owned(), there.len()))
        };
        match self {
            Self::Folder(Photos { path, names, heic, masks }) => {
                let photos = names.iter().chain(heic).map(|name| size(name, &path.join(name)));
                let masks = masks.iter().map(|(name, mask)| size(&format!("mask of {name}"), mask));
                Ok(Record { files: photos.chain(masks).collect::<Result<_>>()?, frames: None })
            }
            Self::Archive { path } | Self::Video { path, .. } => {
                let name = path.file_name().unwrap_or_default().to_string_lossy();
                let frames = if let Self::Video { frames, .. } = self { Some(*frames) } else { None };
                Ok(Record { files: vec![size(&name, path)?], frames })
            }
        }
    }

    /// HEIC photos of a folder, and where in `images` they belong as JPEG.
    pub(crate) fn heic(&self, images: &Path) -> Vec<(PathBuf, PathBuf)> {
        let Self::Folder(Photos { path, heic, .. }) = self else { return Vec::new() };
        heic.iter().map(|name| (path.join(name), images.join(name_in_scene(name)))).collect()
    }

    /// Puts the photos into `images`, and their masks beside it; false where `stop` has ended it.
    pub(crate) fn fill(&self, images: &Path, work: &Path, stop: &AtomicBool) -> Result<bool> {
        match self {
            Self::Folder(photos) => photos.put(images).map(|()| true),
            Self::Archive { path } => {
                let unpacked = work.join(UNPACKED);
                unpacked::unpack(path, &unpacked)?;
                photos_of(&unpacked)?.put(images).map(|()| true)
            }
            Self::Video { path, frames } => video::take_frames(path, *frames, images, work, stop),
        }
    }
}

/// Whether the stages of a scene have been begun in `work`.
pub(crate) fn is_begun(work: &Path) -> bool {
    work.join(RECORD).is_file()
}

/// Removes what [`Source::check_same`] and [`Source::fill`] have put into a new scene, whose photos are to be corrected first.
pub(crate) fn forget(scene: &Path, work: &Path) {
    // Of what stays, the next search tells.
    for folder in [scene.join(IMAGES), scene.join(masks::FOLDER), work.join(UNPACKED)] {
        let _ = fs::remove_dir_all(folder);
    }
    let _ = fs::remove_file(work.join(RECORD));
}

/// The photos in `path`; fails where there are none, and tells of pictures that are not read.
fn photos_of(path: &Path) -> Result<Photos> {
    let folder = Some(path.join(IMAGES)).filter(|images| images.is_dir()).unwrap_or_else(|| path.to_owned());
    let (Found { mut photos, others, masks }, shown) = (list(&folder)?, shown(path));
    let (heic, others): (Vec<_>, Vec<_>) = others.into_iter().partition(|name| is_heic(name));
    // An earlier search has left these where the photos lie in the scene.
    let sources = photos.iter().filter(|name| is_webp(name)).chain(&heic);
    let converted: BTreeSet<String> = sources.map(|name| name_in_scene(name)).collect();
    photos.retain(|name| !converted.contains(name));
    match (photos.is_empty() && heic.is_empty(), others.first()) {
        (true, None) => bail!("{shown} holds no photos; give a folder of JPEG, PNG or WebP files, or a video"),
        (true, Some(first)) => bail!(
            "{shown} holds no JPEG, PNG or WebP files, and others are not read ({first} is one of {}); {CONVERT}",
            others.len()
        ),
        (false, Some(first)) => unpacked::tell_of_unread(others.len(), first),
        (false, None) => {}
    }
    let beside = folder.ends_with(IMAGES).then(|| folder.with_file_name(masks::FOLDER));
    let all = [&photos[..], &heic].concat();
    let masks = masks::of_photos(&all, &masks.into_iter().chain(beside).collect::<Vec<_>>());
    Ok(Photos { path: folder, names: photos, heic, masks })
}

/// Names of the photos below a folder that [`Source::fill`] has filled, sorted.
pub(crate) fn names_in(images: &Path) -> Result<Vec<String>> {
    let mut names = list(images)?.photos;
    names.retain(|name| !is_webp(name));
    Ok(names)
}

impl Photos {
    /// Puts them into `images` in a form that COLMAP reads, upright, and their masks beside it.
    fn put(&self, images: &Path) -> Result<()> {
        self.tell_of_lying(images);
        self.names.par_iter().try_for_each(|name| {
            let (from, to) = (self.path.join(name), images.join(name_in_scene(name)));
            match to.exists() || (!is_webp(name) && turn_of(&from).is_none()) {
                true => link(&from, &to),
                false => Ok(write_upright(&from, &to)?),
            }
        })?;
        let masks = images.with_file_name(masks::FOLDER);
        self.masks.par_iter().try_for_each(|(name, mask)| {
            self.put_mask(&self.path.join(name), mask, &masks::place(&masks, &name_in_scene(name)))
        })
    }

    /// What is in the scene already is the user's, and stays as it is.
    fn tell_of_lying(&self, images: &Path) {
        let is_in_place =
            images.canonicalize().is_ok_and(|images| self.path.canonicalize().is_ok_and(|path| path == images));
        let is_lying = |name: &&String| turn_of(&self.path.join(name)).is_some();
        let lying = if is_in_place { self.names.par_iter().filter(is_lying).count() } else { 0 };
        if lying > 0 {
            output::tell(&format!(
                "notice: {lying} of {} photos are not upright by their EXIF orientation, and cameras are found as they lie; \
                 with another --out they are turned",
                self.names.len()
            ));
        }
    }

    fn put_mask(&self, photo: &Path, mask: &Path, to: &Path) -> Result<()> {
        let turn = turn_of(photo).filter(|_| !to.exists());
        if to.exists() || (turn.is_none() && has_ending(&mask.to_string_lossy(), &["png"])) {
            return link(mask, to);
        }
        Ok(write_mask(mask, to, photo_size(photo).unwrap_or_default().into(), turn)?)
    }
}

/// WebP photos become PNG, and HEIC ones JPEG.
fn name_in_scene(name: &str) -> String {
    match () {
        () if is_webp(name) => format!("{name}.png"),
        () if is_heic(name) => format!("{name}.jpg"),
        () => name.to_owned(),
    }
}

fn is_webp(name: &str) -> bool {
    has_ending(name, &[WEBP])
}

fn is_heic(name: &str) -> bool {
    has_ending(name, &heic::ENDINGS)
}

/// [`link_or_copy`], once.
fn link(from: &Path, to: &Path) -> Result<()> {
    if to.exists() { Ok(()) } else { link_or_copy(from, to).map_err(|error| unwritable(to, &error)) }
}

/// What lies below a folder; all sorted.
#[derive(Debug, Default, PartialEq)]
struct Found {
    /// Names relative to it.
    photos: Vec<String>,
    /// The same of pictures that are not read.
    others: Vec<String>,
    /// Folders of masks.
    masks: Vec<PathBuf>,
}

/// Looks into all folders but those of masks and hidden ones.
fn list(folder: &Path) -> Result<Found> {
    let (mut found, mut folders) = (Found::default(), vec![PathBuf::new()]);
    while let Some(inner) = folders.pop() {
        let path = folder.join(&inner);
        let entries = fs::read_dir(&path).map_err(|error| anyhow!("cannot read {}: {error}", shown(path)))?;
        for entry in entries.flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            let relative = inner.join(entry.file_name());
            match entry.path().is_dir() {
                _ if name.starts_with('.') => {}
                true if name.starts_with("mask") => found.masks.push(entry.path()),
                true => folders.push(relative),
                false if has_ending(&name, &PHOTO_ENDINGS) => found.photos.push(name_of(&relative, &entry.path())?),
                false if has_ending(&name, &UNREAD) => found.others.push(name_of(&relative, &entry.path())?),
                false => {}
            }
        }
    }
    found.photos.sort();
    found.others.sort();
    found.masks.sort();
    Ok(found)
}

/// The name of the photo `file`, by which COLMAP knows it.
fn name_of(relative: &Path, file: &Path) -> Result<String> {
    names::of_path(relative).map_err(|problem| {
        anyhow!("the name of the photo {} {problem}, so cameras cannot be found for it; rename it", shown(file))
    })
}

fn has_ending(name: &str, endings: &[&str]) -> bool {
    name.rsplit_once('.').is_some_and(|(_, end)| endings.iter().any(|known| end.eq_ignore_ascii_case(known)))
}

#[cfg(test)]
mod tests {
    use genesplat::core::Photo;
    use genesplat::io::photos::{encode_jpeg, read_photo, write_png};

    use super::*;

    fn file(folder: &Path, name: &str) {
        fs::create_dir_all(folder.join(name).parent().unwrap()).unwrap();
        fs::write(folder.join(name), name).unwrap();
    }

    #[test]
    fn photos_are_found_in_subfolders_and_masks_are_none() {
        let place = tempfile::tempdir().unwrap();
        for name in ["b/2.JPG", "a.png", ".hidden.jpg", "masks/a.png", "notes.txt", "x.HEIC"] {
            file(place.path(), name);
        }
        let Found { photos, others, masks } = list(place.path()).unwrap();
        assert_eq!((photos, others), (vec!["a.png".to_owned(), "b/2.JPG".into()], vec!["x.HEIC".to_owned()]));
        assert_eq!(masks, [place.path().join("masks")]);
    }

    #[cfg(unix)]
    #[test]
    fn a_name_that_leads_out_elsewhere_is_refused() {
        let photos = tempfile::tempdir().unwrap();
        for name in ["a\\..\\..\\x.jpg", "a\\2.heic", "\\x.webp"] {
            file(photos.path(), name);
            let refusal = Source::open(photos.path(), None).err().unwrap().to_string();
            assert!(refusal.contains("backslash") && refusal.contains("rename it"), "{refusal}");
            fs::remove_file(photos.path().join(name)).unwrap();
        }
    }

    #[test]
    fn masks_come_along_under_the_names_of_their_photos() {
        let place = tempfile::tempdir().unwrap();
        for name in
            ["a/images/1.jpg", "a/images/2.jpg", "a/masks/1.png", "b/1.jpg", "b/masks/1.jpg.png", "b/masks/9.png"]
        {
            file(place.path(), name);
        }
        for (given, scene) in [("a", "of-a"), ("a/images", "of-images"), ("b", "of-b")] {
            let source = Source::open(&place.path().join(given), None).unwrap();
            let scene = place.path().join(scene);
            assert!(source.fill(&scene.join(IMAGES), &scene.join("work"), &AtomicBool::new(false)).unwrap());
            let masks: Vec<PathBuf> =
                fs::read_dir(scene.join("masks")).unwrap().map(|mask| mask.unwrap().path()).collect();
            assert_eq!(masks, [scene.join("masks/1.jpg.png")]);
        }
        file(place.path(), "b/masks/1.jpg.png.bak");
        let (b, work) = (place.path().join("b"), place.path().join("work"));
        fs::create_dir(&work).unwrap();
        Source::open(&b, None).unwrap().check_same(&work).unwrap();
        fs::write(b.join("masks/1.jpg.png"), "another mask").unwrap();
        assert!(Source::open(&b, None).unwrap().check_same(&work).is_err(), "features were looked for elsewhere");
    }

    /// WebP, lossless.
    const ONE_PIXEL: &[u8] = b"RIFF\x1a\0\0\0WEBPVP8L\x0d\0\0\0\x2f\0\0\0\x10\x07\x10\x11\x11\x88\x88\xfe\x07\0";

    #[test]
    fn webp_photos_become_png_and_others_stay_as_they_are() {
        let place = tempfile::tempdir().unwrap();
        let [photos, images] = ["photos", "images"].map(|name| place.path().join(name));
        file(&photos, "b/1.jpg");
        fs::write(photos.join("2.WebP"), ONE_PIXEL).unwrap();
        let source = Source::open(&photos, None).unwrap();
        let never = AtomicBool::new(false);
        assert!(
            source.fill(&images, place.path(), &never).unwrap() && source.fill(&images, place.path(), &never).unwrap()
        );
        assert_eq!(names_in(&images).unwrap(), ["2.WebP.png", "b/1.jpg"]);
        let [png, webp] = [images.join("2.WebP.png"), photos.join("2.WebP")].map(|path| read_photo(&path).unwrap());
        assert_eq!(png, webp);
        assert_eq!(names_in(&photos).unwrap(), ["b/1.jpg"], "photos that lie in the scene already");
    }

    /// A JPEG whose EXIF data say that it is to be turned by a quarter.
    fn lying() -> Vec<u8> {
        let jpeg = encode_jpeg(&Photo { width: 32, height: 16, rgb: vec![90; 3 * 32 * 16] }, 90);
        let tiff = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
        [&[0xFF, 0xD8, 0xFF, 0xE1, 0, 8 + tiff.len() as u8][..], b"Exif\0\0", tiff, &jpeg[2..]].concat()
    }

    #[test]
    fn photos_that_lie_on_their_side_are_turned_with_their_masks() {
        let place = tempfile::tempdir().unwrap();
        let [photos, scene] = ["photos", "scene"].map(|name| place.path().join(name));
        file(&photos, "b/1.jpg");
        fs::write(photos.join("2.jpg"), lying()).unwrap();
        write_png(&photos.join("masks/2.png"), &Photo { width: 32, height: 16, rgb: vec![255; 3 * 32 * 16] }).unwrap();
        let (source, images) = (Source::open(&photos, None).unwrap(), scene.join(IMAGES));
        assert!(source.fill(&images, place.path(), &AtomicBool::new(false)).unwrap());
        for file in ["images/2.jpg", "masks/2.jpg.png"] {
            assert_eq!(photo_size(&scene.join(file)).unwrap(), (16, 32), "{file}");
        }
        assert_eq!(fs::read(images.join("b/1.jpg")).unwrap(), b"b/1.jpg");
    }

    #[test]
    fn webp_photos_in_the_scene_stay_the_same_photos_beside_their_png() {
        let place = tempfile::tempdir().unwrap();
        let [images, work] = [IMAGES, "poses"].map(|name| place.path().join(name));
        fs::create_dir(&images).unwrap();
        fs::write(images.join("1.webp"), ONE_PIXEL).unwrap();
        for _ in 0..2 {
            let source = Source::open(place.path(), None).unwrap();
            source.check_same(&work).unwrap();
            assert!(source.fill(&images, &work, &AtomicBool::new(false)).unwrap());
            assert_eq!(names_in(&images).unwrap(), ["1.webp.png"]);
        }
    }

    #[test]
    fn photos_of_an_archive_are_unpacked_once() {
        let place = tempfile::tempdir().unwrap();
        let [archive, images, work] = ["trip.zip", "images", "work"].map(|name| place.path().join(name));
        let mut zip = zip::ZipWriter::new(fs::File::create(&archive).unwrap());
        for name in ["trip/1.jpg", "trip/b/2.PNG", "trip/notes.txt"] {
            zip.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
        }
        zip.finish().unwrap();
        let (source, never) = (Source::open(&archive, None).unwrap(), AtomicBool::new(false));
        source.check_same(&work).unwrap();
        assert!(!source.is_video() && source.fill(&images, &work, &never).unwrap());
        assert_eq!(names_in(&images).unwrap(), ["trip/1.jpg", "trip/b/2.PNG"]);
        // Whatever has been unpacked stays.
        fs::remove_file(work.join("unpacked/trip/1.jpg")).unwrap();
        assert!(source.fill(&images, &work, &never).unwrap() && names_in(&images).unwrap().len() == 2);
        assert!(!work.join("unpacked/trip/1.jpg").exists());
    }

    #[test]
    fn stages_of_other_photos_are_refused() {
        let place = tempfile::tempdir().unwrap();
        let (photos, work) = (place.path().join("photos"), place.path().join("work"));
        file(&photos, "a.jpg");
        let check = || Source::open(&photos, None).unwrap().check_same(&work);
        check().unwrap();
        check().unwrap();
        file(&photos, "b.jpg");
        let refused = check().unwrap_err().to_string();
        assert!(refused.contains("other photos") && refused.contains("--out"), "{refused}");
        assert!(!refused.contains("remove"), "the scene holds photos, whose it is not known: {refused}");
    }

    #[test]
    fn of_photos_in_the_scene_none_is_said_to_be_removable() {
        let place = tempfile::tempdir().unwrap();
        let work = place.path().join("poses");
        file(place.path(), "images/a.jpg");
        let check = || Source::open(place.path(), None).unwrap().check_same(&work);
        check().unwrap();
        file(place.path(), "images/b.jpg");
        let refused = check().unwrap_err().to_string();
        let [work, sparse] = [&work, &place.path().join("sparse")].map(shown);
        assert!(refused.ends_with(&format!("or remove {work} and {sparse} to start anew")), "{refused}");
    }

    #[test]
    fn heic_photos_are_converted_with_their_masks_or_what_it_takes_is_said() {
        let place = tempfile::tempdir().unwrap();
        let (photos, images) = (place.path().join("photos"), place.path().join("scene/images"));
        file(&photos, "b/1.HEIC");
        file(&photos, "masks/1.png");
        let source = Source::open(&photos, None).unwrap();
        let (pairs, never) = (source.heic(&images), AtomicBool::new(false));
        assert_eq!(pairs, [(photos.join("b/1.HEIC"), images.join("b/1.HEIC.jpg"))]);
        assert!(source.fill(&images, place.path(), &never).unwrap());
        assert!(place.path().join("scene/masks/b/1.HEIC.jpg.png").exists());
        let engine = super::super::engine::Engine::of_python("no-such-python");
        let refused = heic::convert(&pairs, &engine, place.path(), &never).unwrap_err().to_string();
        assert!(refused.contains("1 photo is HEIC") && refused.contains("pip install pillow-heif"), "{refused}");
    }

    #[test]
    fn what_is_neither_photos_nor_a_video_is_said() {
        let place = tempfile::tempdir().unwrap();
        let refusal = |name: &str, frames| Source::open(&place.path().join(name), frames).err().unwrap().to_string();
        for name in ["empty/notes.txt", "phone/1.dng", "photos/1.jpg", "scene.zip", "scene.rar"] {
            file(place.path(), name);
        }
        assert!(refusal("absent", None).contains("does not exist"));
        assert!(refusal("empty", None).contains("holds no photos"));
        assert!(refusal("phone", None).contains("1.dng is one of 1"));
        assert!(refusal("photos", Some(9)).contains("--frames is for a video"));
        assert!(refusal("scene.zip", Some(9)).contains("--frames is for a video"));
        assert!(refusal("scene.rar", None).contains("neither a folder or a zip of photos nor a video"));
    }
}
