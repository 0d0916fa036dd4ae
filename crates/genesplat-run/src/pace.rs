//! How long work will take from here: from how fast it went lately and, of training, from the growth to
//! come, since a step of twice as many Gaussians takes nearly twice as long.

use genesplat_train::GrowthToCome;

/// The part of what is done whose rate counts: the last third.
const RECENT: f64 = 1.0 / 3.0;
/// What a step costs besides its Gaussians, as a part of those that the cloud will have.
const FIXED: f64 = 0.1;
/// The rest of the work is reckoned in so many slices.
const SLICES: u32 = 64;
/// Of the growth of late, so much goes on where no plan is known: it slows down as photos are matched.
const SLOWING: f64 = 0.6;

/// How far work was, and when.
#[derive(Clone, Copy, Debug)]
struct Mark {
    position: u64,
    seconds: f64,
    gaussians: f64,
}

/// The pace of one piece of work; seconds are counted from any fixed moment.
#[derive(Debug)]
pub struct Pace {
    total: u64,
    growth: Option<GrowthToCome>,
    /// At the start, and at each percent that was reached.
    marks: Vec<Mark>,
    now: Mark,
}

impl Pace {
    /// Of work whose pieces are all alike, that begins at `position` of `total`.
    pub fn of(position: u64, total: u64, seconds: f64) -> Self {
        let now = Mark { position, seconds, gaussians: 0.0 };
        Self { total, growth: None, marks: vec![now], now }
    }

    /// Of training a cloud that grows.
    pub(crate) fn of_training(position: u64, total: u64, seconds: f64, growth: GrowthToCome) -> Self {
        Self { growth: Some(growth), ..Self::of(position, total, seconds) }
    }

    /// So far it is now.
    pub fn set(&mut self, position: u64, seconds: f64, gaussians: usize) {
        self.now = Mark { position, seconds, gaussians: gaussians as f64 };
        let percent = |position: u64| 100 * position / self.total.max(1);
        if self.marks.len() == 1 && self.marks[0].gaussians == 0.0 {
            self.marks[0].gaussians = self.now.gaussians;
        }
        if percent(position) > percent(self.marks[self.marks.len() - 1].position) {
            self.marks.push(self.now);
        }
    }

    /// Seconds since it began.
    pub fn passed(&self, seconds: f64) -> f64 {
        seconds - self.marks[0].seconds
    }

    /// `None` where nothing is done yet. `seconds` is the time now.
    pub fn seconds_left(&self, seconds: f64) -> Option<f64> {
        let recent = self.marks_of(RECENT);
        let from = recent[0];
        let (done, left) =
            (self.now.position.checked_sub(from.position)?, self.total.saturating_sub(self.now.position));
        if done == 0 {
            return None;
        }
        let rate = (seconds - from.seconds) / done as f64;
        let Some(growth) = &self.growth else { return Some(rate * left as f64) };
        let fixed = FIXED * self.expected(growth, self.total).max(1.0);
        let of_steps = |position: u64, gaussians: f64| growth.seen(position as u32) * (gaussians + fixed);
        let sum: f64 =
            recent.iter().chain([&self.now]).map(|mark| of_steps(mark.position, mark.gaussians)).sum();
        let usual = sum / (recent.len() + 1) as f64;
        let slice = left as f64 / f64::from(SLICES);
        let at = |index: u32| self.now.position + ((f64::from(index) + 0.5) * slice) as u64;
        let costs = (0..SLICES).map(|index| of_steps(at(index), self.expected(growth, at(index))) / usual);
        Some(rate * slice * costs.sum::<f64>())
    }

    /// The marks of the last such part of what is done.
    fn marks_of(&self, part: f64) -> &[Mark] {
        let done = self.now.position.saturating_sub(self.marks[0].position) as f64;
        let since = self.now.position - (part * done).ceil() as u64;
        let from = self.marks.iter().rposition(|mark| mark.position <= since).unwrap_or(0);
        &self.marks[from..]
    }

    /// Gaussians that there will be.
    fn expected(&self, growth: &GrowthToCome, position: u64) -> f64 {
        let now = self.now;
        if let Some(planned) = growth.planned(position as u32) {
            // A cloud that lags behind its plan catches up with a part of it.
            let reached = growth.planned(now.position as u32).map_or(1.0, |planned| now.gaussians / planned);
            return now.gaussians.max(planned * reached.min(1.0).sqrt());
        }
        let before = self.marks_of(0.5)[0];
        let steps = (now.position - before.position).max(1) as f64;
        let rise = ((now.gaussians - before.gaussians) / steps).max(0.0);
        let until = u64::from(growth.until()).min(position).saturating_sub(now.position);
        let free = now.gaussians + SLOWING * rise * until as f64;
        growth.most().map_or(free, |most| free.min(most.max(now.gaussians)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_that_are_alike_go_on_as_they_did_lately() {
        let mut pace = Pace::of(0, 400, 0.0);
        // Iterations 0 to 50 took a second each, 50 to 100 two seconds.
        pace.set(50, 50.0, 0);
        pace.set(100, 150.0, 0);
        assert_eq!(pace.seconds_left(150.0), Some(600.0));
        assert_eq!(Pace::of(7, 9, 0.0).seconds_left(1.0), None);
    }

    /// Processor seconds of one thread that `train` on 43 photos of a fox, 90x160 pixels, had taken by an
    /// iteration, and its Gaussians then. A step of the last is three times one of the first.
    const FOX: [(u64, f64, usize); 20] = [
        (75, 2.11, 14678),
        (150, 3.73, 15454),
        (225, 5.66, 23606),
        (300, 7.98, 23606),
        (375, 10.57, 28557),
        (450, 14.16, 34556),
        (525, 18.49, 38891),
        (600, 22.0, 38891),
        (675, 26.26, 42790),
        (750, 30.92, 46362),
        (825, 34.55, 46362),
        (900, 38.18, 46362),
        (975, 41.97, 46362),
        (1050, 45.92, 46362),
        (1125, 49.63, 46362),
        (1200, 53.68, 46362),
        (1275, 57.54, 46362),
        (1350, 61.56, 46362),
        (1425, 65.8, 46362),
        (1500, 69.79, 46362),
    ];

    #[test]
    fn what_is_left_of_a_run_that_grows_is_known_from_a_tenth_of_it_on() {
        let photo = genesplat_core::Photo { width: 90, height: 160, rgb: vec![0; 3 * 90 * 160] };
        let camera = genesplat_core::Camera::at_origin(90, 160, 100.0);
        let view = genesplat_core::View {
            name: String::new(),
            camera,
            photo: photo.into(),
            mask: None,
            depth: None,
        };
        let config = genesplat_train::TrainConfig { iterations: 1500, ..Default::default() };
        let growth = GrowthToCome::new(&config.resolve().unwrap(), &vec![view; 43]);
        assert!(growth.most().is_some_and(|most| (46_000.0..48_500.0).contains(&most)), "{growth:?}");
        let whole = FOX[FOX.len() - 1].1;
        let factor = |left: f64, truth: f64| (left / truth).max(truth / left);
        let mut worst_alike: f64 = 1.0;
        let mut paces = (Pace::of_training(0, 1500, 0.0, growth), Pace::of(0, 1500, 0.0));
        for (iteration, seconds, gaussians) in FOX {
            paces.0.set(iteration, seconds, gaussians);
            paces.1.set(iteration, seconds, 0);
            if !(150..1500).contains(&iteration) {
                continue;
            }
            let left = paces.0.seconds_left(seconds).unwrap();
            let off = factor(left, whole - seconds);
            assert!(off < 1.5, "{iteration}: {left:.1} s instead of {:.1}", whole - seconds);
            worst_alike = worst_alike.max(factor(paces.1.seconds_left(seconds).unwrap(), whole - seconds));
        }
        assert!(worst_alike > 1.7, "a pace that knows of no growth is wrong by {worst_alike}");
    }
}
