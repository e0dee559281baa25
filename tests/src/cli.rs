//! The command line as people and scripts use it.
//!
//! Invariant: stdout is not a terminal, so results are CSV; columns are compared by name. The
//! user's own settings are neither read nor written.

use std::{
    ffi::OsStr,
    fs::File,
    io::Write as _,
    process::{Command, Stdio},
};

use crate::{binaries, daemon::Daemon};

/// Exit status and output of a command.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Exit status.
    pub code: Option<i32>,
    /// Results.
    pub stdout: String,
    /// Everything else.
    pub stderr: String,
}

impl Outcome {
    /// The results of a command that must succeed.
    ///
    /// # Panics
    /// If it failed.
    #[track_caller]
    pub fn table(&self) -> Table {
        self.table_with(0)
    }

    /// The results of a command with this exit status, for example because some rows were refused.
    ///
    /// # Panics
    /// If the status differs.
    #[track_caller]
    pub fn table_with(&self, code: i32) -> Table {
        assert_eq!(self.code, Some(code), "{}{}", self.stdout, self.stderr);
        assert!(!self.stderr.contains("panicked"), "{}", self.stderr);
        Table::parse(&self.stdout)
    }

    /// The stderr of a command that must fail with this exit status and name these words.
    ///
    /// # Panics
    /// If it does not.
    #[track_caller]
    pub fn fails(&self, code: i32, words: &[&str]) {
        assert_eq!(self.code, Some(code), "stdout:\n{}\nstderr:\n{}", self.stdout, self.stderr);
        for word in words {
            assert!(self.stderr.contains(word), "{word:?} is not in:\n{}", self.stderr);
        }
        assert!(!self.stderr.contains("panicked"), "{}", self.stderr);
    }
}

/// Results.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Table {
    /// Names of the columns.
    pub columns: Vec<String>,
    /// Rows.
    pub rows: Vec<Vec<String>>,
}

impl Table {
    /// Reads CSV with a header.
    ///
    /// # Panics
    /// If it is none.
    #[must_use]
    pub fn parse(text: &str) -> Self {
        let mut reader = csv::Reader::from_reader(text.as_bytes());
        let words = |record: &csv::StringRecord| record.iter().map(str::to_owned).collect();
        let columns = words(reader.headers().expect("a header"));
        let rows = reader.records().map(|record| words(&record.unwrap_or_else(|error| panic!("{error}:\n{text}"))));
        Self { columns, rows: rows.collect() }
    }

    /// A column, as text.
    ///
    /// # Panics
    /// If there is none of that name.
    #[must_use]
    #[track_caller]
    pub fn column(&self, name: &str) -> Vec<&str> {
        let index = self.columns.iter().position(|column| column == name);
        let index = index.unwrap_or_else(|| panic!("there is no column {name:?} in {:?}", self.columns));
        self.rows.iter().map(|row| row[index].as_str()).collect()
    }

    /// A column of numbers.
    ///
    /// # Panics
    /// If there is none of that name, or something else is in it.
    #[must_use]
    #[track_caller]
    pub fn numbers(&self, name: &str) -> Vec<f64> {
        let number = |text: &str| text.parse().unwrap_or_else(|_| panic!("{name} has {text:?}, which is no number"));
        self.column(name).into_iter().map(number).collect()
    }

    /// The number in a column of the only row.
    ///
    /// # Panics
    /// If there are other rows.
    #[must_use]
    #[track_caller]
    pub fn number(&self, name: &str) -> f64 {
        let numbers = self.numbers(name);
        assert_eq!(numbers.len(), 1, "{self:?}");
        numbers[0]
    }
}

/// Runs `tidemap` with these arguments against a daemon.
///
/// # Panics
/// If it cannot be started.
pub fn tidemap<T: AsRef<OsStr>>(daemon: &Daemon, args: impl IntoIterator<Item = T>) -> Outcome {
    run(command(&daemon.grpc, args))
}

/// Does the same as [`tidemap`], with a text as stdin.
///
/// # Panics
/// If it cannot be started.
pub fn tidemap_reading<T: AsRef<OsStr>>(daemon: &Daemon, args: impl IntoIterator<Item = T>, stdin: &str) -> Outcome {
    let mut file = tempfile::tempfile().expect("a temporary file");
    file.write_all(stdin.as_bytes()).expect("a temporary file can be written");
    rewind(&mut file);
    let mut command = command(&daemon.grpc, args);
    command.stdin(file);
    run(command)
}

fn rewind(file: &mut File) {
    std::io::Seek::rewind(file).expect("a file can be rewound");
}

/// The command, not yet run.
#[must_use]
pub fn command<T: AsRef<OsStr>>(server: &str, args: impl IntoIterator<Item = T>) -> Command {
    let mut command = Command::new(binaries::tidemap());
    for (name, _) in std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("TIDEMAP_")) {
        command.env_remove(name);
    }
    // The folder of this user's producer name; the user's own settings are not touched.
    command.env("XDG_CONFIG_HOME", binaries::profile_folder().join("tests-config"));
    command.arg("--server").arg(server).args(args).stdin(Stdio::null());
    command
}

fn run(mut command: Command) -> Outcome {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("output is text");
    Outcome { code: output.status.code(), stdout: text(output.stdout), stderr: text(output.stderr) }
}
