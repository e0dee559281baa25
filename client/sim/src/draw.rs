//! Random numbers that can be drawn in any order, keyed by topic, index and date.
//!
//! Invariant: equal keys give equal draws; draws of one topic do not depend on draws of another.

use jiff::civil::Date;
use rand::{Rng, RngCore, SeedableRng, rngs::SmallRng};

/// The subject of a draw.
#[derive(Clone, Copy, Debug)]
pub(crate) enum DrawTopic {
    Person,
    Leave,
    Meeting,
    Cleaner,
    StorageDoor,
    Patrol,
    Sensor,
    BuildingUse,
    BuildingReading,
    BuildingDrive,
    BuildingFloor,
    HallPatrol,
}

/// The generator for the `index`-th thing of a topic on a date.
pub(crate) fn draws(seed: u64, topic: DrawTopic, index: usize, date: Date) -> SmallRng {
    let day = u64::from(date.year().unsigned_abs()) * 400 + u64::from(date.day_of_year().unsigned_abs());
    let parts = [topic as u64, index as u64, day];
    let key = parts.into_iter().fold(seed, |key, part| SmallRng::seed_from_u64(key ^ part).next_u64());
    SmallRng::seed_from_u64(key)
}

/// A duration or time of day around `mean_secs`, with standard deviation `spread_secs`.
pub(crate) fn around(rng: &mut SmallRng, mean_secs: i32, spread_secs: i32) -> i32 {
    // The sum of four uniform draws is close to a normal distribution, and bounded.
    let bell: f64 = (0..4).map(|_| rng.random_range(-1.0..1.0)).sum();
    mean_secs + (f64::from(spread_secs) * bell / 1.155) as i32
}
