//! Bad input on the command line and in files: exit status, the wrong value in the message, and the valid rows that are
//! kept.

use std::{fs, path::Path};

use tidemap_tests::{
    cli::{self, Outcome},
    daemon::{Daemon, Launch},
};

use super::{observations, office, states};

const HEADER: &str = "time,state,value\n";

#[tokio::test(flavor = "multi_thread")]
async fn files_that_are_no_observations_are_refused_whole() {
    let (_data, daemon) = office(|launch| launch).await;
    let observe = |text: &str| cli::tidemap_reading(&daemon, ["observe", "office", "-"], text);
    observe("").fails(1, &["stdin", "empty", "time,state,value"]);
    observe("time,value\n1,0\n").fails(1, &["\"state\"", "missing", "time,value"]);
    observe("1451865600,door,0\n").fails(1, &["missing", "1451865600,door,0"]);
    observe("time,state,value,state\n1,a,0,b\n").fails(1, &["\"state\"", "twice"]);
    let absent = cli::tidemap(&daemon, ["observe", "office", "absent.csv"]);
    absent.fails(1, &["absent.csv"]);
    assert_eq!(observations(&daemon).await, 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn rows_that_are_wrong_are_refused_one_by_one() {
    let (_data, daemon) = office(|launch| launch).await;
    let long = "x".repeat(129);
    let rows = [
        ("1451865600,door,1", ""),
        ("1451865660,door,1.5", "1.5"),
        ("1451865720,door,NaN", "NaN"),
        ("1451865780,door,inf", "inf"),
        ("1451865840,door,-0.25", "-0.25"),
        ("1451865900,door,ajar", "ajar"),
        ("-1,door,1", "-1"),
        ("9223372037,door,1", "9223372037"),
        ("1451865600000,door,1", "milliseconds"),
        ("yesterday,door,1", "yesterday"),
        ("2016-01-04,door,1", "2016-01-04"),
        ("1451865960,,1", "empty"),
        (&format!("1451865960,{long},1"), "129"),
        ("1451865960,edge/a/b,1", "edge/a/b"),
        ("1451865960,tab\there,1", "U+0009"),
        ("1451865960,u\u{308}ber,1", "NFC"),
        ("1451865960,door", "2 fields"),
        ("1451865960,door,1,1", "4 fields"),
        ("1451866020,door,0", ""),
        ("2016-01-04T00:08:00Z,gate,0.5", ""),
    ];
    let text: String = rows.iter().map(|(row, _)| format!("{row}\n")).collect();
    let outcome = cli::tidemap_reading(&daemon, ["observe", "office", "-"], &(HEADER.to_owned() + &text));
    let words: Vec<&str> = rows.iter().map(|&(_, word)| word).filter(|word| !word.is_empty()).collect();
    outcome.fails(1, &words);
    for (number, (row, word)) in (1..).zip(&rows) {
        let is_named = outcome.stderr.contains(&format!("row {number} "));
        assert_eq!(is_named, !word.is_empty(), "row {number}, {row:?}:\n{}", outcome.stderr);
    }
    assert_eq!(outcome.table_with(1).rows, [["20", "3", "0", "17"]]);
    assert_eq!(states(&daemon).await, ["door", "gate"]);
    assert_eq!(observations(&daemon).await, 3);

    // Sent again: refused rows are not sent twice either.
    let again = cli::tidemap_reading(&daemon, ["observe", "office", "-"], &(HEADER.to_owned() + &text));
    let again = cli_rows(&again);
    assert_eq!((again[0].as_str(), again[2].as_str()), ("20", "20"));
    assert_eq!(observations(&daemon).await, 3);
}

fn cli_rows(outcome: &Outcome) -> Vec<String> {
    assert!(outcome.code.is_some_and(|code| code < 2), "{outcome:?}");
    cli::Table::parse(&outcome.stdout).rows.concat()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_torn_last_line_is_left_out_and_sent_when_it_is_whole() {
    let (_data, daemon) = office(|launch| launch).await;
    let work = tempfile::tempdir().expect("a folder");
    let file = work.path().join("door.csv");
    let observe = || cli::tidemap(&daemon, ["observe".as_ref(), "office".as_ref(), file.as_os_str()]);
    fs::write(&file, format!("{HEADER}1451865600,door,1\n1451865660,do")).expect("a file");
    observe().fails(1, &["line 3", "1451865660,do", "incomplete"]);
    assert_eq!(observations(&daemon).await, 1);
    fs::write(&file, format!("{HEADER}1451865600,door,1\n1451865660,door,0\n")).expect("a file");
    assert_eq!(observe().table().rows, [["2", "1", "1", "0"]]);
    // A last line with three fields is complete, with or without a line end.
    fs::write(&file, format!("{HEADER}1451865600,door,1\n1451865660,door,0\n1451865720,door,1")).expect("a file");
    assert_eq!(observe().table().rows, [["3", "1", "2", "0"]]);
    assert_eq!(states(&daemon).await, ["door"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn names_that_are_not_known_fail_with_those_that_are() {
    let (_data, daemon) = office(|launch| launch).await;
    let one = format!("{HEADER}1451865600,door,1\n");
    let seen = cli::tidemap_reading(&daemon, ["observe", "office", "-"], &one).table();
    assert_eq!(seen.number("accepted"), 1.0);
    let tidemap = |args: &[&str]| cli::tidemap_reading(&daemon, args, &one);
    for args in [
        &["map", "show", "attic"][..],
        &["map", "delete", "attic", "--yes"],
        &["state", "list", "attic"],
        &["observe", "attic", "-"],
        &["update", "attic"],
        &["predict", "attic", "door", "--at", "0"],
        &["evaluate", "attic", "-"],
        &["model", "show", "attic", "door"],
        &["stats", "attic"],
    ] {
        tidemap(args).fails(1, &["attic", "office"]);
    }
    tidemap(&["predict", "office", "door", "gate", "--at", "0"]).fails(1, &["gate", "door"]);
    tidemap(&["model", "show", "office", "gate"]).fails(1, &["gate", "door"]);
    let other = format!("{HEADER}1451865600,gate,1\n");
    cli::tidemap_reading(&daemon, ["evaluate", "office", "-"], &other).fails(1, &["gate", "door"]);
    tidemap(&["job", "watch", "99"]).fails(1, &["99"]);
    assert_eq!(observations(&daemon).await, 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn maps_that_cannot_be_are_not_created() {
    let (_data, daemon) = office(|launch| launch).await;
    let create = |name: &str, more: &[&str]| {
        let args = ["map", "create"].into_iter().chain(more.iter().copied()).chain(["--", name]);
        cli::tidemap(&daemon, args)
    };
    create("office", &[]).fails(1, &["office", "exists"]);
    let long = "m".repeat(64);
    for name in ["", "-a", "Office", "a/b", "../etc", "büro", &long] {
        create(name, &[]).fails(1, &["map name", "a-z"]);
    }
    create("lab", &["--time-zone", "Mars/Base"]).fails(1, &["Mars/Base"]);
    create("lab", &["--periods", "24h,12h,24h"]).fails(1, &["periods"]);
    create("lab", &["--periods", "24h,200000d"]).fails(2, &["200000d"]);
    create("lab", &["--period-base", "500ms"]).fails(1, &["periodicities"]);
    create("lab", &["--period-base", "0s"]).fails(2, &["0s"]);
    create("lab", &["--period-base", "soon"]).fails(2, &["soon"]);
    create("lab", &["--period-count", "0"]).fails(2, &["0", "1..=2048"]);
    create("lab", &["--period-count", "2049"]).fails(2, &["2049", "1..=2048"]);
    create("lab", &["--periods", "24h", "--period-count", "3"]).fails(2, &["--periods", "--period-count"]);
    let maps = cli::tidemap(&daemon, ["map", "list"]).table();
    assert_eq!(maps.column("name"), ["office"]);
    cli::tidemap(&daemon, ["map", "delete", "office"]).fails(2, &["--yes", "office"]);
    assert_eq!(cli::tidemap(&daemon, ["map", "list"]).table().rows.len(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn questions_that_make_no_sense_are_wrong_usage() {
    let (_data, daemon) = office(|launch| launch).await;
    let one = format!("{HEADER}1451865600,door,1\n");
    assert_eq!(cli::tidemap_reading(&daemon, ["observe", "office", "-"], &one).code, Some(0));
    let predict =
        |more: &[&str]| cli::tidemap(&daemon, ["predict", "office", "door"].into_iter().chain(more.iter().copied()));
    predict(&[]).fails(2, &["--at"]);
    predict(&["--at", "tomorrow"]).fails(2, &["tomorrow", "Unix seconds"]);
    predict(&["--at=-5"]).fails(2, &["-5", "1970"]);
    predict(&["--at", "9223372037"]).fails(2, &["9223372037", "2262"]);
    predict(&["--at", "0", "--order", "16"]).fails(2, &["16", "0..=15"]);
    predict(&["--at", "0", "--model", "fremen"]).fails(2, &["fremen", "spectral"]);
    predict(&["--at", "0", "--model", "histogram:0"]).fails(2, &["histogram:0", "above 0"]);
    predict(&["--at", "0", "--model", "mean", "--order", "1"]).fails(2, &["--order", "mean"]);
    predict(&["--from", "10", "--to", "5", "--step", "1s"]).fails(2, &["--from"]);
    predict(&["--from", "0", "--to", "5"]).fails(2, &["--step"]);
    predict(&["--times", "absent.txt"]).fails(1, &["absent.txt"]);
    cli::tidemap(&daemon, ["evaluate", "office", "absent.csv"]).fails(1, &["absent.csv"]);
    cli::tidemap(&daemon, ["update", "office", "--until", "never"]).fails(2, &["never"]);
    cli::tidemap(&daemon, ["forget", "office"]).fails(2, &["forget"]);
}

#[test]
fn a_daemon_that_is_not_there_is_named() {
    let port = tidemap_tests::daemon::lasting_port();
    let server = format!("127.0.0.1:{port}");
    let run = |server: &str, args: &[&str]| {
        let output = cli::command(server, args).output().expect("tidemap can be started");
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("output is text");
        Outcome { code: output.status.code(), stdout: text(output.stdout), stderr: text(output.stderr) }
    };
    run(&server, &["map", "list"]).fails(1, &[&server, "connection refused"]);
    let work = tempfile::tempdir().expect("a folder");
    let file = work.path().join("door.csv");
    fs::write(&file, format!("{HEADER}1451865600,door,1\n")).expect("a file");
    let file = file.to_str().expect("a path that is text");
    run(&server, &["observe", "office", file, "--patience", "1s"])
        .fails(1, &[&server, "connection refused", "gave up"]);
    run("ftp://here", &["map", "list"]).fails(2, &["ftp://here", "HOST:PORT"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn refused_rows_are_corrected_without_doubling_the_others() {
    let (folder, daemon) = office(|launch| launch).await;
    let [file, again, last] = ["a.csv", "again.csv", "last.csv"].map(|name| folder.path().join(name));
    let text = |path: &Path| path.to_str().expect("UTF-8").to_owned();
    let long = "n".repeat(129);
    let rows = format!("{HEADER}1451865960,door,1\nsoon,door,1\n1451866020,{long},0\n1451866080,door,2\n");
    fs::write(&file, rows).expect("a file");
    let observe = |file: &Path, more: &[&str]| {
        let args = ["observe", "office", &text(file), "--producer", "robot"].map(str::to_owned);
        cli::tidemap(&daemon, args.into_iter().chain(more.iter().map(|&arg| arg.to_owned())))
    };
    // Sent without the option at first: what was refused is found again, and nothing is sent twice.
    observe(&file, &[]).fails(1, &["--refused FILE", "row 2 (line 3)", "row 4 (line 5)"]);
    let with = observe(&file, &["--refused", &text(&again)]);
    assert_eq!(with.table().rows, [["4", "0", "4", "0"]]);
    let kept = fs::read_to_string(&again).expect("a file");
    let lines: Vec<&str> = kept.lines().collect();
    assert_eq!(lines.len(), 4, "{kept}");
    assert_eq!(lines[0], format!("line,refused,{}", HEADER.trim_end()));
    assert!(lines[1].starts_with("3,\"time ") && lines[1].ends_with(",soon,door,1"), "{kept}");
    observe(&file, &["--refused", &text(&again)]).fails(2, &["it exists"]);

    let corrected = kept.replace(",soon,", ",1451866000,").replace(&format!(",{long},0"), ",gate,0");
    fs::write(&again, corrected).expect("a file");
    let outcome = observe(&again, &["--refused", &text(&last)]);
    assert_eq!(outcome.table_with(1).rows, [["3", "2", "0", "1"]]);
    fs::write(&last, fs::read_to_string(&last).expect("a file").replace(",door,2", ",door,0")).expect("a file");
    for accepted in ["1", "0"] {
        assert_eq!(observe(&last, &[]).table().rows[0][1], accepted);
    }
    assert_eq!(observations(&daemon).await, 4);
    // A user who corrects the file itself gets advice what to do.
    fs::write(&file, format!("{HEADER}1451865960,door,1\n1451866000,door,1\n")).expect("a file");
    observe(&file, &[]).fails(1, &["nothing was sent", "a.csv --replace", "--label a-2.csv"]);
    // The proposed label is free.
    let [tuesday, wednesday] = ["tue", "wed"].map(|day| folder.path().join(day));
    for (day, values) in [(&tuesday, "1,0"), (&wednesday, "0,1")] {
        fs::create_dir(day).expect("a folder");
        let (first, second) = values.split_once(',').expect("two values");
        let rows = format!("{HEADER}1451870000,door,{first}\n1451870060,door,{second}\n");
        fs::write(day.join("a.csv"), rows).expect("a file");
    }
    observe(&tuesday.join("a.csv"), &["--label", "a-2.csv"]).table();
    observe(&wednesday.join("a.csv"), &[]).fails(1, &["nothing was sent", "--label a-3.csv"]);
    observe(&wednesday.join("a.csv"), &["--label", "a-3.csv"]).table();
    assert_eq!(observations(&daemon).await, 8);
}

#[test]
fn times_of_a_clock_that_is_not_set_are_refused_unless_the_map_is_of_a_simulation() {
    let folder = tempfile::tempdir().expect("a folder");
    let launch = Launch::on(folder.path());
    let daemon = launch.start();
    let observe = |daemon: &Daemon, map: &str, rows: &str| {
        let text = format!("{HEADER}{rows}");
        cli::tidemap_reading(daemon, ["observe", map, "-", "--producer", "robot"], &text)
    };
    cli::tidemap(&daemon, ["map", "create", "real"]).table();
    cli::tidemap(&daemon, ["map", "create", "simulated", "--clock", "simulated"]).table();
    let outcome = observe(&daemon, "real", "12.5,door,1\n1451865960,door,1\n1451865.96,door,0\n");
    outcome.fails(1, &["row 1 (line 2)", "robot's clock", "clock is simulated", "row 3", "in microseconds"]);
    assert_eq!(outcome.table_with(1).rows, [["3", "1", "0", "2"]]);
    assert_eq!(observe(&daemon, "simulated", "12.5,door,1\n").table().rows, [["1", "1", "0", "0"]]);
    // The choice survives a restart.
    drop(daemon);
    let daemon = launch.start();
    for (map, clock) in [("real", "real"), ("simulated", "any")] {
        let shown = cli::tidemap(&daemon, ["map", "show", map, "--output", "table"]);
        let line = shown.stdout.lines().find(|line| line.starts_with("clock")).unwrap_or_default().to_owned();
        assert_eq!(line.split_whitespace().last(), Some(clock), "{shown:?}");
    }
    observe(&daemon, "real", "12.5,door,1\n1451865960,door,1\n1451865.96,door,0\n5,door,1\n")
        .fails(1, &["row 4 (line 5)", "clock"]);
}
