//! The occupancy grid: millions of cells, each with its own temporal model, at the cost of what changes.
//!
//! Cells live in tiles of 8x8x8, as bit masks. A cell that never changed costs bits. A cell that changed has sums over
//! its observations, kept per run of equal readings and never per observation (T-RO 2017, section VI).
//!
//! A scan passes through `log_head.rs` (differences against the last scan of each tile in the log), the log, `live.rs`
//! (last values per tile, and the exact scans of each local day), `update/` (score, choose orders, learn, train again)
//! and `view.rs` (the data that readers see).
//!
//! - **Bins.** With [`spec::Evidence::Bins`] the scans of each half hour become one bin before an update learns the day
//!   (`bins.rs`): the reading of a cell is then the posterior of its rays. Otherwise each reading counts, as published.
//! - **Cost follows change.** A scan costs its flips. Scans of the same tiles form runs ([`live_tile::ScanRun`]), so
//!   that unchanged tiles are not touched. In an update, a run of occupied readings adds the difference of two rows of
//!   running phasor sums (T-RO eq. 11 without a phasor per reading).
//! - **Patterns.** Tiles seen by the same scans of a day are processed together, with the rows of exactly these scans.
//!   So a run does not end where a scan did not see the tile.
//! - **Observation groups.** Cells of a tile that were always observed together share one sum B_k. Groups split where
//!   the observed cells differ, at most down to single cells.
//! - **Observation runs instead of sums.** A passing robot sees other cells of a tile each time. For a tile with more
//!   than 16 groups, the times at which cells that never changed were observed are kept (`observation_runs.rs`), and
//!   the sums of such a cell are computed at its first change. A tile never takes more than twice the memory of the
//!   smaller of the two forms.
//! - **Scoring is explicit**: every reading of a changed cell, every order, with saturation. This is the largest cost
//!   of a night.
//! - **Support and change alarm** follow the rules of named states; support applies from the fourth week on. The times
//!   of the observations are kept per group ([`observed_times`]), and per changed cell some 120 bytes: gains, alarm,
//!   changes.
//! - **Sensors with different levels**: see [`sensors`]. A map with one sensor keeps no sums for other sensors.
//! - **Sums stay with the writer**, models go to readers. An update takes the sums out, changes them in place and
//!   brings them back, so that they are in memory once.
//! - **A snapshot holds the pending scans.** A restart replays the log from the snapshot's position, and differences
//!   never lack their base.
//! - **Tiles beyond the memory budget** are read from the checkpoint on demand.
//!
//! This crate contains no named states, no producers and no events: a scan reaches it with its time and its sensor.
//!
//! Invariants: no I/O, no clock, no hidden randomness. Unknown, free and occupied are three different things
//! everywhere. A cell is observed when a scan marks it as observed; an occupied cell is observed.

pub mod bins;
mod blend;
pub mod day;
pub mod fade;
mod fold;
pub mod follower;
pub mod generation;
pub mod index;
pub mod live;
pub mod live_tile;
pub mod log_head;
pub mod mask;
pub mod observation_runs;
pub mod observed_times;
pub mod outcome;
pub mod pace;
pub mod paging;
pub mod predict;
mod ray_odds;
pub mod raycast;
pub mod scan;
pub mod sensor_sums;
pub mod sensors;
pub mod snapshot;
pub mod spec;
pub mod standing;
mod tempering;
pub mod tile;
pub mod tile_odds;
pub mod update;
pub mod view;

#[cfg(test)]
mod tests;
