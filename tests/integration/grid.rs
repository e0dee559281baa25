//! Occupancy grids from outside: scans are sent over the real port, through kills and restarts, and the answers are
//! computed independently from the scans.
//!
//! Invariant: expected answers are computed from the scans that were sent, never from a daemon's answers, except where
//! two daemons are compared.

mod bad_files;
mod bad_scans;
mod bad_streams;
mod changed;
mod half_life;
mod hall;
mod history;
mod kill;
pub(crate) mod map_file;
mod map_series;
mod naive;
mod octomap_file;
mod oracle;
mod rays;

use tempfile::TempDir;
use tidemap_client::{
    maps::{GridSpec, GridSummary, NewMap, Retention},
    observe::{
        Producer, ProducerOptions,
        scan::Scan,
        tiles::{Mask, TileIndex, TileMasks},
    },
    queries::{GridQuery, ModelKind, ModelSelector, WholeGrid},
};
use tidemap_tests::{
    daemon::{Daemon, Launch},
    film::Film,
};

/// The map of all these tests.
const MAP: &str = "office";

/// Cells of 0.1 m.
fn grid(retention: Retention) -> GridSpec {
    GridSpec { retention, ..GridSpec::new(0.1) }
}

fn new_map(grid: GridSpec) -> NewMap {
    let zone = Some(Film::ZONE.to_owned());
    NewMap { name: MAP.to_owned(), time_zone: zone, grid: Some(grid), ..NewMap::default() }
}

/// A daemon with an empty map. Its data lives as long as the folder.
async fn office(grid: GridSpec) -> (TempDir, Daemon) {
    let data = tempfile::tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    daemon.client().create_map(new_map(grid)).await.expect("a new map");
    (data, daemon)
}

async fn summary(daemon: &Daemon) -> GridSummary {
    daemon.client().map(MAP).await.expect("the map").grid_summary.expect("a grid")
}

fn model(kind: ModelKind, order: Option<usize>) -> ModelSelector {
    ModelSelector { kind, order, ..ModelSelector::default() }
}

/// The whole grid at one time.
async fn predicted(daemon: &Daemon, time_nanos: i64, model: ModelSelector) -> WholeGrid {
    let query = GridQuery { map: MAP.to_owned(), time_nanos, model, ..GridQuery::default() };
    daemon.client().predict_grid(&query).await.expect("a grid").whole().await.expect("all of it")
}

async fn producer(daemon: &Daemon, name: &str) -> Producer {
    let options = ProducerOptions::new(name, "", MAP);
    Producer::open(&daemon.client(), options).await.expect("a Welcome")
}

/// Sends scans of tiles and waits until they are durable; none of them may be refused.
async fn send(producer: &mut Producer, scans: impl IntoIterator<Item = (i64, Vec<(TileIndex, TileMasks)>)>) {
    for (time, tiles) in scans {
        producer.send_scan(time, Scan::Tiles(tiles)).await.expect("taken");
    }
    producer.flush().await.expect("durable");
    assert_eq!(producer.take_refusals(), []);
}

/// A partial view of a film: every fifth scan, seven seconds later, with six of the tiles, some layers of them, and
/// sometimes an obstacle in a place that is otherwise free.
fn partial_view(film: &Film) -> impl Iterator<Item = (i64, Vec<(TileIndex, TileMasks)>)> {
    film.run().enumerate().skip(3).step_by(5).map(|(number, (time, occupied))| {
        let turn = number / 250;
        let observed = Mask(std::array::from_fn(|z| match (z + turn) % 8 {
            0 | 1 => 0,
            2 => 0x0F0F_0F0F_0F0F_0F0F,
            _ => u64::MAX,
        }));
        let mut tiles = film.seen(&occupied);
        tiles = tiles.into_iter().skip(turn % 4).step_by(2).take(6).collect();
        for (_, masks) in &mut tiles {
            let mut occupied = masks.occupied();
            if number % 7 == 0 {
                occupied.flip(3 * 64 + 17);
            }
            *masks = TileMasks::clipped(observed, occupied);
        }
        (time + 7_000_000_000, tiles)
    })
}
