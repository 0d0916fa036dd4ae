//! Numbers for people: thousands separators, and units that suit the size.

/// A count: `43,000`.
pub fn thousands(count: usize) -> String {
    let digits = count.to_string();
    let mut text = String::with_capacity(digits.len() + digits.len() / 3);
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// A time: `2.1 s`, `48 s`, `3 min 20 s` or `1 h 05 min`.
pub fn duration(seconds: f64) -> String {
    if seconds < 9.95 {
        return format!("{seconds:.1} s");
    }
    let whole = seconds.round() as u64;
    match (whole / 3600, whole / 60 % 60, whole % 60) {
        (0, 0, seconds) => format!("{seconds} s"),
        (0, minutes, seconds) => format!("{minutes} min {seconds:02} s"),
        (hours, minutes, _) => format!("{hours} h {minutes:02} min"),
    }
}

/// How long something will take, as exactly as that can be known: `48 s`, `3 min` or `1 h 05 min`.
pub fn time_left(seconds: f64) -> String {
    match seconds {
        seconds if seconds < 90.0 => format!("{:.0} s", seconds.ceil()),
        seconds if seconds < 3600.0 => format!("{:.0} min", (seconds / 60.0).round()),
        seconds => duration(seconds),
    }
}

/// A figure with its unit; a dash for one that was not measured, or is infinite.
pub fn number(value: Option<f64>, digits: usize, unit: &str) -> String {
    let value = value.filter(|value| value.is_finite());
    value.map_or("-".to_owned(), |value| format!("{value:.digits$}{unit}"))
}

/// An amount of memory: `312 MB` or `1.4 GB`.
pub fn memory(bytes: u64) -> String {
    match bytes as f64 / 1e6 {
        megabytes if megabytes < 999.5 => format!("{megabytes:.0} MB"),
        megabytes => format!("{:.1} GB", megabytes / 1e3),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_have_separators() {
        let texts = [0, 999, 1000, 43_000, 1_234_567].map(thousands);
        assert_eq!(texts, ["0", "999", "1,000", "43,000", "1,234,567"]);
    }

    #[test]
    fn units_suit_the_size() {
        assert_eq!([0.2, 48.0, 200.0, 3900.0].map(time_left), ["1 s", "48 s", "3 min", "1 h 05 min"]);
        let texts = [0.04, 9.96, 59.4, 59.6, 200.0, 3900.0].map(duration);
        assert_eq!(texts, ["0.0 s", "10 s", "59 s", "1 min 00 s", "3 min 20 s", "1 h 05 min"]);
        assert_eq!([312_000_000, 1_400_000_000].map(memory), ["312 MB", "1.4 GB"]);
    }
}
