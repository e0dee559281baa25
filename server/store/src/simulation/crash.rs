//! Power cuts and kills at random moments: every acknowledged record is still there, in order, once.

use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};

use super::{disk::SimulatedDisk, machine::Machine};

/// Acknowledged records, and logs whose beginning was deleted.
fn run(seed: u64) -> (u64, u64) {
    let mut random = SmallRng::seed_from_u64(seed);
    let mut machine = Machine::new(SimulatedDisk::new(SmallRng::seed_from_u64(seed ^ 0x5EED)));
    machine.start().expect("starts");
    for _ in 0..random.random_range(10..60) {
        match random.random_range(0..20) {
            0 | 1 if machine.maps.len() < 3 => machine.create_map(),
            2 | 3 => machine.save(&mut random),
            4 => {
                let is_power_cut = random.random();
                machine.restart(is_power_cut).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
            }
            5..=7 => {
                // The process or the power ends during an operation: this call and all later ones do not happen.
                // After a kill, names are there that a later power cut may take away again.
                let call = machine.disk.calls() + random.random_range(0..6);
                let kind = std::io::ErrorKind::Other;
                machine.disk.set_fault(Some(super::disk::Fault { call, kind, is_sticky: true }));
                match random.random_range(0..4) {
                    0 if machine.maps.len() < 3 => machine.create_map(),
                    1 => machine.save(&mut random),
                    _ => drop(machine.append(&mut random)),
                }
                let is_power_cut = random.random();
                machine.restart(is_power_cut).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
            }
            _ => assert_eq!(machine.append(&mut random), [], "seed {seed}"),
        }
    }
    machine.restart(true).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
    (machine.acknowledged, machine.shortened_logs())
}

/// A number from the environment, which `make durability` and `make soak` set.
fn from_environment(variable: &str) -> Option<u64> {
    let text = std::env::var(variable).ok()?;
    Some(text.parse().unwrap_or_else(|_| panic!("{variable} is {text:?}: it must be a number")))
}

#[test]
fn nothing_acknowledged_is_lost_in_any_seed() {
    let add = |(a, b): (u64, u64), (c, d): (u64, u64)| (a + c, b + d);
    let seeds = from_environment("TIDEMAP_SIMULATED_SEEDS").unwrap_or(200);
    let first = from_environment("TIDEMAP_SEED").unwrap_or(0);
    let (acknowledged, shortened) = (first..first + seeds).map(run).fold((0, 0), add);
    assert!(acknowledged > 10 * seeds, "too little was tried: {acknowledged}");
    assert!(shortened > seeds / 10, "too few segments were deleted: {shortened}");
}
