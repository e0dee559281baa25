//! Exploration from outside: expected information, tours through a room that changes, a day's plan, places that
//! robots did not reach; all of it also after a kill.
//!
//! Invariant: the expected plans follow from the construction of the room, never from the daemon's answers.

use std::{fs, path::Path};

use tidemap_client::{
    maps::{GridSpec, NewMap},
    observe::{
        Producer, ProducerOptions,
        scan::Scan,
        tiles::{Mask, TileIndex, TileMasks},
    },
};
use tidemap_tests::{
    cli::{self, Outcome, Table},
    daemon::{Daemon, Launch},
    oracle,
};

mod left_clients;
mod one_person;

const MAP: &str = "room";
/// A Monday.
const START_SECS: i64 = 1_451_865_600;
const HOUR_SECS: i64 = 3_600;
/// Cells of 0.1 m along each side of the room.
const SIDE: i32 = 80;
/// Where somebody sits from 9 to 17 o'clock: cells along x and y.
const SEAT: std::ops::Range<i32> = 60..66;

fn tidemap<'a>(daemon: &Daemon, args: impl IntoIterator<Item = &'a str>) -> Outcome {
    cli::tidemap(daemon, args)
}

/// Whether a cell is occupied at an hour of the day: walls around and a partition with a gap, and the seat.
fn is_occupied([x, y]: [i32; 2], hour: i64) -> bool {
    let is_wall = x == 0 || y == 0 || x == SIDE - 1 || y == SIDE - 1 || (x == 40 && !(30..45).contains(&y));
    is_wall || (SEAT.contains(&x) && SEAT.contains(&y) && (9..17).contains(&hour))
}

fn scan(hour: i64) -> Vec<(TileIndex, TileMasks)> {
    let tiles = SIDE / 8;
    let mask = |[column, row]: [i32; 2]| {
        (0..64)
            .filter(|place| is_occupied([column * 8 + place % 8, row * 8 + place / 8], hour))
            .fold(0, |mask, place| mask | 1_u64 << place)
    };
    let tile = |at: [i32; 2]| {
        let layer = |word| Mask([word, 0, 0, 0, 0, 0, 0, 0]);
        (TileIndex { x: at[0], y: at[1], z: 0 }, TileMasks::clipped(layer(u64::MAX), layer(mask(at))))
    };
    (0..tiles).flat_map(|row| (0..tiles).map(move |column| [column, row])).map(tile).collect()
}

/// A daemon that has seen the room every quarter of an hour for a week.
async fn room(folder: &Path) -> (Launch, Daemon) {
    let launch = Launch::on(folder);
    let daemon = launch.start();
    let grid = GridSpec { is_flat: true, ..GridSpec::new(0.1) };
    let new = NewMap { name: MAP.to_owned(), grid: Some(grid), ..NewMap::default() };
    daemon.client().create_map(new).await.expect("a new map");
    let mut robot = Producer::open(&daemon.client(), ProducerOptions::new("robot", "", MAP)).await.expect("a Welcome");
    for quarter in 0..7 * 96 {
        let hour = quarter / 4 % 24;
        robot.send_scan((START_SECS + quarter * 900) * 1_000_000_000, Scan::Tiles(scan(hour))).await.expect("taken");
    }
    robot.flush().await.expect("durable");
    assert_eq!(robot.take_refusals(), []);
    drop(robot);
    tidemap(&daemon, ["update", MAP]).table();
    (launch, daemon)
}

fn tour(daemon: &Daemon, at_secs: i64, more: &[&str]) -> Outcome {
    let at = at_secs.to_string();
    let args = ["tour", MAP, "--at", &at];
    tidemap(daemon, args.into_iter().chain(more.iter().copied()))
}

fn goals(table: &Table) -> Vec<[f64; 2]> {
    table.numbers("x").into_iter().zip(table.numbers("y")).map(|(x, y)| [x, y]).collect()
}

/// Whether the seat can be seen from there: it is on the same side of the partition and near.
fn sees_seat([x, y]: [f64; 2]) -> bool {
    x > 4.1 && (x - 6.3).hypot(y - 6.3) < 4.5
}

#[tokio::test]
async fn a_tour_goes_where_the_room_changes_and_avoids_what_is_not_reached() {
    let data = tempfile::tempdir().expect("a folder");
    let (launch, daemon) = room(data.path()).await;
    // The Monday after, at nine: somebody may be there or not.
    let nine = START_SECS + 7 * 86_400 + 9 * HOUR_SECS;
    tour(&daemon, nine, &["--count", "1"]).fails(1, &["charger", "give a start"]);
    let shown = tidemap(&daemon, ["map", "set", MAP, "--charger", "1,7"]).table();
    assert_eq!(shown.column("charger"), ["1,7"]);
    let picture = data.path().join("tour.svg");
    let reply = tour(&daemon, nine, &["--count", "1", "--picture", picture.to_str().expect("text")]).table();
    let best = goals(&reply)[0];
    assert!(sees_seat(best), "{best:?}");
    assert!(reply.number("information_bits") > 2.0 && reply.number("reachability") == 0.5, "{reply:?}");
    let drawn = fs::read_to_string(&picture).expect("a picture");
    assert!(drawn.starts_with("<svg") && drawn.matches("<circle").count() == 1);
    // The way leads from the charger through the gap: it is longer than the straight line.
    let secs = reply.number("arrival_secs");
    assert!(secs > 1.01 * (best[0] - 1.0).hypot(best[1] - 7.0) / 0.5, "{secs} to {best:?}");

    // Late at night there is nothing to learn.
    let night = START_SECS + 7 * 86_400 + 3 * HOUR_SECS;
    let by_night = tour(&daemon, night, &["--count", "1", "--model", "mean"]).table();
    let by_day = tour(&daemon, nine, &["--count", "1", "--model", "mean"]).table();
    assert_eq!(by_night, by_day, "a mean knows no time");

    let place = format!("{},{}", best[0], best[1]);
    for attempt in 1..=5 {
        let reply = tidemap(&daemon, ["visit", MAP, &place, "--reached", "false", "--at", "1452470400"]).table();
        assert_eq!((reply.number("reachability"), reply.number("attempts")), (0.0, f64::from(attempt)));
    }
    let tried = tidemap(&daemon, ["reachability", "list", MAP]).table();
    assert_eq!(
        (tried.rows.len(), tried.number("attempts"), tried.number("last_time")),
        (1, 5.0, 1_452_470_400.0),
        "{tried:?}"
    );
    assert!((tried.number("x") - best[0]).abs() <= 0.25 && (tried.number("y") - best[1]).abs() <= 0.25, "{tried:?}");
    let elsewhere = goals(&tour(&daemon, nine, &["--count", "1"]).table())[0];
    assert!(elsewhere != best && sees_seat(elsewhere), "{elsewhere:?}");
    // The reply to a budget that is too short gives the reason; several goals come in driving order.
    let short = tour(&daemon, nine, &["--budget", "10s"]);
    assert!(short.table().rows.is_empty() && short.stderr.contains("no tour: the time for the tour is 10 s"));
    let many = tour(&daemon, nine, &["--count", "3"]).table();
    assert!(many.numbers("arrival_secs").is_sorted() && many.rows.len() <= 3, "{many:?}");

    let before = tour(&daemon, nine, &["--count", "2"]).table();
    daemon.kill();
    let daemon = launch.start();
    oracle::settled(&daemon.client()).await;
    assert_eq!(tour(&daemon, nine, &["--count", "2"]).table(), before, "all that was told is kept");
    tidemap(&daemon, ["update", MAP]).table();
    daemon.kill();
    let daemon = launch.start();
    oracle::settled(&daemon.client()).await;
    assert_eq!(goals(&tour(&daemon, nine, &["--count", "1"]).table())[0], elsewhere);
}

#[tokio::test]
async fn views_regions_and_mistakes_are_answered() {
    let data = tempfile::tempdir().expect("a folder");
    let (_launch, daemon) = room(data.path()).await;
    let nine = START_SECS + 7 * 86_400 + 9 * HOUR_SECS;
    let at = nine.to_string();
    let info = |more: &[&str]| {
        let args = ["info", MAP, "--at", &at];
        tidemap(&daemon, args.into_iter().chain(more.iter().copied()))
    };
    let looks = info(&["--view", "6,5,0", "--view", "2,2,0"]).table();
    let bits = looks.numbers("information_bits");
    assert!(bits[0] > 2.0 && bits[1] < 1e-9, "{bits:?}");
    let near = info(&["--view", "6,5,0,0.3"]).table().number("information_bits");
    assert!(near < 1e-9, "too short a range to see the seat: {near}");
    let cell = info(&["--state", "cell/62/62/0", "cell/2/2/0"]).table();
    assert!(cell.numbers("information_bits")[0] > 0.1 && cell.numbers("entropy_bits")[1] == 0.0, "{cell:?}");

    let day = |more: &[&str]| {
        let args = ["day", MAP, "--date", "2016-01-11", "--slot", "1h"];
        tidemap(&daemon, args.into_iter().chain(more.iter().copied()))
    };
    let plan = day(&["--views", "1", "--explore", "3", "--strategy", "greedy"]).table();
    for place in plan.column("location").into_iter().filter(|place| !place.is_empty()) {
        let at: Vec<f64> = place.split(',').map(|along| along.parse().expect("a number")).collect();
        assert!(sees_seat([at[0], at[1]]), "{place}");
    }
    assert_eq!(plan.column("location").iter().filter(|place| !place.is_empty()).count(), 3);
    // The seat is uncertain in some hours only: a tour is worth most then.
    tidemap(&daemon, ["map", "set", MAP, "--charger", "1,7"]).table();
    let tours = day(&["--tours", "1", "--explore", "2", "--strategy", "greedy"]).table();
    let bits = tours.numbers("information_bits");
    assert_eq!(tours.column("location").iter().filter(|place| **place == "tour").count(), 2, "{tours:?}");
    assert!(bits.iter().fold(0.0, |highest: f64, &bits| highest.max(bits)) > 1.0, "{tours:?}");
    day(&["--tours", "0"]).fails(2, &["1..=100"]);
    day(&["--tours", "101"]).fails(2, &["101"]);
    day(&["--tours", "2", "--views", "1"]).fails(2, &["--views"]);
    // In the corner of two walls no place for the robot is near, at any hour: no plan, but the reason.
    tidemap(&daemon, ["map", "set", MAP, "--charger", "0.05,0.05"]).table();
    day(&["--tours", "2", "--explore", "2"]).fails(1, &["no slot", "within 0.5 m of the start"]);
    day(&["--views", "0.01"]).fails(2, &["0.01", "640000"]);
    day(&["--views", "0"]).fails(2, &["\"0\" is not a distance"]);

    let many = (nine..nine + 2_001).map(|at| at.to_string()).collect::<Vec<_>>().join(",");
    tidemap(&daemon, ["info", MAP, "--at", &many, "--view", "6,5,0"]).fails(1, &["2001", "2000"]);
    info(&["--view", "4.05,1,0"]).fails(1, &["4.05", "occupied"]);
    info(&["--view", "90,1,0"]).fails(1, &["90", "outside"]);
    info(&["--view", "1,1,0,0"]).fails(2, &["1,1,0,0"]);
    info(&["--view", "1,1,0,1e9"]).fails(1, &["1000000000", "range"]);
    info(&["--state", "cell/900/0/0"]).fails(1, &["never observed"]);
    // Without targets: the places on the grid where an observation is worth most, best first. Unknown cells are in no
    // area.
    let areas = info(&[]).table();
    let bits = areas.numbers("information_bits");
    assert!(bits.len() > 3 && bits.is_sorted_by(|one, next| one >= next) && bits[0] > 0.0, "{:?}", areas.rows);
    let one = info(&["--area", "1000", "--count", "1"]).table();
    assert!(one.column("target")[0] == "0:1000,0:1000", "{:?}", one.rows);
    assert!((one.numbers("information_bits")[0] - bits.iter().sum::<f64>()).abs() < 1e-6, "the same cells");
    info(&["--area", "0"]).fails(2, &["\"0\"", "metres"]);
    info(&["--area", "2", "--view", "1,1,0"]).fails(2, &["--area", "--view"]);
    tour(&daemon, nine, &["--start", "0.05,0.05", "--count", "101"]).fails(2, &["101"]);
    let blocked = tour(&daemon, nine, &["--start", "4.05,0.5", "--robot-radius", "0.6"]);
    assert!(blocked.table().rows.is_empty() && blocked.stderr.contains("no tour"), "{}", blocked.stderr);
    tour(&daemon, nine, &["--start", "900,0"]).fails(1, &["900", "outside"]);
    tour(&daemon, nine, &["--start", "1,1", "--spacing", "0.01"]).fails(1, &["spacing"]);
    tour(&daemon, nine, &["--start", "1,1", "--model", "pergam"]).fails(2, &["pergam"]);
    tidemap(&daemon, ["visit", MAP, "1e9,0", "--reached", "true"]).fails(1, &["at.x_m", "1000000000"]);
    tidemap(&daemon, ["visit", MAP, "9,1", "--reached", "true"]).fails(1, &["9,1", "x from 0 to 8 m"]);
    tidemap(&daemon, ["map", "set", MAP, "--charger", "1,-0.5"]).fails(1, &["1,-0.5", "outside", "y from 0 to 8 m"]);
    tidemap(&daemon, ["tour", "nowhere", "--at", "0"]).fails(1, &["\"nowhere\" does not exist"]);
}

/// A day with two places: one where somebody is from 9 to 17 o'clock, more or less, one that never changes.
fn two_places(daemon: &Daemon) {
    tidemap(daemon, ["map", "create", "flat", "--time-zone", "Europe/London"]).table();
    let mut rows = "time,state,value\n".to_owned();
    for quarter in 0..21 * 96 {
        let (day, hour) = (quarter / 96, quarter % 96 / 4);
        // Somebody comes between 8 and 10 o'clock.
        let is_there = hour >= 8 + day % 3 && hour < 17;
        let time = START_SECS + i64::from(quarter) * 900;
        rows += &format!("{time},desk,{}\n{time},wall,1\n", u8::from(is_there));
    }
    cli::tidemap_reading(daemon, ["observe", "flat", "-", "--producer", "robot"], &rows).table();
    tidemap(daemon, ["update", "flat"]).table();
}

fn day(daemon: &Daemon, more: &[&str]) -> Outcome {
    let args = ["day", "flat", "--date", "2016-01-25"];
    tidemap(daemon, args.into_iter().chain(more.iter().copied()))
}

fn slot(daemon: &Daemon, more: &[&str]) -> Outcome {
    let args = ["slot", "flat", "--at", "2016-01-25T09:07:30Z", "--model", "histogram:24"];
    tidemap(daemon, args.into_iter().chain(more.iter().copied()))
}

/// Each strategy plans its slots and places.
fn check_days(daemon: &Daemon) {
    let greedy = day(daemon, &["--explore", "8", "--strategy", "greedy"]).table();
    assert_eq!(greedy.rows.len(), 96);
    let chosen: Vec<(usize, &str)> =
        greedy.column("location").into_iter().enumerate().filter(|(_, location)| !location.is_empty()).collect();
    assert_eq!(chosen.len(), 8);
    assert!(chosen.iter().all(|(slot, location)| *location == "office" && (28..72).contains(slot)), "{chosen:?}");
    let first = day(daemon, &["--explore", "20", "--seed", "7"]).table();
    assert_eq!(first.column("location").iter().filter(|location| !location.is_empty()).count(), 20);
    assert_eq!(day(daemon, &["--explore", "20", "--seed", "7"]).table(), first, "a seed repeats");
    assert_ne!(day(daemon, &["--explore", "20", "--seed", "8"]).table(), first);
    let turns =
        day(daemon, &["--explore", "10", "--strategy", "round-robin", "--location", "office", "corridor"]).table();
    let visits = |name: &str| turns.column("location").iter().filter(|location| **location == name).count();
    assert_eq!((visits("office"), visits("corridor")), (5, 5));
    // The clocks change: a day of 23 hours.
    let short = tidemap(daemon, ["day", "flat", "--date", "2016-03-27", "--explore", "1"]).table();
    assert_eq!(short.rows.len(), 92);
    // For a task: be where somebody is.
    let served = day(
        daemon,
        &[
            "--explore",
            "8",
            "--strategy",
            "greedy",
            "--exploration-weight",
            "0",
            "--location",
            "office",
            "corridor",
            "--task-state",
            "desk",
            "desk",
        ],
    )
    .table();
    let slots: Vec<usize> = served
        .column("location")
        .iter()
        .enumerate()
        .filter(|(_, place)| !place.is_empty())
        .map(|(slot, _)| slot)
        .collect();
    assert!(slots.iter().all(|slot| (36..68).contains(slot)), "{slots:?}");
}

/// A slot is for the desk, unless the day's visits are spent or planned elsewhere.
fn check_slots(daemon: &Daemon) {
    // In the morning the desk is uncertain; the wall never is.
    assert_eq!(slot(daemon, &[]).table().column("location"), ["office"]);
    assert!(slot(daemon, &[]).table().numbers("information_bits")[0] > 0.1);
    // The published gain by default; both measures add the gain from learning.
    let bits = |measure: &str| slot(daemon, &["--information", measure]).table().numbers("information_bits")[0];
    assert_eq!(bits("ral"), slot(daemon, &[]).table().numbers("information_bits")[0]);
    assert!(bits("both") > bits("ral") && bits("learn") > 0.0, "{} {}", bits("both"), bits("ral"));
    assert_eq!(slot(daemon, &["--online-error"]).table().column("location"), ["office"]);
    // The last visit of the day is not for the morning if the office is as uncertain later; nor is one that was spent.
    assert_eq!(slot(daemon, &["--online-error", "--explore", "96"]).table().column("location"), ["office"]);
    assert_eq!(slot(daemon, &["--explore", "5", "--spent", "5"]).table().column("location"), [""]);
    assert_eq!(
        slot(daemon, &["--monte-carlo", "--seed", "3"]).table(),
        slot(daemon, &["--monte-carlo", "--seed", "3"]).table()
    );
    assert_eq!(
        slot(daemon, &["--planned", "corridor"]).table().column("location"),
        ["corridor"],
        "nothing unexpected was seen"
    );
}

/// A state that contradicts the model is observed instead of the planned location.
fn check_surprise(daemon: &Daemon) {
    // A person at the desk at night, which the model excludes.
    let night = "time,state,value\n1453690800,desk,1\n1453690860,desk,1\n";
    cli::tidemap_reading(daemon, ["observe", "flat", "-", "--producer", "robot", "--label", "night"], night).table();
    tidemap(daemon, ["update", "flat"]).table();
    let args = ["slot", "flat", "--at", "1453690920", "--planned", "corridor", "--model", "histogram:24"];
    let novel = tidemap(daemon, args).table();
    assert_eq!(novel.column("location"), ["office"], "{novel:?}");
    assert!(novel.numbers("surprise_bits")[0] > 1.0, "{novel:?}");
    // The newest value counts fully at its time, and is forgotten after a week.
    let desk = |at: &str, model: &str| {
        let args = ["predict", "flat", "desk", "--at", at, "--model", model];
        tidemap(daemon, args).table().number("probability")
    };
    assert_eq!(desk("1453690860", "spectral+memory"), 1.0);
    let (plain, later) = (desk("1454295660", "spectral"), desk("1454295660", "spectral+memory"));
    assert!((plain - later).abs() < 1e-3, "{plain} {later}");
    let both = ["predict", "flat", "desk", "--at", "1453690860", "--model", "spectral+memory+persistence"];
    tidemap(daemon, both).fails(2, &["+persistence and +memory"]);
}

fn check_mistakes(daemon: &Daemon) {
    day(daemon, &["--information", "more"]).fails(2, &["--information", "ral, learn, both"]);
    day(daemon, &["--information", "both", "--tours", "2"]).fails(2, &["--information", "--tours"]);
    slot(daemon, &["--information", "both", "--exactly-one"]).fails(2, &["--information", "--exactly-one"]);
    slot(daemon, &["--spent", "2"]).fails(2, &["--spent", "--explore"]);
    slot(daemon, &["--ratio", "0"]).fails(2, &["--ratio 0", "above 0"]);
    slot(daemon, &["--explore", "97"]).fails(1, &["97 visits", "96 slots"]);
    slot(daemon, &["--online-error", "--planned", "office"]).fails(2, &["--online-error"]);
    slot(daemon, &["--planned", "attic"]).fails(1, &["\"attic\"", "planned"]);
    slot(daemon, &["--planned", "corridor", "--monte-carlo"]).fails(2, &["--monte-carlo"]);

    day(daemon, &["--explore", "97"]).fails(1, &["97 visits", "96 slots"]);
    day(daemon, &["--slot", "10s"]).fails(1, &["10 s"]);
    day(daemon, &["--ratio", "1.5"]).fails(2, &["1.5"]);
    day(daemon, &["--location", "attic"]).fails(1, &["\"attic\" does not exist"]);
    tidemap(daemon, ["day", "flat", "--date", "yesterday"]).fails(1, &["yesterday", "2016-03-21"]);
    tidemap(daemon, ["location", "set", "flat", "office", "door"]).fails(1, &["\"door\" does not exist", "desk"]);
    tidemap(daemon, ["location", "delete", "flat", "attic"]).fails(1, &["\"attic\" does not exist"]);
}

#[test]
fn a_day_is_explored_when_and_where_it_is_uncertain() {
    let data = tempfile::tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    let daemon = launch.start();
    two_places(&daemon);
    tidemap(&daemon, ["location", "set", "flat", "office", "desk", "--position", "2,3"]).table();
    tidemap(&daemon, ["location", "set", "flat", "corridor", "wall"]).table();
    check_days(&daemon);
    check_slots(&daemon);
    check_surprise(&daemon);
    check_mistakes(&daemon);
    let locations = tidemap(&daemon, ["location", "list", "flat"]).table();
    daemon.kill();
    let daemon = launch.start();
    assert_eq!(tidemap(&daemon, ["location", "list", "flat"]).table(), locations);
    tidemap(&daemon, ["location", "delete", "flat", "office"]);
    assert_eq!(tidemap(&daemon, ["location", "list", "flat"]).table().column("location"), ["corridor"]);
}
