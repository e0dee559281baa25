//! Decides when to try again after a connection broke, and when to give up.
//!
//! Invariant: pure; the caller passes the time since a fixed instant.

use std::time::Duration;

const FIRST_DELAY: Duration = Duration::from_millis(100);
/// The daemon restarts within a second or two: a longer pause would only delay.
const LAST_DELAY: Duration = Duration::from_secs(3);
/// A connection that lasted this long counts as good, even if nothing was acknowledged.
const GOOD_CONNECTION: Duration = Duration::from_secs(10);

/// The attempts since the last success.
#[derive(Clone, Debug)]
pub struct Outage {
    patience: Duration,
    began: Option<Duration>,
    connected: Option<Duration>,
    attempts: u32,
}

impl Outage {
    /// No outage so far; an outage longer than `patience` is given up.
    #[must_use]
    pub fn new(patience: Duration) -> Self {
        Self { patience, began: None, connected: None, attempts: 0 }
    }

    /// An attempt failed, or a connection broke. Returns how long to wait before the next attempt; `None`: give up.
    pub fn failed(&mut self, now: Duration) -> Option<Duration> {
        if self.connected.take().is_some_and(|since| now.saturating_sub(since) >= GOOD_CONNECTION) {
            self.progressed();
        }
        let began = *self.began.get_or_insert(now);
        let left = self.patience.checked_sub(now.saturating_sub(began)).filter(|left| !left.is_zero())?;
        let delay = FIRST_DELAY.saturating_mul(2_u32.saturating_pow(self.attempts)).min(LAST_DELAY);
        self.attempts += 1;
        Some(delay.min(left))
    }

    /// The daemon sent Welcome. A daemon that ends each connection immediately is still failing.
    pub fn connected(&mut self, now: Duration) {
        self.connected = Some(now);
    }

    /// Something was acknowledged: the outage is over.
    pub fn progressed(&mut self) {
        self.began = None;
        self.attempts = 0;
    }

    /// Duration of the outage so far.
    #[must_use]
    pub fn lasted(&self, now: Duration) -> Duration {
        self.began.map_or(Duration::ZERO, |began| now.saturating_sub(began))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn ms(millis: u64) -> Duration {
        Duration::from_millis(millis)
    }

    #[test]
    fn pauses_double_up_to_a_limit_and_end_with_the_patience() {
        let mut outage = Outage::new(ms(20_000));
        let (mut now, mut delays) = (ms(5_000), Vec::new());
        while let Some(delay) = outage.failed(now) {
            delays.push(delay.as_millis());
            now += delay;
        }
        assert_eq!(delays, [100, 200, 400, 800, 1600, 3000, 3000, 3000, 3000, 3000, 1900]);
        assert_eq!(outage.lasted(now), ms(20_000));
    }

    #[test]
    fn progress_ends_an_outage() {
        let mut outage = Outage::new(ms(1_000));
        outage.failed(ms(0));
        outage.failed(ms(900));
        outage.progressed();
        assert_eq!(outage.failed(ms(5_000)), Some(ms(100)));
    }

    #[test]
    fn a_welcome_alone_does_not_end_an_outage_but_a_long_connection_does() {
        let mut outage = Outage::new(ms(1_000));
        outage.failed(ms(0));
        outage.connected(ms(500));
        assert_eq!(outage.failed(ms(1_500)), None);
        let mut outage = Outage::new(ms(1_000));
        outage.failed(ms(0));
        outage.connected(ms(500));
        assert_eq!(outage.failed(ms(60_500)), Some(ms(100)));
    }

    #[test]
    fn without_patience_the_first_failure_is_the_last() {
        assert_eq!(Outage::new(Duration::ZERO).failed(ms(0)), None);
    }
}
