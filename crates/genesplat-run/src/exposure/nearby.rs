//! The exposure that a photo is expected to have before anybody has looked at it: that of training photos
//! which were taken nearby, or shortly before and after. Which of these tell it best, and how many, is what
//! training photos say of each other.

use genesplat_core::camera::mean_and_radius;
use genesplat_core::{Camera, View};
use glam::DVec3;

use super::Exposure;

/// Who is asked of a photo's exposure.
#[derive(Clone, Copy)]
enum Neighbours {
    /// Nobody: the mean exposure is expected.
    None,
    /// So many whose names are next in order, as those of a video are.
    ByName(usize),
    /// So many that were taken from near places in like directions.
    ByPose(usize),
}

const CHOICES: [Neighbours; 5] = [
    Neighbours::None,
    Neighbours::ByName(2),
    Neighbours::ByPose(2),
    Neighbours::ByPose(4),
    Neighbours::ByPose(8),
];

/// Training photos that say, at most, which of these is best.
const ASKED_MAX: usize = 500;

/// The logarithms of the gains of red, green and blue, and of the contrast.
type Logs = [f64; 4];

/// Where and when a photo was taken.
#[derive(Clone, Copy)]
struct Taken {
    camera: Camera,
    /// Its place in the order of names, of training and test photos together.
    order: f64,
}

/// Training photos whose exposure is known.
struct Known {
    photos: Vec<(Taken, Logs)>,
    /// Radius of the places that they were taken from, world units.
    radius: f64,
}

impl Exposure {
    /// The same, with what it says of `test` made without a look at these photos.
    pub fn foretold(&self, train: &[View], test: &[View]) -> Self {
        let mut names: Vec<&str> = train.iter().chain(test).map(|view| view.name.as_str()).collect();
        names.sort_unstable();
        let taken = |view: &View| Taken {
            camera: view.camera,
            order: names.partition_point(|name| *name < view.name.as_str()) as f64,
        };
        let known = Known::of(self, train, taken);
        let neighbours = known.best();
        let mut foretold = self.only(|name| test.iter().all(|view| view.name != name));
        for view in test {
            let logs = known.expected(&taken(view), None, neighbours);
            let [r, g, b, contrast] = logs.map(|log| log.exp() as f32);
            foretold.photos.insert(view.name.clone(), [r, g, b]);
            foretold.contrasts.insert(view.name.clone(), contrast);
        }
        foretold
    }
}

impl Known {
    fn of(exposure: &Exposure, train: &[View], taken: impl Fn(&View) -> Taken) -> Self {
        let logs = |view: &View| {
            let [r, g, b] = exposure.gain(&view.name);
            [r, g, b, exposure.contrast(&view.name)].map(|factor| f64::from(factor).ln())
        };
        let views = train.iter().filter(|view| exposure.photos.contains_key(&view.name));
        let photos: Vec<(Taken, Logs)> = views.map(|view| (taken(view), logs(view))).collect();
        let places: Vec<DVec3> = photos.iter().map(|(taken, _)| taken.camera.centre_in_world()).collect();
        Self { photos, radius: mean_and_radius(&places).1.max(f64::MIN_POSITIVE) }
    }

    /// By these neighbours, of all but the one left out.
    fn expected(&self, taken: &Taken, left_out: Option<usize>, neighbours: Neighbours) -> Logs {
        let (count, far): (_, &dyn Fn(&Taken) -> f64) = match neighbours {
            Neighbours::None => return Logs::default(),
            Neighbours::ByName(count) => (count, &|other| (taken.order - other.order).powi(2)),
            Neighbours::ByPose(count) => (count, &|other| self.apart_squared(&taken.camera, &other.camera)),
        };
        let others = self.photos.iter().enumerate().filter(|(other, _)| Some(*other) != left_out);
        let mut near: Vec<(f64, usize)> = others.map(|(at, (other, _))| (far(other), at)).collect();
        near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        near.truncate(count);
        let nearest = near.first().map_or(1.0, |(far, _)| far.max(1e-9));
        let (mut sum, mut logs) = (f64::MIN_POSITIVE, Logs::default());
        for (far, at) in near {
            let weight = 1.0 / (far + nearest);
            sum += weight;
            logs.iter_mut().zip(self.photos[at].1).for_each(|(log, other)| *log += weight * other);
        }
        logs.map(|log| log / sum)
    }

    /// The square of how far places are from each other, in radii, and directions, in radians.
    fn apart_squared(&self, a: &Camera, b: &Camera) -> f64 {
        let apart = a.centre_in_world().distance(b.centre_in_world()) / self.radius;
        apart.powi(2) + a.axis_in_world().angle_between(b.axis_in_world()).powi(2)
    }

    /// Those by which training photos, each left out in turn, come nearest to what they have.
    fn best(&self) -> Neighbours {
        let every = self.photos.len().div_ceil(ASKED_MAX).max(1);
        let error = |neighbours: Neighbours| -> f64 {
            let of = |(at, (taken, logs)): (usize, &(Taken, Logs))| -> f64 {
                let expected = self.expected(taken, Some(at), neighbours);
                expected.iter().zip(logs).map(|(a, b)| (a - b).powi(2)).sum()
            };
            self.photos.iter().enumerate().step_by(every).map(of).sum()
        };
        let errors = CHOICES.map(error);
        let best = (1..CHOICES.len()).fold(0, |best, at| if errors[at] < errors[best] { at } else { best });
        CHOICES[best]
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use genesplat_core::Photo;

    use super::*;

    /// Views from places along a line.
    fn views(name: &str, places: impl Iterator<Item = f64>) -> Vec<View> {
        let view = |(number, place): (usize, f64)| {
            let mut camera = Camera::at_origin(1, 1, 1.0);
            camera.camera_from_world_translation.x = -place;
            let photo = Photo { width: 1, height: 1, rgb: vec![9; 3] }.into();
            View { name: format!("{name}{number}"), camera, photo, mask: None, depth: None }
        };
        places.enumerate().map(view).collect()
    }

    /// What is said of training photos whose gains are these, and of some that nobody should believe.
    fn exposure(train: &[View], test: &[View], gain: impl Fn(usize) -> f32) -> Exposure {
        let known = train.iter().enumerate().map(|(at, view)| (view.name.clone(), [gain(at), 1.0, 1.0]));
        let own = test.iter().map(|view| (view.name.clone(), [7.0; 3]));
        Exposure {
            stops: 1.0,
            explained: 1.0,
            photos: known.chain(own).collect(),
            contrasts: BTreeMap::new(),
            dark: 1.0,
            fall_off: -0.1,
            plain_corners: test.iter().map(|view| view.name.clone()).collect(),
        }
    }

    #[test]
    fn an_exposure_that_drifts_is_that_of_neighbours_and_no_test_photo_is_asked() {
        let train = views("train", (0..30).map(f64::from));
        let test = views("test", [3.4, 21.9].into_iter());
        let gain = |place: f32| (0.05 * place - 0.7).exp();
        let said = exposure(&train, &test, |at| gain(at as f32));
        let foretold = said.foretold(&train, &test);
        for (view, place) in test.iter().zip([3.4, 21.9]) {
            let ratio = foretold.gain(&view.name)[0] / gain(place);
            assert!((ratio - 1.0).abs() < 0.03, "{ratio}");
            assert_eq!((foretold.gain(&view.name)[1], foretold.contrast(&view.name)), (1.0, 1.0));
            assert_eq!(foretold.fall_off_of(&view.name), -0.1, "the lens of training photos is expected");
        }
        assert_eq!(foretold.gain("train9"), said.gain("train9"));
    }

    #[test]
    fn where_neighbours_tell_nothing_the_mean_exposure_is_expected() {
        let train = views("train", (0..30).map(f64::from));
        let test = views("test", [14.5].into_iter());
        let alternating = exposure(&train, &test, |at| [0.7, 1.4][at % 2]);
        assert_eq!(alternating.foretold(&train, &test).gain("test0"), [1.0; 3]);
        assert_eq!(alternating.foretold(&[], &test).gain("test0"), [1.0; 3]);
    }
}
