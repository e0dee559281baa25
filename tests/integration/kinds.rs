//! Continuous values, counts and angles, from the command line: speeds of a real robot, counts, invalid values,
//! and both after a kill.

use std::{fmt::Write as _, fs, path::Path};

use tidemap_tests::{
    cli::{self, Outcome, Table},
    daemon::{Daemon, Launch},
    oracle, recordings,
};

const DAY_SECS: i64 = 86_400;
/// A Monday.
const START_SECS: i64 = 1_451_865_600;

fn tidemap<'a>(daemon: &Daemon, args: impl IntoIterator<Item = &'a str>) -> Outcome {
    cli::tidemap(daemon, args)
}

/// `tidemap observe office - …` of rows `time,state,value`.
fn observe(daemon: &Daemon, label: &str, rows: &str, more: &[&str]) -> Outcome {
    let args = ["observe", "office", "-", "--producer", "robot", "--label", label];
    cli::tidemap_reading(daemon, args.iter().chain(more).copied(), &format!("time,state,value\n{rows}"))
}

fn evaluate(daemon: &Daemon, rows: &str, models: &str) -> Outcome {
    let args = ["evaluate", "office", "-", "--models", models];
    cli::tidemap_reading(daemon, args, &format!("time,state,value\n{rows}"))
}

fn office(folder: &Path) -> (Launch, Daemon) {
    let launch = Launch::on(folder);
    let daemon = launch.start();
    tidemap(&daemon, ["map", "create", "office", "--time-zone", "Europe/London", "--clock", "simulated"]).table();
    (launch, daemon)
}

/// State and kind of all states.
fn kinds(daemon: &Daemon) -> Vec<(String, String)> {
    let table = tidemap(daemon, ["state", "list", "office"]).table();
    let pairs = table.column("state").into_iter().zip(table.column("kind"));
    pairs.map(|(state, kind)| (state.to_owned(), kind.to_owned())).collect()
}

fn mse(table: &Table, model: &str) -> f64 {
    let place = table.column("model").iter().position(|name| *name == model);
    table.numbers("mse")[place.unwrap_or_else(|| panic!("{model} is not in {table:?}"))]
}

/// All printed data and predictions of a state.
fn answers(daemon: &Daemon, state: &str, at: &str) -> Vec<String> {
    let commands: [&[&str]; 5] = [
        &["reconstruct", "office", state, "--from", "0", "--to", "2000000000"],
        &["predict", "office", state, "--at", at, "--interval", "0.9"],
        &["predict", "office", state, "--at", at, "--model", "spectral+persistence", "--order", "2"],
        &["model", "show", "office", state],
        &["state", "list", "office"],
    ];
    commands
        .iter()
        .map(|args| tidemap(daemon, args.iter().copied()))
        .map(|outcome| {
            outcome.table();
            outcome.stdout
        })
        .collect()
}

#[test]
fn speeds_of_a_robot_are_learned_and_predicted_as_well_as_by_the_reference() {
    let Some(folder) = recordings::folder("velocity") else { return };
    let rows = |name: &str| {
        let text = fs::read_to_string(folder.join(name)).expect("a recording");
        text.lines().fold(String::new(), |mut rows, line| {
            let (time, value) = line.split_once(' ').expect("time and value");
            let _ = writeln!(rows, "{time},path,{value}");
            rows
        })
    };
    let data = tempfile::tempdir().expect("a folder");
    let (launch, daemon) = office(data.path());
    let sent = observe(&daemon, "train", &rows("train.txt"), &["--kind", "continuous"]).table();
    assert_eq!((sent.number("accepted"), sent.number("refused")), (800.0, 0.0));
    tidemap(&daemon, ["update", "office"]).table();

    let test = rows("test1.txt");
    let found =
        evaluate(&daemon, &test, "mean,auto,latest,histogram,calibrated,hypertime-em,hypertime-km,spectral").table();
    for (model, error) in found.column("model").iter().zip(found.column("mse")) {
        println!("{model}: {error}");
    }
    assert!((mse(&found, "mean") - 0.0169).abs() <= 0.0003, "{}", mse(&found, "mean"));
    // These speeds follow no habit: nothing is better than their mean.
    assert!(mse(&found, "auto") <= 1.03 * mse(&found, "mean"), "{}", mse(&found, "auto"));
    assert!(found.column("error_rate").iter().all(|rate| rate.is_empty()), "{found:?}");
    assert!(found.numbers("n").iter().all(|&n| n == 101.0));
    // Models that support other kinds only are left out, with a message.
    evaluate(&daemon, &test, "mean,pergam").fails(1, &["pergam:3 is left out of path", "probabilities", "continuous"]);
    let without = evaluate(&daemon, &test, "all");
    for model in ["persistence", "pergam:3", "uniform", "poisson"] {
        assert!(without.stderr.contains(&format!("{model} is left out of path")), "{model}: {}", without.stderr);
    }
    // Were the speeds normal, one in a hundred would be beyond an interval of 99 %. They are not: some runs were slow.
    let odd = tidemap(&daemon, ["anomalies", "office", "path", "--from", "0", "--to", "1500000000", "--model", "auto"])
        .table();
    println!("anomalies: {} of 800", odd.rows.len());
    assert!(odd.rows.len() < 48 && odd.numbers("probability").iter().all(|&tail| tail <= 0.01), "{odd:?}");
    assert!(odd.numbers("value").iter().all(|&speed| speed < 0.2), "{odd:?}");
    let planted = observe(&daemon, "planted", "1410000000,path,25\n1410000001,path,0.5\n", &[]).table();
    assert_eq!(planted.number("accepted"), 2.0);
    let found = tidemap(
        &daemon,
        ["anomalies", "office", "path", "--from", "1410000000", "--to", "1410000002", "--model", "auto"],
    )
    .table();
    assert_eq!((found.column("time"), found.column("value")), (vec!["1410000000"], vec!["25"]));

    let at = "1409844784,1409900000,1500000000";
    let reply = tidemap(&daemon, ["predict", "office", "path", "--at", at, "--interval", "0.9"]).table();
    let ends = reply.numbers("lower").into_iter().zip(reply.numbers("upper"));
    for (expected, (lower, upper)) in reply.numbers("probability").into_iter().zip(ends) {
        assert!(lower < expected && expected < upper && upper - lower < 2.0, "{lower} {expected} {upper}");
    }
    assert!(reply.column("entropy_bits").iter().all(|entropy| entropy.is_empty()), "{reply:?}");

    let before = answers(&daemon, "path", at);
    daemon.kill();
    let daemon = launch.start();
    oracle::settle(&daemon);
    assert_eq!(answers(&daemon, "path", at), before);
    assert_eq!(kinds(&daemon), [("path".to_owned(), "continuous".to_owned())]);
}

/// People passing within ten minutes, for some days: many at noon, none at night, and one of four days busier.
fn people(days: i64) -> String {
    let mut rows = String::new();
    for slot in 0..days * 144 {
        let (day, hour) = (slot / 144, slot % 144 / 6);
        let people =
            if (8..18).contains(&hour) { 3 + (hour - 8) * (17 - hour) / 2 + slot * 7 % 5 + day % 4 } else { 0 };
        let _ = writeln!(rows, "{},people,{people}", START_SECS + 600 * slot);
    }
    rows
}

#[test]
fn counts_are_learned_as_counts() {
    let data = tempfile::tempdir().expect("a folder");
    let (launch, daemon) = office(data.path());
    let rows = people(28);
    let learn: String = rows.lines().take(21 * 144).map(|row| format!("{row}\n")).collect();
    let test: String = rows.lines().skip(21 * 144).map(|row| format!("{row}\n")).collect();
    tidemap(&daemon, ["state", "add", "office", "people", "--kind", "count"]).table();
    // The kind need not be declared again.
    let sent = observe(&daemon, "learn", &learn, &[]).table();
    assert_eq!((sent.number("accepted"), sent.number("refused")), (21.0 * 144.0, 0.0));

    // The state is untrained: 0, and no interval.
    let at = (START_SECS + 30 * DAY_SECS + 12 * 3600).to_string();
    let reply = tidemap(&daemon, ["predict", "office", "people", "--at", &at]).table();
    assert_eq!(
        (reply.column("probability"), reply.column("lower"), reply.column("upper")),
        (vec!["0"], vec![""], vec![""])
    );

    tidemap(&daemon, ["update", "office"]).table();
    let found = evaluate(&daemon, &test, "mean,auto,poisson,calibrated,histogram").table();
    for (model, error) in found.column("model").iter().zip(found.column("mse")) {
        println!("{model}: {error}");
    }
    for model in ["auto", "poisson", "calibrated", "histogram:24"] {
        assert!(mse(&found, model) < 0.3 * mse(&found, "mean"), "{model}: {found:?}");
    }
    let night = (START_SECS + 30 * DAY_SECS + 3 * 3600).to_string();
    for model in ["auto", "spectral", "poisson", "calibrated", "hypertime-em"] {
        let reply =
            tidemap(&daemon, ["predict", "office", "people", "--at", &format!("{at},{night}"), "--model", model]);
        let reply = reply.table();
        assert!(reply.numbers("probability").iter().all(|&p| (0.0..30.0).contains(&p)), "{model}: {reply:?}");
        assert!(reply.numbers("probability")[0] > reply.numbers("probability")[1], "{model}: {reply:?}");
        assert!(reply.numbers("lower").iter().all(|&lower| lower >= 0.0), "{model}: {reply:?}");
    }

    let before = answers(&daemon, "people", &at);
    daemon.kill();
    let daemon = launch.start();
    oracle::settle(&daemon);
    assert_eq!(answers(&daemon, "people", &at), before);
    assert_eq!(kinds(&daemon), [("people".to_owned(), "count".to_owned())]);
    let again = observe(&daemon, "learn", &learn, &[]).table();
    assert_eq!(again.number("duplicate"), 21.0 * 144.0);
}

#[test]
fn what_is_not_a_value_of_the_kind_is_refused_by_itself() {
    let data = tempfile::tempdir().expect("a folder");
    let (launch, daemon) = office(data.path());
    for (state, kind) in [("people", "count"), ("speed", "continuous"), ("door", "probability")] {
        let added = tidemap(&daemon, ["state", "add", "office", state, "--kind", kind]).table();
        assert_eq!((added.column("state"), added.column("kind")), (vec![state], vec![kind]));
    }
    // Once more is fine, as another kind is not.
    tidemap(&daemon, ["state", "add", "office", "people", "--kind", "count"]).table();
    let other = tidemap(&daemon, ["state", "add", "office", "people", "--kind", "continuous"]);
    other.fails(1, &["\"people\"", "is a count", "never changes"]);
    tidemap(&daemon, ["state", "add", "office", "a/b"]).fails(1, &["state"]);
    tidemap(&daemon, ["state", "add", "nowhere", "a"]).fails(1, &["nowhere"]);
    tidemap(&daemon, ["state", "add", "office", "a", "--kind", "colour"]).fails(2, &["colour", "continuous"]);

    let rows = "1,people,2.5\n2,people,-1\n3,people,7\n4,speed,NaN\n5,speed,1e300\n6,speed,-3.25\n7,speed,inf\n\
                8,door,1.5\n9,door,1\n10,new,-2\n11,new,1\n";
    let sent = observe(&daemon, "mixed", rows, &[]);
    assert_eq!(sent.table_with(1).rows, [["11", "4", "0", "7"]]);
    for words in [
        "row 1 (line 2) is refused: value 2.5 is not a count",
        "row 2 (line 3) is refused: value -1 is not a count",
        "row 4 (line 5) is refused: value NaN is not a number from -1e12 to 1e12",
        "row 5 (line 6) is refused",
        "row 7 (line 8) is refused: value inf is not",
        "row 8 (line 9) is refused: value 1.5 is not between 0 and 1",
        "row 10 (line 11) is refused: value -2 is not between 0 and 1",
    ] {
        assert!(sent.stderr.contains(words), "{words:?} is not in:\n{}", sent.stderr);
    }
    // 0.5 is a probability but not a count, which only the daemon can check.
    observe(&daemon, "half", "20,people,0.5\n", &[]).fails(1, &["row 1", "0.5 is not a count"]);
    // A declared kind that differs from the state's.
    let mismatched = observe(&daemon, "mismatched", "20,people,1\n21,speed,1\n", &["--kind", "continuous"]);
    assert_eq!(mismatched.table_with(1).rows, [["2", "1", "0", "1"]]);
    assert!(mismatched.stderr.contains("is a count, not a continuous"), "{}", mismatched.stderr);

    // No observation is learned, and all are in the log.
    daemon.kill();
    let daemon = launch.start();
    let expected = [("people", "count"), ("speed", "continuous"), ("door", "probability"), ("new", "probability")];
    assert_eq!(kinds(&daemon), expected.map(|(state, kind)| (state.to_owned(), kind.to_owned())));
    for (state, values) in [("people", vec!["7"]), ("speed", vec!["-3.25", "1"]), ("door", vec!["1"])] {
        let kept = tidemap(&daemon, ["reconstruct", "office", state, "--from", "0", "--to", "100"]).table();
        assert_eq!(kept.column("value"), values, "{state}");
    }
    // Invalid values of a file are left out of a comparison, for every kind of state.
    let compared = evaluate(&daemon, "1,people,7\n2,people,-1\n3,speed,9\n4,door,3\n", "mean");
    assert_eq!(compared.table_with(1).column("n"), ["1", "1"]);
}

/// The least angle between two directions in radians.
fn apart(one: f64, other: f64) -> f64 {
    let turns = (one - other) / std::f64::consts::TAU;
    (turns - turns.round()).abs() * std::f64::consts::TAU
}

#[test]
fn angles_are_averaged_on_the_circle_and_survive_a_kill() {
    const NIGHT: i64 = START_SECS + 28 * DAY_SECS + 3 * 3600;
    const DAY: i64 = START_SECS + 28 * DAY_SECS + 15 * 3600;
    let folder = tempfile::tempdir().expect("temporary directory");
    let (launch, daemon) = office(folder.path());
    let added = tidemap(&daemon, ["state", "add", "office", "wind", "--kind", "angle"]);
    assert_eq!(added.table().rows[0][..3], ["wind", "angle", "0"]);
    // Until noon from 350 or from 10 degrees, then from 170 or from 190, without an order.
    let angle = |slot: i64| {
        let mixed = (slot as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let is_left = ((mixed ^ (mixed >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 40).is_multiple_of(2);
        let degrees: f64 = if slot % 48 < 24 { 0.0 } else { 180.0 } + if is_left { 350.0 } else { 10.0 };
        (degrees % 360.0).to_radians()
    };
    let rows = |slots: std::ops::Range<i64>| {
        slots.fold(String::new(), |mut rows, slot| {
            let _ = writeln!(rows, "{},wind,{}", START_SECS + 1800 * slot, angle(slot));
            rows
        })
    };
    assert_eq!(observe(&daemon, "winds", &rows(0..28 * 48), &[]).table().number("accepted"), 1_344.0);
    tidemap(&daemon, ["update", "office"]).table();

    let ask = |daemon: &Daemon, model: &str| {
        let at = format!("{NIGHT},{DAY}");
        let args = ["predict", "office", "wind", "--at", &at, "--interval", "0.9", "--model"];
        let reply = tidemap(daemon, args.into_iter().chain(model.split(' ')));
        let table = reply.table();
        assert_eq!(table.column("state"), ["wind"; 2], "one row for each time");
        assert_eq!(table.column("entropy_bits"), ["", ""]);
        let angles = table.numbers("probability");
        let ends = table.numbers("lower").into_iter().zip(table.numbers("upper"));
        for ((lower, upper), angle) in ends.zip(&angles) {
            let (below, above) = (angle - lower, upper - angle);
            assert!(
                below >= 0.0 && (below - above).abs() < 1e-9 && below <= std::f64::consts::PI,
                "{lower} to {upper}"
            );
        }
        assert!(angles.iter().all(|angle| (-std::f64::consts::PI..std::f64::consts::PI).contains(angle)), "{angles:?}");
        angles
    };
    for model in ["auto", "spectral --order 1", "histogram:24", "calibrated", "hypertime-em:2"] {
        let angles = ask(&daemon, model);
        let errors = (apart(angles[0], 0.0), apart(angles[1], std::f64::consts::PI));
        assert!(errors.0 < 0.1 && errors.1 < 0.1, "{model}: {angles:?}");
    }
    assert!(apart(ask(&daemon, "latest")[0], angle(28 * 48 - 1)) < 1e-5);

    // The error of the best constant direction half a turn away is 2, that of the night's mean 1 - cos 10°.
    let test = rows(28 * 48..29 * 48);
    let table = evaluate(&daemon, &test, "auto,mean,histogram:24").table();
    assert_eq!(table.column("state"), ["wind"; 3]);
    let wanted = 1.0 - 10_f64.to_radians().cos();
    assert!((mse(&table, "histogram:24") - wanted).abs() < 0.002, "{table:?}");
    assert!((mse(&table, "auto") - wanted).abs() < 0.01 && mse(&table, "mean") > 0.5, "{table:?}");

    let before = answers_of_angle(&daemon, DAY);
    daemon.kill();
    let daemon = launch.start();
    assert_eq!(answers_of_angle(&daemon, DAY), before);
    assert_eq!(kinds(&daemon), [("wind".to_owned(), "angle".to_owned())]);
    // A stream without a kind finds it as well.
    assert_eq!(observe(&daemon, "more", &test, &["--kind", "angle"]).table().number("accepted"), 48.0);
}

fn answers_of_angle(daemon: &Daemon, at: i64) -> Vec<String> {
    let at = at.to_string();
    let commands: [&[&str]; 3] = [
        &["predict", "office", "wind", "--at", &at],
        &["predict", "office", "wind/cos", "wind/sin", "--at", &at, "--interval", "0.9"],
        &["state", "list", "office"],
    ];
    commands.iter().map(|args| tidemap(daemon, args.iter().copied())).map(|reply| reply.stdout).collect()
}

#[test]
fn what_is_no_angle_is_refused() {
    let folder = tempfile::tempdir().expect("temporary directory");
    let (_launch, daemon) = office(folder.path());
    let sent = observe(&daemon, "a", "1,wind,3.1\n2,wind,90\n3,wind,NaN\n4,wind,-6.2\n", &["--kind", "angle"]);
    assert_eq!(sent.table_with(1).rows, [["4", "2", "0", "2"]]);
    assert!(sent.stderr.contains("value 90 is not an angle in radians, from -2π to 2π"), "{}", sent.stderr);
    let other = observe(&daemon, "b", "5,wind,1\n", &["--kind", "continuous"]);
    other.fails(1, &["\"wind\" exists and is an angle, not a continuous"]);
    tidemap(&daemon, ["state", "add", "office", "wind", "--kind", "count"]).fails(1, &["is an angle, not a count"]);
    tidemap(&daemon, ["state", "add", "office", "cell", "--kind", "angle"]).fails(1, &["not for a vector or an angle"]);
    // Where single numbers are needed, an angle is its cosine and its sine.
    let refused = tidemap(&daemon, ["model", "show", "office", "wind"]);
    refused.fails(1, &["is an angle", "wind/cos", "wind/sin"]);
    tidemap(&daemon, ["model", "show", "office", "wind/cos"]).table();
    tidemap(&daemon, ["position", "office", "wind", "--at", "1"]).fails(1, &["only a vector has positions"]);
    evaluate(&daemon, "5,wind,1\n6,wind/cos,1\n", "mean").fails(1, &["not both"]);
}
