//! Flows of people from outside: two corridors whose streams turn at noon.
//!
//! Invariant: the expected flows follow from the walks, never from the daemon's answers.

use std::fmt::Write as _;

use tidemap_tests::{
    cli::{self, Outcome},
    daemon::{Daemon, Launch},
};

/// A Monday, UTC.
const START_SECS: i64 = 1_736_121_600;
const DAYS: i64 = 14;
/// The Tuesday after, at nine and at fifteen o'clock.
const MORNING: &str = "2025-01-21T09:00:00Z";
const AFTERNOON: &str = "2025-01-21T15:00:00Z";

fn words(daemon: &Daemon, line: &str) -> Outcome {
    cli::tidemap(daemon, line.split(' '))
}

/// People walk through a corridor at y = 2.5, from 7 to 19 o'clock, every ten minutes one metre a second: east before
/// noon, west after. Their velocity is observed, too, and the heading of some.
fn walks() -> [String; 3] {
    let mut people = "time,state,x,y\n".to_owned();
    let (mut velocity, mut heading) = (people.clone(), "time,state,value\n".to_owned());
    for walk in (0..DAYS * 144).filter(|walk| (42..114).contains(&(walk % 144))) {
        let goes_east = walk % 144 < 72;
        for step in 0..12 {
            let time = START_SECS + walk * 600 + step;
            let x = 0.5 + if goes_east { step } else { 11 - step } as f64;
            let _ = writeln!(people, "{time},people,{x},2.5");
            let _ = writeln!(velocity, "{time},velocity,{},0", if goes_east { 1 } else { -1 });
            let _ = writeln!(heading, "{time},heading,{}", if goes_east { 0.1 } else { 3.1 });
        }
    }
    [people, velocity, heading]
}

fn started() -> (tempfile::TempDir, Launch, Daemon) {
    let data = tempfile::tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    let daemon = launch.start();
    words(&daemon, "map create hall --time-zone UTC").table();
    words(&daemon, "state add hall heading --kind angle").table();
    for (label, rows) in ["people", "velocity", "heading"].into_iter().zip(walks()) {
        let line = format!("observe hall - --producer camera --label {label}");
        let sent = cli::tidemap_reading(&daemon, line.split(' '), &rows).table();
        assert_eq!(sent.number("refused"), 0.0, "{label}");
    }
    words(&daemon, "update hall").table();
    (data, launch, daemon)
}

#[test]
fn streams_that_turn_at_noon_are_predicted_and_survive_a_kill() {
    let (_data, launch, daemon) = started();
    let ask = |daemon: &Daemon, motion: &str| {
        words(daemon, &format!("position hall people --flow {motion} --at {MORNING},{AFTERNOON} --top 0"))
    };
    let flow = ask(&daemon, "velocity");
    assert!(flow.stderr.contains("12 cells have a rhythm"), "{}", flow.stderr);
    let flow = flow.table();
    // A dozen cells at each of two times.
    assert_eq!(flow.rows.len(), 24);
    let mut seen = [0; 2];
    for (arrow, count) in flow.column("arrow").iter().zip(flow.numbers("expected_count")) {
        // One person in each cell every ten minutes.
        assert!((0.7..1.3).contains(&count), "{count}");
        seen[usize::from(*arrow == "←")] += 1;
    }
    assert_eq!(seen, [12, 12]);
    assert_eq!(flow.column("arrow")[..12], ["→"; 12]);
    assert!(flow.numbers("share").iter().all(|share| *share > 0.9), "{:?}", flow.numbers("share"));
    assert_eq!(ask(&daemon, "heading").table().column("arrow"), flow.column("arrow"), "by heading");
    daemon.kill();
    let daemon = launch.start();
    assert_eq!(ask(&daemon, "velocity").table().rows, flow.rows);
}

#[test]
fn a_route_avoids_people_where_a_detour_is_short() {
    let (_data, _launch, daemon) = started();
    let ways = "node West\nnode East\nnode Detour\nlink West East 20\nlink West Detour 12\nlink Detour East 12\n";
    cli::tidemap_reading(&daemon, "topology load hall -".split(' '), ways).table();
    let avoid = "route hall West East --avoid people --flow velocity --at";
    words(&daemon, &format!("{avoid} {MORNING}")).fails(1, &["avoid_people", "no node of the topology has a position"]);
    for (node, position) in [("West", "0.5,2.5"), ("East", "11.5,2.5"), ("Detour", "6,8")] {
        words(&daemon, &format!("topology edit set-node hall {node} --position {position}")).table();
    }
    let way = |line: String| {
        let found = words(&daemon, &line).table();
        (found.column("to").join(" "), found)
    };
    assert_eq!(way(format!("route hall West East --objective time --at {MORNING}")).0, "East");
    let (detour, found) = way(format!("{avoid} {MORNING} --encounter-cost 300"));
    assert_eq!(detour, "Detour East");
    assert!(found.numbers("encounters").iter().all(|met| *met < 0.01), "{:?}", found.rows);
    let (straight, found) = way(format!("{avoid} {MORNING}"));
    assert_eq!(straight, "East", "a few seconds near somebody are not worth the time");
    // One person in each cell for a second of ten minutes; π of five square metres are near, for twenty seconds.
    let met = found.number("encounters");
    assert!((0.01..0.1).contains(&met), "{met}");
    assert_eq!(way(format!("{avoid} 2025-01-21T03:00:00Z --encounter-cost 300")).0, "East", "nobody is there at night");
}

#[test]
fn what_is_no_flow_is_refused() {
    let (_data, _launch, daemon) = started();
    let ask = |state: &str, motion: &str, more: &str| {
        words(&daemon, format!("position hall {state} --flow {motion} --at {MORNING} {more}").trim_end())
    };
    ask("people", "people", "").fails(1, &["source.motion_state"]);
    ask("heading", "velocity", "").fails(1, &["source.state", "only a vector has positions"]);
    ask("people", "nothing", "").fails(1, &["nothing"]);
    ask("people", "velocity", "--resolution 0.0001").fails(1, &["use larger cells"]);
    ask("people", "velocity", "--region 50,50:60,60").fails(1, &["nobody was detected in the region", "12096"]);
    ask("people", "velocity", "--directions 3").fails(2, &["4..=36"]);
    ask("people", "velocity", "--mask costs.png").fails(2, &[".pgm"]);
}
