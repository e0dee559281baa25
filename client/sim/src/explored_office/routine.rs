//! Where a person is in the course of a day.
//!
//! Invariant: a day of a person depends on the seed, the person and the day only.

use rand::{Rng as _, RngCore as _, SeedableRng as _, rngs::SmallRng};

const MINUTE: i64 = 60;
const HOUR: i64 = 3600;
/// How often somebody is away all day.
const ABSENT: f64 = 0.03;
/// Short breaks a day.
const BREAKS: usize = 2;

/// Where somebody is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Whereabouts {
    /// Not in the office.
    Away,
    /// In the office, where the grid does not show it.
    Elsewhere,
    Desk,
    Lunch,
    Meeting,
}

/// A person with habits, in seconds of the day.
#[derive(Clone, Copy, Debug)]
pub(super) struct Person {
    seed: u64,
    arrives: i64,
    leaves: i64,
    lunch: i64,
    lunch_length: i64,
    /// Of every day, and of those alone who take part.
    meeting: Option<i64>,
}

/// Seconds around a mean, seldom further off than twice the spread, never further than 3.5 times.
fn around(random: &mut SmallRng, mean: i64, spread: i64) -> i64 {
    let bell: f64 = (0..4).map(|_| random.random_range(-1.0..1.0)).sum();
    mean + (spread as f64 * bell / 1.155) as i64
}

/// Draws of their own for each number of a chain.
fn draws(seed: u64, numbers: [u64; 2]) -> SmallRng {
    let key = numbers.into_iter().fold(seed, |key, number| SmallRng::seed_from_u64(key ^ number).next_u64());
    SmallRng::seed_from_u64(key)
}

impl Person {
    pub(super) fn new(seed: u64, person: usize) -> Self {
        let mut random = draws(seed, [0, person as u64]);
        let seed = random.next_u64();
        let between = |random: &mut SmallRng, from: i64, until: i64| random.random_range(from..until);
        Self {
            seed,
            arrives: between(&mut random, 8 * HOUR, 10 * HOUR),
            leaves: between(&mut random, 16 * HOUR + 30 * MINUTE, 19 * HOUR),
            lunch: between(&mut random, 12 * HOUR, 13 * HOUR + 30 * MINUTE),
            lunch_length: between(&mut random, 35 * MINUTE, HOUR),
            // Every other one on average; the same time for all.
            meeting: random.random_bool(0.5).then_some(10 * HOUR + 30 * MINUTE),
        }
    }

    pub(super) fn whereabouts(&self, day: i64, second: i64) -> Whereabouts {
        let mut random = draws(self.seed, [1, day as u64]);
        let is_absent = random.random_bool(ABSENT);
        let arrives = around(&mut random, self.arrives, 12 * MINUTE);
        let leaves = around(&mut random, self.leaves, 15 * MINUTE);
        if is_absent || !(arrives..leaves).contains(&second) {
            return Whereabouts::Away;
        }
        let lunch = around(&mut random, self.lunch, 8 * MINUTE);
        if (lunch..around(&mut random, lunch + self.lunch_length, 5 * MINUTE)).contains(&second) {
            return Whereabouts::Lunch;
        }
        if let Some(meeting) = self.meeting {
            let starts = around(&mut random, meeting, 3 * MINUTE);
            if (starts..around(&mut random, starts + 40 * MINUTE, 6 * MINUTE)).contains(&second) {
                return Whereabouts::Meeting;
            }
        }
        for _ in 0..BREAKS {
            let starts = random.random_range(arrives..leaves);
            if (starts..starts + random.random_range(5 * MINUTE..25 * MINUTE)).contains(&second) {
                return Whereabouts::Elsewhere;
            }
        }
        Whereabouts::Desk
    }
}
