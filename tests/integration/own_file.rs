//! Files of one's own on the command line: kinds by patterns, refusals that repeat, what to do next.
//!
//! Invariant: every advised command is run as it was printed, or its words are compared with the options that were
//! given.

use std::{
    fmt::Write as _,
    fs,
    path::{Path, PathBuf},
};

use tempfile::{TempDir, tempdir};
use tidemap_tests::{
    cli::{Outcome, tidemap},
    daemon::{Daemon, Launch},
};

/// A map in Berlin, and a file.
struct Home {
    data: TempDir,
    daemon: Daemon,
}

impl Home {
    fn new() -> Self {
        let data = tempdir().expect("a folder");
        let daemon = Launch::on(data.path()).start();
        tidemap(&daemon, ["map", "create", "home", "--time-zone", "Europe/Berlin"]).table();
        Self { data, daemon }
    }

    fn file(&self, name: &str, text: &str) -> PathBuf {
        let path = self.data.path().join(name);
        fs::write(&path, text).expect("written");
        path
    }

    fn observe(&self, file: &Path, more: &[&str]) -> Outcome {
        let path = file.display().to_string();
        let words = ["observe", "home", &path, "--producer", "hub"].into_iter().chain(more.iter().copied());
        tidemap(&self.daemon, words.collect::<Vec<_>>())
    }

    fn run(&self, words: &[&str]) -> Outcome {
        tidemap(&self.daemon, words.iter().copied())
    }

    fn kinds(&self) -> Vec<(String, String)> {
        let table = self.run(&["state", "list", "home"]).table();
        let kinds = table.column("kind").into_iter().map(str::to_owned);
        let mut all: Vec<_> = table.column("state").into_iter().map(str::to_owned).zip(kinds).collect();
        all.sort();
        all
    }
}

#[test]
fn one_file_of_all_sensors_goes_in_with_one_command() {
    let home = Home::new();
    let file = home.file(
        "all.csv",
        "time,state,value\n1738537200,temperature.hall,21.5\n1738537200,temperature.attic,-3\n1738537200,door,1\n\
         1738537200,visits-1,4\n1738537260,temperature.hall,22\n",
    );
    let kinds = ["--kinds", "temperature.*=continuous,visits-?=count,nothing*=angle"];
    let sent = home.observe(&file, &kinds);
    assert_eq!(sent.table().numbers("accepted"), [5.0]);
    assert!(sent.stderr.contains("no state of") && sent.stderr.contains("fits 'nothing*'"), "{}", sent.stderr);
    let expected = [
        ("door", "probability"),
        ("temperature.attic", "continuous"),
        ("temperature.hall", "continuous"),
        ("visits-1", "count"),
    ];
    assert_eq!(home.kinds(), expected.map(|(state, kind)| (state.to_owned(), kind.to_owned())));
    // Sent again, nothing is new; in place of what was sent, the kinds are there again.
    assert_eq!(home.observe(&file, &kinds).table().numbers("duplicate"), [5.0]);
    assert_eq!(home.observe(&file, &[&kinds[..], &["--replace"]].concat()).table().numbers("accepted"), [5.0]);
    // A kind never changes, and nothing is withdrawn for that.
    let other = home.observe(&file, &["--kinds", "door=count", "--replace"]);
    other.fails(1, &["state \"door\" exists and is of kind probability, not count", "Nothing was sent"]);
    assert_eq!(home.kinds().len(), 4);
    let fresh = home.file("fresh.csv", "time,state,value\n1738537200,gate,1\n");
    home.observe(&fresh, &["--kinds", "gate=probability", "--events"]).fails(2, &["does not go with --events"]);
    assert_eq!(home.observe(&fresh, &["--kinds", "gate=count", "--events"]).table().numbers("accepted"), [1.0]);
    for (wrong, words) in [("door", "PATTERN=KIND"), ("door=warm", "is not a kind"), ("door=vector", "positions")] {
        home.observe(&file, &["--kinds", wrong]).fails(2, &[words]);
    }
    home.observe(&file, &["--kinds", "door=count", "--kind", "count"]).fails(2, &["--kind"]);
}

/// The command after the last of these words, up to the end of its line or to a word in brackets.
fn advised(outcome: &Outcome, before: &str) -> Vec<String> {
    let line = outcome.stderr.lines().rev().find_map(|line| Some(line.split_once(before)?.1));
    let line = line.unwrap_or_else(|| panic!("{before:?} is not in:\n{}", outcome.stderr));
    let words = line.split_whitespace().take_while(|word| !word.ends_with(')'));
    words.map(|word| word.trim_end_matches([';', ',']).to_owned()).collect()
}

#[test]
fn rows_of_an_erased_state_are_sent_anew_by_the_advised_command() {
    let home = Home::new();
    let file = home.file("log.csv", "when,name,value\n2025-02-03 08:00:00,door,open\n2025-02-03 09:00:00,lamp,on\n");
    let options = ["--changes", "--local", "--columns", "time=when,state=name", "--hold-max", "1d"];
    assert_eq!(home.observe(&file, &options).table().numbers("accepted"), [2.0]);
    let again = home.observe(&file, &options);
    assert!(!again.stderr.contains("the map has nothing of"), "{}", again.stderr);
    home.run(&["erase", "home", "--state", "door"]).table();
    let erased = home.observe(&file, &options);
    assert_eq!(erased.table().numbers("duplicate"), [2.0]);
    assert!(erased.stderr.contains("the map has nothing of \"door\":"), "{}", erased.stderr);
    let command = advised(&erased, "To send them anew: tidemap ");
    for word in ["--changes", "--local", "time=when,state=name", "86400s", "--replace"] {
        assert!(command.iter().any(|part| part == word), "{word}: {command:?}");
    }
    let sent = home.run(&command.iter().map(String::as_str).collect::<Vec<_>>());
    assert_eq!(sent.table().numbers("accepted"), [2.0]);
    assert_eq!(home.kinds().len(), 2);
}

#[test]
fn rows_that_do_not_mean_what_their_sender_thinks_give_a_warning() {
    let home = Home::new();
    let (mut words, mut events) = ("time,state,value\n".to_owned(), "time,state,value\n".to_owned());
    for row in 0..30 {
        let value = if row % 2 == 0 { "on" } else { "aus" };
        let _ = writeln!(words, "{},door,{value}", 1_738_537_200 + row * 600);
        let _ = writeln!(events, "{},gate,1", 1_738_537_200 + row * 600);
    }
    // Half of the words are unknown: each is reported once.
    let sent = home.observe(&home.file("words.csv", &words), &["--changes"]);
    sent.fails(1, &["have only one value, 1 for the first", "state \"door\"", "--values WORD=0"]);
    assert_eq!(sent.stderr.matches("value \"aus\" is not a number").count(), 1, "{}", sent.stderr);
    assert!(sent.stderr.contains("and 14 more rows for the reasons above"), "{}", sent.stderr);
    assert!(!sent.stderr.contains("If each row is an event"), "{}", sent.stderr);
    // Events that were sent as changes.
    let sent = home.observe(&home.file("gate.csv", &events), &["--changes"]);
    assert!(sent.stderr.contains("state \"gate\": all rows have one value"), "{}", sent.stderr);
    home.run(&["erase", "home", "--state", "gate"]).table();
    let command = advised(&sent, "and send the file anew: tidemap ");
    let anew = home.run(&command.iter().map(String::as_str).collect::<Vec<_>>());
    assert_eq!(anew.table().numbers("accepted"), [30.0]);
    // Numbers of another kind, a word for one, another separator, another date.
    let file = home.file("warm.csv", "time,state,value\n1738537200,hall,21.5\n1738537200,hatch,ajar\n");
    let sent = home.observe(&file, &["--values", "ajar=5"]);
    sent.fails(1, &["\"ajar\" means 5", "21.5 is not between 0 and 1", "--kinds 'PATTERN=continuous'"]);
    home.observe(&home.file("semi.csv", "time;state;value\n1;door;0\n"), &[]).fails(1, &["separated by semicolons"]);
    let dated = home.file("dated.csv", "time,state,value\n03.02.2025 08:00,door,1\n03.02.2025 09:00,door,0\n");
    home.observe(&dated, &["--local"]).fails(1, &["\"03.02.2025 08:00\" is a date as day.month.year"]);
}

#[test]
fn the_night_in_which_an_hour_comes_twice_is_reported() {
    let home = Home::new();
    // 2025-10-26T00:00:00Z is 02:00 in Berlin for the first time.
    let first = 1_761_436_800;
    let rows: String = (-24..24).map(|hour| format!("{},door,{}\n", first + hour * 3_600, hour & 1)).collect();
    home.observe(&home.file("night.csv", &format!("time,state,value\n{rows}")), &[]).table();
    home.run(&["update", "home"]).table();
    let predict = |more: &[&str]| home.run(&[&["predict", "home", "door"], more].concat());
    let predicted = predict(&["--at", "2025-10-26T02:30", "--local"]);
    assert_eq!(predicted.table().column("time"), [(first + 1_800).to_string()]);
    assert!(predicted.stderr.contains("comes twice in Europe/Berlin"), "{}", predicted.stderr);
    assert!(predicted.stderr.contains("The second is 2025-10-26T02:30+01:00"), "{}", predicted.stderr);
    let second = predict(&["--at", "2025-10-26T02:30+01:00"]);
    assert_eq!(second.table().column("time"), [(first + 5_400).to_string()]);
    let table = predict(&["--date", "2025-10-26", "--output", "table"]);
    for shown in ["Sun 2025-10-26 02:00+02:00", "Sun 2025-10-26 02:00+01:00", "Sun 2025-10-26 03:00 "] {
        assert!(table.stdout.contains(shown), "{shown}: {}", table.stdout);
    }
    let steps = predict(&["--date", "2025-10-26", "--step", "6h"]).table().numbers("time");
    assert_eq!(steps, [-2.0, 5.0, 11.0, 17.0].map(|hours| f64::from(first) + hours * 3_600.0));
    let kept = ["reconstruct", "home", "door", "--from", "2025-10-26T03:00", "--to", "2025-10-26T05:00", "--local"];
    assert_eq!(home.run(&kept).table().numbers("time"), [2.0, 3.0].map(|hours| f64::from(first) + hours * 3_600.0));
    home.run(&kept[..7]).fails(2, &["--local"]);
    let anomalies = home.run(&["anomalies", "home", "door", "--date", "2025-10-26", "--model", "mean"]);
    assert!(anomalies.table().numbers("time").iter().all(|time| *time >= f64::from(first - 7_200)));
    home.run(&["anomalies", "home", "--confidence", "0.6"]).fails(2, &["--confidence 0.6", "use 0.9 to 1"]);
    let loose = ["anomalies", "home", "door", "--model", "mean", "--confidence", "0.5"];
    home.run(&loose).fails(2, &["--confidence 0.5", "above 0.5 and at most 1"]);
    // The model behind auto is named as predictions name it.
    let shown = home.run(&["model", "show", "home", "door"]).table();
    let answered = predict(&["--at", "2025-10-26T12:00:00Z"]).table();
    assert_eq!(shown.column("auto").first(), answered.column("model").first());
}
