//! Traversals of edges from outside: learned exactly once, also through a kill; and refusals.
//!
//! Invariant: the expected answers follow from the file that was sent, never from the daemon's answers.

use std::fmt::Write as _;

use tidemap_client::observe::{Producer, ProducerOptions, TraversalReport};
use tidemap_tests::{
    cli::{self, Outcome, tidemap},
    daemon::{Daemon, Launch, lasting_port},
    oracle,
};

/// A Monday in winter, when London has UTC.
const START_SECS: i64 = 1_451_865_600;
const HOUR_SECS: i64 = 3_600;
const DAYS: i64 = 14;

/// A daemon with a hall, a lab 6 m away, and a lift with a time only.
fn started() -> (tempfile::TempDir, Launch, Daemon) {
    let data = tempfile::tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    let daemon = launch.start();
    tidemap(&daemon, ["map", "create", "office", "--time-zone", "Europe/London"]).table();
    let text = "node Hall\nnode Lab\nnode Lift\nlink Hall Lift 20\n";
    cli::tidemap_reading(&daemon, ["topology", "load", "office", "-"], text).table();
    tidemap(&daemon, ["topology", "edit", "link", "office", "Hall", "Lab", "--length", "6"]).table();
    (data, launch, daemon)
}

/// A robot's hourly round: to the lab in 4 s, which is closed from 20 to 24 o'clock, and the lift in 40 s.
fn report() -> String {
    let mut rows = "from,to,action,start,end,success,reason\n".to_owned();
    for hour in 0..DAYS * 24 {
        let start = START_SECS + hour * HOUR_SECS;
        let (is_open, end) = (hour % 24 < 20, start + 4);
        let reason = if is_open { "" } else { "door closed, again" };
        writeln!(rows, "Hall,Lab,,{start},{end},{is_open},\"{reason}\"").expect("memory");
        writeln!(rows, "Hall,Lift,,{},{},1,", start + 60, start + 100).expect("memory");
    }
    rows
}

/// Invalid rows, with the line number that each gets behind the valid ones, and the reason.
const BAD: [(&str, &str); 5] = [
    ("Hall,Attic,,1451865600,1451865604,true,", "\"Attic\""),
    ("Lab,Lift,,1451865600,1451865604,true,", "Lab/Lift"),
    ("Hall,Lab,,1451865604,1451865600,true,", "before start"),
    ("Hall,Lab,,1451865600,1451865600,true,", "takes time"),
    ("Hall,Lab,,1451865600,soon,true,", "end"),
];

fn traverse(daemon: &Daemon, text: &str) -> Outcome {
    cli::tidemap_reading(daemon, ["traverse", "office", "-", "--producer", "robot", "--label", "log"], text)
}

/// The prediction of a state at an hour of the day after the last.
fn predicted(daemon: &Daemon, state: &str, hour: i64, model: &str) -> f64 {
    let at = (START_SECS + (DAYS * 24 + hour) * HOUR_SECS).to_string();
    let table = tidemap(daemon, ["predict", "office", state, "--at", &at, "--model", model]).table();
    table.numbers("probability")[0]
}

fn counts(daemon: &Daemon) -> Vec<(String, String, String)> {
    let table = tidemap(daemon, ["state", "list", "office"]).table();
    let column = |name: &str| table.column(name).into_iter().map(str::to_owned).collect::<Vec<_>>();
    let (states, kinds, counts) = (column("state"), column("kind"), column("observations"));
    states.into_iter().zip(kinds).zip(counts).map(|((state, kind), count)| (state, kind, count)).collect()
}

#[test]
fn edges_are_learned_from_reports_exactly_once() {
    let (data, launch, daemon) = started();
    let good = report();
    let rows = (DAYS * 48) as u64;
    let text = BAD.iter().fold(good.clone(), |text, (row, _)| text + row + "\n");

    let outcome = traverse(&daemon, &text);
    let table = outcome.table_with(1);
    let bad = BAD.len() as u64;
    let numbers = ["read", "accepted", "duplicate", "refused"].map(|column| table.number(column) as u64);
    assert_eq!(numbers, [rows + bad, rows, 0, bad]);
    for (place, (_, words)) in (1..).zip(BAD) {
        let row = format!("row {} (line {})", rows + place, rows + place + 1);
        let line =
            outcome.stderr.lines().find(|line| line.starts_with(&row)).unwrap_or_else(|| panic!("{}", outcome.stderr));
        assert!(line.contains(words), "{line}");
    }

    daemon.kill();
    let daemon = launch.start();
    oracle::settle(&daemon);
    let known = counts(&daemon);
    let (hours, open) = ((DAYS * 24).to_string(), (DAYS * 20).to_string());
    let expected = [
        ("edge/Hall/Lab", "probability", &hours),
        ("speed/Hall/Lab", "continuous", &open),
        ("edge/Hall/Lift", "probability", &hours),
        ("pace/Hall/Lift", "continuous", &hours),
    ];
    assert_eq!(known, expected.map(|(state, kind, count)| (state.to_owned(), kind.to_owned(), count.clone())));
    let again = traverse(&daemon, &text).table();
    assert_eq!((again.number("duplicate") as u64, again.number("refused") as u64), (rows + bad, 0));
    assert_eq!(counts(&daemon), known, "nothing is learned twice");
    traverse(&daemon, &text.replace("again", "still")).fails(1, &["differs"]);

    tidemap(&daemon, ["update", "office"]).table();
    let mean = predicted(&daemon, "edge/Hall/Lab", 12, "mean");
    assert!((mean - 20.0 / 24.0).abs() < 1e-6, "{mean}");
    let (noon, night) =
        (predicted(&daemon, "edge/Hall/Lab", 12, "auto"), predicted(&daemon, "edge/Hall/Lab", 22, "auto"));
    assert!(noon > 0.9 && night < 0.3, "{noon} {night}");
    assert!((predicted(&daemon, "speed/Hall/Lab", 12, "auto") - 1.5).abs() < 1e-6);
    assert!((predicted(&daemon, "pace/Hall/Lift", 12, "auto") - 0.5).abs() < 1e-6);
    tidemap(&daemon, ["model", "show", "office", "edge/Hall/Lab"]).table();
    tidemap(&daemon, ["topology", "edit", "set-link", "office", "Hall", "Lab", "--length", "60"]).table();
    assert!((predicted(&daemon, "speed/Hall/Lab", 12, "auto") - 1.5).abs() < 1e-6, "a length is no speed");

    let failures = |daemon: &Daemon, more: &[&str]| {
        tidemap(daemon, ["topology", "failures", "office"].into_iter().chain(more.iter().copied())).table()
    };
    let all = failures(&daemon, &[]);
    assert_eq!(all.rows.len() as i64, DAYS * 4);
    let starts = all.numbers("start");
    assert_eq!(starts[0] as i64, START_SECS + (DAYS * 24 - 1) * HOUR_SECS);
    assert!(starts.windows(2).all(|pair| pair[0] > pair[1]) && all.numbers("end")[0] == starts[0] + 4.0);
    assert!(all.column("edge").iter().all(|edge| *edge == "Hall/Lab"));
    let few = failures(&daemon, &["--limit", "3", "--edge", "Hall/Lab"]);
    assert_eq!(few.rows, all.rows[..3]);
    assert!(failures(&daemon, &["--edge", "Lab/Hall"]).rows.is_empty());
    let json = tidemap(&daemon, ["topology", "failures", "office", "--limit", "1", "--output", "json"]);
    assert!(json.stdout.contains("door closed, again"), "{}", json.stdout);
    daemon.stop_in_order();

    let daemon = launch.start();
    assert_eq!(failures(&daemon, &[]), all, "a checkpoint keeps them, too");
    assert_eq!(counts(&daemon), known);
    drop((daemon, data));
}

#[test]
fn an_error_names_what_is_wrong_with_a_single_report() {
    let (_data, _launch, daemon) = started();
    let one = |from: &str, end: &str, more: &[&str]| {
        let args =
            ["traverse", "office", "--from", from, "--to", "Lab", "--start", "2016-01-04T00:00:00Z", "--end", end];
        cli::tidemap(&daemon, args.iter().chain(more).chain(&["--producer", "robot"]).copied())
    };
    let table = one("Hall", "2016-01-04T00:00:03Z", &["--success", "true"]).table();
    assert_eq!((table.number("accepted"), table.number("refused")), (1.0, 0.0));
    one("Hall", "2016-01-04T00:00:03Z", &["--success", "false", "--reason", "somebody stood there"]).table();
    assert_eq!(tidemap(&daemon, ["topology", "failures", "office"]).table().column("reason"), ["somebody stood there"]);
    let unknown = one("Lift", "2016-01-04T00:00:03Z", &["--success", "true"]);
    assert!(
        unknown.stderr.contains("no edge Lift/Lab") && unknown.stderr.contains("can be loaded again"),
        "{}",
        unknown.stderr
    );
    assert_eq!(unknown.table_with(1).number("refused"), 1.0);
    one("Hall", "2016-01-03T00:00:00Z", &["--success", "true"]).fails(2, &["before start"]);
    one("Hall", "2016-01-04T00:00:03Z", &[]).fails(2, &["--success"]);
    one("Hall", "2016-01-04T00:00:03Z", &["--success", "perhaps"]).fails(2, &["perhaps"]);
    tidemap(&daemon, ["traverse", "office"]).fails(2, &["FILE"]);
    tidemap(&daemon, ["topology", "failures", "office", "--edge", "Hall"]).fails(2, &["FROM/TO"]);
    assert_eq!(counts(&daemon).len(), 2);

    // Only traversals create such states.
    let rows = "time,state,value\n1451865600,edge/Hall/Lab,1\n1451865600,speed/Hall/Lab,1\n1451865600,pace/A/B,1\n";
    let outcome =
        cli::tidemap_reading(&daemon, ["observe", "office", "-", "--producer", "robot", "--label", "x"], rows);
    assert_eq!(outcome.table_with(1).number("refused"), 3.0);
    tidemap(&daemon, ["state", "add", "office", "edge/Lab/Hall"]).fails(1, &["'/'"]);
    let missing = cli::tidemap_reading(&daemon, ["traverse", "office", "-"], "from,to,start,end\n");
    missing.fails(1, &["\"success\"", "from, to, start, end and success"]);
}

#[test]
fn a_stream_goes_on_where_a_kill_cut_it_off() {
    let data = tempfile::tempdir().expect("a folder");
    let launch = Launch::on(data.path()).setting("listen", format!("127.0.0.1:{}", lasting_port()));
    let daemon = launch.start();
    tidemap(&daemon, ["map", "create", "office"]).table();
    cli::tidemap_reading(&daemon, ["topology", "load", "office", "-"], "node A\nnode x\nlink A x 5\n").table();
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    runtime.block_on(async {
        let client = daemon.client();
        let mut producer =
            Producer::open(&client, ProducerOptions::new("robot", "", "office")).await.expect("a stream");
        let mut daemon = Some(daemon);
        for number in 0..2_000 {
            let start_nanos = (START_SECS + number * 10) * 1_000_000_000;
            let success = number % 4 != 0;
            let edge = if number % 2 == 0 { ("A", "x") } else { ("x", "A") };
            let traversal = TraversalReport {
                from: edge.0.to_owned(),
                to: edge.1.to_owned(),
                start_nanos,
                end_nanos: start_nanos + 5_000_000_000,
                success,
                reason: number.to_string(),
                ..TraversalReport::default()
            };
            producer.send_traversal(&traversal).await.expect("taken");
            if number % 100 == 7 {
                producer.send("door", start_nanos, 1.0).await.expect("taken");
            }
            if number == 900 {
                daemon.take().expect("running").kill();
                daemon = Some(launch.start());
            }
        }
        producer.close().await.expect("durable");
        assert!(producer.take_refusals().is_empty());
        let daemon = daemon.expect("running");
        let known = counts(&daemon);
        let count = |state: &str| known.iter().find(|(name, ..)| name == state).map(|(.., count)| count.as_str());
        assert_eq!((count("edge/A/x"), count("pace/A/x")), (Some("1000"), Some("500")));
        assert_eq!((count("edge/x/A"), count("pace/x/A"), count("door")), (Some("1000"), Some("1000"), Some("20")));
        let failures = client.failures("office", 2, None).await.expect("there");
        assert_eq!(failures.iter().map(|failure| failure.reason.as_str()).collect::<Vec<_>>(), ["1996", "1992"]);
    });
}

#[test]
fn states_of_edges_may_have_long_names() {
    let data = tempfile::tempdir().expect("a folder");
    let launch = Launch::on(data.path());
    let daemon = launch.start();
    tidemap(&daemon, ["map", "create", "office"]).table();
    let [from, to, action] = ["ü", "房", "z"].map(|letter| letter.repeat(128));
    let nodes = format!("node {from}\nnode {to}\n");
    cli::tidemap_reading(&daemon, ["topology", "load", "office", "-"], &nodes).table();
    tidemap(&daemon, ["topology", "edit", "link", "office", &from, &to, "--action", &action, "--length", "3"]).table();
    let rows = format!("from,to,action,start,end,success\n{from},{to},{action},{START_SECS},{},1\n", START_SECS + 6);
    traverse(&daemon, &rows).table();
    tidemap(&daemon, ["update", "office"]).table();
    let state = format!("speed/{from}/{to}/{action}");
    daemon.kill();
    let daemon = launch.start();
    oracle::settle(&daemon);
    assert!((predicted(&daemon, &state, 12, "auto") - 0.5).abs() < 1e-9);
    daemon.stop_in_order();
    let daemon = launch.start();
    assert_eq!(counts(&daemon)[1].0, state);
    let rows = format!("time,state,value\n{START_SECS},{state},0.25\n");
    let errors = cli::tidemap_reading(&daemon, ["evaluate", "office", "-", "--models", "mean"], &rows).table();
    assert!((errors.number("mse") - 0.0625).abs() < 1e-9, "{errors:?}");
    let outcome =
        cli::tidemap_reading(&daemon, ["observe", "office", "-", "--producer", "robot", "--label", "x"], &rows);
    assert_eq!(outcome.table_with(1).number("refused"), 1.0);
}
