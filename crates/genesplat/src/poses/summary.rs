//! What a search for cameras has found, in figures and in words.

use std::collections::HashSet;
use std::fs;
use std::path::Path;

use anyhow::{Result, anyhow, bail};
use genesplat::io::colmap::{find_model, read_model};
use genesplat::io::{input, plural, shown};
use genesplat::run::files::write_own_json;
use genesplat::run::numbers::thousands;
use serde::{Deserialize, Serialize};

use super::stages::Outcome;

/// Below the folder of the stages; where it is, the search is done.
pub(crate) const SUMMARY: &str = "summary.json";
/// So many photos that were left out are named.
const NAMED_MAX: usize = 3;

/// The cameras that were found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Folder of the largest model among those that were found.
    pub model: String,
    /// Photos that were given.
    pub photos: usize,
    /// Those that have a camera.
    pub registered: usize,
    /// Points of the model.
    pub points: usize,
    /// Mean over its points, px.
    pub reprojection_error_px: Option<f64>,
    /// Photos that have no camera.
    pub left_out: Vec<String>,
    /// Models with some of these.
    pub other_models: usize,
    /// Which pairs of photos were compared. Not known of searches by older versions, and of films that the
    /// program `colmap` has searched.
    #[serde(default)]
    pub compared: Option<Compared>,
}

/// Which pairs of photos were compared.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Compared {
    /// Pairs that were compared.
    pub pairs: usize,
    /// Pairs that there are.
    pub of: usize,
    /// `looks`, `place`, `order`; nothing where all pairs were compared.
    #[serde(default)]
    pub chosen_by: Vec<String>,
    /// Whether each photo that is left out was compared with each that is not.
    pub left_out_with_all: bool,
}

impl Compared {
    pub(crate) fn all_of(photos: usize) -> Self {
        let pairs = pairs_of(photos);
        Self { pairs, of: pairs, chosen_by: Vec::new(), left_out_with_all: true }
    }

    fn sentence(&self) -> String {
        let Self { pairs, of, chosen_by, .. } = self;
        let chosen = match &chosen_by[..] {
            [] => String::new(),
            [one] => format!(", chosen by {one}"),
            [first @ .., last] => format!(", chosen by {} and {last}", first.join(", ")),
        };
        match pairs == of {
            true => format!("compared all {} pairs of photos", thousands(*of)),
            false => format!("compared {} of {} pairs of photos{chosen}", thousands(*pairs), thousands(*of)),
        }
    }
}

/// Why a search has found no model.
pub(crate) fn none_found(photos: usize) -> String {
    format!(
        "no cameras were found for these {photos} photos; they need to show the same things from places that differ by small steps, \
         sharp and with texture: take more, and walk around what you photograph"
    )
}

/// How many pairs there are of so many photos.
pub(crate) fn pairs_of(photos: usize) -> usize {
    photos * photos.saturating_sub(1) / 2
}

impl Summary {
    /// Of the model with the most photos in the folder `models`; `names` are all photos.
    pub(crate) fn of_largest(
        models: &Path,
        names: &[String],
        Outcome { errors_px, compared }: &Outcome,
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
        let mut found = found.into_iter();
        let Some((name, model)) = found.next() else {
            bail!(none_found(names.len()));
        };
        let registered: HashSet<&str> = model.images.iter().map(|image| image.name.as_str()).collect();
        let is_left_out = |name: &str| !registered.contains(name);
        let other_models =
            found.filter(|(_, other)| other.images.iter().any(|image| is_left_out(&image.name))).count();
        let left_out = names.iter().filter(|name| is_left_out(name)).cloned().collect();
        Ok(Self {
            reprojection_error_px: errors_px.get(&name).copied(),
            model: name,
            photos: names.len(),
            registered: model.images.len(),
            points: model.points.len(),
            left_out,
            other_models,
            compared: compared.clone(),
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

    /// A line of figures, one of what was compared, and one of advice where photos were left out.
    pub fn sentences(&self) -> Vec<String> {
        let Self { photos, registered, points, reprojection_error_px, compared, .. } = self;
        let error = reprojection_error_px.map_or(String::new(), |error| {
            format!("; on average a point is found {error:.2} pixels from where its camera should see it")
        });
        let found = format!(
            "found the cameras of {registered} of {photos} photos, and {} points{error}",
            thousands(*points)
        );
        let compared = compared.as_ref().map(Compared::sentence);
        [Some(found), compared, self.advice()].into_iter().flatten().collect()
    }

    fn advice(&self) -> Option<String> {
        let left_out = &self.left_out;
        let named = left_out.iter().take(NAMED_MAX).cloned().collect::<Vec<_>>().join(", ");
        let more = if left_out.len() > NAMED_MAX { ", ..." } else { "" };
        (!left_out.is_empty()).then(|| {
            format!(
                "notice: {} {} left out ({named}{more}): {}",
                left_out.len(),
                plural(left_out.len(), "photo is", "photos are"),
                self.cause()
            )
        })
    }

    /// Why photos are left out, and what to do.
    fn cause(&self) -> &'static str {
        match (&self.compared, self.other_models) {
            (None, _) => {
                "they share too little with those that they were compared with, or are blurred; take photos in between, in small steps"
            }
            (Some(compared), _) if !compared.left_out_with_all => {
                "they share too little with the photos that look most alike, and were not compared with all others; --all-pairs does \
                 that and goes on from here, or take photos in between, in small steps"
            }
            (Some(_), 0) => {
                "they share too little with the others, or are blurred; take photos in between, in small steps"
            }
            (Some(_), _) => {
                "they belong together in groups that share too little with this one; take photos in between, in small steps"
            }
        }
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
        let compared = Compared { pairs: 30, left_out_with_all: false, ..Compared::all_of(9) };
        let outcome = Outcome { errors_px: [("1".to_owned(), 0.57)].into(), compared: Some(compared) };
        let summary = Summary::of_largest(&models, &names, &outcome).unwrap();
        assert_eq!((summary.model.as_str(), summary.registered, summary.other_models), ("1", 7, 0));
        assert_eq!(summary.left_out, names[7..]);
        let said = summary.sentences().join("\n");
        assert!(
            said.contains("7 of 9 photos") && said.contains("0.57 pixels") && said.contains(&names[8]),
            "{said}"
        );
        summary.write(place.path()).unwrap();
        assert_eq!(Summary::read(place.path()).unwrap(), Some(summary));
        let none =
            Summary::of_largest(&scene.join("images"), &names, &Outcome::default()).unwrap_err().to_string();
        assert!(none.contains("no cameras were found for these 9 photos"), "{none}");
    }
    fn summary(other_models: usize, compared: Option<Compared>) -> String {
        let left_out = ["a.jpg".to_owned()].into();
        let (model, reprojection_error_px) = ("0".to_owned(), None);
        let summary = Summary {
            model,
            photos: 9,
            registered: 8,
            points: 9,
            reprojection_error_px,
            left_out,
            other_models,
            compared,
        };
        summary.sentences().join("\n")
    }

    #[test]
    fn what_was_compared_is_said_and_the_cause_fits_it() {
        let some = |chosen_by: &[&str], left_out_with_all| {
            let chosen_by = chosen_by.iter().map(|by| by.to_string()).collect();
            Some(Compared { pairs: 1200, of: 3160, chosen_by, left_out_with_all })
        };
        let all = summary(0, Some(Compared::all_of(9)));
        assert!(all.contains("compared all 36 pairs of photos\n") && all.contains("blurred"), "{all}");
        let looks = summary(1, some(&["looks"], true));
        assert!(looks.contains("compared 1,200 of 3,160 pairs of photos, chosen by looks\n"), "{looks}");
        assert!(looks.contains("belong together in groups"), "{looks}");
        let many = summary(0, some(&["looks", "place", "order"], false));
        assert!(many.contains("chosen by looks, place and order\n"), "{many}");
        assert!(many.contains("were not compared with all others; --all-pairs does"), "{many}");
        let unknown = summary(0, None);
        assert!(unknown.contains("with those that they were compared with"), "{unknown}");
    }
}
