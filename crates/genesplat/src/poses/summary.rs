//! What a search for cameras has found, in figures and in words.

use std::collections::{BTreeMap, HashSet};
use std::fs;
use std::path::Path;

use anyhow::{Result, anyhow, bail};
use genesplat::io::colmap::{find_model, read_model};
use genesplat::io::{input, plural, shown};
use genesplat::run::files::write_own_json;
use genesplat::run::numbers::thousands;
use serde::{Deserialize, Serialize};

/// Below the folder of the stages; where it is, the search is done.
const SUMMARY: &str = "summary.json";
/// So many photos that were left out are named.
const NAMED_MAX: usize = 3;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Summary {
    /// Folder of the largest model among those that were found.
    pub(crate) model: String,
    pub(crate) photos: usize,
    pub(crate) registered: usize,
    pub(crate) points: usize,
    pub(crate) reprojection_error_px: Option<f64>,
    /// Photos that have no camera.
    pub(crate) left_out: Vec<String>,
    /// Models that photos were found for apart from the largest.
    pub(crate) other_models: usize,
}

impl Summary {
    /// Of the model with the most photos in the folder `models`; `names` are all photos.
    pub(crate) fn of_largest(
        models: &Path,
        names: &[String],
        errors_px: &BTreeMap<String, f64>,
    ) -> Result<Self> {
        let entries =
            fs::read_dir(models).map_err(|error| anyhow!("cannot read {}: {error}", shown(models)))?;
        let mut found = Vec::new();
        for entry in entries.flatten() {
            if let Some(folder) = find_model(&entry.path()) {
                found.push((entry.file_name().to_string_lossy().into_owned(), read_model(&folder)?));
            }
        }
        // Of equal ones, the first.
        found
            .sort_by(|(a_name, a), (b_name, b)| b.images.len().cmp(&a.images.len()).then(a_name.cmp(b_name)));
        let other_models = found.len().saturating_sub(1);
        let Some((name, model)) = found.into_iter().next() else {
            bail!(
                "no cameras were found for these {} photos; they need to show the same things from places that differ by small steps, \
                 sharp and with texture: take more, and walk around what you photograph",
                names.len()
            );
        };
        let registered: HashSet<&str> = model.images.iter().map(|image| image.name.as_str()).collect();
        let left_out = names.iter().filter(|name| !registered.contains(name.as_str())).cloned().collect();
        Ok(Self {
            reprojection_error_px: errors_px.get(&name).copied(),
            model: name,
            photos: names.len(),
            registered: model.images.len(),
            points: model.points.len(),
            left_out,
            other_models,
        })
    }

    /// That of an earlier search, if it came to its end.
    pub(crate) fn read(work: &Path) -> Result<Option<Self>> {
        let file = work.join(SUMMARY);
        let Ok(bytes) = input::read(&file) else { return Ok(None) };
        let problem = "is damaged; remove it to find the cameras again";
        serde_json::from_slice(&bytes).map(Some).map_err(|_| anyhow!("{} {problem}", shown(file)))
    }

    pub(crate) fn write(&self, work: &Path) -> Result<()> {
        write_own_json(work, SUMMARY, self)
    }

    /// One line of figures, and one of advice where photos were left out.
    pub(crate) fn sentences(&self) -> Vec<String> {
        let Self { photos, registered, points, reprojection_error_px, left_out, .. } = self;
        let error = reprojection_error_px.map_or(String::new(), |error| {
            format!("; on average a point is found {error:.2} pixels from where its camera should see it")
        });
        let mut sentences = vec![format!(
            "found the cameras of {registered} of {photos} photos, and {} points{error}",
            thousands(*points)
        )];
        if !left_out.is_empty() {
            let named = left_out.iter().take(NAMED_MAX).cloned().collect::<Vec<_>>().join(", ");
            let more = if left_out.len() > NAMED_MAX { ", ..." } else { "" };
            let apart = match self.other_models {
                0 => "they share too little with the others, or are blurred",
                _ => "they belong together in groups that share too little with this one",
            };
            sentences.push(format!(
                "notice: {} {} left out ({named}{more}): {apart}; take photos in between, in small steps",
                left_out.len(),
                plural(left_out.len(), "photo is", "photos are")
            ));
        }
        sentences
    }
}

#[cfg(test)]
mod tests {
    use genesplat::gallery::{self, GalleryOptions};
    use genesplat::io::colmap::write_model;

    use super::*;

    #[test]
    fn the_largest_model_counts_and_photos_without_a_camera_are_named() {
        let place = tempfile::tempdir().unwrap();
        let options = GalleryOptions { width: 16, height: 16, views: 9, points: 20, seed: 1 };
        let scene = place.path().join("scene");
        gallery::generate(&options).write_colmap(&scene).unwrap();
        let mut model = read_model(&find_model(&scene).unwrap()).unwrap();
        let names: Vec<String> = model.images.iter().map(|image| image.name.clone()).collect();
        let models = place.path().join("models");
        for (folder, photos) in [("0", 2), ("1", 7)] {
            model.images = read_model(&find_model(&scene).unwrap()).unwrap().images;
            model.images.truncate(photos);
            write_model(&models.join(folder), &model).unwrap();
        }
        let summary = Summary::of_largest(&models, &names, &[("1".to_owned(), 0.57)].into()).unwrap();
        assert_eq!((summary.model.as_str(), summary.registered, summary.other_models), ("1", 7, 1));
        assert_eq!(summary.left_out, names[7..]);
        let said = summary.sentences().join("\n");
        assert!(
            said.contains("7 of 9 photos") && said.contains("0.57 pixels") && said.contains(&names[8]),
            "{said}"
        );
        summary.write(place.path()).unwrap();
        assert_eq!(Summary::read(place.path()).unwrap(), Some(summary));
        let none =
            Summary::of_largest(&scene.join("images"), &names, &BTreeMap::new()).unwrap_err().to_string();
        assert!(none.contains("no cameras were found for these 9 photos"), "{none}");
    }
}
