//! What the motions of all cameras have in common. A scene may be turned, shifted, scaled and bent a little
//! with its cameras, and photos hardly show it; only where cameras stood tells. Their errors are taken to be
//! another one for each photo, so of each number of the motions, what is linear in the place of the camera is
//! none of them.

use genesplat_core::{Camera, camera::mean_and_radius};
use glam::DVec3;

use super::motion::Motion;
use super::solve::Equations;

/// So little that it decides only what cameras do not: those in a plane say nothing of what is across.
const UNDECIDED: f64 = 1e-6;

/// What takes it back of cameras that stood where `given` do: a motion for each.
pub(super) fn without_common(given: &[Camera], motions: &[Motion]) -> Vec<Motion> {
    let centres: Vec<DVec3> = given.iter().map(Camera::centre_in_world).collect();
    let (mean, radius) = mean_and_radius(&centres);
    let arms: Vec<DVec3> =
        centres.iter().map(|centre| (*centre - mean) / radius.max(f64::MIN_POSITIVE)).collect();
    let linear = |number: &dyn Fn(&Motion) -> f64| {
        let values: Vec<f64> = motions.iter().map(number).collect();
        linear_part(&arms, &values)
    };
    let turns = [0, 1, 2].map(|axis| linear(&|motion| motion.turn[axis]));
    let shifts = [0, 1, 2].map(|axis| linear(&|motion| motion.shift[axis]));
    let back = |at: usize| Motion {
        turn: [0, 1, 2].map(|axis| -turns[axis][at]),
        shift: [0, 1, 2].map(|axis| -shifts[axis][at]),
    };
    (0..given.len()).map(back).collect()
}

/// The linear function of `arms` that is nearest to `values`, at each.
fn linear_part(arms: &[DVec3], values: &[f64]) -> Vec<f64> {
    let mut equations = Equations::<4>::default();
    for (arm, value) in arms.iter().zip(values) {
        equations.add([1.0, arm.x, arm.y, arm.z], -value, 1.0);
    }
    for unknown in 0..4 {
        equations.add(std::array::from_fn(|at| f64::from(u8::from(at == unknown))), 0.0, UNDECIDED);
    }
    let [constant, x, y, z] = equations.solved(0.0).unwrap_or_default();
    arms.iter().map(|arm| constant + DVec3::new(x, y, z).dot(*arm)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cameras(place: impl Fn(f64) -> DVec3) -> Vec<Camera> {
        let at = |at: i32| Camera {
            camera_from_world_translation: -place(f64::from(at) - 10.0),
            ..Camera::at_origin(40, 30, 50.0)
        };
        (0..21).map(at).collect()
    }

    #[test]
    fn what_all_have_in_common_is_taken_back_and_the_rest_is_kept() {
        let places: [fn(f64) -> DVec3; 3] = [
            |at| DVec3::new(at, at * at * 0.2, (1.3 * at).sin()),
            |at| DVec3::new(at, 3.0, (1.3 * at).sin()),
            |at| DVec3::new(at, 2.0 * at, -at),
        ];
        for place in places {
            let given = cameras(place);
            // A scene that is turned, shifted and scaled.
            let (turn, shift) = (DVec3::new(0.002, -0.001, 0.003), DVec3::new(0.01, 0.02, -0.03));
            let common = given.iter().map(|camera| {
                let centre = camera.centre_in_world();
                Motion { turn: turn.into(), shift: (turn.cross(centre) + shift + 0.004 * centre).into() }
            });
            let motions: Vec<Motion> = common.collect();
            let left = motions.iter().zip(without_common(&given, &motions)).map(|(of, back)| of.then(&back));
            assert!(left.into_iter().all(|left| left.angle() < 1e-6 && left.distance() < 1e-5));
            let mut alone = vec![Motion::default(); given.len()];
            alone[10].turn = [0.09, 0.0, 0.0];
            let kept = alone[10].then(&without_common(&given, &alone)[10]);
            assert!((0.07..0.09).contains(&kept.angle()), "{kept:?}");
        }
    }
}
