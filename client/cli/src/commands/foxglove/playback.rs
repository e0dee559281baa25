//! The position of the time bar, and its speed.
//!
//! Invariant: the time is within the range; it moves only while playing.

use std::time::Duration;

/// Fastest speed: an hour in a second.
const SPEED_MAX: f64 = 3_600.0;

/// A time bar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Playback {
    first_nanos: i64,
    last_nanos: i64,
    at_nanos: i64,
    /// Nanoseconds of the map in a nanosecond of the clock.
    speed: f64,
    is_playing: bool,
}

impl Playback {
    /// A time bar that stands at a time.
    pub(super) fn new((first_nanos, last_nanos): (i64, i64), at_nanos: i64) -> Self {
        let at_nanos = at_nanos.clamp(first_nanos, last_nanos);
        Self { first_nanos, last_nanos, at_nanos, speed: 1.0, is_playing: false }
    }

    /// Changes the playback as a client requests; an invalid speed leaves the speed as it is.
    pub(super) fn request(&mut self, plays: bool, speed: f64, seek_nanos: Option<i64>) {
        if speed.is_finite() && speed > 0.0 {
            self.speed = speed.min(SPEED_MAX);
        }
        if let Some(seek) = seek_nanos {
            self.at_nanos = seek.clamp(self.first_nanos, self.last_nanos);
        }
        self.is_playing = plays && self.at_nanos < self.last_nanos;
    }

    /// Lets time pass. Returns whether it has just reached the end.
    pub(super) fn advance(&mut self, elapsed: Duration) -> bool {
        if !self.is_playing {
            return false;
        }
        let passed = elapsed.as_secs_f64() * self.speed * 1e9;
        // Beyond the range it saturates, and is then at the end.
        self.at_nanos = self.at_nanos.saturating_add(passed as i64).min(self.last_nanos);
        self.is_playing = self.at_nanos < self.last_nanos;
        !self.is_playing
    }

    pub(super) fn at_nanos(&self) -> i64 {
        self.at_nanos
    }

    pub(super) fn speed(&self) -> f64 {
        self.speed
    }

    pub(super) fn is_playing(&self) -> bool {
        self.is_playing
    }

    pub(super) fn is_at_end(&self) -> bool {
        self.at_nanos >= self.last_nanos
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: i64 = 1_000_000_000;

    #[test]
    fn time_moves_while_it_plays_and_ends_at_the_end() {
        let mut bar = Playback::new((0, 100 * SECOND), 40 * SECOND);
        assert!(!bar.advance(Duration::from_secs(5)));
        assert_eq!(bar.at_nanos(), 40 * SECOND, "it does not play yet");
        bar.request(true, 2.0, None);
        assert!(!bar.advance(Duration::from_secs(5)));
        assert_eq!((bar.at_nanos(), bar.is_playing()), (50 * SECOND, true));
        assert!(bar.advance(Duration::from_secs(50)));
        assert_eq!((bar.at_nanos(), bar.is_playing(), bar.is_at_end()), (100 * SECOND, false, true));
        assert!(!bar.advance(Duration::from_secs(1)), "the end is reached once");
        bar.request(true, 1.0, None);
        assert!(!bar.is_playing(), "there is nothing behind the end");
        bar.request(true, 1.0, Some(10 * SECOND));
        assert_eq!((bar.at_nanos(), bar.is_playing()), (10 * SECOND, true));
    }

    #[test]
    fn a_request_beyond_the_range_is_held_within_it() {
        let mut bar = Playback::new((10, 20), 500);
        assert_eq!(bar.at_nanos(), 20);
        bar.request(false, f64::NAN, Some(5));
        assert_eq!((bar.at_nanos(), bar.speed()), (10, 1.0));
        bar.request(false, 1e12, Some(i64::MAX));
        assert_eq!((bar.at_nanos(), bar.speed()), (20, SPEED_MAX));
        bar.request(true, -1.0, Some(i64::MIN));
        assert_eq!((bar.at_nanos(), bar.speed(), bar.is_playing()), (10, SPEED_MAX, true));
    }
}
