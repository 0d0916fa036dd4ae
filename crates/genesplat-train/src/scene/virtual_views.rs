//! Virtual views: what the cloud itself shows from between the photos.
//!
//! Where photos are seen often, steps learn each of them by heart, and what lies between them gets worse. So
//! late steps look in turn at a photo and at a picture that the cloud has made from halfway between two of
//! them: the running mean of what it showed there, which holds fast what all photos agreed on. (Means of
//! earlier outputs as a target: Laine and Aila, "Temporal ensembling for semi-supervised learning", 2017.
//! Views between few photos: RegNeRF, FSGS.)

use std::collections::BTreeSet;
use std::sync::Arc;

use genesplat_core::memory::ensure_memory;
use genesplat_core::{BackendError, Camera, Device, Image, Photo, RenderSettings, Rng, Stream, View};

use super::views::ViewOrder;
use crate::schedule::Schedule;
use crate::timeline::{VirtualSteps, Visit};

/// Each photo has one with so many of its neighbours.
const NEIGHBOURS: usize = 2;

/// What a new picture counts in the running mean.
const NEW: f32 = 0.2;

/// So many are looked at again at a time.
const REFRESHED: usize = 16;

/// Main memory for what they show, 512 MiB: all neighbours of a hundred photos of two megapixels. Where it is
/// too little, some of them are left out, evenly.
const PICTURES_BYTES: usize = 512 << 20;

/// They are visited in an order of their own.
const ORDER: u32 = u32::from_be_bytes(*b"virt");

/// The virtual views of a run.
pub(crate) struct VirtualViews {
    /// When steps look at them; `None` for never, and there are none.
    steps: Option<VirtualSteps>,
    views: Vec<VirtualView>,
    order: ViewOrder,
    rng: Rng,
    /// What they show, 8-bit; empty before the first look.
    pictures: Vec<Arc<Photo>>,
}

/// A place halfway between two photos.
struct VirtualView {
    /// For messages.
    name: String,
    camera: Camera,
}

impl VirtualViews {
    /// Halfway between each photo and its nearest neighbours. Near are cameras that stand and look alike: a
    /// turn counts as much as the way of what is at `extent`, the scene's, in world units.
    pub(crate) fn new(photos: &[View], steps: Option<VirtualSteps>, extent: f64, rng: Rng) -> Self {
        let photos = if steps.is_some() { photos } else { &[] };
        let near = |a| nearest(photos, a, extent).into_iter().map(move |b| (a.min(b), a.max(b)));
        let pairs: BTreeSet<_> = (0..photos.len()).flat_map(near).collect();
        let views = pairs.into_iter().map(|(a, b)| VirtualView::halfway(&photos[a], &photos[b])).collect();
        let views = within(views, PICTURES_BYTES);
        Self { steps, order: ViewOrder::new(rng.fork(ORDER), views.len()), views, rng, pictures: Vec::new() }
    }

    /// When steps look at them.
    pub(crate) fn steps(&self) -> Option<VirtualSteps> {
        self.steps
    }

    /// What the step of iteration `i` looks at. (A run that was resumed with other settings may have no
    /// pictures yet.)
    pub(crate) fn visit(&self, i: u32) -> Visit {
        let steps = self.steps.filter(|_| self.are_shown());
        steps.map_or(Visit::Photo(i - 1), |steps| steps.visit(i))
    }

    /// The view of the `visit`-th look, counted from 0.
    pub(crate) fn view(&mut self, visit: u32) -> usize {
        self.order.view(visit)
    }

    /// The device has them.
    pub(crate) fn are_shown(&self) -> bool {
        !self.pictures.is_empty()
    }

    /// What a resumed run goes on with.
    pub(crate) fn pictures(&self) -> &[Arc<Photo>] {
        &self.pictures
    }

    /// Pictures of a run with the same photos, which one without virtual views has no use for; false where
    /// they are of other photos.
    pub(crate) fn restore(&mut self, pictures: Vec<Arc<Photo>>) -> bool {
        if self.steps.is_none() {
            return true;
        }
        let size = |view: &VirtualView| [view.camera.width, view.camera.height];
        let fits =
            pictures.iter().map(|picture| [picture.width, picture.height]).eq(self.views.iter().map(size));
        self.pictures = pictures;
        fits || self.pictures.is_empty()
    }

    /// Looks at the cloud in iteration `i`, the first time from everywhere, and gives the device the photos
    /// and, after them, what it has shown. Does nothing in a run without virtual views.
    pub(crate) fn refresh(
        &mut self,
        backend: &mut dyn Device,
        photos: &[View],
        settings: &RenderSettings,
        i: u32,
    ) -> Result<(), BackendError> {
        if self.steps.is_none() {
            return Ok(());
        }
        let pictures = self.looked_at(backend, settings, i)?;
        backend.set_views(&self.with(photos, &pictures))?;
        self.pictures = pictures;
        Ok(())
    }

    fn looked_at(
        &self,
        backend: &mut dyn Device,
        settings: &RenderSettings,
        i: u32,
    ) -> Result<Vec<Arc<Photo>>, BackendError> {
        let look = |backend: &mut dyn Device, index: usize| -> Result<_, BackendError> {
            let shown = backend.render(&self.views[index].camera, settings)?;
            let old = self.pictures.get(index).map(Arc::as_ref);
            Ok(Arc::new(blended(old, &shown, &self.rng, [i, index as u32])))
        };
        if self.pictures.is_empty() {
            ensure_memory(self.views.iter().map(VirtualView::bytes).sum(), "the pictures of virtual views")?;
            return (0..self.views.len()).map(|index| look(backend, index)).collect();
        }
        let mut pictures = self.pictures.clone();
        for index in
            self.rng.permutation(Stream::VirtualTurn, i, self.views.len()).into_iter().take(REFRESHED)
        {
            pictures[index as usize] = look(backend, index as usize)?;
        }
        Ok(pictures)
    }

    /// The photos, and after them the virtual views as pictures show them.
    pub(crate) fn after(&self, photos: &[View]) -> Vec<View> {
        self.with(photos, &self.pictures)
    }

    fn with(&self, photos: &[View], pictures: &[Arc<Photo>]) -> Vec<View> {
        let shown = |(VirtualView { name, camera }, picture): (&VirtualView, &Arc<Photo>)| View {
            name: name.clone(),
            camera: *camera,
            photo: picture.clone().into(),
            mask: None,
            depth: None,
        };
        photos.iter().cloned().chain(self.views.iter().zip(pictures).map(shown)).collect()
    }
}

impl VirtualView {
    /// With the lens of the first.
    fn halfway(a: &View, b: &View) -> Self {
        let [from, to] = [a, b].map(|view| view.camera.camera_from_world_rotation.normalize());
        // Of a rotation's two quaternions the one that is nearer.
        let rotation = from.slerp(if from.dot(to) < 0.0 { -to } else { to }, 0.5);
        let centre = a.camera.centre_in_world().midpoint(b.camera.centre_in_world());
        Self {
            name: format!("between {} and {}", a.name, b.name),
            camera: Camera {
                camera_from_world_rotation: rotation,
                camera_from_world_translation: -(rotation * centre),
                ..a.camera
            },
        }
    }

    /// Of its picture.
    fn bytes(&self) -> usize {
        3 * self.camera.width as usize * self.camera.height as usize
    }
}

/// Bytes that their pictures take at most in a run with these photos; 0 where it has none.
pub fn virtual_picture_bytes(schedule: &Schedule, photos: &[View]) -> usize {
    let bytes = |photo: &View| NEIGHBOURS * 3 * photo.photo.pixels();
    let all = || photos.iter().map(bytes).sum::<usize>().min(PICTURES_BYTES);
    schedule.virtual_steps(photos.len()).map_or(0, |_| all())
}

/// All views where their pictures have no more than `bytes`, else as many as that allows, evenly chosen.
fn within(views: Vec<VirtualView>, bytes: usize) -> Vec<VirtualView> {
    let (all, wanted) = (views.len(), views.iter().map(VirtualView::bytes).sum::<usize>());
    if wanted <= bytes {
        return views;
    }
    let kept = (all as u64 * bytes as u64 / wanted as u64).max(1) as usize;
    let is_kept = |index: usize| (index + 1) * kept / all > index * kept / all;
    views.into_iter().enumerate().filter(|(index, _)| is_kept(*index)).map(|(_, view)| view).collect()
}

/// The nearest neighbours of a view.
fn nearest(views: &[View], view: usize, extent: f64) -> Vec<usize> {
    let distance = |b: usize| distance(&views[view].camera, &views[b].camera, extent);
    let mut others: Vec<_> = (0..views.len()).filter(|&b| b != view).map(|b| (distance(b), b)).collect();
    others.sort_by(|(x, _), (y, _)| x.total_cmp(y));
    others.into_iter().take(NEIGHBOURS).map(|(_, b)| b).collect()
}

/// Between the places of two cameras, and between what they look at, an extent of the scene ahead of them.
fn distance(a: &Camera, b: &Camera, extent: f64) -> f64 {
    let [from, to] = [a, b].map(Camera::centre_in_world);
    let target = |camera: &Camera| camera.centre_in_world() + extent * camera.axis_in_world();
    from.distance(to) + target(a).distance(target(b))
}

/// The running mean after one more picture. It is kept as photos are: rounded up or down by chance, so that
/// small changes add up; `address` is that of the chance.
fn blended(old: Option<&Photo>, new: &Image, rng: &Rng, address: [u32; 2]) -> Photo {
    let pixels = new.width as usize * new.height as usize;
    let mut rgb = vec![0; 3 * pixels];
    for (pixel, out) in rgb.chunks_exact_mut(3).enumerate() {
        let chance = rng.at(Stream::VirtualPicture, address[0], address[1], pixel as u32);
        for (channel, out) in out.iter_mut().enumerate() {
            let shown = 255.0 * new.planes[channel * pixels + pixel].clamp(0.0, 1.0);
            let mean = old.map_or(shown, |old| {
                let old = f32::from(old.rgb[3 * pixel + channel]);
                old + NEW * (shown - old)
            });
            *out = (mean + chance.uniform(channel)) as u8;
        }
    }
    Photo { width: new.width, height: new.height, rgb }
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};

    use super::*;
    use crate::config::TrainConfig;

    fn view(name: &str, degrees: f64) -> View {
        // On a circle around the origin, towards which it looks.
        let rotation = DQuat::from_rotation_y(degrees.to_radians());
        let camera = Camera {
            camera_from_world_rotation: rotation,
            camera_from_world_translation: DVec3::new(0.0, 0.0, 4.0),
            ..Camera::at_origin(2, 1, 2.0)
        };
        View {
            name: name.into(),
            camera,
            photo: Photo { width: 2, height: 1, rgb: vec![0; 6] }.into(),
            mask: None,
            depth: None,
        }
    }

    #[test]
    fn pictures_stay_within_their_memory() {
        // Six bytes each.
        let views =
            || (0..10).map(|i| VirtualView::halfway(&view(&i.to_string(), 0.0), &view("", 9.0))).collect();
        let names = |bytes| within(views(), bytes).into_iter().map(|view| view.name).collect::<Vec<_>>();
        assert_eq!(names(60).len(), 10);
        assert_eq!(names(29), ["between 2 and ", "between 4 and ", "between 7 and ", "between 9 and "]);
        assert_eq!(names(0), ["between 9 and "]);
    }

    #[test]
    fn what_pictures_take_is_known_before_the_run() {
        let bytes = |photos: usize| {
            let config = TrainConfig { iterations: 7000, ..TrainConfig::default() };
            virtual_picture_bytes(&Schedule::new(config), &vec![view("", 0.0); photos])
        };
        // Two pictures of six bytes for each photo; of 29, none is seen 250 times.
        assert_eq!([1, 2, 28, 29].map(bytes), [0, 24, 336, 0]);
    }

    #[test]
    fn a_virtual_camera_stands_and_looks_halfway() {
        let mut other = view("b", 50.0);
        // The same rotation.
        other.camera.camera_from_world_rotation *= -1.0;
        let VirtualView { name, camera } = VirtualView::halfway(&view("a", 10.0), &other);
        assert_eq!(name, "between a and b");
        let wanted = view("", 30.0).camera;
        assert!(camera.rotation().abs_diff_eq(wanted.rotation(), 1e-12));
        // On the chord of the circle.
        let centre = wanted.centre_in_world() * 20f64.to_radians().cos();
        assert!(camera.centre_in_world().abs_diff_eq(centre, 1e-12), "{}", camera.centre_in_world());
    }

    #[test]
    fn photos_have_them_with_their_two_nearest() {
        let photos = [0.0, 5.0, 11.0, 90.0].map(|degrees| view(&degrees.to_string(), degrees));
        let VirtualViews { views, .. } =
            VirtualViews::new(&photos, Some(VirtualSteps { from: 1, every: 2 }), 4.0, Rng::new(0));
        let names: Vec<_> = views.iter().map(|view| view.name.as_str()).collect();
        let wanted = ["0 and 5", "0 and 11", "5 and 11", "5 and 90", "11 and 90"];
        assert!(
            names.iter().zip(wanted).all(|(name, wanted)| *name == format!("between {wanted}")),
            "{names:?}"
        );
        assert_eq!(names.len(), wanted.len());
    }

    #[test]
    fn what_looks_elsewhere_is_far_away() {
        let ahead = view("", 0.0).camera;
        let turned = |degrees: f64| {
            let rotation = DQuat::from_rotation_y(degrees.to_radians());
            // At the same place.
            let translation = -(rotation * ahead.centre_in_world());
            Camera {
                camera_from_world_rotation: rotation,
                camera_from_world_translation: translation,
                ..ahead
            }
        };
        assert!((distance(&ahead, &turned(180.0), 4.0) - 8.0).abs() < 1e-9);
        assert!(distance(&ahead, &turned(20.0), 4.0) < distance(&ahead, &turned(30.0), 4.0));
    }

    /// A difference below one step of 8 bits is neither lost nor exaggerated.
    #[test]
    fn the_running_mean_follows_small_changes() {
        let (width, height) = (200, 100);
        let old = Photo { width, height, rgb: vec![100; 60_000] };
        let mut new = Image::zeros(width, height);
        new.planes.fill(101.5 / 255.0);
        let mean = |old| {
            let photo = blended(old, &new, &Rng::new(3), [7, 2]);
            assert!(photo.rgb.iter().all(|value| [100, 101, 102].contains(value)));
            photo.rgb.iter().map(|&value| f64::from(value)).sum::<f64>() / 60_000.0
        };
        // Six standard errors of 60,000 coins.
        let tolerance = 6.0 * 0.5 / 60_000f64.sqrt();
        assert!((mean(Some(&old)) - 100.3).abs() < tolerance, "{}", mean(Some(&old)));
        assert!((mean(None) - 101.5).abs() < tolerance, "{}", mean(None));
    }
}
