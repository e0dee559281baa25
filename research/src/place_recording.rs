//! A recording of the place where a person was in every minute.
//!
//! A row is `FROM UNTIL PLACE`, in minutes from the first local midnight; UNTIL is exclusive.
//! Invariant: every minute of every day has exactly one place, and days are whole; a partial last day is dropped.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

/// Minutes of a day.
pub(crate) const DAY_MINUTES: usize = 1440;
/// Maximum length of a recording: ten years.
const MINUTES_MAX: usize = 10 * 366 * DAY_MINUTES;
/// Maximum number of places.
const PLACES_MAX: usize = 64;
/// Maximum length of a file.
const FILE_BYTES_MAX: u64 = 256 * 1024 * 1024;

/// Why a recording is invalid.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message of each variant names its fields")]
pub enum RecordingError {
    /// The file cannot be read.
    #[error("the world {} cannot be read: {why}; paths are relative to the protocol's folder", path.display())]
    Io { path: PathBuf, why: io::Error },
    /// A row is invalid.
    #[error("{}: line {line}: {wrong}", path.display())]
    Row { path: PathBuf, line: usize, wrong: String },
    /// The recording is too short or too long, or has a single place.
    #[error("{}: {wrong}", path.display())]
    Whole { path: PathBuf, wrong: String },
}

/// The place of the person in every minute.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct PlaceRecording {
    /// Names of the places.
    pub places: Vec<String>,
    /// Length of a slot, which divides the day.
    pub slot_minutes: usize,
    /// Index of the place, by minute.
    minutes: Vec<u8>,
}

impl PlaceRecording {
    /// Reads a recording.
    pub(crate) fn read(path: &Path, slot_minutes: usize) -> Result<PlaceRecording, RecordingError> {
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

    /// Parses a recording. An error in a line comes with its number, from 1.
    pub(crate) fn parse(text: &str, slot_minutes: usize) -> Result<PlaceRecording, (Option<usize>, String)> {
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

    /// Number of whole days.
    pub(crate) fn days(&self) -> usize {
        self.minutes.len() / DAY_MINUTES
    }

    /// Number of slots in a day.
    pub(crate) fn slots(&self) -> usize {
        DAY_MINUTES / self.slot_minutes
    }

    /// The place in every minute of a slot; slots are counted from the start of the recording.
    pub(crate) fn slot(&self, slot: usize) -> &[u8] {
        self.minutes.get(slot * self.slot_minutes..(slot + 1) * self.slot_minutes).unwrap_or_default()
    }

    /// The place at the middle of a slot: in the minute that starts there.
    pub(crate) fn seen(&self, slot: usize) -> usize {
        usize::from(self.slot(slot).get(self.slot_minutes / 2).copied().unwrap_or_default())
    }
}
