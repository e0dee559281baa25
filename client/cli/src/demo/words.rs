//! Numbers as text for people.
//!
//! Invariant: pure functions.

/// A period: "24 h", "7 d", "3.5 d", "45 min".
pub(super) fn period(secs: f64) -> String {
    const HOUR_SECS: f64 = 3600.0;
    // Periods up to 36 hours are in hours, longer ones in days.
    let (value, unit) = match secs {
        secs if secs > 36.0 * HOUR_SECS => (secs / (24.0 * HOUR_SECS), "d"),
        secs if secs >= HOUR_SECS => (secs / HOUR_SECS, "h"),
        secs => (secs / 60.0, "min"),
    };
    format!("{} {unit}", decimal(value))
}

/// One digit after the decimal point, unless it is 0.
fn decimal(value: f64) -> String {
    let text = format!("{value:.1}");
    text.strip_suffix(".0").map_or(text.clone(), str::to_owned)
}

/// A number with commas between thousands.
pub(super) fn count(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (at, digit) in digits.chars().enumerate() {
        if at > 0 && (digits.len() - at).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// Compares the mean squared errors of a forecast and of the mean model.
pub(super) fn comparison(error: f64, mean_error: f64) -> String {
    const ALIKE: f64 = 0.05;
    if mean_error < 1e-3 && error < 1e-3 {
        "both exact".to_owned()
    } else if (error - mean_error).abs() <= ALIKE * mean_error {
        "alike".to_owned()
    } else if error < mean_error {
        format!("{} % less", ((1.0 - error / mean_error) * 100.0).round())
    } else {
        format!("{} % more", ((error / mean_error - 1.0) * 100.0).round())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn periods_are_readable() {
        let hour = 3600.0;
        for (secs, words) in [
            (7.0 * 24.0 * hour, "7 d"),
            (3.5 * 24.0 * hour, "3.5 d"),
            (24.0 * hour, "24 h"),
            (28.0 * hour, "28 h"),
            (24.0 * hour / 7.0, "3.4 h"),
            (0.5 * hour, "30 min"),
        ] {
            assert_eq!(period(secs), words);
        }
    }

    #[test]
    fn counts_have_commas() {
        assert_eq!(
            ["0", "999", "1,000", "1,234,567"],
            [0, 999, 1000, 1_234_567].map(count).each_ref().map(String::as_str)
        );
    }

    #[test]
    fn errors_are_compared_in_words() {
        assert_eq!(comparison(0.05, 0.2), "75 % less");
        assert_eq!(comparison(0.2, 0.2), "alike");
        assert_eq!(comparison(0.3, 0.2), "50 % more");
        assert_eq!(comparison(0.0, 0.0), "both exact");
    }
}
