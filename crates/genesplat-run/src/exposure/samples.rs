//! What photos show where they see the points of the reconstruction.

use genesplat_core::{Mask, Photo, PhotoLost, View};
use genesplat_io::{Point, Scene};
use glam::Vec3;
use rayon::prelude::*;

use super::fall_off::radius_squared;

/// Darkest and brightest value that is believed: beyond, a photo is clipped.
const BELIEVED: std::ops::RangeInclusive<u8> = 5..=245;

/// Most times that photos see points: more tell no more, and take memory.
const SEEN_MAX: usize = 1_000_000;

/// A photo at the place of a point: the mean of 3x3 pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample {
    pub(super) point: u32,
    /// Whether it lies in the left half of the photo.
    pub(super) is_left: bool,
    /// Where it lies between the middle, 0, and a corner, 1.
    pub(super) radius_squared: f32,
    /// Logarithms of red, green and blue.
    pub(super) logs: [f32; 3],
}

/// The samples of each photo of which `views` are a part: the views of one photo follow each other, and have
/// one exposure.
pub(super) fn of_photos(scene: &Scene, views: &[View]) -> Result<Vec<Vec<Sample>>, PhotoLost> {
    // The same points in all photos, or nothing would be shared.
    let every = scene.seen.values().map(Vec::len).sum::<usize>().div_ceil(SEEN_MAX).max(1) as u32;
    let of_view = |view: &View| -> Result<Vec<Sample>, PhotoLost> {
        let Some(seen) = scene.seen.get(scene.photo_of(&view.name)) else { return Ok(Vec::new()) };
        let photo = view.photo.read()?;
        let mask = view.mask.as_deref();
        let seen = seen.iter().map(|sight| sight.point).filter(|point| point % every == 0);
        let place = |point: u32| scene.points.get(point as usize);
        Ok(seen.filter_map(|point| sample(view, &photo, mask, point, place(point)?)).collect())
    };
    let of_views: Vec<Vec<Sample>> = views.par_iter().map(of_view).collect::<Result<_, PhotoLost>>()?;
    let mut rest = of_views.into_iter();
    Ok(by_photo(scene, views).map(|views| rest.by_ref().take(views.len()).flatten().collect()).collect())
}

/// The views of each photo.
pub(crate) fn by_photo<'a>(scene: &'a Scene, views: &'a [View]) -> impl Iterator<Item = &'a [View]> {
    views.chunk_by(|a, b| scene.photo_of(&a.name) == scene.photo_of(&b.name))
}

fn sample(view: &View, photo: &Photo, mask: Option<&Mask>, point: u32, place: &Point) -> Option<Sample> {
    let in_camera = view.camera.camera_from_world(Vec3::from(place.position).as_dvec3());
    if in_camera.z < view.camera.near {
        return None;
    }
    let pixel = view.camera.pixel_from_camera(in_camera).map(f64::round);
    let sides = [photo.width, photo.height].map(f64::from);
    // Of a pixel beside the border there are not nine.
    let is_inside = (0..2).all(|axis| pixel[axis] >= 1.0 && pixel[axis] <= sides[axis] - 2.0);
    let [x, y] = is_inside.then(|| pixel.map(|coordinate| coordinate as u32))?;
    let mut sums = [0u32; 3];
    for (x, y) in (y - 1..=y + 1).flat_map(|y| (x - 1..=x + 1).map(move |x| (x, y))) {
        let rgb = photo.pixel(x, y);
        let counts = mask.is_none_or(|mask| mask.counts[(y * photo.width + x) as usize]);
        if !counts || !rgb.iter().all(|value| BELIEVED.contains(value)) {
            return None;
        }
        sums.iter_mut().zip(rgb).for_each(|(sum, value)| *sum += u32::from(value));
    }
    let logs = sums.map(|sum| (sum as f32 / (9.0 * 255.0)).ln());
    let radius_squared = radius_squared(&view.camera, f64::from(x) + 0.5, f64::from(y) + 0.5) as f32;
    Some(Sample { point, is_left: 2 * x < photo.width, radius_squared, logs })
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use genesplat_core::Camera;
    use genesplat_io::{HoldOut, Sight};

    use super::*;
    use crate::small_scene;

    fn view(rgb: impl Fn(u32, u32) -> u8, mask: Option<Mask>) -> View {
        let camera = Camera::at_origin(20, 10, 10.0);
        let pixels = (0..10).flat_map(|y| (0..20).map(move |x| (x, y)));
        let rgb = pixels.flat_map(|(x, y)| [rgb(x, y); 3]).collect();
        let photo = Photo { width: 20, height: 10, rgb }.into();
        View { name: "a".into(), camera, photo, mask: mask.map(Arc::new), depth: None }
    }

    fn sight(point: u32) -> Sight {
        Sight { point, ray: None }
    }

    /// The points at the middles of these pixels, at depth 2.
    fn samples(view: View, pixels: &[[f32; 2]]) -> Vec<Sample> {
        let point = |[x, y]: [f32; 2]| Point {
            position: [0.2 * (x + 0.5 - 10.0), 0.2 * (y + 0.5 - 5.0), 2.0],
            rgb: [0; 3],
        };
        let mut points: Vec<Point> = pixels.iter().copied().map(point).collect();
        points.push(Point { position: [0.0, 0.0, -2.0], rgb: [0; 3] });
        let seen = [("a".to_owned(), (0..points.len() as u32 + 1).map(sight).collect())].into();
        let mut scene = small_scene::gallery().into_scene(HoldOut::None);
        (scene.points, scene.seen) = (points, seen);
        of_photos(&scene, &[view]).unwrap().remove(0)
    }

    #[test]
    fn a_sample_is_the_mean_of_nine_pixels_around_a_point() {
        let found =
            samples(view(|x, y| if (x, y) == (4, 3) { 190 } else { 100 }, None), &[[5.0, 3.0], [15.0, 8.0]]);
        let log = (110.0f32 / 255.0).ln();
        assert_eq!((found[0].point, found[0].is_left, found[1].is_left), (0, true, false));
        assert!(
            (found[0].logs[1] - log).abs() < 1e-6
                && (found[1].logs[2] - (100.0f32 / 255.0).ln()).abs() < 1e-6
        );
    }

    #[test]
    fn parts_of_a_photo_have_its_samples_together() {
        let mut scene = small_scene::gallery().into_scene(HoldOut::None);
        scene.points = vec![Point { position: [0.1, 0.1, 2.0], rgb: [0; 3] }];
        scene.seen = ["a", "b"].map(|photo| (photo.to_owned(), vec![sight(0)])).into();
        scene.whole = ["a.front", "a.up"].map(|part| (part.to_owned(), "a".to_owned())).into();
        let views = ["a.front", "a.up", "b"].map(|name| View { name: name.into(), ..view(|_, _| 100, None) });
        assert_eq!(by_photo(&scene, &views).map(<[View]>::len).collect::<Vec<_>>(), [2, 1]);
        let samples = of_photos(&scene, &views).unwrap();
        assert_eq!(samples.iter().map(Vec::len).collect::<Vec<_>>(), [2, 1]);
    }

    #[test]
    fn clipped_hidden_and_cut_places_are_left_out() {
        let places = [[5.0, 3.0], [0.0, 3.0], [19.0, 3.0], [5.0, 9.0], [25.0, 3.0]];
        let of = |bad: u8| samples(view(|x, y| if (x, y) == (6, 4) { bad } else { 100 }, None), &places);
        assert_eq!([4, 5, 245, 246].map(|bad| of(bad).len()), [0, 1, 1, 0]);
        let mask = Mask { counts: (0..200).map(|at| at != 4 * 20 + 6).collect() };
        assert!(samples(view(|_, _| 100, Some(mask)), &places).is_empty());
    }
}
