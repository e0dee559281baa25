//! The main use of tidemap, on the recording of a real door, from the command line: learn ten weeks, predict four.
//! The expected figures come from an independent implementation.

mod again;
mod anomalies;
mod figures;
mod models;
mod nightly;
mod predictions;
mod uniform;

use std::path::{Path, PathBuf};

use tempfile::TempDir;
use tidemap_tests::{
    cli::{self, Outcome},
    daemon::{Daemon, Launch},
    recordings,
};

/// A daemon with a map `door`, and the folder of the recording.
struct Door {
    daemon: Daemon,
    _data: TempDir,
    recording: PathBuf,
}

impl Door {
    /// `None` where there is no recording. People at the door lived by the time of this zone.
    fn new(time_zone: &str) -> Option<Self> {
        let recording = recordings::folder("door")?;
        let data = tempfile::tempdir().expect("a folder");
        let door = Self { daemon: Launch::on(data.path()).start(), _data: data, recording };
        let created = door.tidemap(["map", "create", "door", "--time-zone", time_zone]).table();
        assert_eq!(created.column("time_zone"), [time_zone]);
        Some(door)
    }

    fn file(&self, name: &str) -> PathBuf {
        self.recording.join(name)
    }

    fn tidemap<'a>(&self, args: impl IntoIterator<Item = &'a str>) -> Outcome {
        cli::tidemap(&self.daemon, args)
    }

    /// `tidemap observe door FILE` as a producer of its own.
    fn observe(&self, file: &Path, more: &[&str]) -> Outcome {
        let file = file.to_str().expect("a path that is text");
        self.tidemap(["observe", "door", file, "--producer", "camera"].into_iter().chain(more.iter().copied()))
    }

    /// Observes the ten weeks and learns from them.
    fn learn(&self) {
        let sent = self.observe(&self.file("train.csv"), &[]).table();
        assert_eq!(sent.columns, ["read", "accepted", "duplicate", "refused"]);
        assert_eq!(sent.rows, [["96480", "96480", "0", "0"]]);
        let update = self.tidemap(["update", "door"]).table();
        assert_eq!(update.column("state"), ["door"]);
        assert_eq!(update.column("observations"), ["96480"]);
        assert_eq!(update.column("order_before"), ["0"]);
    }
}
