//! Gaussians that no photo supports: where they are follows from no two photos that agree.

use genesplat_core::{BackendError, Camera, Device, Gaussians, RenderSettings, View, median};
use glam::DVec3;

use crate::scene::nearest::mean_squared_distances_of;

/// No photo shows a Gaussian whose blending weights in all of them have a lower sum, pixels. Those that are
/// shown faintly hold many pixels together, so the least that is visible counts.
const SHOWN: f32 = 0.1;
/// Fewer photos than this do not tell how far away it is, where it is suspicious already.
const FEW: f32 = 3.0;
/// With so many, nothing but one photo has a say.
const ONE: f32 = 1.02;
/// It is right in front of a camera within this part of the way from there to the middle of the splat.
const NEAR: f64 = 0.1;
/// It is alone if its three nearest neighbours are farther than so many times its own size.
const ALONE: f32 = 10.0;

/// Why a Gaussian has no support. Each has the first of these that holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Unsupported {
    /// No photo shows it.
    Unseen,
    /// It is right in front of a camera, and at most two photos show it.
    Near,
    /// Nothing is around it, and at most two photos show it.
    Alone,
    /// One photo shows it, so that nothing says how far away it is.
    Once,
}

impl Unsupported {
    /// All of them, in their order.
    pub const ALL: [Self; 4] = [Self::Unseen, Self::Near, Self::Alone, Self::Once];
}

/// How much photos show a Gaussian.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Support {
    /// Sum of its blending weights in all photos, pixels.
    weight: f32,
    /// Sum of the squares of its weight in each.
    squares: f32,
}

impl Support {
    /// That of a Gaussian which has these weights in photos, pixels.
    pub fn of(weights: impl IntoIterator<Item = f32>) -> Self {
        let mut support = Self::default();
        weights.into_iter().for_each(|weight| support.add(weight));
        support
    }

    fn add(&mut self, weight: f32) {
        self.weight += weight;
        self.squares += weight * weight;
    }

    /// Of how many photos its weight is, if it is spread evenly: fewer where one has most of it.
    fn photos(&self) -> f32 {
        if self.squares > 0.0 { self.weight * self.weight / self.squares } else { 0.0 }
    }
}

/// How much `views` show each Gaussian that `device` holds `[N]`. They become its training views.
pub fn support(
    device: &mut dyn Device,
    views: &[View],
    settings: &RenderSettings,
    mut on_view: impl FnMut(usize),
) -> Result<Vec<Support>, BackendError> {
    device.set_views(views)?;
    let mut support = vec![Support::default(); device.gaussian_count()];
    for (at, view) in views.iter().enumerate() {
        let pixels = view.camera.width as usize * view.camera.height as usize;
        for of_view in device.blending_weights(&[at], &|_| Ok(vec![1.0; pixels]), settings)? {
            support.iter_mut().zip(of_view).for_each(|(support, weight)| support.add(weight));
        }
        on_view(at + 1);
    }
    Ok(support)
}

/// Why each Gaussian has no support, of those that have none `[N]`; positions are finite.
pub fn unsupported(cloud: &Gaussians, cameras: &[Camera], support: &[Support]) -> Vec<Option<Unsupported>> {
    let middle = |axis: usize| median(cloud.positions.iter().map(|p| f64::from(p[axis]))).unwrap_or(0.0);
    let middle = DVec3::new(middle(0), middle(1), middle(2));
    let few = |row: &u32| support[*row as usize].photos() < FEW;
    let few: Vec<u32> = (0..cloud.len() as u32).filter(few).collect();
    let distances = mean_squared_distances_of(&cloud.positions, &few);
    let mut reasons = vec![None; cloud.len()];
    for (&row, squared) in few.iter().zip(distances) {
        let row = row as usize;
        let size = cloud.log_scales[row].into_iter().fold(f32::MIN, f32::max).exp();
        let position = DVec3::from(cloud.positions[row].map(f64::from));
        reasons[row] = if support[row].weight < SHOWN {
            Some(Unsupported::Unseen)
        } else if cameras.iter().any(|camera| is_in_front(camera, position, middle)) {
            Some(Unsupported::Near)
        } else if squared.sqrt() > ALONE * size {
            Some(Unsupported::Alone)
        } else {
            (support[row].photos() < ONE).then_some(Unsupported::Once)
        };
    }
    reasons
}

/// Whether the camera has this close to itself, and in its picture.
fn is_in_front(camera: &Camera, position: DVec3, middle: DVec3) -> bool {
    let seen = camera.camera_from_world(position);
    let reach = NEAR * camera.centre_in_world().distance(middle);
    if seen.z <= 0.0 || seen.z > reach {
        return false;
    }
    let [u, v] = camera.pixel_from_camera(seen);
    (0.0..f64::from(camera.width)).contains(&u) && (0.0..f64::from(camera.height)).contains(&v)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall of 20 by 20 Gaussians, ten units before a camera at the origin.
    fn wall() -> Gaussians {
        let positions: Vec<[f32; 3]> =
            (0..400).map(|k| [(k % 20) as f32 * 0.1 - 1.0, (k / 20) as f32 * 0.1 - 1.0, 10.0]).collect();
        Gaussians { log_scales: vec![[-3.0; 3]; 400], positions, ..Gaussians::zeros(400) }
    }

    #[test]
    fn each_reason_is_found() {
        let mut cloud = wall();
        cloud.positions[1] = [0.0, 0.0, 0.5];
        cloud.positions[2] = [0.0, 0.0, -0.5];
        cloud.positions[3] = [2.0, 2.0, 4.0];
        let cameras = [Camera::at_origin(100, 100, 100.0)];
        let mut support = vec![Support::of([1.0; 5]); 400];
        let weights: [&[f32]; 6] = [&[0.04, 0.05], &[1.0, 2.0], &[1.0; 5], &[0.3], &[5.0, 0.02], &[1.0, 1.0]];
        for (support, weights) in support.iter_mut().zip(weights) {
            *support = Support::of(weights.iter().copied());
        }
        let reasons = unsupported(&cloud, &cameras, &support);
        assert_eq!(
            reasons[..6],
            [
                Some(Unsupported::Unseen),
                Some(Unsupported::Near),
                None,
                Some(Unsupported::Alone),
                Some(Unsupported::Once),
                None
            ]
        );
        assert!(reasons[6..].iter().all(Option::is_none));
    }

    #[test]
    fn what_many_photos_show_stays_wherever_it_is() {
        let mut cloud = wall();
        cloud.positions[0] = [0.0, 0.0, 0.5];
        cloud.positions[1] = [50.0, 0.0, 0.0];
        let reasons =
            unsupported(&cloud, &[Camera::at_origin(100, 100, 100.0)], &[Support::of([0.2; 3]); 400]);
        assert!(reasons.iter().all(Option::is_none));
    }
}
