//! How many Gaussians there may be.

use genesplat_core::View;

use crate::config::TrainConfig;
use crate::scene::coarse::coarse_share;
use crate::schedule::Schedule;
use crate::timeline::{Event, Growth};

/// Training pixels that count to each Gaussian, for each of √(number of photos), since photos show the same
/// things.
const PIXELS: f64 = 2.0;

/// Gaussians for each root of the number of training pixels, which is the lower limit where photos have more
/// than 20,000 pixels (160 px): finer photos show the same with more of them. (Measured at 160 and 480 px.)
const PER_ROOT_PIXEL: f64 = 70.0;

/// Pixels of one photo (their mean) to each Gaussian, however many photos there are: the lower limit from 45
/// photos on.
const PHOTO_PIXELS: f64 = 0.3;

/// Part of what the photos can determine that a run with a denser cloud starts from: the rest grows where it
/// is needed. (A dense cloud of plush, 600 steps at 160 px: 21.6 dB with all of the cap, 25.4 with half of
/// it, 26.1 with a quarter.)
const DENSE_SHARE: f64 = 0.25;

/// The most Gaussians that density control may grow to, by who says so.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Cap {
    /// The user's limit.
    asked: Option<usize>,
    /// The published limit of the density control, where it has one.
    published: Option<usize>,
    /// What the photos can determine, with the method's `capacity`: with more, a cloud learns photos by
    /// heart.
    from_photos: Option<usize>,
}

impl Cap {
    pub(crate) fn new(config: &TrainConfig, views: &[View]) -> Self {
        let (method, capacity) = (config.method.name.method(), config.method.capacity);
        let from_photos = (capacity > 0.0).then(|| cap_from_photos(views, capacity));
        let published = method.published_cap();
        Self { asked: config.max_gaussians, published, from_photos }
    }

    /// The lower of what is asked for and what the photos can determine, or what is published where nobody
    /// says anything.
    pub(crate) fn get(self) -> Option<usize> {
        self.asked.into_iter().chain(self.from_photos).min().or(self.published)
    }

    /// Points that a run may start from, of `all` that there are: a dense cloud (LiDAR, multi-view stereo)
    /// has more than the photos can determine, and leaves no room where Gaussians are needed. A published
    /// method without a limit keeps all.
    pub(crate) fn most_points(self, all: usize) -> usize {
        let dense = self.from_photos.filter(|&most| all > most);
        let from_photos = dense.map(|most| (most as f64 * DENSE_SHARE) as usize);
        self.asked.into_iter().chain(from_photos).min().unwrap_or(usize::MAX)
    }

    /// Not all of the scene's points are started from.
    pub(crate) fn notice_of_thinned_points(self, all: usize) -> Option<String> {
        let most = self.most_points(all);
        let source = match self.asked {
            Some(asked) if asked == most => "--max-gaussians",
            _ => {
                "a quarter of what the photos can determine, so that the rest can grow where it is needed; method.capacity"
            }
        };
        (all > most).then(|| format!("the scene's {all} points are thinned evenly to {most} ({source})"))
    }

    /// It cannot wait until that limit is reached: MCMC refuses nothing, so there would be nothing to tell
    /// then.
    pub(crate) fn notice_of_lower_cap(self) -> Option<String> {
        self.asked.or(self.published)?;
        let from_photos = self.from_photos?;
        self.asked.is_none_or(|asked| from_photos < asked).then(|| {
            let beside = self.asked.map_or(String::new(), |asked| format!(", and not to the limit of {asked}"));
            format!(
                "the cloud grows no further than {from_photos} Gaussians, which is what the photos can determine \
                 (method.capacity){beside}"
            )
        })
    }

    /// The limit of `cap` is reached in iteration `i`, and `refused` more wanted to grow; `is_last`: no
    /// densification follows.
    pub(crate) fn notice_of_full_cloud(self, cap: usize, i: u32, refused: usize, is_last: bool) -> String {
        let is_from_photos = self.from_photos == Some(cap) && self.asked != Some(cap);
        let source = if is_from_photos { " from the photos (method.capacity)" } else { "" };
        let rest = if is_last { "" } else { "; from now on there is only the room that pruning leaves" };
        format!(
            "iteration {i}: the limit of {cap} Gaussians{source} is reached ({refused} more wanted to grow){rest}"
        )
    }
}

/// How many Gaussians a run will end with, about: its cap or, without one, as many as the photos can
/// determine.
pub fn expected_gaussians(config: &TrainConfig, views: &[View]) -> usize {
    Cap::new(config, views).get().unwrap_or_else(|| cap_from_photos(views, 1.0))
}

/// How many Gaussians a run from so many points begins with.
pub fn starting_gaussians(config: &TrainConfig, views: &[View], points: usize) -> usize {
    points.min(Cap::new(config, views).most_points(points))
}

/// What is known beforehand of how a cloud, and the photos that steps see, will grow.
#[derive(Clone, Debug, PartialEq)]
pub struct GrowthToCome {
    /// At each percent of the run, where density control follows a plan.
    planned: Option<Vec<f64>>,
    iterations: u32,
    until: u32,
    most: Option<f64>,
    /// The iteration from which on steps see all pixels, and the part of them that they see before.
    full_photos: (u32, f64),
}

impl GrowthToCome {
    /// Of a run with these settings on these photos.
    pub fn new(schedule: &Schedule, views: &[View]) -> Self {
        let schedule = schedule.on(views.len());
        let timeline = schedule.timeline();
        let most = Cap::new(schedule.config(), views).get().map(|cap| cap as f64);
        let iterations = schedule.iterations.max(1);
        let at = |percent: u32| (u64::from(iterations) * u64::from(percent) / 100) as u32;
        let planned = most
            .filter(|_| timeline.growth != Growth::Free)
            .map(|most| (0..=100).map(|percent| most * timeline.grown(at(percent))).collect());
        let full_photos = timeline.first(Event::FullPhotos);
        let full_photos = full_photos.map_or((0, 1.0), |from| (from, coarse_share(views)));
        Self { planned, iterations, until: timeline.densify.until, most, full_photos }
    }

    /// Gaussians that are planned for an iteration.
    pub fn planned(&self, iteration: u32) -> Option<f64> {
        let percent = 100 * u64::from(iteration) / u64::from(self.iterations);
        self.planned.as_ref().map(|planned| planned[percent.min(100) as usize].max(1.0))
    }

    /// The part of a photo's pixels that the step of an iteration sees.
    pub fn seen(&self, iteration: u32) -> f64 {
        let (from, before) = self.full_photos;
        if iteration > from { 1.0 } else { before }
    }

    /// The iteration from which on there is no growth.
    pub fn until(&self) -> u32 {
        self.until
    }

    /// Gaussians that there will be at most.
    pub fn most(&self) -> Option<f64> {
        self.most
    }
}

/// As many Gaussians as the photos can determine, times `capacity`.
fn cap_from_photos(views: &[View], capacity: f64) -> usize {
    let pixels_of = |view: &View| view.counted_pixels() as f64;
    let (all, photos) = (views.iter().map(pixels_of).sum::<f64>(), views.len() as f64);
    let limits = [all / (PIXELS * photos.sqrt()), PER_ROOT_PIXEL * all.sqrt(), all / photos / PHOTO_PIXELS];
    let least = limits.into_iter().fold(f64::INFINITY, f64::min);
    ((least * capacity) as usize).max(1)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use genesplat_core::{Camera, Mask, Photo, StoredPhoto};

    use super::*;
    use crate::method::MethodName;

    #[test]
    fn the_lower_of_the_limits_counts() {
        let camera = Camera::at_origin(30, 20, 1.0);
        let photo = Photo { width: 30, height: 20, rgb: vec![0; 1800] }.into();
        let views = vec![View { name: String::new(), camera, photo, mask: None, depth: None }; 9];
        let of = |method, max_gaussians, capacity| {
            let mut config = TrainConfig { max_gaussians, ..TrainConfig::of(method) };
            config.method.capacity = capacity;
            Cap::new(&config, &views)
        };
        use MethodName::{Genesplat, ImprovedGs, Mcmc, PixelGs, ThreeDgs};
        let notice = |max_gaussians| of(ImprovedGs, max_gaussians, 1.0).notice_of_lower_cap();
        assert!(notice(Some(1000)).unwrap().ends_with("and not to the limit of 1000"));
        assert!(notice(None).unwrap().ends_with("(method.capacity)"), "nobody has set the published limit");
        assert_eq!(notice(Some(900)), None);
        // A dense cloud leaves room to grow; what is published keeps every point.
        let starts = |method, asked, capacity| of(method, asked, capacity).most_points(901);
        assert_eq!((starts(Genesplat, None, 1.0), starts(Genesplat, Some(100), 1.0)), (225, 100));
        assert_eq!((starts(ThreeDgs, None, 0.0), starts(ThreeDgs, Some(7), 0.0)), (usize::MAX, 7));
        let told = |points| of(Genesplat, None, 1.0).notice_of_thinned_points(points);
        assert_eq!(told(900), None, "the points of photos are kept");
        assert!(
            told(901).unwrap().starts_with("the scene's 901 points are thinned evenly to 225 (a quarter")
        );
        let cap = |method, max_gaussians, capacity| of(method, max_gaussians, capacity).get();
        // 9 · 600 pixels over 2 · √9, which is less than 600 over 0.3.
        assert_eq!(cap(Genesplat, None, 1.0), Some(900));
        assert_eq!(cap(Genesplat, None, 0.5), Some(450));
        assert_eq!(cap(Genesplat, Some(500), 1.0), Some(500));
        assert_eq!(cap(ImprovedGs, None, 1.0), Some(900));
        // The published limit is none where photos can determine more.
        assert_eq!(cap(Genesplat, None, 1e6), Some(900_000_000));
        assert_eq!(cap(Genesplat, None, 0.0), Some(1_000_000));
        assert_eq!(cap(PixelGs, None, 0.0), None);
        assert_eq!(cap(ThreeDgs, None, 1.0), Some(900));
        assert_eq!(cap(Mcmc, None, 0.0), Some(1_000_000));
        assert_eq!(cap(ImprovedGs, Some(7), 0.0), Some(7));
        let half = Arc::new(Mask { counts: (0..600).map(|pixel| pixel < 300).collect() });
        let masked: Vec<View> =
            views.iter().map(|view| View { mask: Some(half.clone()), ..view.clone() }).collect();
        assert_eq!(cap_from_photos(&masked, 1.0), 450, "what is hidden determines nothing");
        let many = vec![views[0].clone(); 100];
        assert_eq!(cap_from_photos(&many, 1.0), 2000, "600 pixels of one photo over 0.3");
        let (width, height) = (400, 400);
        let photo = StoredPhoto::from(Photo { width, height, rgb: vec![0; 480_000] });
        let fine = vec![View { name: String::new(), camera, photo, mask: None, depth: None }; 16];
        assert_eq!(cap_from_photos(&fine, 1.0), 112_000, "70 times the root of 16 · 160,000 pixels");
    }
}
