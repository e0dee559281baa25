//! The store's behaviour, tested through its public functions where possible.

mod backups;
mod bit_flips;
mod copies;
mod damage;
mod digests;
pub(crate) mod example;
mod golden;
mod golden_belief;
mod golden_categorical;
mod golden_ensemble;
mod golden_events;
mod golden_grid;
mod golden_numbers;
mod golden_refusals;
mod golden_rows;
mod golden_sensor;
mod golden_shared;
mod golden_states;
mod golden_trained;
mod grid;
pub(crate) mod grid_example;
mod grid_life;
mod grid_records;
mod groups;
mod history;
mod history_runs;
mod landmarks;
mod learned_fields;
mod life;
mod losses;
mod missing;
mod refused;
mod round_trip;
mod scans;
mod scrubs;
mod segments;
mod spectra;
mod tasks;
mod torn_tail;
mod traversals;
mod verdicts;
mod wire;

/// Whether slow tests run in full, as `make durability` does, and not in their short versions.
pub(crate) fn is_full() -> bool {
    std::env::var_os("TIDEMAP_FULL").is_some()
}
