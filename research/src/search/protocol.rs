//! The protocol of searches: map, recording, models and tuning.
//!
//! Invariant: a protocol that was read can be run on every recording that is long enough. Paths are relative to its
//! file.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use tidemap_model::StateKind;

use crate::{
    place_recording::DAY_MINUTES,
    protocol::{
        Lists, ModelEntry, OUT, ProtocolError,
        keys::{ProtocolFile, from_yaml, parsed, required, whole},
        model_entry::{self, Allowed},
        raw::{RawModel, RawTuning, Word},
        tuning,
    },
};

const MINUTE_NANOS: i64 = 60 * 1_000_000_000;
/// Maximum number of training days: ten years.
const TRAIN_DAYS_MAX: usize = 3_660;

/// The criterion that the tuning of parameters minimises.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TuningCriterion {
    /// The mean time until the person is found.
    #[default]
    Seconds,
    /// The mean of -ln p of the node where the person is, with p as its share of the predictions of all nodes. Orders
    /// of nodes change in steps, this does not, so it has less noise on few weeks.
    LogLoss,
}

/// The protocol of searches.
#[derive(Debug)]
pub struct SearchProtocol {
    /// The file of the topological map.
    pub topology: PathBuf,
    /// The file of the recording.
    pub world: PathBuf,
    /// The first local midnight, nanoseconds since 1970-01-01T00:00 local.
    pub first_nanos: i64,
    /// Name of the node where the robot starts.
    pub start: String,
    /// Minutes of training data from the start of the recording; whole days.
    pub train_minutes: usize,
    /// Folds of the training data on which parameters are tuned; 0: no tuning.
    pub folds: usize,
    /// Length of a fold.
    pub fold_minutes: usize,
    /// The criterion that tuning minimises.
    pub criterion: TuningCriterion,
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
    tuning: Option<RawSearchTuning>,
    models: Option<Vec<RawModel>>,
    out: Option<Word>,
}

/// The section `tuning`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawSearchTuning {
    folds: Word,
    fold: Word,
    by: Option<Word>,
}

/// Reads a protocol.
///
/// # Errors
/// [`ProtocolError`], with line, key, the value found and the values allowed.
pub fn read(path: &Path) -> Result<SearchProtocol, ProtocolError> {
    let file = ProtocolFile::read(path)?;
    parse(&file.text, &file.folder)
}

/// Parses a protocol.
pub(super) fn parse(text: &str, folder: &Path) -> Result<SearchProtocol, ProtocolError> {
    let written: RawSearchProtocol = from_yaml(text)?;
    let topology = required(written.topology, "topology", "the file of nodes and links, as `topology load` reads it")?;
    let world = required(written.world, "world", "the file of the world, with rows of FROM UNTIL PLACE in minutes")?;
    let first_day = required(written.first_day, "first_day", "the first date of the recording, such as 2010-11-04")?;
    let first_nanos = parsed(&first_day, "first_day", "a date such as 2010-11-04", |text| {
        midnight_nanos(text).filter(|nanos| nanos.abs() < i64::MAX / 2)
    })?;
    let start = required(written.start, "start", "the name of the node where the robot starts")?;
    let days =
        required(written.train_days, "train_days", "the number of training days before the first search, such as 28")?;
    let train_minutes = whole(&days, "train_days", 1..=TRAIN_DAYS_MAX)? * DAY_MINUTES;
    let (folds, fold_minutes, criterion) = match written.tuning {
        None => (0, 0, TuningCriterion::default()),
        Some(RawSearchTuning { folds, fold, by }) => {
            let criterion = criterion_of(by)?;
            let (folds, fold_minutes) = folds_of(&RawTuning { folds, fold }, train_minutes)?;
            (folds, fold_minutes, criterion)
        }
    };
    // Searches begin far from any reading.
    let allowed = Allowed { values: StateKind::Probability, tunes: folds > 0, lists: Lists::Tuned, has_newest: false };
    let models = model_entry::read(written.models, allowed)?;
    let out = required(written.out, "out", OUT)?;
    Ok(SearchProtocol {
        topology: folder.join(topology.text),
        world: folder.join(world.text),
        first_nanos,
        start: start.text,
        train_minutes,
        folds,
        fold_minutes,
        criterion,
        models,
        out: folder.join(out.text),
    })
}

fn criterion_of(by: Option<Word>) -> Result<TuningCriterion, ProtocolError> {
    let Some(by) = by else { return Ok(TuningCriterion::default()) };
    parsed(&by, "by", "seconds (the time until somebody is found) or log-loss", |text| match text {
        "seconds" => Some(TuningCriterion::Seconds),
        "log-loss" => Some(TuningCriterion::LogLoss),
        _ => None,
    })
}

/// Number of folds and minutes of each; some training data must be left before the first.
fn folds_of(written: &RawTuning, train_minutes: usize) -> Result<(usize, usize), ProtocolError> {
    let tuning = tuning(written)?;
    let wrong = |right: &str| ProtocolError::value("fold", &written.fold, right);
    if tuning.fold_nanos % MINUTE_NANOS != 0 {
        return Err(wrong("whole minutes, such as 7d"));
    }
    let fold_minutes = usize::try_from(tuning.fold_nanos / MINUTE_NANOS).unwrap_or(usize::MAX);
    if fold_minutes.checked_mul(tuning.folds).is_none_or(|all| all >= train_minutes) {
        return Err(wrong("so short that all folds are less than train_days, to leave training data before the first"));
    }
    Ok((tuning.folds, fold_minutes))
}

/// The local midnight at which a date starts, in nanoseconds since 1970-01-01T00:00 local; none if `date` is no date.
fn midnight_nanos(date: &str) -> Option<i64> {
    let date: jiff::civil::Date = date.parse().ok()?;
    let timestamp = date.to_zoned(jiff::tz::TimeZone::UTC).ok()?.timestamp();
    i64::try_from(timestamp.as_nanosecond()).ok()
}
