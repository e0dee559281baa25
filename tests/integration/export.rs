//! Exported maps, read back by readers that others wrote: the crate mcap here, and in `export/readers.rs` two packages
//! of Python.
//!
//! Invariant: expected values are those that other commands print; files are read as their formats define, not by the
//! code that wrote them.

mod compare;
mod files;
mod graph;
mod readers;

use std::{collections::BTreeMap, fs, path::PathBuf};

use tempfile::TempDir;
use tidemap_tests::{
    cli::{Outcome, Table, tidemap, tidemap_reading},
    daemon::{Daemon, Launch},
};

const MAP: &str = "home";
const NOON: &str = "2025-01-28T12:00:00Z";
/// Four times of one day: midnight, six, noon and eighteen.
const DAY: [&str; 6] = ["--from", "2025-01-28T00:00:00Z", "--to", "2025-01-29T00:00:00Z", "--step", "6h"];

/// A map that has everything: a grid, a topological map with traversals, and two states.
struct Home {
    folder: TempDir,
    daemon: Daemon,
}

impl Home {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let daemon = Launch::on(&folder.path().join("data")).start();
        let home = Self { folder, daemon };
        home.run(&["map", "create", MAP, "--time-zone", "UTC", "--grid", "resolution=0.5,origin=-4:-4:0,flat"]);
        home.send_scans();
        home.send_states();
        let topology = "node Hall\nnode Lab\nnode Shop\nnode Attic\nlink Hall Lab 10\nlink Lab Shop 20\nlink Shop Hall 30\n\
                        link Attic Hall 5\n";
        tidemap_reading(&home.daemon, ["topology", "load", MAP, "-"], topology).table();
        for (node, place) in [("Hall", "0,0"), ("Lab", "1.5,0"), ("Shop", "1.5,-1")] {
            home.run(&["topology", "edit", "set-node", MAP, node, "--position", place]);
        }
        tidemap_reading(&home.daemon, ["traverse", MAP, "-", "--producer", "r", "--label", "runs"], &traversals())
            .table();
        home.run(&["update", MAP]);
        home
    }

    /// Scans of four points around the robot; at night there is a fifth, nearer one.
    fn send_scans(&self) {
        let head = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 5\nHEIGHT 1\n\
                    VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 5\nDATA ascii\n2 0 0\n0 2 0\n-2 0 0\n1 1 0\n";
        // Every four hours from two o'clock on, for two weeks.
        let names: Vec<String> = (0..84).map(|scan| format!("scan-{scan:02}.pcd")).collect();
        for (scan, name) in names.iter().enumerate() {
            let is_day = (8..20).contains(&((2 + 4 * scan) % 24));
            let point = if is_day { "0 -3 0\n" } else { "0 -1 0\n" };
            fs::write(self.path(name), format!("{head}{point}")).expect("a file");
        }
        let paths: Vec<String> = names.iter().map(|name| self.text(name)).collect();
        let paths: Vec<&str> = paths.iter().map(String::as_str).collect();
        let options = ["--at", "2025-01-06T02:00:00Z", "--every", "4h", "--pose", "0,0,0", "--producer", "r"];
        self.run(&[&["grid", "observe", MAP], &paths[..], &options].concat());
    }

    fn send_states(&self) {
        let mut rows = "time,state,value\n".to_owned();
        for step in 0..1_000_i64 {
            let time = 1_736_121_600 + step * 1_740;
            let is_open = (9..17).contains(&(time / 3_600 % 24));
            rows += &format!("{time},door,{}\n{time},light,{}\n", u8::from(is_open), u8::from(!is_open));
        }
        tidemap_reading(&self.daemon, ["observe", MAP, "-", "--producer", "r"], &rows).table();
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).to_str().expect("a path of text").to_owned()
    }

    fn run(&self, words: &[&str]) -> Outcome {
        let outcome = tidemap(&self.daemon, words);
        assert_eq!(outcome.code, Some(0), "{words:?}: {}", outcome.stderr);
        outcome
    }

    /// Exports to a file of this name; returns its path, and what was written of each content.
    fn export(&self, name: &str, words: &[&str]) -> (PathBuf, BTreeMap<String, f64>) {
        let path = self.text(name);
        let table = self.run(&[&["export", MAP, &path], words].concat()).table();
        assert!(table.column("out").iter().all(|out| *out == path), "{table:?}");
        let contents = table.column("content").into_iter().map(str::to_owned);
        (self.path(name), contents.zip(table.numbers("count")).collect())
    }

    /// The known cells of the grid at a time by `grid predict`.
    fn cells(&self, at: &str) -> Cells {
        let path = self.text("cells.csv");
        self.run(&["grid", "predict", MAP, "--at", at, "--out", &path]);
        let table = Table::parse(&fs::read_to_string(&path).expect("a file"));
        let places = table.numbers("x").into_iter().zip(table.numbers("y"));
        let values = table.numbers("probability");
        places.zip(values).map(|((x, y), value)| (millimetres([x, y]), (value * 100.0).round() as i32)).collect()
    }
}

/// Known cells: the centre in millimetres, and the probability in percent.
type Cells = BTreeMap<[i64; 2], i32>;

fn millimetres(at_m: [f64; 2]) -> [i64; 2] {
    at_m.map(|along| (along * 1_000.0).round() as i64)
}

/// The known cells of rows of percents, the lowest row first; -1 is unknown.
fn known_cells(percents: &[i32], width: usize, origin_m: [f64; 2], resolution_m: f64) -> Cells {
    let centre = |at: usize| {
        let cell = [at % width, at / width];
        millimetres([0, 1].map(|axis| origin_m[axis] + (cell[axis] as f64 + 0.5) * resolution_m))
    };
    percents
        .iter()
        .enumerate()
        .filter(|(_, percent)| **percent >= 0)
        .map(|(at, percent)| (centre(at), *percent))
        .collect()
}

fn traversals() -> String {
    let mut rows = "from,to,start,end,success,reason\n".to_owned();
    for hour in 0..300_i64 {
        let start = 1_736_121_600 + hour * 3_600;
        for (from, to, secs, minute) in [("Hall", "Lab", 10, 0), ("Lab", "Shop", 25, 10), ("Shop", "Hall", 30, 20)] {
            let is_passed = from != "Lab" || (8..20).contains(&(hour % 24));
            let start = start + minute * 60;
            rows += &format!("{from},{to},{start},{},{is_passed},\n", start + secs);
        }
    }
    rows
}
