//! Renewal: the Gaussians that nobody would miss die, and those that most is wrong with become two.
//!
//! Selection and reproduction, with a Gaussian as the individual and the cloud as the population, which stays as large as it
//! is. An individual's fitness is what it is worth to the pictures ([`Merit::weight`]); who reproduces is decided by the
//! error that it has part in ([`Merit::error`]), since there more is wanted. Both are measured by rendering. A parent and
//! its twin render nearly like the parent alone, so a renewal costs little at once, and gradients find out what the new
//! ones are for.

use genesplat_core::{Merit, Origin, RowEdit};

/// Decides a renewal of `share` of the rows; `iteration` is that of the edit. Changes nothing where no row has part in an
/// error.
///
/// As many rows die as reproduce. The dead are the rows of least weight, the parents those of the largest error among the
/// others; of equal ones the first.
pub fn plan(merits: &[Merit], share: f64, iteration: u32) -> RowEdit {
    let mut edit = RowEdit { iteration, ..RowEdit::default() };
    for (row, fate) in (0..).zip(fates(merits, share)) {
        match fate {
            Fate::Dies => {}
            Fate::Lives => edit.push(row, Origin::Kept),
            Fate::Reproduces => {
                edit.push(row, Origin::Twin { child: 0 });
                edit.push(row, Origin::Twin { child: 1 });
            }
        }
    }
    edit
}

/// What becomes of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fate {
    Lives,
    Dies,
    Reproduces,
}

fn fates(merits: &[Merit], share: f64) -> Vec<Fate> {
    let wanted = (share * merits.len() as f64) as usize;
    let mut by_weight: Vec<usize> = (0..merits.len()).collect();
    by_weight.sort_by(|&a, &b| merits[a].weight.total_cmp(&merits[b].weight));
    let (weakest, others) = by_weight.split_at(wanted.min(merits.len() / 2));
    let mut parents: Vec<usize> = others.iter().copied().filter(|&row| merits[row].error > 0.0).collect();
    parents.sort_by(|&a, &b| merits[b].error.total_cmp(&merits[a].error).then(a.cmp(&b)));
    parents.truncate(weakest.len());
    let mut fates = vec![Fate::Lives; merits.len()];
    for (&dead, &parent) in weakest.iter().zip(&parents) {
        (fates[dead], fates[parent]) = (Fate::Dies, Fate::Reproduces);
    }
    fates
}

#[cfg(test)]
mod tests {
    use super::*;

    fn merits(rows: &[(f32, f32)]) -> Vec<Merit> {
        rows.iter().map(|&(weight, error)| Merit { weight, error }).collect()
    }

    #[test]
    fn the_weakest_make_room_for_twins_of_those_that_most_is_wrong_with() {
        let merits = merits(&[(9.0, 1.0), (0.1, 7.0), (5.0, 3.0), (8.0, 2.0), (0.2, 0.0), (7.0, 4.0)]);
        let edit = plan(&merits, 0.34, 1500);
        // Rows 1 and 4 die, whatever the error they have part in; 5 and 2 reproduce.
        assert_eq!(edit.sources, [0, 2, 2, 3, 5, 5]);
        let twins = [Origin::Twin { child: 0 }, Origin::Twin { child: 1 }];
        assert_eq!(edit.origins[1..3], twins);
        assert_eq!(edit.origins[4..6], twins);
        assert_eq!(edit.iteration, 1500);
    }

    #[test]
    fn nobody_dies_without_an_heir() {
        let few = merits(&[(0.0, 0.0), (0.0, 0.0), (3.0, 0.0), (2.0, 1.0)]);
        assert_eq!(plan(&few, 0.5, 1).sources, [1, 2, 3, 3], "one parent, one death");
        for (rows, share) in
            [(merits(&[(1.0, 0.0); 4]), 0.5), (few, 0.0), (merits(&[(1.0, 1.0)]), 1.0), (Vec::new(), 0.5)]
        {
            assert!(plan(&rows, share, 1).is_identity(rows.len()));
        }
    }

    #[test]
    fn poisoned_errors_do_not_reproduce() {
        let edit = plan(&merits(&[(0.0, 1.0), (1.0, f32::NAN), (2.0, 1.0), (3.0, 0.5)]), 0.25, 1);
        assert_eq!(edit.sources, [1, 2, 2, 3]);
    }

    proptest::proptest! {
        #[test]
        fn the_cloud_stays_as_large_as_it_is(
            rows in proptest::collection::vec((0f32..4.0, 0f32..4.0), 0..60),
            share in 0f64..1.0,
        ) {
            let edit = plan(&merits(&rows), share, 1);
            assert_eq!(edit.sources.len(), rows.len());
            assert!(edit.sources.is_sorted());
        }
    }
}
