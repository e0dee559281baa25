//! Number of rounds and seed of a random test.
//!
//! Invariant: the seed is printed, and the same seed draws the same numbers; timing is not reproducible.

use std::{env, process};

use rand::{SeedableRng, rngs::SmallRng};

/// A count from the environment.
///
/// # Panics
/// If the variable is set to something else than a number.
#[must_use]
pub fn count(variable: &str, default: u32) -> u32 {
    match env::var(variable) {
        Ok(text) => text.parse().unwrap_or_else(|_| panic!("{variable} is {text:?}: it must be a number")),
        Err(_) => default,
    }
}

/// A seed, from `TIDEMAP_SEED` or from the process's number, printed with the name of the test.
///
/// # Panics
/// If the variable is set to something else than a number.
#[must_use]
pub fn seed(test: &str) -> u64 {
    let seed = match env::var("TIDEMAP_SEED") {
        Ok(text) => text.parse().unwrap_or_else(|_| panic!("TIDEMAP_SEED is {text:?}: it must be a number")),
        Err(_) => u64::from(process::id()),
    };
    println!("{test}: TIDEMAP_SEED={seed}");
    seed
}

/// Draws from a seed.
#[must_use]
pub fn draws(seed: u64) -> SmallRng {
    SmallRng::seed_from_u64(seed)
}
