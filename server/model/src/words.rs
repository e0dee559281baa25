//! Common words for values, such as the words for the values of a door contact or a lamp.
//!
//! Invariant: words are in lower case, and a word has one meaning.

/// Words for 1.
pub const ONES: [&str; 12] =
    ["on", "open", "opened", "true", "yes", "detected", "occupied", "home", "active", "motion", "pressed", "present"];
/// Words for 0.
pub const ZEROS: [&str; 12] =
    ["off", "closed", "close", "false", "no", "clear", "free", "not_home", "inactive", "away", "released", "absent"];
/// Words for a sensor without a value.
pub const NO_VALUE: [&str; 9] = ["", "unavailable", "unknown", "none", "null", "nan", "na", "n/a", "offline"];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_word_has_one_meaning_and_is_found_in_any_case() {
        let all: Vec<&str> = [&ONES[..], &ZEROS, &NO_VALUE].concat();
        for (place, word) in all.iter().enumerate() {
            assert_eq!(*word, word.to_lowercase());
            assert!(!all[..place].contains(word), "{word}");
        }
    }
}
