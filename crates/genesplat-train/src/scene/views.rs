//! Which training view is looked at, and when.

use genesplat_core::{Rng, Stream, View};

/// The order in which gradient steps visit the views: every epoch sees each view once, in a random order of
/// its own.
pub(crate) struct ViewOrder {
    rng: Rng,
    views: usize,
    epoch: u32,
    /// The views of `epoch`.
    order: Vec<u32>,
}

impl ViewOrder {
    /// The order that `rng` gives to `views` views.
    pub(crate) fn new(rng: Rng, views: usize) -> Self {
        Self { rng, views, epoch: 0, order: rng.permutation(Stream::ViewOrder, 0, views) }
    }

    /// The view of the `visit`-th step, counted from 0.
    pub(crate) fn view(&mut self, visit: u32) -> usize {
        let epoch = visit / self.views as u32;
        if epoch != self.epoch {
            self.epoch = epoch;
            self.order = self.rng.permutation(Stream::ViewOrder, epoch, self.views);
        }
        self.order[visit as usize % self.views] as usize
    }
}

/// `count` views spread evenly over the views in order of name, from a random offset on, in that order; all
/// where there are no more. Names follow a capture's path, so they cover the scene. The same `stage` gives
/// the same views.
pub fn spread_evenly(views: &[View], count: usize, rng: &Rng, stage: u32) -> Vec<usize> {
    let mut by_name: Vec<usize> = (0..views.len()).collect();
    by_name.sort_by(|&a, &b| views[a].name.cmp(&views[b].name));
    if count >= by_name.len() {
        return by_name;
    }
    let offset = f64::from(rng.at(Stream::FitnessViews, stage, 0, 0).uniform(0));
    let spacing = by_name.len() as f64 / count as f64;
    (0..count).map(|k| by_name[((k as f64 + offset) * spacing) as usize]).collect()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use genesplat_core::{Camera, Photo};

    use super::*;

    fn views(n: usize) -> Vec<View> {
        let camera = Camera::at_origin(1, 1, 1.0);
        let photo = Arc::new(Photo { width: 1, height: 1, rgb: vec![0; 3] });
        // Given in reverse order of name.
        (0..n)
            .rev()
            .map(|i| View {
                name: format!("{i:03}.jpg"),
                camera,
                photo: photo.clone().into(),
                mask: None,
                depth: None,
            })
            .collect()
    }

    #[test]
    fn every_epoch_visits_each_view_once_in_another_order() {
        let mut order = ViewOrder::new(Rng::new(9), 7);
        let visits: Vec<usize> = (0..14).map(|visit| order.view(visit)).collect();
        for epoch in visits.chunks(7) {
            let mut sorted = epoch.to_vec();
            sorted.sort_unstable();
            assert_eq!(sorted, [0, 1, 2, 3, 4, 5, 6]);
        }
        assert_ne!(visits[..7], visits[7..]);
        assert_eq!(ViewOrder::new(Rng::new(9), 7).view(12), visits[12], "a resumed run goes on where it was");
    }

    #[test]
    fn fitness_views_are_evenly_spaced_by_name() {
        let views = views(43);
        for seed in 0..20 {
            let chosen = spread_evenly(&views, 6, &Rng::new(seed), 0);
            let names: Vec<i64> = chosen.iter().map(|&view| views[view].name[..3].parse().unwrap()).collect();
            assert_eq!(names.len(), 6);
            // 43 / 6 = 7.17: neighbours are 7 or 8 apart.
            assert!(names.windows(2).all(|pair| [7, 8].contains(&(pair[1] - pair[0]))), "{names:?}");
            assert!(names[0] < 8 && names[5] >= 35, "{names:?}");
        }
    }

    #[test]
    fn offsets_differ_between_stages_and_few_views_are_all_taken() {
        let views = views(43);
        let offsets: Vec<_> = (0..6).map(|stage| spread_evenly(&views, 6, &Rng::new(0), stage)).collect();
        assert!(offsets.iter().any(|chosen| *chosen != offsets[0]));
        assert_eq!(spread_evenly(&views[..4], 6, &Rng::new(0), 0), [3, 2, 1, 0]);
    }
}
