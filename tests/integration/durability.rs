//! What is acknowledged survives: kill -9, power cuts, full and failing disks, flipped bits. And that these tests can
//! fail: a daemon with a planted fault is caught by them.
//!
//! Invariant: every test names what it draws from, and a round in which nothing was acknowledged does not count.

mod bit_flips;
mod full_disk;
mod kill;
mod planted_fault;
mod power_cut;
mod sync_error;

use tidemap::maps::NewMap;
use tidemap_tests::{daemon::Daemon, oracle::Oracle};

/// Producers that stream at the same time.
const PRODUCERS: usize = 8;

/// Creates the oracle's map. By London's time, so that local midnights are not those of UTC throughout.
async fn create_map(daemon: &Daemon, oracle: &Oracle) {
    let map = NewMap { name: oracle.map.clone(), time_zone: Some("Europe/London".to_owned()), ..NewMap::default() };
    daemon.client().create_map(map).await.expect("a new map");
}
