//! A scene for tests.

use std::sync::LazyLock;

use genesplat_gallery::{Gallery, GalleryOptions, generate};

/// Nine small photos and twenty points, made once: lighting the gallery takes longest.
pub(crate) fn gallery() -> Gallery {
    static GALLERY: LazyLock<Gallery> =
        LazyLock::new(|| generate(&GalleryOptions { width: 16, height: 16, views: 9, points: 20, seed: 1 }));
    GALLERY.clone()
}
