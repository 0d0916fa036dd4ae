//! What a run began with: its settings, and digests of its photos, masks, cameras and points.
//!
//! A run's folder has it in `inputs.json`, and its checkpoint has it, too, so that nothing goes on with
//! something else unnoticed. Files are known by their bytes (`sha256sum` finds the same), wherever they lie.

use std::fmt::Display;
use std::io::{BufReader, ErrorKind};
use std::path::Path;

use anyhow::{Result, anyhow, bail, ensure};
use genesplat_io::{Offset, PhotoDigests, Scene, SceneDigests, input, shown};
use genesplat_train::Checkpoint;
use serde::{Deserialize, Serialize};

use super::session::Caller;
use super::{CHECKPOINT, CONFIG, INPUTS, photos};
use crate::cameras::Cameras;
use crate::corrected::Corrected;
use crate::exposure::Exposure;
use crate::output;
use crate::settings::{Settings, difference_of_results};

/// What `inputs.json` holds, and a checkpoint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Inputs {
    /// Those on which the result depends, as TOML.
    pub settings: String,
    /// Its photos, masks, cameras and points.
    pub scene: SceneDigests,
    /// That of its photos, where they were brought to one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure: Option<Exposure>,
    /// How its cameras were moved, where they were.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cameras: Option<Cameras>,
    /// What has changed meanwhile, and was accepted when the run was resumed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    accepted: Vec<String>,
}

impl Inputs {
    /// Those of a run with these settings on `scene`, of which this was put right.
    pub fn of(settings: &Settings, scene: &Scene, corrected: &Corrected) -> Self {
        let (settings, scene) = (settings.of_result(), scene.digests.clone());
        let Corrected { cameras, exposure } = corrected.clone();
        Self { settings, scene, exposure, cameras, accepted: Vec::new() }
    }

    /// As `inputs.json` holds it.
    pub fn to_json(&self) -> String {
        serde_json::to_string_pretty(self).expect("text and digests are always JSON") + "\n"
    }

    /// Those of the run in `folder`; `None` where an older version has written it.
    pub fn read(folder: &Path) -> Result<Option<Self>> {
        let path = folder.join(INPUTS);
        let text = match input::read(&path) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            text => text.map_err(|error| anyhow!("cannot read {}: {error}", shown(&path)))?,
        };
        let damaged = |error| {
            anyhow!(
                "{} is damaged ({error}), so nobody knows what the run began with; bring it back, or remove that folder",
                shown(&path)
            )
        };
        serde_json::from_slice(&text).map(Some).map_err(damaged)
    }

    /// Those of the run whose checkpoint is in `folder`.
    pub fn of_checkpoint(folder: &Path) -> Result<Self> {
        let path = folder.join(CHECKPOINT);
        let file = input::open(&path).map_err(|error| anyhow!("cannot read {}: {error}", shown(&path)))?;
        let origin = Checkpoint::read_origin(BufReader::new(file))
            .map_err(|error| anyhow!("{}: {error}", shown(&path)))?;
        serde_json::from_str(&origin).map_err(|_| {
            anyhow!(
                "{} does not say what its run began with; remove it to begin the run anew, without --resume",
                shown(&path)
            )
        })
    }
}

/// What the scene of the run in `folder` was moved by when it began: nothing, for one that says what it began
/// with, and not this. `None` where that is not known.
pub fn offset(folder: &Path) -> Option<Offset> {
    let inputs = Inputs::read(folder).ok().flatten()?;
    Some(inputs.scene.offset.unwrap_or_default())
}

/// What of the run in `folder` was run with other settings than these, by what it and its checkpoint say. One
/// that is not known is left to who reads it.
pub fn other_settings(folder: &Path, settings: &Settings) -> Option<String> {
    let here = settings.of_result();
    let differ = |name: &str, inputs: &Inputs| {
        difference_of_results(&inputs.settings, &here)
            .map(|difference| format!("by its {name}, {difference}"))
    };
    match Inputs::read(folder) {
        Err(error) => return Some(error.to_string()),
        Ok(inputs) => inputs.and_then(|inputs| differ(INPUTS, &inputs)),
    }
    .or_else(|| Inputs::of_checkpoint(folder).ok().and_then(|inputs| differ(CHECKPOINT, &inputs)))
}

/// Fails where the checkpoint in `folder` is of another run than the one that goes on with `now`, or the
/// scene called `name` is not what it began with, unless that is accepted. What has been accepted is noted in
/// `now`.
pub fn check_goes_on(
    folder: &Path,
    now: &mut Inputs,
    name: &str,
    caller: Caller,
    accepts: bool,
) -> Result<()> {
    let began = Inputs::of_checkpoint(folder)?;
    if let Some(difference) = difference_of_results(&began.settings, &now.settings) {
        bail!(
            "{} is of another run than {} beside it ({difference}); bring back the one that belongs to the other, or remove the \
             checkpoint to begin the run anew",
            shown(folder.join(CHECKPOINT)),
            CONFIG
        );
    }
    ensure!(
        began.exposure == now.exposure && began.cameras == now.cameras,
        "the run in {} began with photos of another exposure, or with cameras elsewhere; {}",
        shown(folder),
        advice(caller)
    );
    now.accepted.clone_from(&began.accepted);
    let changes = Changes::between(&began.scene, &now.scene);
    let Some(change) = changes.told(folder, name) else { return Ok(()) };
    if accepts {
        output::tell(&format!("notice: {change}; the run goes on with what is there now"));
        now.accepted.extend(changes.0);
        return Ok(());
    }
    // The folder knows its scene, and the checkpoint another one.
    let is_foreign = Inputs::read(folder).is_ok_and(|kept| kept.is_some_and(|kept| kept.scene == now.scene));
    let checkpoint = shown(folder.join(CHECKPOINT));
    let of = if is_foreign { format!("{checkpoint} is of another run: ") } else { String::new() };
    bail!("{of}{change}; {}", advice(caller))
}

fn advice(caller: Caller) -> &'static str {
    match caller {
        Caller::Train => {
            "bring it back as it was, choose another --out, or add --accept-changes to go on with what is there now"
        }
        Caller::Experiment | Caller::Demo => {
            "bring it back as it was, choose another --out, or remove that folder to have it run anew"
        }
    }
}

/// Fails where the finished run in `folder` began with another scene.
pub fn check_began_with(folder: &Path, scene: &Scene) -> Result<()> {
    let Some(began) = Inputs::read(folder)? else { return photos::check(folder, scene) };
    let change = Changes::between(&began.scene, &scene.digests).told(folder, &scene.name);
    change.map_or(Ok(()), |change| bail!("{change}; {}", advice(Caller::Experiment)))
}

/// Fails where the runs in two folders, whose figures or splats come together, began with different scenes.
pub fn check_alike(folders: [&Path; 2], inputs: [&Inputs; 2]) -> Result<()> {
    let change = Changes::between(&inputs[0].scene, &inputs[1].scene).0.into_iter().next();
    change.map_or(Ok(()), |change| {
        bail!(
            "{} and {} began with different scenes: for the latter, {change}; choose another --out, or remove the one that is \
             out of date to have it run anew",
            shown(folders[0]),
            shown(folders[1])
        )
    })
}

/// Fails where the runs in two folders have a photo of one name that is not the same.
pub fn check_shared(folders: [&Path; 2], inputs: [&Inputs; 2]) -> Result<()> {
    let of_photo = |photo: &PhotoDigests| {
        let other = inputs[1].scene.photo(&photo.name)?;
        changes_of(photo, other).into_iter().next()
    };
    let change = inputs[0].scene.photos.iter().find_map(of_photo);
    change.map_or(Ok(()), |change| {
        bail!(
            "{} and {} began with different photos: for the latter, {change}; split the scene as it is now, and train its blocks \
             anew",
            shown(folders[0]),
            shown(folders[1])
        )
    })
}

/// Tells who looks at what the run in `folder` has made that photos or cameras of the scene called `name` are
/// not those that it began with.
pub fn notice_changes(began: &SceneDigests, folder: &Path, now: &SceneDigests, name: &str) {
    if let Some(change) = Changes::of_photos(began, now).told(folder, name) {
        output::tell(&format!("notice: {change}"));
    }
}

/// What differs between a scene and what it was, a clause each.
struct Changes(Vec<String>);

impl Changes {
    fn between(began: &SceneDigests, now: &SceneDigests) -> Self {
        let Self(mut changes) = Self::of_photos(began, now);
        let split = began.photos.iter().filter_map(|photo| {
            let now = now.photo(&photo.name)?;
            let name = shown(&photo.name);
            match (photo.held_out, now.held_out) {
                (true, false) => {
                    Some(format!("photo {name} is trained on, and was held out when the run began"))
                }
                (false, true) => {
                    Some(format!("photo {name} is held out, and was trained on when the run began"))
                }
                _ => None,
            }
        });
        let new = now.photos.iter().filter(|photo| began.photo(&photo.name).is_none());
        changes.extend(split);
        changes.extend(
            new.map(|photo| format!("photo {} was not there when the run began", shown(&photo.name))),
        );
        let points_differ = began.points.zip(now.points).is_some_and(|(began, now)| began != now);
        changes.extend(points_differ.then(|| "the points are not what the run began with".to_owned()));
        Self(changes)
    }

    /// Those of the photos that the run began with, and of their cameras.
    fn of_photos(began: &SceneDigests, now: &SceneDigests) -> Self {
        let of_photo = |photo: &PhotoDigests| match now.photo(&photo.name) {
            Some(now) => changes_of(photo, now),
            None => vec![format!("photo {}, which the run began with, is not there", shown(&photo.name))],
        };
        Self(began.photos.iter().flat_map(of_photo).collect())
    }

    /// The first, and how many there are; `None` where there is none.
    fn told(&self, folder: &Path, scene: &str) -> Option<String> {
        let (first, count) = (self.0.first()?, self.0.len());
        let count = if count > 1 { format!("the first of {count} changes; ") } else { String::new() };
        Some(format!("{first} ({count}the run is {}, the scene {})", shown(folder), shown(scene)))
    }
}

fn changes_of(began: &PhotoDigests, now: &PhotoDigests) -> Vec<String> {
    let name = shown(&began.name);
    let not_the_same = |what: &dyn Display| format!("{what} is not what the run began with");
    let photo = format!("photo {name}");
    let mask = match (began.mask, now.mask) {
        (None, Some(_)) => Some(format!("{photo} has a mask, and had none when the run began")),
        (Some(_), None) => Some(format!("{photo} has no mask, and had one when the run began")),
        (began, now) => (began != now).then(|| not_the_same(&format!("the mask of {photo}"))),
    };
    let depth = (began.depth != now.depth).then(|| not_the_same(&format!("the depth map of {photo}")));
    let picture = (began.photo != now.photo).then(|| not_the_same(&photo));
    let lens = (began.lens != now.lens)
        .then(|| not_the_same(&format!("the camera (size, focal length or lens) of {photo}")));
    let pose = (began.pose != now.pose).then(|| not_the_same(&format!("the pose of {photo}")));
    [picture, mask, depth, lens, pose].into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use genesplat_io::{Digest, HoldOut};

    use super::*;
    use crate::small_scene;

    fn digests() -> SceneDigests {
        small_scene::gallery().into_scene(HoldOut::EveryEighth).digests
    }

    #[test]
    fn every_change_is_named() {
        let other = Digest::of(b"other");
        type Change = fn(&mut SceneDigests, Digest);
        let cases: [(Change, &str); 9] = [
            (|_, _| (), ""),
            (
                |scene, other| scene.photos[3].photo = other,
                "photo gallery_003.png is not what the run began with",
            ),
            (
                |scene, other| scene.photos[3].mask = Some(other),
                "photo gallery_003.png has a mask, and had none",
            ),
            (|scene, other| scene.photos[3].pose = other, "the pose of photo gallery_003.png is not"),
            (
                |scene, other| scene.photos[3].lens = other,
                "the camera (size, focal length or lens) of photo gallery_003",
            ),
            (
                |scene, _| _ = scene.photos.remove(3),
                "photo gallery_003.png, which the run began with, is not there",
            ),
            (
                |scene, _| scene.photos[8].name = "z.png".into(),
                "photo gallery_008.png, which the run began with, is not",
            ),
            (
                |scene, _| scene.photos[0].held_out = false,
                "photo gallery_000.png is trained on, and was held out",
            ),
            (|scene, other| scene.points = Some(other), "the points are not what the run began with"),
        ];
        for (change, words) in cases {
            let (began, mut now) = (digests(), digests());
            change(&mut now, other);
            let told = Changes::between(&began, &now).told(Path::new("run"), "scene").unwrap_or_default();
            assert!(told.starts_with(words) && told.is_empty() == words.is_empty(), "{words}: {told}");
            // And back.
            assert_eq!(Changes::between(&now, &began).0.is_empty(), words.is_empty());
        }
        let (began, mut now) = (digests(), digests());
        (now.photos[3].photo, now.photos[4].photo) = (began.photos[4].photo, began.photos[3].photo);
        let told = Changes::between(&began, &now).told(Path::new("run"), "scene").unwrap();
        assert!(told.ends_with("(the first of 2 changes; the run is run, the scene scene)"), "{told}");
        now = SceneDigests { points: None, ..digests() };
        assert!(Changes::between(&began, &now).0.is_empty(), "who looks at a splat loads no points");
    }

    #[test]
    fn a_damaged_file_is_a_sentence_and_a_missing_one_is_none() {
        let folder = tempfile::tempdir().unwrap();
        assert!(Inputs::read(folder.path()).unwrap().is_none());
        let gain = [0.1, 1.0 / 3.0, 1.7];
        let exposure = Exposure {
            stops: 0.53,
            explained: 0.351,
            photos: [("a.png".to_owned(), gain)].into(),
            dark: 0.7,
            contrasts: [("a.jpg".to_owned(), 1.1)].into(),
            fall_off: -0.1,
            plain_corners: ["a.jpg".to_owned()].into(),
        };
        for exposure in [None, Some(exposure)] {
            let (settings, scene) = ("seed = 1".into(), digests());
            let inputs = Inputs { settings, scene, exposure, cameras: None, accepted: Vec::new() };
            fs::write(folder.path().join(INPUTS), inputs.to_json()).unwrap();
            assert_eq!(Inputs::read(folder.path()).unwrap(), Some(inputs));
        }
        fs::write(folder.path().join(INPUTS), "{\"settings\": 1}").unwrap();
        let error = Inputs::read(folder.path()).unwrap_err().to_string();
        assert!(error.contains("inputs.json is damaged"), "{error}");
    }
}
