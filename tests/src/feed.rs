//! Observations as a function of the producer and the sequence number, so that the expected content of a daemon follows
//! from the last sequence number of each producer.
//!
//! Invariant: no two observations of a feed have the same time; times are out of order by less than
//! [`Feed::JITTER`] steps; it is known which ones are refused.

/// The first time: 2021-03-01T00:00:00Z, a Monday.
const START_NANOS: i64 = 1_614_556_800_000_000_000;

/// An observation as a producer sends it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Index of the state; [`state_name`] is its name.
    pub state: u32,
    /// Nanoseconds UTC.
    pub time_nanos: i64,
    /// The value; outside [0, 1] if the daemon must refuse it.
    pub value: f64,
}

impl Observation {
    /// Whether the daemon must refuse the observation.
    #[must_use]
    pub fn is_refused(&self) -> bool {
        !(0.0..=1.0).contains(&self.value)
    }
}

/// Name of a state.
#[must_use]
pub fn state_name(state: u32) -> String {
    format!("state {state}")
}

/// A deterministic source of observations.
#[derive(Clone, Copy, Debug)]
pub struct Feed {
    /// Another seed draws other observations.
    pub seed: u64,
    /// Number of states.
    pub states: u32,
    /// Time between one number and the next.
    pub step_nanos: i64,
    /// Interval between refused observations; 0: none.
    pub refused_every: u64,
}

impl Feed {
    /// Steps by which a time may be out of order.
    pub const JITTER: u64 = 64;

    /// A feed with a time every 20 seconds, of eleven states, with some refused observations.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self { seed, states: 11, step_nanos: 20_000_000_000, refused_every: 397 }
    }

    /// Observation number `sequence`, from 1, of a producer.
    #[must_use]
    pub fn observation(&self, producer: u32, sequence: u64) -> Observation {
        let draw = mixed(self.seed ^ mixed(u64::from(producer) << 48 ^ sequence));
        let place = i64::try_from(sequence + draw % Self::JITTER).expect("fewer numbers than i64 holds");
        // Makes times differ: numbers with the same time step are within 64 of each other.
        let own = i64::from(producer) * 1_000 + i64::try_from(sequence % 1_000).expect("below 1000");
        let refused = self.refused_every != 0 && sequence % self.refused_every == self.refused_every / 2;
        let value = match draw >> 8 & 3 {
            _ if refused => 1.5,
            0 => 0.0,
            1 | 2 => 1.0,
            _ => (draw >> 16 & 0xFFFF) as f64 / f64::from(0xFFFF),
        };
        let state = u32::try_from((draw >> 32) % u64::from(self.states)).expect("an index");
        Observation { state, time_nanos: START_NANOS + place * self.step_nanos + own, value }
    }
}

/// SplitMix64.
fn mixed(number: u64) -> u64 {
    let mut z = number.wrapping_add(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn times_differ_and_do_not_ascend() {
        let feed = Feed::new(1);
        let all: Vec<i64> =
            (0..8).flat_map(|producer| (1..3_000).map(move |n| feed.observation(producer, n).time_nanos)).collect();
        assert_eq!(all.iter().collect::<BTreeSet<_>>().len(), all.len());
        assert!(!all[..3_000].is_sorted());
    }

    #[test]
    fn all_states_all_kinds_of_values_and_refusals_occur() {
        let feed = Feed::new(2);
        let all: Vec<Observation> = (1..2_000).map(|n| feed.observation(3, n)).collect();
        assert_eq!(all.iter().map(|o| o.state).collect::<BTreeSet<_>>().len(), 11);
        assert_eq!(all.iter().filter(|o| o.is_refused()).count(), 5);
        for wanted in [0.0, 1.0] {
            assert!(all.iter().any(|o| o.value == wanted));
        }
        assert!(all.iter().any(|o| o.value > 0.0 && o.value < 1.0));
    }
}
