//! Which photos are trained on, and which are held out for testing.

use genesplat_core::View;

use crate::listing::{ListedPhoto, Purpose};

/// Which photos are held out for testing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum HoldOut {
    /// Sorted by name, every eighth, from the first on: the field's convention. A scene that names its own test
    /// photos (Blender, nerfstudio file lists) keeps those instead.
    #[default]
    EveryEighth,
    /// None: everything is trained on, but for what a scene's lists leave out.
    None,
}

impl HoldOut {
    /// Training and test views of a scene that names no test photos, each sorted by name.
    pub fn split(self, views: Vec<View>) -> (Vec<View>, Vec<View>) {
        every_eighth(views, |view| &view.name, self)
    }
}

/// Training and test photos, each sorted by name.
pub(super) fn split(photos: Vec<ListedPhoto>, hold_out: HoldOut) -> (Vec<ListedPhoto>, Vec<ListedPhoto>) {
    let used: Vec<_> = photos.into_iter().filter(|photo| photo.purpose != Purpose::Unused).collect();
    if used.iter().all(|photo| photo.purpose == Purpose::Unsaid) {
        return every_eighth(used, |photo| &photo.name, hold_out);
    }
    // The scene itself says which photos are for testing.
    let (used, _) = every_eighth(used, |photo| &photo.name, HoldOut::None);
    used.into_iter().partition(|photo| hold_out == HoldOut::None || photo.purpose != Purpose::Test)
}

/// The reference's split: sorted by the file name up to its first dot (the whole name breaks ties), every eighth for
/// testing, from the first on.
fn every_eighth<T>(mut items: Vec<T>, name: impl Fn(&T) -> &str, hold_out: HoldOut) -> (Vec<T>, Vec<T>) {
    items.sort_by(|a, b| {
        let (a, b) = (name(a), name(b));
        stem(a).cmp(stem(b)).then_with(|| a.cmp(b))
    });
    let numbered = items.into_iter().enumerate();
    let (train, test): (Vec<_>, Vec<_>) = numbered.partition(|(index, _)| hold_out == HoldOut::None || index % 8 != 0);
    let items = |part: Vec<(usize, T)>| part.into_iter().map(|(_, item)| item).collect();
    (items(train), items(test))
}

fn stem(name: &str) -> &str {
    name.split('.').next().unwrap_or(name)
}
