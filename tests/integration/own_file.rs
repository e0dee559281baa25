//! Files of one's own on the command line: kinds by patterns, refusals that repeat, what to do next.
//!
//! Invariant: every advised command is run as it was printed, or its words are compared with the options that were given.

use std::{fmt::Write as _, fs, path::PathBuf};

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

    fn observe(&self, file: &PathBuf, more: &[&str]) -> Outcome {
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
