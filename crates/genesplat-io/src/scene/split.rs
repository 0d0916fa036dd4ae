//! Which photos are trained on, and which are held out for testing.

use std::num::NonZeroU32;
use std::path::Path;

use genesplat_core::View;
use serde::{Deserialize, Serialize};

use crate::error::SceneError;
use crate::listing::{ListedPhoto, Purpose};
use crate::shown;

/// The field's convention: every eighth photo.
const USUAL_INTERVAL: usize = 8;

/// Which photos are held out for testing.
#[derive(Clone, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum HoldOut {
    /// Sorted by name, every eighth, from the first on: the field's convention. A scene that names its own test
    /// photos (Blender, nerfstudio file lists) keeps those instead.
    #[default]
    EveryEighth,
    /// The same with another interval, at least 2, whatever the scene itself names.
    Every(NonZeroU32),
    /// These and no others: by the name of their view, with or without its ending, or by the end of their path.
    Photos(Vec<String>),
    /// None: everything is trained on, but for what a scene's lists leave out.
    None,
}

impl HoldOut {
    /// Training and test views of a scene that names no test photos, each sorted by name.
    pub fn split(&self, views: Vec<View>) -> (Vec<View>, Vec<View>) {
        self.part(views, |view| &view.name)
    }

    /// The reference's order: by the file name up to its first dot (the whole name breaks ties). Every so many-th is for
    /// testing, from the first on.
    fn part<T>(&self, mut items: Vec<T>, name: impl Fn(&T) -> &str) -> (Vec<T>, Vec<T>) {
        items.sort_by(|a, b| {
            let (a, b) = (name(a), name(b));
            first_part(a).cmp(first_part(b)).then_with(|| a.cmp(b))
        });
        let is_test = |(index, item): &(usize, T)| match self {
            Self::EveryEighth => index % USUAL_INTERVAL == 0,
            Self::Every(interval) => index % interval.get() as usize == 0,
            Self::Photos(names) => names.iter().any(|listed| listed == name(item)),
            Self::None => false,
        };
        let (test, train): (Vec<_>, Vec<_>) = items.into_iter().enumerate().partition(is_test);
        let items = |part: Vec<(usize, T)>| part.into_iter().map(|(_, item)| item).collect();
        (items(train), items(test))
    }

    /// The same with the names of views in place of what else a photo is called by.
    fn by_view_names(&self, photos: &[ListedPhoto], scene: &Path) -> Result<Self, SceneError> {
        let Self::Photos(names) = self else { return Ok(self.clone()) };
        Ok(Self::Photos(names.iter().map(|name| view_name(name, photos, scene)).collect::<Result<_, _>>()?))
    }
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
        let (used, _) = HoldOut::None.part(used, |photo| &photo.name);
        return Ok(used.into_iter().partition(|photo| photo.purpose != Purpose::Test));
    }
    let hold_out = hold_out.by_view_names(&used, scene)?;
    Ok(hold_out.part(used, |photo| &photo.name))
}

/// The name of the one view that `listed` stands for.
fn view_name(listed: &str, photos: &[ListedPhoto], scene: &Path) -> Result<String, SceneError> {
    let is_called = |photo: &&ListedPhoto| {
        photo.name == listed || without_ending(&photo.name) == listed || photo.path.ends_with(listed)
    };
    let mut found = photos.iter().filter(is_called);
    let problem = match (found.next(), found.count()) {
        (Some(photo), 0) => return Ok(photo.name.clone()),
        (None, _) => {
            let example = photos.first().map_or(String::new(), |photo| shown(&photo.name));
            format!(
                "has no photo called {}, which is to be held out; its photos have names like {example}",
                shown(listed)
            )
        }
        (_, more) => {
            format!("has {} photos called {}; name the folder of the one that is meant", more + 1, shown(listed))
        }
    };
    Err(SceneError::invalid(scene, problem))
}

fn first_part(name: &str) -> &str {
    name.split('.').next().unwrap_or(name)
}

fn without_ending(name: &str) -> &str {
    name.rsplit_once('.').map_or(name, |(stem, _)| stem)
}
