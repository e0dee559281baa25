//! Numbers of things, as text for people.
//!
//! Invariant: pure functions.

/// A number with commas between thousands.
pub(crate) fn count(number: u64) -> String {
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

/// A number of things: `1 scan`, `1,204 scans`.
pub(crate) fn counted(number: u64, noun: &str) -> String {
    format!("{} {noun}{}", count(number), if number == 1 { "" } else { "s" })
}

/// The things of which there are some, with `and` between; empty if there are none.
pub(crate) fn some_of(things: &[(u64, &str)]) -> String {
    let some = things.iter().filter(|(number, _)| *number > 0);
    some.map(|(number, noun)| counted(*number, noun)).collect::<Vec<_>>().join(" and ")
}

/// A share of a number in whole percent, never 100 unless it is all, never 0 unless it is none; empty of 0.
pub(crate) fn percent(part: u64, whole: u64) -> String {
    if whole == 0 {
        return String::new();
    }
    let share = (part as f64 / whole as f64 * 100.0).round();
    let share = if part == 0 || part == whole { share } else { share.clamp(1.0, 99.0) };
    format!(" ({share} %)")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_have_commas() {
        assert_eq!(
            ["0", "999", "1,000", "1,234,567"],
            [0, 999, 1000, 1_234_567].map(count).each_ref().map(String::as_str)
        );
    }

    #[test]
    fn things_that_are_none_are_left_out() {
        assert_eq!(some_of(&[(1, "scan"), (2000, "observation")]), "1 scan and 2,000 observations");
        assert_eq!(some_of(&[(0, "scan"), (2, "observation")]), "2 observations");
        assert_eq!(some_of(&[(0, "scan")]), "");
    }

    #[test]
    fn a_share_is_all_or_none_only_if_it_is() {
        let shares = [(0, 3), (1, 1000), (500, 1000), (999, 1000), (3, 3), (0, 0)];
        assert_eq!(
            shares.map(|(part, whole)| percent(part, whole)),
            [" (0 %)", " (1 %)", " (50 %)", " (99 %)", " (100 %)", ""]
        );
    }
}
