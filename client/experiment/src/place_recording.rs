//! A recorded world: where somebody was in every minute.
//!
//! A row is `FROM UNTIL PLACE`: minutes, UNTIL not included, from the first local midnight on. Invariant: every minute
//! of every day has exactly one place, and days are whole; what follows the last whole day is left out.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

/// Minutes of a day.
pub const DAY_MINUTES: usize = 1440;
/// Longest recording: a hundred years would be 5e7 minutes; ten are enough.
const MINUTES_MAX: usize = 10 * 366 * DAY_MINUTES;
/// Most places.
const PLACES_MAX: usize = 64;
/// Longest file.
const FILE_BYTES_MAX: u64 = 256 * 1024 * 1024;

/// Why a recording cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// It cannot be read.
    #[error("the world {} cannot be read: {why}; paths are relative to the protocol's folder", path.display())]
    Io {
        /// Which.
        path: PathBuf,
        /// Why.
        why: io::Error,
    },
    /// A row that is none.
    #[error("{}: line {line}: {wrong}", path.display())]
    Row {
        /// Which file.
        path: PathBuf,
        /// From 1.
        line: usize,
        /// What is wrong, and what would be right.
        wrong: String,
    },
    /// It is too short, or has one place.
    #[error("{}: {wrong}", path.display())]
    Whole {
        /// Which file.
        path: PathBuf,
        /// What is wrong, and what would be right.
        wrong: String,
    },
}

/// Where somebody was in every minute.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlaceRecording {
    /// Names of the places.
    pub places: Vec<String>,
    /// Minutes of a slot; they divide the day.
    pub slot_minutes: usize,
    /// Index of the place, by minute.
    minutes: Vec<u8>,
}

impl PlaceRecording {
    /// Reads a recording.
    pub fn read(path: &Path, slot_minutes: usize) -> Result<PlaceRecording, RecordingError> {
        let io = |why| RecordingError::Io { path: path.to_owned(), why };
        let length = fs::metadata(path).map_err(io)?.len();
        if length > FILE_BYTES_MAX {
            let wrong = format!("it has {length} bytes, and a world at most {FILE_BYTES_MAX}");
            return Err(RecordingError::Whole { path: path.to_owned(), wrong });
        }
        let text = fs::read_to_string(path).map_err(io)?;
        PlaceRecording::parse(&text, slot_minutes).map_err(|(line, wrong)| match line {
            Some(line) => RecordingError::Row { path: path.to_owned(), line, wrong },
            None => RecordingError::Whole { path: path.to_owned(), wrong },
        })
    }

    /// Makes a world of a text; what is wrong comes with its line, from 1, where one is to blame.
    pub fn parse(text: &str, slot_minutes: usize) -> Result<PlaceRecording, (Option<usize>, String)> {
        let mut world = PlaceRecording { places: Vec::new(), slot_minutes, minutes: Vec::new() };
        for (line, row) in (1..).zip(text.lines()) {
            if !row.trim().is_empty() {
                world.add(row).map_err(|wrong| (Some(line), wrong))?;
            }
        }
        if world.places.len() < 2 {
            return Err((None, format!("a world has at least two places, and this has {}", world.places.len())));
        }
        if world.days() == 0 {
            let wrong = format!("it has {} minutes, and a day has {DAY_MINUTES}", world.minutes.len());
            return Err((None, wrong));
        }
        world.minutes.truncate(world.days() * DAY_MINUTES);
        Ok(world)
    }

    fn add(&mut self, row: &str) -> Result<(), String> {
        let shown: String = row.chars().take(60).collect();
        let mut words = row.split_ascii_whitespace();
        let (Some(from), Some(until), Some(place), None) = (words.next(), words.next(), words.next(), words.next())
        else {
            return Err(format!("{shown:?} is no row: write FROM UNTIL PLACE, such as 341 344 Kitchen"));
        };
        let minute = |word: &str| {
            word.parse::<usize>().map_err(|_| format!("{word:?} is no minute: write a whole number from 0"))
        };
        let (from, until) = (minute(from)?, minute(until)?);
        if from != self.minutes.len() {
            return Err(format!("it begins at minute {from}, and the row before ends at {}", self.minutes.len()));
        }
        if until <= from || until > MINUTES_MAX {
            return Err(format!("it ends at minute {until}: it has to be after {from}, and at most {MINUTES_MAX}"));
        }
        let known = self.places.iter().position(|known| known == place);
        let index = match known {
            Some(index) => index,
            None if self.places.len() == PLACES_MAX => return Err(format!("there are more than {PLACES_MAX} places")),
            None => {
                self.places.push(place.to_owned());
                self.places.len() - 1
            }
        };
        // At most 64 places.
        self.minutes.resize(until, index as u8);
        Ok(())
    }

    /// Whole days.
    pub fn days(&self) -> usize {
        self.minutes.len() / DAY_MINUTES
    }

    /// Slots of a day.
    pub fn slots(&self) -> usize {
        DAY_MINUTES / self.slot_minutes
    }

    /// The place in every minute of a slot, which is counted from the beginning of the world.
    pub fn slot(&self, slot: usize) -> &[u8] {
        self.minutes.get(slot * self.slot_minutes..(slot + 1) * self.slot_minutes).unwrap_or_default()
    }

    /// The place at the middle of a slot: in the minute that begins there.
    pub fn seen(&self, slot: usize) -> usize {
        usize::from(self.slot(slot).get(self.slot_minutes / 2).copied().unwrap_or_default())
    }
}
