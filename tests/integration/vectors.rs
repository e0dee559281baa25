//! Vectors, from the command line: positions of a person, after a kill and after a second transfer, and rows that are
//! not positions.

use std::{fmt::Write as _, path::Path};

use tidemap_tests::{
    cli::{self, Outcome, Table},
    daemon::{Daemon, Launch},
};

const DAY_SECS: i64 = 86_400;
/// A Monday in winter, when London has UTC.
const START_SECS: i64 = 1_451_865_600;
const KITCHEN: [f64; 2] = [2.0, 1.0];
const DESK: [f64; 2] = [8.0, 5.0];

fn tidemap<'a>(daemon: &Daemon, args: impl IntoIterator<Item = &'a str>) -> Outcome {
    cli::tidemap(daemon, args)
}

fn observe(daemon: &Daemon, label: &str, text: &str, more: &[&str]) -> Outcome {
    let args = ["observe", "office", "-", "--producer", "robot", "--label", label];
    cli::tidemap_reading(daemon, args.iter().chain(more).copied(), text)
}

fn office(folder: &Path) -> (Launch, Daemon) {
    let launch = Launch::on(folder);
    let daemon = launch.start();
    tidemap(&daemon, ["map", "create", "office", "--time-zone", "Europe/London", "--clock", "simulated"]).table();
    (launch, daemon)
}

/// A pseudo-random number from -0.5 to 0.5.
fn jitter(index: i64) -> f64 {
    let mixed = (index as u64).wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let mixed = (mixed ^ (mixed >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    ((mixed ^ (mixed >> 32)) >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
}

/// The position of a person every 20 minutes: until noon around the kitchen, then around the desk.
fn person(days: i64) -> Vec<(i64, [f64; 2])> {
    let slots = (0..days * 72).filter(|slot| (24..54).contains(&(slot % 72)));
    let place = |slot: i64| if slot % 72 < 36 { KITCHEN } else { DESK };
    let at = |slot: i64| [place(slot)[0] + jitter(2 * slot), place(slot)[1] + jitter(2 * slot + 1)];
    slots.map(|slot| (START_SECS + 1200 * slot, at(slot))).collect()
}

fn csv(rows: &[(i64, [f64; 2])]) -> String {
    rows.iter().fold("time,state,x,y\n".to_owned(), |mut text, (time, [x, y])| {
        let _ = writeln!(text, "{time},anna,{x},{y}");
        text
    })
}

/// Probability of being within 1.5 m of a point at a time.
fn near(table: &Table, time: i64, place: [f64; 2]) -> f64 {
    let rows = table.numbers("time").into_iter().zip(table.numbers("x")).zip(table.numbers("y"));
    rows.zip(table.numbers("probability"))
        .filter(|(((at, x), y), _)| *at == time as f64 && (x - place[0]).hypot(y - place[1]) < 1.5)
        .map(|(_, probability)| probability)
        .sum()
}

fn kinds(daemon: &Daemon) -> Vec<[String; 4]> {
    let table = tidemap(daemon, ["state", "list", "office"]).table();
    let column = |name: &str| table.column(name).into_iter().map(str::to_owned).collect::<Vec<_>>();
    let (states, kinds, dimensions, counts) =
        (column("state"), column("kind"), column("dimensions"), column("observations"));
    let rows = states.into_iter().zip(kinds).zip(dimensions).zip(counts);
    rows.map(|(((state, kind), dimensions), count)| [state, kind, dimensions, count]).collect()
}

/// The probability outside the region, as reported on stderr.
fn outside(outcome: &Outcome, time: i64) -> f64 {
    let line = outcome.stderr.lines().find(|line| line.contains(&format!("{time}: expected at")));
    let text = line.and_then(|line| line.split("the region with ").nth(1)?.split(';').next());
    text.and_then(|text| text.parse().ok()).unwrap_or_else(|| panic!("{}", outcome.stderr))
}

const MORNING_SECS: i64 = START_SECS + 23 * DAY_SECS + 10 * 3600;
const AFTERNOON_SECS: i64 = START_SECS + 23 * DAY_SECS + 15 * 3600;

fn both_times() -> String {
    format!("{MORNING_SECS},{AFTERNOON_SECS}")
}

fn ask(daemon: &Daemon, more: &[&str]) -> Outcome {
    let at = both_times();
    let args = ["position", "office", "anna", "--at", &at, "--resolution", "0.25"];
    tidemap(daemon, args.iter().chain(more).copied())
}

/// The learned positions of both axes.
fn kept(daemon: &Daemon) -> [Vec<(f64, f64)>; 2] {
    ["anna/x", "anna/y"].map(|axis| {
        let (from, to) = (START_SECS.to_string(), (START_SECS + 30 * DAY_SECS).to_string());
        let table = tidemap(daemon, ["reconstruct", "office", axis, "--from", &from, "--to", &to]).table();
        table.numbers("time").into_iter().zip(table.numbers("value")).collect()
    })
}

/// The person is where they are at that time of day; all cells and the outside add up to 1.
fn check_places(daemon: &Daemon) {
    for model in ["hypertime-em:3", "hypertime-em:2", "hypertime-km:3"] {
        let table = ask(daemon, &["--top", "0", "--model", model]).table();
        for (time, here, there) in [(MORNING_SECS, KITCHEN, DESK), (AFTERNOON_SECS, DESK, KITCHEN)] {
            let (here, there) = (near(&table, time, here), near(&table, time, there));
            println!("{model}: {here:.3} where it is, {there:.3} where not");
            assert!(here > 0.7 && here > 5.0 * there, "{model}: {here}, {there}");
        }
    }
    // The cells and the outside add up to 1; a region that was never visited has nearly 0.
    let all = ask(daemon, &["--top", "0"]);
    let of_time = |time: i64| {
        let table = all.table();
        let rows = table.numbers("time").into_iter().zip(table.numbers("probability"));
        rows.filter(|(at, _)| *at == time as f64).map(|(_, probability)| probability).sum::<f64>()
    };
    for time in [MORNING_SECS, AFTERNOON_SECS] {
        let outside = outside(&all, time);
        assert!((of_time(time) + outside - 1.0).abs() < 1e-3, "{} and {outside}", of_time(time));
    }
    let elsewhere = ask(daemon, &["--region", "-9,-9:-8,-8", "--top", "1"]);
    assert!(elsewhere.table().numbers("probability").iter().all(|&probability| probability < 1e-3));
    assert!(elsewhere.stderr.contains("with 1.0000") || elsewhere.stderr.contains("with 0.9"), "{}", elsewhere.stderr);
    let few = ask(daemon, &["--top", "3"]).table();
    assert_eq!(few.rows.len(), 6);
}

/// An axis is a state like any other.
fn check_axes(daemon: &Daemon) {
    let outcome = tidemap(daemon, ["predict", "office", "anna", "--at", &both_times()]).table();
    assert_eq!(outcome.column("state"), ["anna/x", "anna/x", "anna/y", "anna/y"]);
    let positions = outcome.numbers("probability");
    let expected = [KITCHEN[0], DESK[0], KITCHEN[1], DESK[1]];
    assert!(
        positions.iter().zip(expected).all(|(position, expected)| (position - expected).abs() < 1.0),
        "{positions:?}"
    );
    let trained = ["predict", "office", "anna", "anna/y", "--at", &both_times(), "--model", "histogram:24"];
    let trained = tidemap(daemon, trained).table();
    assert_eq!(trained.column("state"), ["anna/x", "anna/x", "anna/y", "anna/y", "anna/y", "anna/y"]);
    let compared = format!("time,state,value\n{MORNING_SECS},anna/x,2\n{AFTERNOON_SECS},anna/x,8\n");
    let args = ["evaluate", "office", "-", "--models", "mean,auto"];
    let compared = cli::tidemap_reading(daemon, args, &compared).table().numbers("mse");
    assert!(compared[1] < 0.2 * compared[0], "{compared:?}");
}

#[test]
fn a_person_is_expected_where_they_are_at_that_time_of_day() {
    let data = tempfile::tempdir().expect("a folder");
    let (launch, daemon) = office(data.path());
    let rows = person(21);
    let count = rows.len();
    let sent = observe(&daemon, "walk", &csv(&rows), &[]).table();
    assert_eq!((sent.number("accepted"), sent.number("refused")), (count as f64, 0.0));
    assert_eq!(kinds(&daemon), [["anna", "vector", "2", &count.to_string()].map(str::to_owned)]);
    // Before the first update the state is untrained.
    tidemap(&daemon, ["position", "office", "anna", "--at", "now"]).fails(1, &["anna/x", "learned", "update"]);
    tidemap(&daemon, ["update", "office"]).table();

    check_places(&daemon);
    check_axes(&daemon);

    // Durable positions survive a kill, each complete; sending the same file again adds nothing.
    let before = (kept(&daemon), ask(&daemon, &["--top", "0"]).stdout);
    let axis = |axis: usize| rows.iter().map(|(time, place)| (*time as f64, place[axis])).collect::<Vec<_>>();
    assert_eq!(before.0, [axis(0), axis(1)]);
    daemon.kill();
    let daemon = launch.start();
    assert_eq!((kept(&daemon), ask(&daemon, &["--top", "0"]).stdout), before);
    let again = observe(&daemon, "walk", &csv(&rows), &["--kind", "vector"]).table();
    assert_eq!((again.number("duplicate"), again.number("accepted")), (count as f64, 0.0));
    // A longer file is continued, and a different one is refused.
    let longer = person(22);
    let more = observe(&daemon, "walk", &csv(&longer), &[]).table();
    assert_eq!((more.number("duplicate"), more.number("accepted")), (count as f64, (longer.len() - count) as f64));
    let mut other = longer.clone();
    other[3].1[1] += 0.5;
    observe(&daemon, "walk", &csv(&other), &[]).fails(1, &["differs"]);
    daemon.kill();
    let daemon = launch.start();
    let count = longer.len().to_string();
    assert_eq!(kinds(&daemon), [["anna", "vector", "2", &count].map(str::to_owned)]);
    let again = observe(&daemon, "walk", &csv(&longer), &[]).table();
    assert_eq!(again.number("duplicate"), longer.len() as f64);
}

#[test]
fn three_coordinates_are_learned_and_predicted() {
    let data = tempfile::tempdir().expect("a folder");
    let (_launch, daemon) = office(data.path());
    let added = ["state", "add", "office", "drone", "--kind", "vector", "--dimensions", "3"];
    let added = tidemap(&daemon, added).table();
    assert_eq!((added.column("kind"), added.column("dimensions")), (vec!["vector"], vec!["3"]));
    let text = person(14).iter().fold("time,state,x,y,z\n".to_owned(), |mut text, (time, [x, y])| {
        let _ = writeln!(text, "{time},drone,{x},{y},{}", if *x < 5.0 { 0.5 } else { 2.5 });
        text
    });
    observe(&daemon, "flight", &text, &["--nightly"]).table();
    let at = (START_SECS + 15 * DAY_SECS + 15 * 3600).to_string();
    let outcome = tidemap(&daemon, ["position", "office", "drone", "--at", &at, "--top", "0"]);
    let beyond = outside(&outcome, at.parse().expect("a time"));
    let outcome = outcome.table();
    let sum: f64 = outcome.numbers("probability").iter().sum();
    assert!((sum + beyond - 1.0).abs() < 1e-3, "{sum} and {beyond}");
    let high: f64 = outcome
        .numbers("z")
        .into_iter()
        .zip(outcome.numbers("probability"))
        .filter(|(z, _)| *z > 1.5)
        .map(|(_, probability)| probability)
        .sum();
    assert!(high > 0.75 * sum, "{high} of {sum}");
    let outcome = tidemap(&daemon, ["predict", "office", "drone", "--at", &at]).table();
    assert_eq!(outcome.column("state"), ["drone/x", "drone/y", "drone/z"]);
}

#[test]
fn what_is_no_position_is_refused_whole() {
    let data = tempfile::tempdir().expect("a folder");
    let (launch, daemon) = office(data.path());
    for more in [&["--dimensions", "2"][..], &["--dimensions", "2"]] {
        let args = ["state", "add", "office", "anna", "--kind", "vector"];
        tidemap(&daemon, args.iter().chain(more).copied()).table();
    }
    tidemap(&daemon, ["state", "add", "office", "door"]).table();
    let add = |args: &[&'static str]| tidemap(&daemon, ["state", "add", "office"].iter().chain(args).copied());
    add(&["anna", "--kind", "vector", "--dimensions", "3"]).fails(1, &["vector of 2", "vector of 3", "never changes"]);
    add(&["anna", "--kind", "continuous"]).fails(1, &["is a vector of 2 coordinates, not a continuous"]);
    add(&["door", "--kind", "vector", "--dimensions", "2"]).fails(1, &["is a probability, not a vector"]);
    add(&["cell", "--kind", "vector", "--dimensions", "2"]).fails(1, &["cell/x"]);
    add(&["anna/x"]).fails(1, &["'/'"]);
    add(&["new", "--kind", "vector"]).fails(2, &["--dimensions"]);
    add(&["new", "--kind", "vector", "--dimensions", "4"]).fails(2, &["4"]);
    add(&["new", "--kind", "count", "--dimensions", "2"]).fails(2, &["--dimensions", "count"]);

    let rows = "time,state,x,y\n1,anna,1,2\n2,anna,NaN,2\n3,anna,1,inf\n4,anna,1e13,0\n5,anna,there,0\n6,anna,1\n\
                7,door,1,2\n8,cell,1,2\n9,anna/x,1,2\n10,anna,-1e12,0\n11,new,5,6\n";
    let sent = observe(&daemon, "mixed", rows, &[]);
    assert_eq!(sent.table_with(1).rows, [["11", "3", "0", "8"]]);
    for words in [
        "row 2 (line 3) is refused: x NaN is not a number from -1e12 to 1e12",
        "row 3 (line 4) is refused: y inf is not",
        "row 4 (line 5) is refused: x 10000000000000 is not",
        "row 5 (line 6) is refused: x \"there\" is not a number",
        "row 6 (line 7) is refused",
        "row 7 (line 8) is refused: state \"door\" exists and is a probability, not a vector of 2 coordinates",
        "row 8 (line 9) is refused: state name \"cell\" is not for a vector",
        "row 9 (line 10) is refused: state name \"anna/x\" contains '/'",
    ] {
        assert!(sent.stderr.contains(words), "{words:?} is not in:\n{}", sent.stderr);
    }
    let deep = observe(&daemon, "deep", "time,state,x,y,z\n20,anna,1,2,3\n", &[]);
    deep.fails(1, &["\"anna\" exists and is a vector of 2 coordinates, not a vector of 3 coordinates"]);
    let single = observe(&daemon, "single", "time,state,value\n20,anna,1\n", &[]);
    single.fails(1, &["is a vector of 2 coordinates, not a single value"]);
    let single = observe(&daemon, "counted", "time,state,value\n20,anna,1\n", &["--kind", "count"]);
    single.fails(1, &["is a vector of 2 coordinates, not a count"]);
    observe(&daemon, "kind", "time,state,value\n20,anna,1\n", &["--kind", "vector"]).fails(2, &["column value"]);
    observe(&daemon, "kind", "time,state,x,y\n20,anna,1,2\n", &["--kind", "count"]).fails(2, &["columns x and y"]);
    observe(&daemon, "half", "time,state,x\n20,anna,1\n", &[]).fails(1, &["\"y\" is missing"]);

    // Scalar queries address an axis.
    let axes = &["is a vector of 2 coordinates", "anna/x, anna/y"];
    tidemap(&daemon, ["model", "show", "office", "anna"]).fails(1, axes);
    tidemap(&daemon, ["reconstruct", "office", "anna", "--from", "0", "--to", "9"]).fails(1, axes);
    tidemap(&daemon, ["anomalies", "office", "anna", "--from", "0", "--to", "9"]).fails(1, axes);
    assert!(tidemap(&daemon, ["anomalies", "office", "anna/x", "--from", "0", "--to", "9"]).table().rows.is_empty());
    tidemap(&daemon, ["model", "show", "office", "anna/x"]).table();
    let compare = |text: &str| cli::tidemap_reading(&daemon, ["evaluate", "office", "-"], text);
    compare("time,state,value\n1,anna,1\n").fails(1, axes);
    compare("time,state,x,y\n1,anna,1,2\n").fails(1, &["positions", "NAME/x"]);
    // Positions need a vector, a model of positions and a valid region.
    let position = |args: &[&'static str]| tidemap(&daemon, ["position", "office"].iter().chain(args).copied());
    position(&["door", "--at", "1"]).fails(1, &["door", "only a vector"]);
    position(&["nobody", "--at", "1"]).fails(1, &["nobody", "does not exist"]);
    position(&["anna", "--at", "1", "--model", "mean"]).fails(1, &["mean", "hypertime-em"]);
    position(&["anna", "--at", "1", "--model", "hypertime-em+persistence"]).fails(1, &["persistence"]);
    position(&["anna", "--at", "1", "--region", "0,0,0:1,1,1"]).fails(1, &["3 coordinates", "has 2"]);
    position(&["anna", "--at", "1", "--region", "0,0:0,1"]).fails(1, &["not above"]);
    position(&["anna", "--at", "1", "--region", "0:x"]).fails(2, &["not a region"]);
    position(&["anna", "--at", "1", "--resolution", "0"]).fails(2, &["above 0"]);
    position(&["anna", "--at", "1", "--region", "0,0:1,1", "--resolution", "1e-9"])
        .fails(1, &["cells", "max_predictions"]);

    // No observation is learned, and all are in the log.
    daemon.kill();
    let daemon = launch.start();
    let expected = [["anna", "vector", "2", "2"], ["door", "probability", "", "0"], ["new", "vector", "2", "1"]];
    assert_eq!(kinds(&daemon), expected.map(|row| row.map(str::to_owned)));
    for (axis, values) in [("anna/x", ["1", "-1000000000000"]), ("anna/y", ["2", "0"])] {
        let kept = tidemap(&daemon, ["reconstruct", "office", axis, "--from", "0", "--to", "100"]).table();
        assert_eq!(kept.numbers("value"), values.map(|value| value.parse::<f64>().expect("a number")), "{axis}");
    }
}

#[test]
fn how_many_positions_there_are_follows_the_hours() {
    let data = tempfile::tempdir().expect("a folder");
    let (_, daemon) = office(data.path());
    // Three positions an hour from 08:00 to 18:00, none at night.
    observe(&daemon, "walk", &csv(&person(28)), &[]).table();
    tidemap(&daemon, ["update", "office"]).table();
    let day = START_SECS + 30 * DAY_SECS;
    let expected = |hour: i64, window: &str| {
        let at = (day + 3600 * hour).to_string();
        let args = ["position", "office", "anna", "--at", &at, "--count", window, "--top", "0"];
        tidemap(&daemon, args).table().numbers("expected_count").iter().sum::<f64>()
    };
    let (morning, night, whole) = (expected(10, "1h"), expected(2, "1h"), expected(0, "24h"));
    println!("{morning:.2} in an hour of the morning, {night:.2} at night, {whole:.1} in a day");
    // The region leaves a part of the probability outside.
    assert!((2.0..=3.5).contains(&morning), "{morning}");
    assert!(night < 0.5, "{night}");
    assert!((22.0..=33.0).contains(&whole), "{whole}");
    let at = day.to_string();
    let args = ["position", "office", "anna", "--at", &at, "--count", "8d"];
    tidemap(&daemon, args).fails(1, &["at most 7 days"]);
}

#[test]
fn a_state_depends_on_where_it_was_observed() {
    let data = tempfile::tempdir().expect("a folder");
    let (_, daemon) = office(data.path());
    let rows = person(21);
    observe(&daemon, "walk", &csv(&rows), &[]).table();
    // It is noisy in the kitchen, and quiet at the desk; half of the positions have a reading.
    let noise = rows.iter().step_by(2).fold("time,state,value\n".to_owned(), |mut text, (time, [x, _])| {
        let level = if *x < 5.0 { 60.0 } else { 40.0 } + 4.0 * jitter(*time);
        let _ = writeln!(text, "{time},noise,{level}");
        text
    });
    observe(&daemon, "noise", &noise, &["--kind", "continuous"]).table();
    let elsewhere = format!("time,state,value\n{},humidity,40\n", START_SECS + 1);
    observe(&daemon, "humidity", &elsewhere, &["--kind", "continuous"]).table();
    tidemap(&daemon, ["update", "office"]).table();

    let at = (START_SECS + 23 * DAY_SECS + 11 * 3600).to_string();
    let ask = |more: &[&'static str]| {
        let args = ["predict", "office", "noise", "--at", &at];
        tidemap(&daemon, args.into_iter().chain(more.iter().copied()).collect::<Vec<_>>())
    };
    let outcome = ask(&["--where", "anna=2,1", "--where", "anna=8,5", "--density", "60,40"]);
    let table = outcome.table();
    let (expected, lower, upper) = (table.numbers("expected"), table.numbers("lower"), table.numbers("upper"));
    assert!((expected[0] - 60.0).abs() < 3.0 && (expected[1] - 40.0).abs() < 3.0, "{expected:?}");
    assert!((0..2).all(|i| lower[i] <= expected[i] && expected[i] <= upper[i]), "{lower:?}, {upper:?}");
    let (loud, quiet) = (table.numbers("density_60"), table.numbers("density_40"));
    assert!(loud[0] > 10.0 * loud[1] && quiet[1] > 10.0 * quiet[0], "{loud:?}, {quiet:?}");
    assert!(outcome.stderr.contains(&format!("from {} of", rows.len().div_ceil(2))), "{}", outcome.stderr);

    ask(&["--where", "anna=1,2,3"]).fails(1, &["each place has 2"]);
    ask(&["--where", "noise=1,2"]).fails(1, &["only a vector"]);
    ask(&["--where", "anna=1,2", "--model", "mean"]).fails(1, &["hypertime-em"]);
    ask(&["--where", "anna=1"]).fails(2, &["not a place"]);
    let never = ["predict", "office", "humidity", "--at", &at, "--where", "anna=1,2"];
    tidemap(&daemon, never).fails(1, &["never observed at the same time"]);
}
