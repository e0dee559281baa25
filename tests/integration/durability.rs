//! Acknowledged observations survive kill -9, power cuts, full and failing disks, flipped bits. A daemon with a planted
//! fault shows that these tests can fail.
//!
//! Invariant: every test prints its seed, and a round in which nothing was acknowledged does not count.

mod backups;
mod bit_flips;
mod erasure_kills;
mod full_disk;
mod kill;
mod planted_fault;
mod power_cut;
mod sync_error;
mod system_calls;

use std::{ffi::OsString, path::Path, process::Command};

use tidemap_client::maps::NewMap;
use tidemap_tests::{daemon::Daemon, oracle::Oracle};

/// Producers that stream at the same time.
const PRODUCERS: usize = 8;

/// Creates the oracle's map. By London's time, so that local midnights are not those of UTC throughout.
async fn create_map(daemon: &Daemon, oracle: &Oracle) {
    let map = NewMap { name: oracle.map.clone(), time_zone: Some("Europe/London".to_owned()), ..NewMap::default() };
    daemon.client().create_map(map).await.expect("a new map");
}

/// Whether processes can be traced on this machine, or the reason why not.
fn can_trace() -> Result<(), String> {
    match Command::new("strace").args(["-qq", "-e", "trace=none", "true"]).output() {
        Ok(output) if output.status.success() => Ok(()),
        Ok(output) => Err(format!("strace: {}", String::from_utf8_lossy(&output.stderr).trim())),
        Err(error) => Err(format!("strace: {error}")),
    }
}

/// strace before a daemon, with its output in a file. It traces as a grandchild (-D), so that the process started is
/// the daemon itself, with its own number and exit status.
fn strace(output: &Path, more: &[&str]) -> Vec<OsString> {
    let words = ["strace", "-D", "-f", "-qq", "-o"].map(OsString::from);
    words.into_iter().chain([output.into()]).chain(more.iter().map(OsString::from)).collect()
}
