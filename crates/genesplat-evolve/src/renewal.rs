//! Renewal: the Gaussians of least contribution are replaced by splitting those of largest error.
//!
//! Selection and reproduction with a Gaussian as the individual and the cloud as the population, whose size stays.
//! Twins together render nearly like their parent, so a renewal costs little at once, and gradient steps then pull the
//! twins apart.
//!
//! Prior art: pruning by contribution (LightGaussian, PUP 3D-GS, Speedy-Splat), growth by error (Revising Densification, Taming
//! 3DGS, ConeGS), relocation at a constant number (3DGS-MCMC), selection pressure (Natural Selection for 3DGS).

use genesplat_core::{Contribution, Origin, Rng, RowEdit};

/// Removes `fraction` of the rows, those of least weight, and splits as many of the others, those of largest error; of
/// equal ones the first. Changes nothing where no row has part in an error.
pub fn plan(contributions: &[Contribution], fraction: f64, rng: Rng, iteration: u32) -> RowEdit {
    let mut edit = RowEdit::new(rng, iteration);
    for (row, fate) in (0..).zip(fates(contributions, fraction)) {
        match fate {
            Fate::Removed => {}
            Fate::Kept => edit.push(row, Origin::Kept),
            Fate::Split => {
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
    Kept,
    Removed,
    Split,
}

fn fates(contributions: &[Contribution], fraction: f64) -> Vec<Fate> {
    let wanted = (fraction * contributions.len() as f64) as usize;
    let mut by_weight: Vec<usize> = (0..contributions.len()).collect();
    by_weight.sort_by(|&a, &b| contributions[a].weight.total_cmp(&contributions[b].weight));
    let (weakest, others) = by_weight.split_at(wanted.min(contributions.len() / 2));
    let mut parents: Vec<usize> = others.iter().copied().filter(|&row| contributions[row].error > 0.0).collect();
    parents.sort_by(|&a, &b| contributions[b].error.total_cmp(&contributions[a].error).then(a.cmp(&b)));
    parents.truncate(weakest.len());
    let mut fates = vec![Fate::Kept; contributions.len()];
    for (&removed, &parent) in weakest.iter().zip(&parents) {
        (fates[removed], fates[parent]) = (Fate::Removed, Fate::Split);
    }
    fates
}

#[cfg(test)]
mod tests {
    use super::*;

    fn contributions(rows: &[(f32, f32)]) -> Vec<Contribution> {
        rows.iter().map(|&(weight, error)| Contribution { weight, error }).collect()
    }

    #[test]
    fn the_least_contribution_is_replaced_by_twins_of_the_largest_error() {
        let contributions = contributions(&[(9.0, 1.0), (0.1, 7.0), (5.0, 3.0), (8.0, 2.0), (0.2, 0.0), (7.0, 4.0)]);
        let edit = plan(&contributions, 0.34, Rng::new(1), 1500);
        // Rows 1 and 4 are removed, whatever their error; 5 and 2 are split.
        assert_eq!(edit.sources, [0, 2, 2, 3, 5, 5]);
        let twins = [Origin::Twin { child: 0 }, Origin::Twin { child: 1 }];
        assert_eq!(edit.origins[1..3], twins);
        assert_eq!(edit.origins[4..6], twins);
        assert_eq!(edit.iteration, 1500);
    }

    #[test]
    fn nothing_is_removed_without_a_split() {
        let few = contributions(&[(0.0, 0.0), (0.0, 0.0), (3.0, 0.0), (2.0, 1.0)]);
        assert_eq!(plan(&few, 0.5, Rng::new(1), 1).sources, [1, 2, 3, 3], "one parent, one removed");
        for (rows, fraction) in
            [(contributions(&[(1.0, 0.0); 4]), 0.5), (few, 0.0), (contributions(&[(1.0, 1.0)]), 1.0), (Vec::new(), 0.5)]
        {
            assert!(plan(&rows, fraction, Rng::new(1), 1).is_identity(rows.len()));
        }
    }

    #[test]
    fn errors_that_are_not_finite_are_not_split() {
        let edit = plan(&contributions(&[(0.0, 1.0), (1.0, f32::NAN), (2.0, 1.0), (3.0, 0.5)]), 0.25, Rng::new(1), 1);
        assert_eq!(edit.sources, [1, 2, 2, 3]);
    }

    proptest::proptest! {
        #[test]
        fn the_cloud_stays_as_large_as_it_is(
            rows in proptest::collection::vec((0f32..4.0, 0f32..4.0), 0..60),
            fraction in 0f64..1.0,
        ) {
            let edit = plan(&contributions(&rows), fraction, Rng::new(1), 1);
            assert_eq!(edit.sources.len(), rows.len());
            assert!(edit.sources.is_sorted());
        }
    }
}
