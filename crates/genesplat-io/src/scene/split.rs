//! Which photos are trained on, and which are held out for testing.

use std::collections::BTreeMap;
use std::num::{NonZeroU32, NonZeroUsize};
use std::path::{Path, PathBuf};

use genesplat_core::View;
use serde::{Deserialize, Serialize};

use crate::alike::{composed, difference};
use crate::error::SceneError;
use crate::listing::{ListedPhoto, Purpose};
use crate::shown;

/// The field's convention: every eighth photo.
const USUAL_INTERVAL: usize = 8;

/// Which photos are held out for testing.
#[derive(Clone, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum HoldOut {
    /// Sorted by name, every eighth, from the first on: the field's convention; of photos that a rig of
    /// lenses took at one moment, all or none. A scene that names its own test photos (Blender, nerfstudio
    /// file lists) keeps those instead.
    #[default]
    EveryEighth,
    /// The same with another interval, at least 2, whatever the scene itself names.
    Every(NonZeroU32),
    /// These and no others: by the name of their view, with or without its ending, or by the end of their
    /// path.
    Photos(Vec<String>),
    /// None: everything is trained on, but for what a scene's lists leave out.
    None,
}

impl HoldOut {
    /// Training and test views of a scene that names no test photos, each sorted by name.
    pub fn split(&self, views: Vec<View>) -> (Vec<View>, Vec<View>) {
        self.part(views, |view| (&*view.name, None))
    }

    /// The reference's order: by the file name up to its first dot (the whole name breaks ties). Every so
    /// many-th is for testing, from the first on; what was taken at one moment counts once. Of each item its
    /// name and moment are `told`.
    fn part<T>(&self, mut items: Vec<T>, told: impl Fn(&T) -> (&str, Option<u32>)) -> (Vec<T>, Vec<T>) {
        items.sort_by(|a, b| {
            let (a, b) = (told(a).0, told(b).0);
            first_part(a).cmp(first_part(b)).then_with(|| a.cmp(b))
        });
        let is_test = |(number, item): &(usize, T)| match self {
            Self::EveryEighth => number % USUAL_INTERVAL == 0,
            Self::Every(interval) => number % interval.get() as usize == 0,
            Self::Photos(names) => names.iter().any(|listed| listed == told(item).0),
            Self::None => false,
        };
        let numbers = numbers(items.iter().map(|item| told(item).1));
        let (test, train): (Vec<_>, Vec<_>) = numbers.into_iter().zip(items).partition(is_test);
        let items = |part: Vec<(usize, T)>| part.into_iter().map(|(_, item)| item).collect();
        (items(train), items(test))
    }

    /// The same with the names of views in place of what else a photo is called by.
    fn by_view_names(&self, photos: &[ListedPhoto], scene: &Path) -> Result<Self, SceneError> {
        let Self::Photos(names) = self else { return Ok(self.clone()) };
        let files = photos.iter().map(|photo| (&*photo.name, &*photo.path));
        let view = |name: &String| view_name(name, files.clone(), scene).map(str::to_owned);
        Ok(Self::Photos(names.iter().map(view).collect::<Result<_, _>>()?))
    }
}

/// Places among items without those of a moment that came before; a moment has one place.
fn numbers(moments: impl Iterator<Item = Option<u32>>) -> Vec<usize> {
    let (mut known, mut next) = (BTreeMap::new(), 0..);
    let mut new = || next.next().expect("there are fewer items than numbers");
    moments
        .map(|moment| match moment {
            Some(moment) => *known.entry(moment).or_insert_with(&mut new),
            None => new(),
        })
        .collect()
}

/// Training and test photos of `scene`, each sorted by name.
pub(super) fn split(
    photos: Vec<ListedPhoto>,
    hold_out: &HoldOut,
    scene: &Path,
) -> Result<(Vec<ListedPhoto>, Vec<ListedPhoto>), SceneError> {
    let used: Vec<_> = photos.into_iter().filter(|photo| photo.purpose != Purpose::Unused).collect();
    let is_named = |photo: &ListedPhoto| photo.purpose != Purpose::Unsaid;
    if *hold_out == HoldOut::EveryEighth && used.iter().any(is_named) {
        // The scene itself says which photos are for testing.
        let (used, _) = HoldOut::None.part(used, |photo| (&*photo.name, None));
        return Ok(used.into_iter().partition(|photo| photo.purpose != Purpose::Test));
    }
    let hold_out = hold_out.by_view_names(&used, scene)?;
    Ok(hold_out.part(used, |photo| (&*photo.name, photo.moment)))
}

/// The name of the one view that is called `asked`, of the views and their files in `photos`: by its name or
/// by the end of its path, with or without its ending.
pub(super) fn view_name<'a>(
    asked: &str,
    mut photos: impl Iterator<Item = (&'a str, &'a Path)> + Clone,
    scene: &Path,
) -> Result<&'a str, SceneError> {
    let wanted = &*composed(asked);
    let is_called = |(name, path): &(&str, &Path)| {
        let (name, path) = (composed(name), path.to_string_lossy());
        let path = composed(&path);
        let path = Path::new(&*path);
        *name == *wanted
            || without_ending(&name) == wanted
            || path.ends_with(wanted)
            || path.with_extension("").ends_with(wanted)
    };
    let mut found = photos.clone().filter(is_called);
    let problem = match (found.next(), found.count()) {
        (Some((name, _)), 0) => return Ok(name),
        (None, _) => {
            let example = photos.next().map(|(name, path)| usual_name(name, path)).unwrap_or_default();
            let differs = difference(asked, &example.file_name().unwrap_or_default().to_string_lossy());
            let (asked, example) = (shown(asked), shown(&example));
            format!("has no photo called {asked}; its photos have names like {example}{differs}")
        }
        (_, more) => {
            format!(
                "has {} photos called {}; name the ending or the folder of the one that is meant",
                more + 1,
                shown(asked)
            )
        }
    };
    Err(SceneError::invalid(scene, problem))
}

/// A photo as its owner calls it: with its folder, where views are told apart by that.
fn usual_name(view: &str, path: &Path) -> PathBuf {
    let file = path.file_name().unwrap_or_default();
    match path.parent().and_then(Path::file_name) {
        Some(folder) if composed(view) != composed(&file.to_string_lossy()) => Path::new(folder).join(file),
        _ => file.into(),
    }
}

fn first_part(name: &str) -> &str {
    name.split('.').next().unwrap_or(name)
}

fn without_ending(name: &str) -> &str {
    name.rsplit_once('.').map_or(name, |(stem, _)| stem)
}

/// At most so many of the held-out photos, or of the others where there are none, at even distances.
pub(super) fn sample<T>(train: Vec<T>, test: Vec<T>, most: NonZeroUsize) -> (Vec<T>, Vec<T>) {
    let thinned = |photos: Vec<T>| {
        let step = photos.len().div_ceil(most.get()).max(1);
        photos.into_iter().step_by(step).collect()
    };
    if test.is_empty() { (thinned(train), test) } else { (Vec::new(), thinned(test)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn photos_of_one_moment_count_once() {
        let moments = [None, Some(7), Some(9), None, Some(9), Some(7), None];
        assert_eq!(numbers(moments.into_iter()), [0, 1, 2, 3, 2, 1, 4]);
    }

    #[test]
    fn a_sample_is_of_held_out_photos_where_there_are_some() {
        let of = |train: std::ops::Range<u32>, test: std::ops::Range<u32>| {
            sample(train.collect(), test.collect::<Vec<_>>(), NonZeroUsize::new(4).unwrap())
        };
        assert_eq!(of(0..20, 20..30), (vec![], vec![20, 23, 26, 29]));
        assert_eq!(of(0..20, 0..0), (vec![0, 5, 10, 15], vec![]));
        assert_eq!(of(0..3, 5..7), (vec![], vec![5, 6]));
    }
}
