//! Whether a depth map has the unit of its scene: the points of the reconstruction tell.
//!
//! Networks tell inverse depth up to a scale and a shift of their own; a phone tells metres, whatever the
//! reconstruction's unit is. Both are a line through what points and map say at the same pixels.

use genesplat_core::median;

/// So many points must lie in a photo for its map to be judged.
const PAIRS_MIN: usize = 30;

/// Rounds of least squares, each weighted by what the one before left.
const ROUNDS: u32 = 30;

/// A line is believed where it takes this part of the median difference away.
const BETTER: f64 = 1.0 / 3.0;

/// Points that lie at different depths, by this part of them, must be told apart better than by one depth for
/// all: any map can be made that.
const SPREAD: f64 = 0.02;

/// A map is of its photo where so many points lie within [`NEAR`] of it.
const AGREED: f64 = 1.0 / 3.0;
const NEAR: f64 = 0.1;

/// What points say of a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Fit {
    /// Too few points lie in the photo.
    Unknown,
    /// The map has the unit of the scene.
    Same,
    /// Inverse depths of the scene are `scale` times those of the map, and `shift`.
    Line { scale: f64, shift: f64 },
    /// The map shows something else.
    Other,
}

/// Of points that may be hidden, at least this part must lie where the map is, or before it.
const SEEN: f64 = 0.2;

/// Compares inverse depths of a map with those of points at the same pixels, which are known to be seen there or
/// not.
pub(super) fn fit(pairs: &[[f64; 2]], are_seen: bool) -> Fit {
    if pairs.len() < PAIRS_MIN {
        return Fit::Unknown;
    }
    if !are_seen && is_same_where_seen(pairs) {
        return Fit::Same;
    }
    let same = median_off(pairs, 1.0, 0.0);
    let line = line(pairs).filter(|&(scale, shift)| median_off(pairs, scale, shift) < (1.0 - BETTER) * same);
    let (scale, shift) = line.unwrap_or((1.0, 0.0));
    if !shows(pairs, scale, shift) {
        return Fit::Other;
    }
    line.map_or(Fit::Same, |(scale, shift)| Fit::Line { scale, shift })
}

/// Whether the map has the unit of the scene, leaving out the points behind what it shows: of a closed thing
/// most are on its other side.
fn is_same_where_seen(pairs: &[[f64; 2]]) -> bool {
    let seen: Vec<[f64; 2]> = pairs.iter().copied().filter(|[map, point]| point / map > 1.0 - NEAR).collect();
    let enough = PAIRS_MIN.max((SEEN * pairs.len() as f64) as usize);
    let agree = seen.iter().filter(|[map, point]| (map / point - 1.0).abs() < NEAR).count();
    seen.len() >= enough && 2 * agree >= seen.len() && shows(&seen, 1.0, 0.0)
}

/// Whether the map shows the points with this line, and not just one depth for all.
fn shows(pairs: &[[f64; 2]], scale: f64, shift: f64) -> bool {
    let agree = pairs.iter().filter(|[map, point]| ((scale * map + shift) / point - 1.0).abs() < NEAR);
    let usual = middle(pairs.iter().map(|[_, point]| *point));
    let spread = median_off(pairs, 0.0, usual);
    let tells_nothing = spread > SPREAD * usual && median_off(pairs, scale, shift) > (1.0 - BETTER) * spread;
    !tells_nothing && agree.count() as f64 >= AGREED * pairs.len() as f64
}

fn median_off(pairs: &[[f64; 2]], scale: f64, shift: f64) -> f64 {
    middle(pairs.iter().map(|[map, point]| (scale * map + shift - point).abs()))
}

/// Of what at least one pair has.
fn middle(values: impl Iterator<Item = f64>) -> f64 {
    median(values).expect("there are pairs")
}

/// Scale and shift of the least sum of absolute differences; `None` where none rises.
fn line(pairs: &[[f64; 2]]) -> Option<(f64, f64)> {
    let (mut scale, mut shift) = (middle(pairs.iter().map(|[map, point]| point / map)), 0.0);
    let least = 1e-6 * middle(pairs.iter().map(|[_, point]| *point));
    for _ in 0..ROUNDS {
        let [mut one, mut x, mut y, mut xx, mut xy] = [0.0; 5];
        for [map, point] in pairs {
            let weight = 1.0 / (scale * map + shift - point).abs().max(least);
            one += weight;
            x += weight * map;
            y += weight * point;
            xx += weight * map * map;
            xy += weight * map * point;
        }
        let determinant = one * xx - x * x;
        // A wall that is seen head on has one depth: no line, but a scale.
        if determinant <= 1e-9 * one * xx {
            (scale, shift) = (xy / xx, 0.0);
            continue;
        }
        (scale, shift) = ((one * xy - x * y) / determinant, (xx * y - x * xy) / determinant);
    }
    (scale.is_finite() && scale > 0.0 && shift.is_finite()).then_some((scale, shift))
}

#[cfg(test)]
mod tests {
    use genesplat_core::{Rng, Stream};

    use super::*;

    fn uniform(index: u32, lane: usize) -> f64 {
        f64::from(Rng::new(4).at(Stream::Test, 0, index, 0).uniform(lane))
    }

    /// Points at 1 to 5, off by half a percent, and their map; one in so many is behind what the map shows.
    fn pairs(count: u32, behind: u32, of_map: impl Fn(f64) -> f64) -> Vec<[f64; 2]> {
        let pair = |index: u32| {
            let inverse = 1.0 / (1.0 + 4.0 * uniform(index, 0));
            let point = inverse * (1.0 + 0.01 * (uniform(index, 1) - 0.5));
            let hidden = if index.is_multiple_of(behind) { 0.3 + 0.4 * uniform(index, 2) } else { 1.0 };
            [of_map(inverse), point * hidden]
        };
        (0..count).map(pair).collect()
    }

    #[test]
    fn maps_in_the_unit_of_the_scene_stay() {
        assert_eq!(fit(&pairs(200, 1000, |inverse| inverse), true), Fit::Same);
        assert_eq!(fit(&pairs(200, 4, |inverse| inverse), true), Fit::Same);
        assert_eq!(fit(&pairs(29, 1000, |inverse| inverse), true), Fit::Unknown);
    }

    #[test]
    fn scale_and_shift_come_back_though_points_are_hidden() {
        for behind in [1000, 4, 3] {
            // What a network says: the scene is 0.37 times that, and 0.1.
            let Fit::Line { scale, shift } = fit(&pairs(300, behind, |inverse| (inverse - 0.1) / 0.37), true)
            else {
                panic!("one in {behind}")
            };
            assert!((scale / 0.37 - 1.0).abs() < 0.01 && (shift - 0.1).abs() < 0.003, "{scale} {shift}");
        }
    }

    /// As of a ball, of whose points more than half are on the side that a photo does not see.
    #[test]
    fn points_behind_what_a_map_shows_are_no_witnesses_where_they_may_be_hidden() {
        let mut ball = pairs(200, 1000, |inverse| inverse);
        ball.extend(pairs(300, 1, |inverse| inverse));
        assert_eq!([true, false].map(|are_seen| fit(&ball, are_seen)), [Fit::Other, Fit::Same]);
        // In thousandths, all of them lie behind.
        let thousandths: Vec<[f64; 2]> = ball.iter().map(|[map, point]| [1000.0 * map, *point]).collect();
        assert!(fit(&thousandths, false) != Fit::Same);
    }

    #[test]
    fn a_wall_has_a_scale() {
        let wall: Vec<[f64; 2]> = (0..50).map(|_| [2.0, 0.5]).collect();
        assert_eq!(fit(&wall, true), Fit::Line { scale: 0.25, shift: 0.0 });
    }

    #[test]
    fn a_map_of_something_else_is_noticed() {
        let others: Vec<[f64; 2]> = (0..300).map(|i| [uniform(i, 0) + 0.02, uniform(i, 1) + 0.02]).collect();
        assert_eq!(fit(&others, true), Fit::Other);
        assert_eq!(fit(&others, false), Fit::Other);
    }
}
