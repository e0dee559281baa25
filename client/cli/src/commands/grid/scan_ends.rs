//! The cells in which scans ended and that a written map shows as free or unknown: in a line for people, and as columns
//! for programs.
//!
//! Invariant: the numbers are those of the file that was written, at its thresholds.

use tidemap_formats::{
    nav2::{ScanEnds, Thresholds},
    table::Cell,
};

use crate::counted::{count, counted, percent};

/// Additional columns of a written map.
pub(crate) const COLUMNS: [&str; 5] = ["scan_ends", "scan_ends_free", "scan_ends_unknown", "free_up_to", "occupied_from"];

/// The cells in which scans ended, in a file that was written.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FileScanEnds {
    pub(crate) ends: ScanEnds,
    pub(crate) kind: ShownAs,
}

/// The kind of a file, which decides the thresholds and the words.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum ShownAs {
    /// A map of mode trinary.
    Map(Thresholds),
    /// A map of cells that are occupied from a probability on, and else free.
    AtLeast(f64),
    /// A keepout mask, forbidden from a probability on.
    Keepout(f64),
}

impl FileScanEnds {
    /// The values of [`COLUMNS`].
    pub(crate) fn cells(&self) -> Vec<Cell> {
        let (free_up_to, occupied_from) = match self.kind {
            ShownAs::Map(Thresholds { free, occupied }) => (Some(free), occupied),
            ShownAs::AtLeast(from) | ShownAs::Keepout(from) => (None, from),
        };
        let ScanEnds { cells, free, unknown } = self.ends;
        vec![cells.into(), free.into(), unknown.into(), Cell::maybe(free_up_to), occupied_from.into()]
    }

    /// The line for people. `file` is the name of the image.
    pub(crate) fn line(&self, file: &str) -> String {
        let ScanEnds { cells, free, unknown } = self.ends;
        let share = percent(free, cells);
        let free = count(free);
        let ended = format!("scans ended in {}", counted(cells, "cell"));
        match self.kind {
            ShownAs::Map(Thresholds { free: up_to, occupied }) => format!(
                "{ended}: {free}{share} of them are free in {file}, with a probability up to {up_to} at this time, and {} \
                 unknown, below {occupied}. grid predict --pgm-mode raw writes the probabilities",
                count(unknown)
            ),
            ShownAs::AtLeast(from) => {
                format!("{ended}: {free}{share} of them are free in {file}, with a probability below {from} at this time")
            }
            ShownAs::Keepout(from) => format!(
                "{ended}: {free}{share} of them are not forbidden in {file}, with a probability below {from} at this \
                 time. --occupied sets another limit"
            ),
        }
    }
}
