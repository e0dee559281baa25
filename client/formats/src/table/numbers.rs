//! Numbers and durations as people read them.
//!
//! Invariant: a number has three decimals or three digits, but never so few that it appears as 0 or 1 and is not. A
//! number that needs more than six decimals has an exponent near 0, and an inequality near 1.

/// Numbers of less than this have an exponent.
const SMALL: f64 = 1e-6;
/// Digits that are kept of a small number.
const DIGITS: i32 = 3;
/// Digits that are kept of the distance from 1.
const DIGITS_FROM_ONE: i32 = 1;

/// A number with three decimals, or with the three first digits if it is small: `0.977`, `0.0113`, `458123.25`. A
/// number close below 1 keeps as many digits as show that it is below: `0.9995`.
#[must_use]
pub fn number(number: f64) -> String {
    let size = number.abs();
    if !number.is_finite() || size == 0.0 {
        // A zero has no sign.
        return (number + 0.0).to_string();
    }
    if size < SMALL {
        return trimmed_exponent(number);
    }
    if size < 1.0 && 1.0 - size < SMALL {
        return format!("{}0.999999", if number < 0.0 { "<-" } else { ">" });
    }
    let needed = places(size, DIGITS).max(if size < 1.0 { places(1.0 - size, DIGITS_FROM_ONE) } else { 0 });
    let text = format!("{number:.*}", usize::try_from(needed.max(3)).unwrap_or(3));
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// The number of decimals that show this many digits of a number below 1.
fn places(size: f64, digits: i32) -> i32 {
    digits - 1 - size.log10().floor() as i32
}

/// `1.29e-53`.
fn trimmed_exponent(number: f64) -> String {
    let rounded: f64 = format!("{number:.2e}").parse().unwrap_or(number);
    format!("{rounded:e}")
}

/// A duration of this many seconds: `7 d`, `24 h`, `45 min`, `-3 d`. Up to 36 hours it is in hours.
#[must_use]
pub fn period(secs: f64) -> String {
    let size = secs.abs();
    let (value, unit) = match size {
        size if size > 36.0 * 3600.0 => (size / 86_400.0, "d"),
        size if size >= 3600.0 => (size / 3600.0, "h"),
        size if size >= 60.0 => (size / 60.0, "min"),
        size if size >= 1.0 || size == 0.0 => (size, "s"),
        size => (size * 1e3, "ms"),
    };
    let decimals = usize::from(value < 100.0) + usize::from(value < 10.0);
    let text = format!("{value:.decimals$}");
    if value < 0.005 && value > 0.0 {
        return "<0.01 ms".to_owned();
    }
    let text = if decimals > 0 { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    format!("{}{text} {unit}", if secs < 0.0 && text != "0" { "-" } else { "" })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_three_decimals_and_cannot_be_taken_for_another() {
        for (value, text) in [
            (0.0, "0"),
            (-0.0, "0"),
            (1.0, "1"),
            (0.976_902, "0.977"),
            (0.5, "0.5"),
            (0.012_345_678, "0.0123"),
            (0.000_412_3, "0.000412"),
            (0.999_51, "0.9995"),
            (0.999_998_2, "0.999998"),
            (0.999_999_2, ">0.999999"),
            (86_400.0, "86400"),
            (458_123.25, "458123.25"),
            (21.456_78, "21.457"),
            (1.294_76e-53, "1.29e-53"),
            (-0.000_01, "-0.00001"),
            (-12.5, "-12.5"),
            (f64::NAN, "NaN"),
            (f64::INFINITY, "inf"),
        ] {
            assert_eq!(number(value), text);
        }
    }

    #[test]
    fn periods_are_readable() {
        for (secs, text) in [
            (604_800.0, "7 d"),
            (302_400.0, "3.5 d"),
            (86_400.0, "24 h"),
            (87_720.0, "24.4 h"),
            (100_800.0, "28 h"),
            (43_200.0, "12 h"),
            (60_480.0, "16.8 h"),
            (86_400.0 / 7.0, "3.43 h"),
            (100.0 * 86_400.0, "100 d"),
            (1_800.0, "30 min"),
            (90.0, "1.5 min"),
            (30.0, "30 s"),
            (0.25, "250 ms"),
            (0.004_21, "4.21 ms"),
            (0.000_001, "<0.01 ms"),
            (0.0, "0 s"),
            (-3.0 * 86_400.0, "-3 d"),
        ] {
            assert_eq!(period(secs), text);
        }
    }
}
