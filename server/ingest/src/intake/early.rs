//! Times before today's clocks: from a robot whose clock is not set, or in another unit.
//!
//! Invariant: only maps with a real clock refuse them, so that simulations may begin at 0.

use tidemap_map::spec::REAL_CLOCK_MIN_NANOS;
use tidemap_model::time::format_rfc3339;

/// The latest plausible time, the year 2100: a conversion from another unit to a later time was not meant.
const LATEST_NANOS: i64 = 4_102_444_800_000_000_000;

/// The text of a refusal of a time, with its probable meaning.
pub fn refusal(time: i64) -> String {
    let secs = time as f64 / 1e9;
    let meant = [("seconds", 1_000_000_000), ("milliseconds", 1_000_000), ("microseconds", 1_000)]
        .into_iter()
        .find_map(|(unit, nanos): (_, i64)| Some((unit, time.checked_mul(nanos)?)))
        .filter(|(_, time)| (REAL_CLOCK_MIN_NANOS..LATEST_NANOS).contains(time));
    let guess = match meant {
        Some((unit, time)) => format!("was it meant in {unit}, as {}?", format_rfc3339(time)),
        None => "is the robot's clock set?".to_owned(),
    };
    format!(
        "time {time} ns is {secs} s after the beginning of 1970: {guess} A map whose clock is simulated accepts times \
         before 1990"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_unit_is_guessed() {
        let now = 1_738_000_000_i64;
        for (time, text) in [
            (now, "meant in seconds, as 2025-01-27T"),
            (now * 1_000, "meant in milliseconds, as 2025-01-27T"),
            (now * 1_000_000, "meant in microseconds, as 2025-01-27T"),
            (5_000_000_000_000, "is the robot's clock set?"),
            (0, "clock set?"),
        ] {
            let detail = refusal(time);
            assert!(detail.contains(text), "{detail}");
            assert!(detail.chars().count() <= super::super::DETAIL_CHARS_MAX, "{detail}");
        }
    }
}
