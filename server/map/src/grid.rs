//! The occupancy grid of a map: millions of cells, each with its own temporal model, at the cost of what changes.
//!
//! Cells live in tiles of 8x8x8, as bit masks. A cell that never changed costs bits; one that changed has sums over its
//! observations, kept per run of equal readings and never per observation (T-RO 2017, section VI is the job to beat).
//!
//! Invariant: unknown, free and occupied are three different things everywhere. A cell is observed when a scan says so;
//! an occupied cell is observed.

pub mod day;
mod fold;
pub mod generation;
pub mod index;
pub mod live;
pub mod live_tile;
pub mod log_head;
pub mod mask;
pub mod observation_runs;
pub mod outcome;
pub mod paging;
pub mod predict;
pub mod raycast;
pub mod scan;
pub mod sensor_sums;
pub mod sensors;
pub mod snapshot;
pub mod spec;
pub mod tile;
pub mod update;
pub mod view;

#[cfg(test)]
mod tests;
