//! Numbers as text for people.
//!
//! Invariant: pure functions.

pub(super) use crate::counted::count;

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
    fn errors_are_compared_in_words() {
        assert_eq!(comparison(0.05, 0.2), "75 % less");
        assert_eq!(comparison(0.2, 0.2), "alike");
        assert_eq!(comparison(0.3, 0.2), "50 % more");
        assert_eq!(comparison(0.0, 0.0), "both exact");
    }
}
