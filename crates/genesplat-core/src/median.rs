//! The median, which a few stray values do not move.

/// The middle one of some values, the upper one of two; `None` of none.
pub fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_value_is_the_upper_one_of_two() {
        assert_eq!((median([]), median([3.0, 1.0, 2.0])), (None, Some(2.0)));
        assert_eq!(median([3.0, 1.0, 2.0, 9.0]), Some(3.0));
    }
}
