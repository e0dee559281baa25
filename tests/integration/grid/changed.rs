//! Cells whose change alarm is on: `grid changed`.
//!
//! Invariant: what is listed is what `model show` reports for each cell, before and after a kill.

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

/// A Monday.
const START_SECS: i64 = 1_704_067_200;
const DAYS: i64 = 60;
/// The day from which the routine of cell 0 is another.
const CHANGED: i64 = 40;

/// Cell 0 is occupied by day, later in the evening; cell 1 by day, always. Each reads wrong once in some hours.
async fn observe(daemon: &Daemon, map: &str) {
    let mut robot = Producer::open(&daemon.client(), ProducerOptions::new("robot", "", map)).await.expect("a Welcome");
    for number in 0..24 * DAYS {
        let (day, hour) = (number / 24, number % 24);
        let by_day = (8..17).contains(&hour);
        let occupied = |place: i64, expected: bool| expected != ((number * 7 + place * 11) % 29 == 0);
        let first = occupied(0, if day < CHANGED { by_day } else { (17..23).contains(&hour) });
        let word = u64::from(first) | u64::from(occupied(1, by_day)) << 1;
        let layer = |word| Mask([word, 0, 0, 0, 0, 0, 0, 0]);
        let tile = (TileIndex { x: -1, y: 0, z: 0 }, TileMasks::clipped(layer(0b11), layer(word)));
        robot.send_scan((START_SECS + number * 3_600) * 1_000_000_000, Scan::Tiles(vec![tile])).await.expect("taken");
    }
    robot.flush().await.expect("durable");
    assert_eq!(robot.take_refusals(), []);
    cli::tidemap(daemon, ["update", map]).table();
}

#[tokio::test(flavor = "multi_thread")]
async fn cells_with_another_routine_are_listed_also_after_a_kill() {
    let data = tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    let mut daemon = launch.start();
    cli::tidemap(&daemon, ["map", "create", "hall", "--grid", "resolution=0.5,flat,origin=10:0:0"]).table();
    cli::tidemap(&daemon, ["map", "create", "doors"]).table();
    let changed = |daemon: &Daemon, more: &[&str]| {
        let args = ["grid", "changed", "hall", "--output", "csv"];
        cli::tidemap(daemon, args.into_iter().chain(more.iter().copied()))
    };
    assert_eq!(changed(&daemon, &["--region", "0:20,0:8"]).table().rows.len(), 0);
    observe(&daemon, "hall").await;
    for _ in 0..2 {
        let listed = changed(&daemon, &[]).table();
        assert_eq!(listed.column("state"), ["cell/-8/0/0"]);
        assert_eq!((listed.number("x"), listed.number("y")), (6.25, 0.25));
        assert_eq!(listed.number("n"), (24 * DAYS) as f64);
        let shown = cli::tidemap(&daemon, ["model", "show", "hall", "cell/-8/0/0", "--output", "json"]);
        let shown: serde_json::Value = serde_json::from_str(&shown.stdout).expect("JSON");
        assert_eq!(shown["change_date"], listed.column("change_date")[0]);
        assert!(("2024-02-10".."2024-02-25").contains(&listed.column("change_date")[0]), "{:?}", listed);
        assert_eq!((listed.number("mean"), listed.number("order")), (number(&shown["mean"]), number(&shown["order"])));
        let table = cli::tidemap(&daemon, ["grid", "changed", "hall", "--output", "table"]);
        assert!(table.stderr.contains("1 cell"), "{}", table.stderr);
        // The cell lies from 6 to 6.5 m.
        assert_eq!(changed(&daemon, &["--region", "6:6.5,0:0.5"]).table().rows.len(), 1);
        assert_eq!(changed(&daemon, &["--region", "6.5:9,0:0.5"]).table().rows.len(), 0);
        daemon.kill();
        daemon = launch.start();
    }
    changed(&daemon, &["--z", "0:1"]).fails(2, &["--z", "flat"]);
    cli::tidemap(&daemon, ["grid", "changed", "doors"]).fails(1, &["doors", "no grid"]);
    cli::tidemap(&daemon, ["grid", "changed", "nowhere"]).fails(1, &["nowhere"]);
}

fn number(value: &serde_json::Value) -> f64 {
    value.as_f64().expect("a number")
}
