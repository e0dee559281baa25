//! The cells that were occupied at some time and that a written map shows as free or unknown: in a line for people, and
//! as columns for programs.
//!
//! Invariant: the numbers are those of the file that was written, at its thresholds.

use tidemap_formats::{
    nav2::{EverOccupied, Thresholds},
    table::Cell,
};

use crate::counted::{count, counted, percent};

/// Additional columns of a written map.
pub(crate) const COLUMNS: [&str; 5] =
    ["ever_occupied", "ever_occupied_free", "ever_occupied_unknown", "free_up_to", "occupied_from"];

/// The cells that were occupied at some time, in a file that was written.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FileEverOccupied {
    pub(crate) occupied: EverOccupied,
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

impl FileEverOccupied {
    /// The values of [`COLUMNS`].
    pub(crate) fn cells(&self) -> Vec<Cell> {
        let (free_up_to, occupied_from) = match self.kind {
            ShownAs::Map(Thresholds { free, occupied }) => (Some(free), occupied),
            ShownAs::AtLeast(from) | ShownAs::Keepout(from) => (None, from),
        };
        let EverOccupied { cells, free, unknown } = self.occupied;
        vec![cells.into(), free.into(), unknown.into(), Cell::maybe(free_up_to), occupied_from.into()]
    }

    /// The line for people. `file` is the name of the image.
    pub(crate) fn line(&self, file: &str) -> String {
        let EverOccupied { cells, free, unknown } = self.occupied;
        if cells == 0 {
            return "no cell was occupied at a time that an update has learned".to_owned();
        }
        let share = percent(free, cells);
        let free = count(free);
        let were = if cells == 1 { "was" } else { "were" };
        let known = format!("{} {were} occupied at some time", counted(cells, "cell"));
        match self.kind {
            ShownAs::Map(Thresholds { free: up_to, occupied }) => format!(
                "{known}: {free}{share} of them are free in {file}, with a probability up to {up_to} at this time, and {} are \
                 unknown, below {occupied}. grid predict --pgm-mode raw writes the probabilities",
                count(unknown)
            ),
            ShownAs::AtLeast(from) => {
                format!(
                    "{known}: {free}{share} of them are free in {file}, with a probability below {from} at this time"
                )
            }
            ShownAs::Keepout(from) => format!(
                "{known}: {free}{share} of them are not forbidden in {file}, with a probability below {from} at this \
                 time. --occupied sets another limit"
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_has_the_numbers_and_the_threshold_of_the_file() {
        let occupied = EverOccupied { cells: 1204, free: 87, unknown: 40 };
        let line = |occupied, kind| FileEverOccupied { occupied, kind }.line("ten.pgm");
        for (kind, words) in [
            (ShownAs::Map(Thresholds::default()), &["87 (7 %)", "up to 0.25", "40 are unknown, below 0.65"][..]),
            (ShownAs::AtLeast(0.9), &["87 (7 %)", "below 0.9"]),
            (ShownAs::Keepout(0.4), &["87 (7 %)", "not forbidden", "below 0.4", "--occupied"]),
        ] {
            let line = line(occupied, kind);
            assert!(line.starts_with("1,204 cells were occupied at some time: ") && line.contains("ten.pgm"), "{line}");
            assert!(words.iter().all(|word| line.contains(word)), "{line}");
        }
        assert!(line(EverOccupied::default(), ShownAs::AtLeast(0.5)).starts_with("no cell was occupied"));
    }
}
