//! A recording of the activity of a person in every minute, and of the place; with the classifier that was measured
//! there.
//!
//! A folder has `activity_names.txt`, a name a line, counted from 0; `activity_15days.txt` and `location_15days.txt`, a
//! number a line for each minute from midnight of the first day; `confusion.txt`, a row for each true activity.
//!
//! Invariant: both have the same minutes, days are whole, every activity has a name, and each row of the matrix has a
//! likelihood above 0.

use std::{
    fs, io,
    path::{Path, PathBuf},
    str::FromStr,
};

use tidemap_model::label_evidence::LABELS;

use crate::place_recording::DAY_MINUTES;

/// Maximum length of a file.
const FILE_BYTES_MAX: u64 = 64 * 1024 * 1024;
/// The unknown activity, and two that can be taken for each other.
const NAMES_MIN: usize = 3;
/// Places are numbered below this.
const PLACES_MAX: usize = 1024;

/// Why a recording of activities is invalid.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message of each variant names its fields")]
pub enum ActivityRecordingError {
    /// A file cannot be read.
    #[error("{} cannot be read: {why}", path.display())]
    Io { path: PathBuf, why: io::Error },
    /// A line is invalid.
    #[error("{}: line {line}: {wrong}", path.display())]
    Line { path: PathBuf, line: usize, wrong: String },
    /// A file is too long, too short, or does not match the others.
    #[error("{}: {wrong}", path.display())]
    Whole { path: PathBuf, wrong: String },
}

/// Activities and places by minute.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ActivityRecording {
    /// Names of the activities. The first means that none is known; two or more are known.
    pub(crate) names: Vec<String>,
    /// The activity in each minute.
    pub(crate) activities: Vec<usize>,
    /// The place in each minute.
    pub(crate) places: Vec<usize>,
    /// For each true activity, the likelihood of each answer of the classifier.
    pub(crate) confusion: Vec<Vec<f64>>,
}

impl ActivityRecording {
    /// Reads a folder.
    pub(crate) fn read(folder: &Path) -> Result<Self, ActivityRecordingError> {
        let file = |name: &str| folder.join(name);
        let names_file = file("activity_names.txt");
        let names: Vec<String> = read(&names_file)?.lines().map(|line| line.trim().to_owned()).collect();
        if !(NAMES_MIN..=*LABELS.end()).contains(&names.len()) {
            let wrong = format!("it has {} names, and there have to be {NAMES_MIN} to {}", names.len(), LABELS.end());
            return Err(ActivityRecordingError::Whole { path: names_file, wrong });
        }
        let activities = numbers(&file("activity_15days.txt"), names.len())?;
        let places_file = file("location_15days.txt");
        let places = numbers(&places_file, PLACES_MAX)?;
        if places.len() != activities.len() {
            let wrong = format!("it has {} minutes, and the activities have {}", places.len(), activities.len());
            return Err(ActivityRecordingError::Whole { path: places_file, wrong });
        }
        let confusion = matrix(&file("confusion.txt"), names.len())?;
        Ok(Self { names, activities, places, confusion })
    }

    /// Number of days.
    pub(crate) fn days(&self) -> usize {
        self.activities.len() / DAY_MINUTES
    }
}

fn read(path: &Path) -> Result<String, ActivityRecordingError> {
    let io = |why| ActivityRecordingError::Io { path: path.to_owned(), why };
    let length = fs::metadata(path).map_err(io)?.len();
    if length > FILE_BYTES_MAX {
        let wrong = format!("it has {length} bytes, and at most {FILE_BYTES_MAX} are read");
        return Err(ActivityRecordingError::Whole { path: path.to_owned(), wrong });
    }
    fs::read_to_string(path).map_err(io)
}

fn line_error(path: &Path, line: usize, wrong: String) -> ActivityRecordingError {
    ActivityRecordingError::Line { path: path.to_owned(), line, wrong }
}

fn parse<T: FromStr>(path: &Path, line: usize, word: &str) -> Result<T, ActivityRecordingError> {
    let shown: String = word.chars().take(60).collect();
    word.parse().map_err(|_| line_error(path, line, format!("{shown:?} is not a number")))
}

/// A number below `limit` for each minute of whole days.
fn numbers(path: &Path, limit: usize) -> Result<Vec<usize>, ActivityRecordingError> {
    let text = read(path)?;
    let number = |(line, word): (usize, &str)| {
        let number: usize = parse(path, line, word.trim())?;
        let wrong = || line_error(path, line, format!("{number} is out of range: numbers are from 0 to {}", limit - 1));
        (number < limit).then_some(number).ok_or_else(wrong)
    };
    let numbers = (1..).zip(text.lines()).map(number).collect::<Result<Vec<usize>, ActivityRecordingError>>()?;
    if numbers.is_empty() || numbers.len() % DAY_MINUTES != 0 {
        let wrong = format!("it has {} minutes, and whole days have {DAY_MINUTES} each", numbers.len());
        return Err(ActivityRecordingError::Whole { path: path.to_owned(), wrong });
    }
    Ok(numbers)
}

fn matrix(path: &Path, labels: usize) -> Result<Vec<Vec<f64>>, ActivityRecordingError> {
    let text = read(path)?;
    let row = |(line, row): (usize, &str)| {
        let words = row.split_ascii_whitespace();
        let row = words.map(|word| parse(path, line, word)).collect::<Result<Vec<f64>, ActivityRecordingError>>()?;
        let are_likelihoods =
            row.iter().all(|value| (0.0..=1.0).contains(value)) && row.iter().any(|&value| value > 0.0);
        if row.len() == labels && are_likelihoods {
            return Ok(row);
        }
        Err(line_error(path, line, format!("write {labels} numbers from 0 to 1, of which one is above 0")))
    };
    let rows = (1..).zip(text.lines()).map(row).collect::<Result<Vec<Vec<f64>>, ActivityRecordingError>>()?;
    if rows.len() != labels {
        let wrong = format!("it has {} rows, and there are {labels} activities", rows.len());
        return Err(ActivityRecordingError::Whole { path: path.to_owned(), wrong });
    }
    Ok(rows)
}
