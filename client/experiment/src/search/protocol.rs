//! Whom to look for, where, and by which models, as a file says.
//!
//! Invariant: a protocol that was read can be run on every world that is long enough. Paths are relative to its file.

use std::{
    fs,
    path::{Path, PathBuf},
};

use serde::Deserialize;

use super::recorded_world::midnight_nanos;
use crate::{
    parameter_set::ValueKind,
    place_recording::DAY_MINUTES,
    protocol::{
        FILE_BYTES_MAX, ModelEntry, ProtocolError, model_entry,
        raw::{RawModel, RawTuning, Word},
        tuning,
    },
};

const MINUTE_NANOS: i64 = 60 * 1_000_000_000;
/// Most days to learn: ten years.
const TRAIN_DAYS_MAX: usize = 3_660;

/// What a protocol says.
#[derive(Debug)]
pub struct SearchProtocol {
    /// The places and ways.
    pub topology: PathBuf,
    /// Where the person was.
    pub world: PathBuf,
    /// The first local midnight, nanoseconds since 1970-01-01T00:00 local.
    pub first_nanos: i64,
    /// Name of the node where the robot starts.
    pub start: String,
    /// Minutes that are learned, from the first on; whole days.
    pub train_minutes: usize,
    /// Pieces of what is learned that parameters are chosen on; 0: none are chosen.
    pub folds: usize,
    /// Minutes of each.
    pub fold_minutes: usize,
    /// The models, at least one.
    pub models: Vec<ModelEntry>,
    /// Folder of the results.
    pub out: PathBuf,
}

/// The file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawSearchProtocol {
    topology: Option<Word>,
    world: Option<Word>,
    first_day: Option<Word>,
    start: Option<Word>,
    train_days: Option<Word>,
    tuning: Option<RawTuning>,
    models: Option<Vec<RawModel>>,
    out: Option<Word>,
}

/// Reads a protocol.
///
/// # Errors
/// [`ProtocolError`], with line, key, what was found and what would be right.
pub fn read(path: &Path) -> Result<SearchProtocol, ProtocolError> {
    let length = fs::metadata(path)?.len();
    if length > FILE_BYTES_MAX {
        return Err(ProtocolError::TooLong { found: length, most: FILE_BYTES_MAX });
    }
    let folder = path.parent().unwrap_or_else(|| Path::new(""));
    parse(&fs::read_to_string(path)?, folder)
}

/// Makes a protocol of a text.
pub fn parse(text: &str, folder: &Path) -> Result<SearchProtocol, ProtocolError> {
    let written: RawSearchProtocol = serde_saphyr::from_str(text).map_err(|error| ProtocolError::yaml(&error))?;
    let topology = filled(written.topology, "topology", "the file of nodes and links, as `topology load` reads it")?;
    let world = filled(written.world, "world", "the file of the world, with rows of FROM UNTIL PLACE in minutes")?;
    let first_day = filled(written.first_day, "first_day", "the date that the world begins with, as 2010-11-04")?;
    let first_nanos = midnight_nanos(&first_day.text)
        .filter(|nanos| nanos.abs() < i64::MAX / 2)
        .ok_or_else(|| ProtocolError::value("first_day", &first_day, "a date such as 2010-11-04"))?;
    let start = filled(written.start, "start", "the name of the node where the robot starts")?;
    let days = filled(written.train_days, "train_days", "how many days are learned before the first search, as 28")?;
    let train_days = days.text.parse().ok().filter(|days| (1..=TRAIN_DAYS_MAX).contains(days));
    let train_days: usize = train_days.ok_or_else(|| {
        ProtocolError::value("train_days", &days, &format!("a whole number of days from 1 to {TRAIN_DAYS_MAX}"))
    })?;
    let train_minutes = train_days * DAY_MINUTES;
    let (folds, fold_minutes) = match written.tuning {
        None => (0, 0),
        Some(written) => chosen_on(written, train_minutes)?,
    };
    let models = match written.models {
        Some(models) if !models.is_empty() => model_entry::read(&models, ValueKind::Probability, folds > 0)?,
        _ => return Err(ProtocolError::missing("models", "a list of models, such as [mean, spectral]")),
    };
    let out = filled(written.out, "out", "the folder that results are written to")?;
    Ok(SearchProtocol {
        topology: folder.join(topology.text),
        world: folder.join(world.text),
        first_nanos,
        start: start.text,
        train_minutes,
        folds,
        fold_minutes,
        models,
        out: folder.join(out.text),
    })
}

fn filled(word: Option<Word>, key: &'static str, right: &str) -> Result<Word, ProtocolError> {
    match word {
        Some(word) if word.text.is_empty() => Err(ProtocolError::value(key, &word, right)),
        Some(word) => Ok(word),
        None => Err(ProtocolError::missing(key, right)),
    }
}

/// How many folds of how many minutes, of which some minutes are left to learn before the first.
fn chosen_on(written: RawTuning, train_minutes: usize) -> Result<(usize, usize), ProtocolError> {
    let fold = written.fold.clone();
    let tuning = tuning(written)?;
    let wrong = |right: &str| ProtocolError::value("fold", &fold, right);
    if tuning.fold_nanos % MINUTE_NANOS != 0 {
        return Err(wrong("whole minutes, such as 7d"));
    }
    let fold_minutes = usize::try_from(tuning.fold_nanos / MINUTE_NANOS).unwrap_or(usize::MAX);
    if fold_minutes.checked_mul(tuning.folds).is_none_or(|all| all >= train_minutes) {
        return Err(wrong("so short that all folds are less than train_days: before the first something is learned"));
    }
    Ok((tuning.folds, fold_minutes))
}
