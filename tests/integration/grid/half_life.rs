//! Cells that forget: `map create --grid-half-life`.
//!
//! Invariant: a cell is occupied for ten days and free for the ten days after; what it should predict follows from the
//! half-life alone.

use tempfile::tempdir;
use tidemap_client::observe::{
    Producer, ProducerOptions,
    scan::Scan,
    tiles::{Mask, TileIndex, TileMasks},
};
use tidemap_tests::{
    cli,
    daemon::{Daemon, Launch},
};

const START_SECS: i64 = 1_704_067_200;
const DAYS: i64 = 20;

async fn observe(daemon: &Daemon, map: &str) {
    let mut robot = Producer::open(&daemon.client(), ProducerOptions::new("robot", "", map)).await.expect("a Welcome");
    for hour in 0..24 * DAYS {
        let layer = |word| Mask([word, 0, 0, 0, 0, 0, 0, 0]);
        let occupied = if hour < 12 * DAYS { 0b1 } else { 0b10 };
        let tile = (TileIndex { x: 0, y: 0, z: 0 }, TileMasks::clipped(layer(0b11), layer(occupied)));
        robot.send_scan((START_SECS + hour * 3_600) * 1_000_000_000, Scan::Tiles(vec![tile])).await.expect("taken");
    }
    robot.flush().await.expect("durable");
    assert_eq!(robot.take_refusals(), []);
    cli::tidemap(daemon, ["update", map]).table();
}

#[tokio::test(flavor = "multi_thread")]
async fn cells_forget_old_readings_also_after_a_kill() {
    let data = tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    let mut daemon = launch.start();
    let create = |daemon: &Daemon, map: &str, more: &[&str]| {
        let args = ["map", "create", map, "--grid", "resolution=0.1,flat,hit=0.9,false-alarm=0.1,prior=0.5"];
        cli::tidemap(daemon, args.into_iter().chain(more.iter().copied()))
    };
    create(&daemon, "keeps", &[]).table();
    create(&daemon, "forgets", &["--grid-half-life", "2d"]).table();
    create(&daemon, "hasty", &["--grid-half-life", "1h"]).fails(1, &["half-life", "0.1 days"]);
    cli::tidemap(&daemon, ["map", "create", "none", "--grid-half-life", "2d"]).fails(2, &["--grid"]);
    for map in ["keeps", "forgets"] {
        observe(&daemon, map).await;
    }
    for _ in 0..2 {
        let shown = cli::tidemap(&daemon, ["map", "show", "forgets", "--output", "csv"]).table();
        assert_eq!(shown.column("grid_half_life"), ["2d"]);
        let mean = |map: &str, cell: &str| {
            let at = (START_SECS + (24 * DAYS + 6) * 3_600).to_string();
            let args = ["predict", map, cell, "--at", &at, "--model", "mean"];
            cli::tidemap(&daemon, args).table().number("probability")
        };
        // Days 0 to 9 have 2^-5 of the weight of the days ten later. A reading counts 0.9 or 0.1.
        let old = 0.1 + 0.8 / 33.0;
        let expected = [("keeps", 0.5, 0.5), ("forgets", old, 1.0 - old)];
        for (map, first, second) in expected {
            let found = [mean(map, "cell/0/0/0"), mean(map, "cell/1/0/0")];
            assert!((found[0] - first).abs() < 1e-6 && (found[1] - second).abs() < 1e-6, "{map}: {found:?}");
        }
        daemon.kill();
        daemon = launch.start();
    }
}
