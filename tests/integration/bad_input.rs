//! Bad input is refused by itself with a message that names it, and everything beside it is kept: on the wire and on
//! the command line.

mod files;
mod requests;
mod streams;
mod wire;

use tempfile::TempDir;
use tidemap_client::maps::NewMap;
use tidemap_tests::daemon::{Daemon, Launch};

/// A daemon with an empty map `office`. Its data lives as long as the folder.
async fn office(change: impl FnOnce(Launch) -> Launch) -> (TempDir, Daemon) {
    let data = tempfile::tempdir().expect("a folder");
    let daemon = change(Launch::on(data.path())).start();
    let map = NewMap { name: "office".to_owned(), ..NewMap::default() };
    daemon.client().create_map(map).await.expect("a new map");
    (data, daemon)
}

/// Observations that the map `office` holds.
async fn observations(daemon: &Daemon) -> u64 {
    daemon.client().map("office").await.expect("the map").observations
}

/// Names of the states of the map `office`.
async fn states(daemon: &Daemon) -> Vec<String> {
    let (states, _) = daemon.client().states("office", "").await.expect("the map");
    states.into_iter().map(|state| state.name).collect()
}
