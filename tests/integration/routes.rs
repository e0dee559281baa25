//! Routes and policies from outside: a building with a door that is shut at night, reported by robots.
//!
//! Invariant: the expected routes follow from the times at which the door was shut, never from the daemon's answers.

use std::fmt::Write as _;

use tidemap_tests::{
    cli::{self, Outcome, Table},
    daemon::{Daemon, Launch},
};

/// Midnight of a Monday.
const START_SECS: i64 = 1_767_571_200;
const DAY_SECS: i64 = 86_400;
const HOUR_SECS: i64 = 3_600;
/// The first day without reports.
const LATER: i64 = START_SECS + 21 * DAY_SECS;

/// A door straight to the lab, and a way around it.
const BUILDING: &str = "node lobby\nnode lab\nnode hall\nnode yard\nlink lobby lab 20\nlink lobby hall 30\n\
                        link hall lab 30\nlink hall yard 10\n";

fn tidemap<'a>(daemon: &Daemon, args: impl IntoIterator<Item = &'a str>) -> Outcome {
    cli::tidemap(daemon, args)
}

/// A daemon with three weeks of reports: the door is shut from 20 to 6.
fn learned() -> (tempfile::TempDir, Launch, Daemon) {
    let data = tempfile::tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    let daemon = launch.start();
    tidemap(&daemon, ["map", "create", "b"]).table();
    cli::tidemap_reading(&daemon, ["topology", "load", "b", "-"], BUILDING).table();
    let mut rows = "from,to,start,end,success,reason\n".to_owned();
    for hour in 0..21 * 24 {
        let time = START_SECS + hour * HOUR_SECS;
        let is_open = (6..20).contains(&(hour % 24));
        let reason = if is_open { "" } else { "shut" };
        writeln!(rows, "lobby,lab,{time},{},{is_open},{reason}", time + 20).expect("memory");
        writeln!(rows, "lobby,hall,{},{},true,", time + 900, time + 930).expect("memory");
        writeln!(rows, "hall,lab,{},{},{},stairs", time + 1_800, time + 1_830, hour % 20 != 7).expect("memory");
    }
    let taken = cli::tidemap_reading(&daemon, ["traverse", "b", "-", "--producer", "robot"], &rows).table();
    assert_eq!(taken.number("accepted"), 3.0 * 21.0 * 24.0);
    tidemap(&daemon, ["update", "b"]).table();
    (data, launch, daemon)
}

fn route(daemon: &Daemon, from: &str, to: &str, more: &[&str]) -> Outcome {
    tidemap(daemon, ["route", "b", from, to].into_iter().chain(more.iter().copied()))
}

fn at(hours: i64) -> String {
    (LATER + hours * HOUR_SECS).to_string()
}

/// Nodes of the best route.
fn nodes(table: &Table) -> Vec<&str> {
    let of_best = table.column("route").iter().filter(|route| **route == "1").count();
    table.column("from")[..1].iter().chain(&table.column("to")[..of_best]).copied().collect()
}

#[test]
fn the_door_is_taken_by_day_and_the_way_around_it_at_night() {
    let (data, launch, daemon) = learned();
    let noon = route(&daemon, "lobby", "lab", &["--at", &at(12), "--alternatives", "1"]).table();
    assert_eq!(nodes(&noon), ["lobby", "lab"]);
    assert_eq!(noon.column("route"), ["1", "2", "2"]);
    let likely = noon.numbers("probability");
    assert!(likely[0] > 0.95 && likely.iter().all(|p| (0.0..1.0).contains(p)), "{likely:?}");
    let (lower, upper) = (noon.numbers("lower"), noon.numbers("upper"));
    assert!((0..3).all(|i| lower[i] <= likely[i] && likely[i] <= upper[i]), "{noon:?}");
    assert!((noon.numbers("duration_secs")[0] - 20.0).abs() < 0.2);
    let start = noon.numbers("start");
    assert!((start[2] - start[1] - noon.numbers("duration_secs")[1]).abs() < 1e-3, "each for when it is reached");

    let night = route(&daemon, "lobby", "lab", &["--at", &at(23), "--alternatives", "1"]).table();
    assert_eq!(nodes(&night), ["lobby", "hall", "lab"]);
    assert!(night.numbers("probability")[2] < 0.2, "{night:?}");
    let fastest = route(&daemon, "lobby", "lab", &["--at", &at(23), "--objective", "time"]).table();
    assert_eq!(nodes(&fastest), ["lobby", "hall", "lab"]);
    // The way back was never reported: it gets the map's prior, with little evidence.
    let back = route(&daemon, "lab", "lobby", &["--at", &at(23)]).table();
    let (p, low, high) = (back.numbers("probability")[0], back.numbers("lower")[0], back.numbers("upper")[0]);
    assert!(back.numbers("reports")[0] == 0.0 && p > 0.5 && p < 0.95 && high - low > 0.4, "{back:?}");

    // Arrival by 21 o'clock; and the best departure between 4 and 8.
    let early = route(&daemon, "lobby", "lab", &["--arrive", &at(21), "--objective", "time"]).table();
    assert_eq!(nodes(&early), ["lobby", "hall", "lab"]);
    let secs = early.numbers("expected_secs")[0];
    let left = early.numbers("start")[0];
    assert!(left + secs <= (LATER + 21 * HOUR_SECS) as f64 + 0.2 && left + secs > (LATER + 21 * HOUR_SECS - 60) as f64);
    let best = route(&daemon, "lobby", "lab", &["--from", &at(4), "--to", &at(8), "--objective", "time"]).table();
    assert!(best.numbers("start")[0] >= (LATER + 6 * HOUR_SECS) as f64 && nodes(&best) == ["lobby", "lab"], "{best:?}");

    let picture = data.path().join("way.svg");
    let path = picture.to_str().expect("text");
    route(&daemon, "lobby", "lab", &["--at", &at(23), "--picture", path]).table();
    let drawn = std::fs::read_to_string(&picture).expect("a picture");
    assert!(drawn.starts_with("<svg") && drawn.matches("stroke-width=\"4\"").count() == 2, "{drawn}");

    // Training data stay with a renamed node, and survive a kill.
    tidemap(&daemon, ["topology", "edit", "rename-node", "b", "lab", "laboratory"]).table();
    daemon.kill();
    let daemon = launch.start();
    let renamed = route(&daemon, "lobby", "laboratory", &["--at", &at(23)]).table();
    assert_eq!(nodes(&renamed), ["lobby", "hall", "laboratory"]);
    assert_eq!(renamed.numbers("probability")[..], night.numbers("probability")[..2]);
    let table = tidemap(&daemon, ["topology", "predict", "b", "--at", &at(23)]).table();
    assert_eq!((table.rows.len(), table.column("to")[0]), (8, "laboratory"));
    assert_eq!(table.numbers("probability")[0], night.numbers("probability")[2]);
}

#[test]
fn a_policy_waits_for_the_door_where_there_is_no_way_around_it() {
    let (_data, _launch, daemon) = learned();
    let policy = |args: &[&str]| tidemap(&daemon, ["policy", "b", "lab"].into_iter().chain(args.iter().copied()));
    let entries_of = |table: &Table, node: &str| -> Vec<(String, String)> {
        let rows = table.column("node").into_iter().zip(table.column("action")).zip(table.column("next"));
        rows.filter(|((at, _), _)| *at == node)
            .map(|((_, action), next)| (action.to_owned(), next.to_owned()))
            .collect()
    };
    let early = ["--at", &at(4), "--horizon", "4h", "--slot", "30m", "--objective", "time"];
    let around = policy(&early).table();
    assert_eq!(around.rows.len(), 4 * 8);
    let lobby = entries_of(&around, "lobby");
    assert_eq!(lobby[0], ("take".to_owned(), "hall".to_owned()), "{lobby:?}");
    assert_eq!(lobby[7], ("take".to_owned(), "lab".to_owned()), "{lobby:?}");
    assert!(entries_of(&around, "lab").iter().all(|(action, _)| action == "arrived"));

    tidemap(&daemon, ["topology", "edit", "unlink", "b", "hall", "lab"]).table();
    // A failure at half past five would last until after six.
    let waiting = policy(&[&early[..], &["--recovery", "3000"]].concat()).table();
    let lobby = entries_of(&waiting, "lobby");
    assert_eq!(lobby[3].0, "wait", "{lobby:?}");
    assert_eq!(lobby[4], ("take".to_owned(), "lab".to_owned()), "{lobby:?}");
    assert!(waiting.numbers("probability").iter().all(|p| (0.0..=1.0).contains(p)));

    policy(&["--at", &at(4), "--horizon", "9000h", "--slot", "1s"]).fails(1, &["slots", "200000"]);
    policy(&["--at", &at(4), "--slot", "10ms"]).fails(1, &["slot", "0.01 s"]);
}

#[test]
fn a_search_may_take_edges_as_they_were_travelled() {
    let (_data, _launch, daemon) = learned();
    // Robots take a minute from the hall to the yard, for which the map has 10 s.
    let mut rows = "from,to,start,end,success\n".to_owned();
    let mut seen = "time,state,value\n".to_owned();
    for hour in 0..21 * 24 {
        let time = START_SECS + hour * HOUR_SECS;
        writeln!(rows, "hall,yard,{},{},true", time + 100, time + 160).expect("memory");
        writeln!(seen, "{time},yard,0.8\n{time},lab,1").expect("memory");
    }
    let label = ["--producer", "robot", "--label", "yard"];
    cli::tidemap_reading(&daemon, [&["traverse", "b", "-"], &label[..]].concat(), &rows).table();
    cli::tidemap_reading(&daemon, ["observe", "b", "-", "--producer", "watcher"], &seen).table();
    tidemap(&daemon, ["update", "b"]).table();
    let search = |more: &[&str]| {
        let now = at(12);
        let args = ["search", "b", "--start", "hall", "--at", &now];
        tidemap(&daemon, args.into_iter().chain(more.iter().copied())).table()
    };
    assert_eq!((search(&[]).column("node")[0], search(&[]).numbers("arrival_secs")[0]), ("yard", 10.0));
    let travelled = search(&["--as-travelled"]);
    assert!(
        (travelled.numbers("arrival_secs")[0] - 30.0).abs() < 1.0 && travelled.column("node")[0] == "lab",
        "{travelled:?}"
    );
}

#[test]
fn questions_of_routes_that_have_no_answer_are_refused() {
    let (_data, _launch, daemon) = learned();
    let now = at(12);
    let ask = |more: &[&str]| route(&daemon, "lobby", "lab", &[&["--at", &now], more].concat());
    route(&daemon, "lobby", "attic", &["--at", &now]).fails(1, &["no node \"attic\"", "lobby, lab, hall, yard"]);
    route(&daemon, "lobby", "lab", &[]).fails(2, &["--at"]);
    ask(&["--recovery", "-5"]).fails(1, &["recovery_secs", "-5"]);
    ask(&["--objective", "blend", "--doubt", "2"]).fails(1, &["doubt", "2"]);
    ask(&["--alternatives", "11"]).fails(1, &["11", "0 to 10"]);
    ask(&["--interval", "1"]).fails(1, &["confidence", "1"]);
    ask(&["--horizon", "5s"]).fails(1, &["\"lobby\"", "\"lab\"", "5 s", "raise the horizon"]);
    ask(&["--speed", "NaN"]).fails(1, &["speed_m_per_s", "NaN"]);
    ask(&["--picture", "way.png"]).fails(2, &["way.png", ".svg"]);
    route(&daemon, "lobby", "lab", &["--arrive", "10"]).fails(1, &["no departure"]);
    route(&daemon, "lobby", "lab", &["--from", "0", "--to", "9000000", "--step", "1s"])
        .fails(1, &["departures", "1000"]);
    tidemap(&daemon, ["topology", "edit", "add-node", "b", "island"]).table();
    route(&daemon, "lobby", "island", &["--at", &now]).fails(1, &["no route", "\"island\""]);
    assert!(route(&daemon, "lobby", "lobby", &["--at", &now]).table().rows.is_empty());
    tidemap(&daemon, ["map", "create", "empty"]).table();
    tidemap(&daemon, ["route", "empty", "a", "b", "--at", &now]).fails(1, &["\"empty\" has no nodes"]);
}
