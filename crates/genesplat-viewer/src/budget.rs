//! How much of the time pictures may take while a page is open: a credit that grows with the clock.

/// Pictures of a run that trains take at most this share of the time that a page is open: with what sending
/// them costs, 5 %.
const SHARE: f64 = 0.04;
/// What is not spent is kept up to so many seconds, so that a movement after a rest is smooth.
const CREDIT_MAX: f64 = 1.0;
/// The least time between two pictures from the same place, seconds: the cloud changes slowly.
const REFRESH: f64 = 1.0;
/// What pictures from the same place leave for movements, seconds.
const RESERVE: f64 = 0.2;

/// Seconds are counted from any fixed moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Budget {
    /// Seconds that may be spent; below 0 after a picture that cost more.
    credit: f64,
    /// When a page was last known to be open.
    seen: Option<f64>,
    /// When the last picture was taken.
    last: Option<f64>,
}

impl Budget {
    /// The time is `now`, and a page is open or not.
    pub fn tick(&mut self, now: f64, is_open: bool) {
        if let (true, Some(seen)) = (is_open, self.seen) {
            self.credit = (self.credit + SHARE * (now - seen)).min(CREDIT_MAX);
        }
        self.seen = is_open.then_some(now);
    }

    /// A page that has moved may have a picture.
    pub fn allows_new(&self) -> bool {
        self.credit >= 0.0
    }

    /// A page that looks from where it did may have one of the cloud as it is now; some credit is kept for
    /// movements.
    pub fn allows_refresh(&self, now: f64) -> bool {
        self.last.is_none_or(|last| now - last >= REFRESH && self.credit >= RESERVE)
    }

    /// A picture was taken that cost so many seconds.
    pub fn spend(&mut self, now: f64, seconds: f64) {
        self.credit -= seconds;
        self.last = Some(now);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Seconds spent on pictures of `cost` in `seconds`, by a page that always moves or never does.
    fn spent(cost: f64, seconds: u32, moves: bool) -> f64 {
        let (mut budget, mut spent, mut now) = (Budget::default(), 0.0, 0.0);
        while now < f64::from(seconds) {
            budget.tick(now, true);
            if if moves { budget.allows_new() } else { budget.allows_refresh(now) } {
                budget.spend(now, cost);
                spent += cost;
                now += cost;
            }
            now += 0.01;
        }
        spent
    }

    #[test]
    fn pictures_take_their_share_and_no_more() {
        for cost in [0.002, 0.03, 0.8] {
            for moves in [true, false] {
                let spent = spent(cost, 600, moves);
                assert!(spent <= SHARE * 600.0 + cost, "{cost} {moves}: {spent}");
            }
            assert!(spent(cost, 600, true) > 0.9 * SHARE * 600.0, "{cost}");
        }
    }

    #[test]
    fn time_without_a_page_earns_nothing() {
        let mut budget = Budget::default();
        budget.tick(0.0, true);
        budget.spend(0.0, 0.5);
        budget.tick(1.0, false);
        budget.tick(1000.0, true);
        assert!(!budget.allows_new());
        budget.tick(1001.0 + 0.5 / SHARE, true);
        assert!(budget.allows_new());
    }
}
