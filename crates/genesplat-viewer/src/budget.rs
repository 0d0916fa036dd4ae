//! How much of the time pictures may take while a page is open: credits that grow with the clock.

/// Pictures from the same place take at most this share of the time that a page is open: with what sending
/// them costs, 5 %.
const SHARE: f64 = 0.04;
/// What is not spent is kept up to so many seconds.
const CREDIT_MAX: f64 = 1.0;
/// The least time between two pictures from the same place, seconds: the cloud changes slowly.
const REFRESH: f64 = 1.0;
/// While somebody moves, training yields: pictures may take so many seconds in a row, and half the time after
/// that.
const YIELD: f64 = 2.0;
/// Seconds of yielding that a second of training earns.
const EARNED: f64 = 1.0;

/// Seconds are counted from any fixed moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Budget {
    /// Seconds that pictures from the same place may take; below 0 after one that cost more.
    credit: f64,
    /// Seconds that pictures of movements may take.
    of_movements: f64,
    /// When a page was last known to be open.
    seen: Option<f64>,
    /// When the last picture was taken.
    last: Option<f64>,
    /// The last picture was one of a movement.
    has_moved: bool,
}

impl Default for Budget {
    fn default() -> Self {
        Self { credit: 0.0, of_movements: YIELD, seen: None, last: None, has_moved: false }
    }
}

impl Budget {
    /// The time is `now`, and a page is open or not.
    pub fn tick(&mut self, now: f64, is_open: bool) {
        if let (true, Some(seen)) = (is_open, self.seen) {
            self.credit = (self.credit + SHARE * (now - seen)).min(CREDIT_MAX);
            self.of_movements = (self.of_movements + EARNED * (now - seen)).min(YIELD);
        }
        self.seen = is_open.then_some(now);
    }

    /// A page that has moved may have a picture.
    pub fn allows_new(&self) -> bool {
        self.of_movements > 0.0
    }

    /// A page that looks from where it did may have one of the cloud as it is now.
    pub fn allows_refresh(&self, now: f64) -> bool {
        self.credit >= 0.0 && self.last.is_none_or(|last| now - last >= REFRESH)
    }

    /// Training has waited so many seconds until `now` for pictures of a page that moves. They earn nothing.
    pub fn spend_on_movement(&mut self, now: f64, seconds: f64) {
        self.of_movements -= seconds;
        (self.last, self.has_moved) = (Some(now), true);
        self.seen = self.seen.map(|_| now);
    }

    /// A picture from the same place was taken that cost so many seconds.
    pub fn spend(&mut self, now: f64, seconds: f64) {
        self.credit -= seconds;
        (self.last, self.has_moved) = (Some(now), false);
    }

    /// Pictures took so many seconds to encode, beside training.
    pub fn spend_on_encoding(&mut self, seconds: f64) {
        *(if self.has_moved { &mut self.of_movements } else { &mut self.credit }) -= seconds;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Seconds spent on pictures of `cost` in `seconds`, by a page that always moves or never does, beside
    /// steps of 10 ms.
    fn spent(cost: f64, seconds: u32, moves: bool) -> f64 {
        let (mut budget, mut spent, mut now) = (Budget::default(), 0.0, 0.0);
        while now < f64::from(seconds) {
            budget.tick(now, true);
            if moves && budget.allows_new() {
                budget.spend_on_movement(now + cost, cost);
                (spent, now) = (spent + cost, now + cost);
            } else if !moves && budget.allows_refresh(now) {
                budget.spend(now, cost);
                (spent, now) = (spent + cost, now + cost);
            }
            now += 0.01;
        }
        spent
    }

    #[test]
    fn pictures_take_their_share_and_no_more() {
        for cost in [0.002, 0.03, 0.8] {
            let spent = spent(cost, 600, false);
            assert!(spent <= SHARE * 600.0 + cost, "{cost}: {spent}");
        }
        assert!(spent(0.8, 600, false) > 0.9 * SHARE * 600.0);
    }

    #[test]
    fn training_yields_at_once_to_who_moves_and_keeps_half_the_time() {
        for cost in [0.03, 0.8] {
            assert!(spent(cost, 2, true) > 1.5, "{cost}");
            let long = spent(cost, 600, true);
            assert!((250.0..=302.0 + cost).contains(&long), "{cost}: {long}");
        }
    }

    #[test]
    fn time_without_a_page_earns_nothing() {
        let mut budget = Budget::default();
        budget.tick(0.0, true);
        budget.spend(0.0, 0.5);
        budget.spend_on_movement(0.0, 3.0);
        budget.tick(1.0, false);
        budget.tick(1000.0, true);
        assert!(!budget.allows_new() && !budget.allows_refresh(1000.0));
        budget.tick(1001.0 + 0.5 / SHARE, true);
        assert!(budget.allows_new() && budget.allows_refresh(1001.0 + 0.5 / SHARE));
    }
}
