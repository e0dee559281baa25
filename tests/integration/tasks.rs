//! Tasks from outside: planned around a door that is shut in the morning, kept through a kill, reported exactly once.
//!
//! Invariant: the expected plans and figures follow from the building and the reports, never from the daemon's answers.

use tidemap_client::tasks::{TaskName, TaskRun};
use tidemap_tests::{
    cli::{self, Outcome},
    daemon::{Daemon, Launch},
    oracle,
};

/// A Monday in winter, when London has UTC.
const START_SECS: i64 = 1_451_865_600;
const HOUR_SECS: i64 = 3_600;
const DAYS: i64 = 14;
/// The Monday after the reports.
const DATE: &str = "2016-01-18";

fn tidemap<'a>(daemon: &Daemon, args: impl IntoIterator<Item = &'a str>) -> Outcome {
    cli::tidemap(daemon, args)
}

fn words<'a>(daemon: &Daemon, line: &'a str) -> Outcome {
    tidemap(daemon, line.split(' ').collect::<Vec<&'a str>>())
}

/// A daemon with a dock, a hall and a lab behind a door that is shut until noon. A robot has tried it for two weeks.
fn started() -> (tempfile::TempDir, Launch, Daemon) {
    let data = tempfile::tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    let daemon = launch.start();
    tidemap(&daemon, ["map", "create", "office", "--time-zone", "Europe/London"]).table();
    let text = "node Dock\nnode Hall\nnode Lab\nlink Dock Hall 20\nlink Hall Lab 10\n";
    cli::tidemap_reading(&daemon, ["topology", "load", "office", "-"], text).table();
    let mut rows = "from,to,start,end,success\n".to_owned();
    for hour in 0..DAYS * 24 {
        let (start, is_open) = (START_SECS + hour * HOUR_SECS, hour % 24 >= 12);
        rows += &format!("Hall,Lab,{start},{},{is_open}\nDock,Hall,{},{},true\n", start + 10, start + 60, start + 80);
    }
    cli::tidemap_reading(&daemon, ["traverse", "office", "-", "--producer", "robot", "--label", "log"], &rows).table();
    tidemap(&daemon, ["update", "office"]).table();
    (data, launch, daemon)
}

#[test]
fn a_day_of_tasks_is_planned_kept_and_found_after_a_kill() {
    let (_data, launch, daemon) = started();
    words(&daemon, "task add office charge Dock --from 12:00 --until 13:00 --duration 30m --value 50").table();
    words(&daemon, "task add office inspect Lab --from 08:00 --until 18:00 --duration 20m --days mon-fri").table();
    words(&daemon, "task add office greet Hall --from 09:00 --until 10:00 --duration 10m").table();
    words(&daemon, "task add office clean Attic --duration 10m").table();
    words(&daemon, "task add office rest Hall --duration 10m --days sat,sun").table();
    let tasks = words(&daemon, "task list office").table();
    assert_eq!(tasks.column("kind"), ["charge", "clean", "greet", "inspect", "rest"]);
    assert_eq!((tasks.column("days")[3], tasks.column("until")[1]), ("mon,tue,wed,thu,fri", "24:00"));

    let planned = words(&daemon, &format!("day office --date {DATE} --tasks --keep"));
    // The node does not exist: the task has its reason, and the others are planned.
    assert!(planned.stderr.contains("clean/Attic") && planned.stderr.contains("no such node"), "{}", planned.stderr);
    let slots = planned.table();
    // Between nine and ten.
    assert!(slots.column("task")[36..40].contains(&"greet/Hall"), "{:?}", slots.column("task"));
    assert!(slots.column("location").iter().all(|location| location.is_empty()), "the map has no locations");

    daemon.kill();
    let daemon = launch.start();
    oracle::settle(&daemon);
    let shown = words(&daemon, &format!("plan show office --date {DATE} --at {DATE}T12:10:00Z")).table();
    let names = shown.column("task");
    assert_eq!(names.len(), 3, "{names:?}");
    assert_eq!(names[..1], ["greet/Hall"]);
    let day = START_SECS + DAYS * 24 * HOUR_SECS;
    let hours: Vec<f64> = shown.numbers("start").iter().map(|start| (start - day as f64) / 3_600.0).collect();
    let at = |task: &str| hours[names.iter().position(|name| *name == task).expect("planned")];
    assert!((9.0..10.0).contains(&at("greet/Hall")) && (12.0..12.5).contains(&at("charge/Dock")), "{hours:?}");
    // The door is shut in the morning.
    assert!(at("inspect/Lab") >= 12.0, "{hours:?}");
    let now: Vec<&str> = shown.column("now");
    assert_eq!(now.iter().filter(|now| **now == "true").count(), 1, "{now:?}");
    let ends = shown.numbers("end");
    let departures = shown.numbers("departure");
    assert!(ends.iter().zip(&departures[1..]).all(|(end, next)| end <= next), "{ends:?} {departures:?}");

    words(&daemon, "plan show office --date 2016-01-19").fails(1, &["2016-01-19", "no plan"]);
    assert_eq!(words(&daemon, "task remove office clean Attic").code, Some(0));
    words(&daemon, "task remove office clean Attic").fails(1, &["clean/Attic"]);
    words(&daemon, "task add office clean Hall --from 10:00 --until 09:00 --duration 10m").fails(1, &["window"]);
    words(&daemon, &format!("day office --date {DATE} --tasks --start-node Attic")).fails(1, &["Attic", "Dock"]);
}

#[test]
fn slots_that_tasks_leave_over_explore() {
    let (_data, _launch, daemon) = started();
    tidemap(&daemon, ["state", "add", "office", "door"]).table();
    tidemap(&daemon, ["location", "set", "office", "desk", "door"]).table();
    words(&daemon, "task add office guard Hall --from 06:00 --until 12:00 --duration 6h").table();
    let day = format!("day office --date {DATE} --slot 1h --ratio 1 --strategy round-robin --tasks --start-node Hall");
    let slots = words(&daemon, &day).table();
    for (hour, (location, task)) in slots.column("location").into_iter().zip(slots.column("task")).enumerate() {
        let is_busy = (6..12).contains(&hour);
        assert_eq!((location, task), if is_busy { ("", "guard/Hall") } else { ("desk", "") }, "hour {hour}");
    }
    // Half of the day is over.
    let late = words(&daemon, &format!("{day} --ready {DATE}T07:00:00Z"));
    assert!(late.stderr.contains("guard/Hall") && late.stderr.contains("window is over"), "{}", late.stderr);
}

#[test]
fn reports_are_taken_exactly_once_and_make_the_figures() {
    let (_data, launch, daemon) = started();
    let monday = START_SECS + DAYS * 24 * HOUR_SECS;
    let run = |hour: i64, success: bool| TaskRun {
        name: TaskName::new("greet", "Hall").expect("valid"),
        start_nanos: (monday + hour * HOUR_SECS) * 1_000_000_000,
        end_nanos: (monday + (hour + 1) * HOUR_SECS) * 1_000_000_000,
        success,
        intervention: !success,
        reason: if success { String::new() } else { "nobody came".to_owned() },
    };
    tokio::runtime::Runtime::new().expect("a runtime").block_on(async {
        let client = daemon.client();
        for (sequence, hour) in (1..).zip([9, 10, 26]) {
            for _ in 0..2 {
                let sent = client.report_task("office", ("robot", "work"), sequence, &run(hour, hour != 10)).await;
                let receipt = sent.expect("taken");
                assert_eq!((receipt.durable_sequence, receipt.refused), (sequence, None));
            }
        }
        // Another report with a known number is no repetition.
        client.report_task("office", ("robot", "work"), 2, &run(11, true)).await.expect_err("a different report");
    });
    let before = words(&daemon, "task weeks office --hours 08:00-18:00 --days mon-fri").table();

    daemon.kill();
    let daemon = launch.start();
    oracle::settle(&daemon);
    let states = tidemap(&daemon, ["state", "list", "office"]).table();
    let place = states.column("state").iter().position(|state| *state == "task/greet/Hall").expect("a state");
    assert_eq!((states.column("kind")[place], states.column("observations")[place]), ("probability", "3"));
    let weeks = words(&daemon, "task weeks office --hours 08:00-18:00 --days mon-fri").table();
    assert_eq!(weeks.column("monday"), [DATE]);
    for table in [&before, &weeks] {
        let numbers = ["runs", "failed", "interventions"].map(|column| table.number(column) as u64);
        assert_eq!(numbers, [3, 1, 1]);
        // Two hours on Monday of ten; the hour on Tuesday is at two in the morning.
        assert_eq!((table.number("active_secs"), table.number("allowed_secs")), (7_200.0, 72_000.0));
        assert_eq!((table.number("autonomy_percent"), table.number("lifetime_secs")), (10.0, 7_200.0));
    }

    // Reports are learned, and erased with their state.
    tidemap(&daemon, ["update", "office"]).table();
    let noon = format!("{DATE}T12:00:00Z");
    let chance = tidemap(&daemon, ["predict", "office", "task/greet/Hall", "--at", &noon, "--model", "mean"]).table();
    assert!((chance.number("probability") - 2.0 / 3.0).abs() < 0.2, "{}", chance.number("probability"));
    tidemap(&daemon, ["erase", "office", "--state", "task/greet/Hall"]).table();
    assert_eq!(words(&daemon, "task weeks office").table().column("monday"), Vec::<&str>::new());
}

#[test]
fn what_is_reported_wrongly_is_refused() {
    let (_data, _launch, daemon) = started();
    let report = "task report office greet Hall --success true --producer r";
    let start = format!("{DATE}T10:00:00Z");
    words(&daemon, &format!("{report} --start {start} --end {DATE}T09:00:00Z")).fails(1, &["end_time", "before start"]);
    words(&daemon, &format!("{report} --start {start} --end 2016-01-20T09:00:00Z")).fails(1, &["more than a day"]);
    let named = format!("task report office gr/eet Hall --success true --producer r --start {start}");
    words(&daemon, &named).fails(1, &["gr/eet"]);
    // An ordinary observation of such a state is refused.
    let rows = format!("time,state,value\n{start},task/greet/Hall,1\n");
    cli::tidemap_reading(&daemon, ["observe", "office", "-", "--producer", "p"], &rows).table_with(1);
}

#[test]
fn nothing_is_planned_through_a_no_go_area() {
    let (_data, launch, daemon) = started();
    let set = |daemon: &Daemon, node: &str, at: &str| {
        words(daemon, &format!("topology edit set-node office {node} --position {at}")).table();
    };
    for (node, at) in [("Dock", "0,0"), ("Hall", "4,0"), ("Lab", "8,0")] {
        set(&daemon, node, at);
    }
    // A way around.
    words(&daemon, "topology edit add-node office Yard --position 4,4").table();
    words(&daemon, "topology edit link office Dock Yard 90").table();
    words(&daemon, "topology edit link office Yard Hall 90").table();
    let noon = format!("{DATE}T13:00:00Z");
    let route = format!("route office Dock Hall --at {noon} --objective time");
    assert_eq!(words(&daemon, &route).table().rows.len(), 1);
    words(&daemon, "no-go add office pit 1.5,-1:2.5,-1:2,1").table();
    words(&daemon, "task add office greet Hall --from 09:00 --until 10:00 --duration 10m").table();

    daemon.kill();
    let daemon = launch.start();
    oracle::settle(&daemon);
    assert_eq!(words(&daemon, "no-go list office").table().column("area"), ["pit"]);
    assert_eq!(words(&daemon, &route).table().rows.len(), 2, "by the yard");
    let lab = words(&daemon, &format!("search office --start Dock --at {noon}"));
    assert_eq!(lab.code, Some(1), "no state of a node was observed: {}", lab.stdout);
    words(&daemon, &format!("day office --date {DATE} --tasks --keep --start-node Dock")).table();
    let plan = words(&daemon, &format!("plan show office --date {DATE}")).table();
    let way = plan.numbers("start")[0] - plan.numbers("departure")[0];
    assert!(way > 170.0, "{way} s by the yard");
    // The edges of the topology are still predicted.
    assert_eq!(words(&daemon, &format!("topology predict office --at {noon}")).table().rows.len(), 8);

    // A node inside is not reached.
    words(&daemon, "no-go add office hall 3,-1:5,-1:5,1:3,1").table();
    words(&daemon, &route).fails(1, &["no route"]);
    let unserved = words(&daemon, &format!("day office --date {DATE} --tasks --start-node Dock"));
    assert!(unserved.stderr.contains("greet/Hall") && unserved.stderr.contains("no way"), "{}", unserved.stderr);
    words(&daemon, "no-go remove office hall");
    words(&daemon, "no-go remove office pit");
    assert_eq!(words(&daemon, &route).table().rows.len(), 1);
    words(&daemon, "no-go remove office pit").fails(1, &["pit"]);
    words(&daemon, "no-go add office line 0,0:1,1").fails(2, &[]);
    words(&daemon, "no-go add office tie 0,0:1,1:1,0:0,1").fails(1, &["area \"tie\" cross or touch"]);

    let reasons = "from,to,start,end,success,reason\nHall,Lab,1453100000,1453100010,false,stuck\n";
    cli::tidemap_reading(&daemon, ["traverse", "office", "-", "--producer", "r", "--label", "x"], reasons).table();
    let counted = words(&daemon, "topology failures office --by reason").table();
    assert_eq!((counted.column("reason"), counted.numbers("failures")), (vec!["", "stuck"], vec![168.0, 1.0]));
}
