//! The whereabouts of a person of the explored office during a day.
//!
//! Invariant: a person's day depends on the seed, the person and the day only.

use rand::{Rng as _, RngCore as _, SeedableRng as _, rngs::SmallRng};

const MINUTE: i64 = 60;
const HOUR: i64 = 3600;
/// Probability that a person is away all day.
const ABSENT: f64 = 0.03;
/// Number of short breaks in a day.
const BREAKS: usize = 2;

/// The whereabouts of a person.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Whereabouts {
    /// Not in the office.
    Away,
    /// In the office, but not visible in the grid.
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
    /// Every day at this time; none for people who do not take part.
    meeting: Option<i64>,
}

/// Seconds around `mean` with standard deviation `spread`, at most 3.5 standard deviations away.
fn around(random: &mut SmallRng, mean: i64, spread: i64) -> i64 {
    let bell: f64 = (0..4).map(|_| random.random_range(-1.0..1.0)).sum();
    mean + (spread as f64 * bell / 1.155) as i64
}

/// A generator for each pair of numbers.
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
            // Half of the people on average; the same time for all.
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
