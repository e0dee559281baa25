//! The protocol of an experiment: which data, which models, tuned how, and compared with what.
//!
//! Invariant: a protocol that was read makes sense by itself: every model can be fitted, every list can be tuned, labels
//! are unique. Whether its files exist is for the reading of data to say. Paths are relative to the protocol's file.

use std::{
    fs,
    path::{Path, PathBuf},
};

use tidemap_map::time::parse_duration;
use tidemap_model::Zone;

mod error;
pub(super) mod model_entry;
pub(super) mod raw;

#[cfg(test)]
mod tests;

pub use error::ProtocolError;
pub use model_entry::ModelEntry;

use super::parameter_set::ValueKind;
use raw::{RawProtocol, RawTuning, Word, Words};

/// Longest protocol; a long one has a hundred lines.
pub(super) const FILE_BYTES_MAX: u64 = 1024 * 1024;
/// Most folds; each is a fit of every candidate.
const FOLDS_MAX: usize = 1000;

/// How rows are laid out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RowFormat {
    /// Columns time, state and value, with a header.
    #[default]
    Csv,
    /// `time value`, of one state, without a header.
    Pairs,
}

/// When models are fitted again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Refit {
    /// Once, on the training data.
    #[default]
    Never,
    /// Before each test set, on all that came before.
    Each,
}

/// Rolling origin: the last folds of the training data are predicted, each from what is before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tuning {
    /// How many.
    pub folds: usize,
    /// How long each is.
    pub fold_nanos: i64,
}

/// Which predictions are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Predictions {
    /// Those of every reading.
    #[default]
    All,
    /// Those of the first reading of each interval.
    Every {
        /// Its length.
        nanos: i64,
    },
    /// None.
    Off,
}

/// A test set.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TestFile {
    /// What it is called in results.
    pub label: String,
    /// Its file.
    pub path: PathBuf,
}

/// What a protocol says.
#[derive(Debug)]
pub struct Protocol {
    /// Of the experiment.
    pub name: String,
    /// By whose clocks people live.
    pub zone: Zone,
    /// What the values are.
    pub kind: ValueKind,
    /// How the files are laid out.
    pub format: RowFormat,
    /// The states to compare models on; all where empty.
    pub states: Vec<String>,
    /// Files of training data, at least one.
    pub train: Vec<PathBuf>,
    /// Test sets, at least one, in order of time.
    pub test: Vec<TestFile>,
    /// When models are fitted again.
    pub refit: Refit,
    /// The models, at least one.
    pub models: Vec<ModelEntry>,
    /// How parameters are chosen.
    pub tuning: Option<Tuning>,
    /// The model that all are compared with; an index of `models`.
    pub baseline: usize,
    /// Level of the tests; intervals hold one less this.
    pub significance: f64,
    /// Which predictions are written.
    pub predictions: Predictions,
    /// Folder of the results.
    pub out: PathBuf,
}

/// Reads a protocol.
///
/// # Errors
/// [`ProtocolError`], with line, key, what was found and what would be right.
pub fn read(path: &Path) -> Result<Protocol, ProtocolError> {
    let length = fs::metadata(path)?.len();
    if length > FILE_BYTES_MAX {
        return Err(ProtocolError::TooLong { found: length, most: FILE_BYTES_MAX });
    }
    let stem = path.file_stem().map_or_else(|| "experiment".into(), |stem| stem.to_string_lossy());
    let folder = path.parent().unwrap_or_else(|| Path::new(""));
    parse(&fs::read_to_string(path)?, &stem, folder)
}

/// Makes a protocol of a text; `name` is used where it says none.
pub fn parse(text: &str, name: &str, folder: &Path) -> Result<Protocol, ProtocolError> {
    let written: RawProtocol = serde_saphyr::from_str(text).map_err(|error| ProtocolError::yaml(&error))?;
    let right = "an IANA time zone by which people live there, such as Europe/London or UTC";
    let zone = needed(written.zone, "zone", right)?;
    let zone = Zone::named(&zone.text).map_err(|_| ProtocolError::value("zone", &zone, right))?;
    let kind = choice(
        written.kind,
        "kind",
        &[("probability", ValueKind::Probability), ("continuous", ValueKind::Continuous), ("count", ValueKind::Count)],
    )?;
    let format = choice(written.format, "format", &[("csv", RowFormat::Csv), ("pairs", RowFormat::Pairs)])?;
    let states = states(written.states, format)?;
    let train = paths(written.train, "train", folder)?.into_iter().map(|(_, path)| path).collect();
    let test = labelled(paths(written.test, "test", folder)?);
    let refit = choice(written.refit, "refit", &[("never", Refit::Never), ("each", Refit::Each)])?;
    let tuning = written.tuning.map(tuning).transpose()?;
    let models = match written.models {
        Some(models) if !models.is_empty() => model_entry::read(&models, kind, tuning.is_some())?,
        _ => return Err(ProtocolError::missing("models", "a list of models, such as [mean, spectral]")),
    };
    let baseline = match written.baseline {
        Some(word) => models.iter().position(|model| model.label == word.text).ok_or_else(|| {
            let labels: Vec<&str> = models.iter().map(|model| model.label.as_str()).collect();
            ProtocolError::value("baseline", &word, &format!("one of the models: {}", labels.join(", ")))
        })?,
        None => 0,
    };
    let significance = match written.significance {
        Some(word) => number_within(&word, 1e-3, 0.5)
            .ok_or_else(|| ProtocolError::value("significance", &word, "a number from 0.001 to 0.5, such as 0.05"))?,
        None => 0.05,
    };
    let predictions = match written.predictions.as_ref().map(|word| (word, word.text.as_str())) {
        None | Some((_, "all")) => Predictions::All,
        Some((_, "off")) => Predictions::Off,
        Some((word, text)) => Predictions::Every {
            nanos: parse_duration(text)
                .map_err(|_| ProtocolError::value("predictions", word, "all, off, or a duration such as 5m"))?,
        },
    };
    let out = needed(written.out, "out", "the folder that results are written to")?;
    if out.text.is_empty() {
        return Err(ProtocolError::value("out", &out, "the folder that results are written to"));
    }
    Ok(Protocol {
        name: written.name.map_or_else(|| name.to_owned(), |word| word.text),
        zone,
        kind,
        format,
        states,
        train,
        test,
        refit,
        models,
        tuning,
        baseline,
        significance,
        predictions,
        out: folder.join(out.text),
    })
}

fn needed(word: Option<Word>, key: &'static str, right: &'static str) -> Result<Word, ProtocolError> {
    word.ok_or_else(|| ProtocolError::missing(key, right))
}

/// One of several words; the default where nothing is written.
fn choice<T: Copy + Default>(
    word: Option<Word>,
    key: &'static str,
    choices: &[(&'static str, T)],
) -> Result<T, ProtocolError> {
    let Some(word) = word else { return Ok(T::default()) };
    let chosen = choices.iter().find(|(name, _)| *name == word.text);
    chosen.map(|(_, choice)| *choice).ok_or_else(|| {
        let names: Vec<&str> = choices.iter().map(|(name, _)| *name).collect();
        ProtocolError::value(key, &word, &format!("one of: {}", names.join(", ")))
    })
}

fn number_within(word: &Word, least: f64, most: f64) -> Option<f64> {
    word.text.parse().ok().filter(|number| (least..=most).contains(number))
}

fn states(written: Option<Words>, format: RowFormat) -> Result<Vec<String>, ProtocolError> {
    let words = written.map_or_else(Vec::new, |written| written.words);
    if let (RowFormat::Pairs, Some(second)) = (format, words.get(1)) {
        return Err(ProtocolError::value("states", second, "one name: files in format pairs have one state"));
    }
    let repeated = words.iter().enumerate().find(|(at, word)| words[..*at].iter().any(|one| one.text == word.text));
    if let Some((_, word)) = repeated {
        return Err(ProtocolError::value("states", word, "each state once"));
    }
    Ok(words.into_iter().map(|word| word.text).collect())
}

fn paths(written: Option<Words>, key: &'static str, folder: &Path) -> Result<Vec<(Word, PathBuf)>, ProtocolError> {
    const RIGHT: &str = "a list of files, relative to the protocol's folder";
    let words = written.map_or_else(Vec::new, |written| written.words);
    if words.is_empty() {
        return Err(ProtocolError::missing(key, RIGHT));
    }
    let mut paths: Vec<(Word, PathBuf)> = Vec::with_capacity(words.len());
    for word in words {
        let path = folder.join(&word.text);
        if word.text.is_empty() {
            return Err(ProtocolError::value(key, &word, RIGHT));
        }
        if paths.iter().any(|(_, other)| *other == path) {
            return Err(ProtocolError::value(key, &word, "each file once"));
        }
        paths.push((word, path));
    }
    Ok(paths)
}

/// Test sets are called as their files are, with a number where two are called alike.
fn labelled(paths: Vec<(Word, PathBuf)>) -> Vec<TestFile> {
    let mut tests: Vec<TestFile> = Vec::with_capacity(paths.len());
    for (word, path) in paths {
        let stem = path.file_stem().map_or_else(|| word.text.clone(), |stem| stem.to_string_lossy().into_owned());
        let numbered = (1..).map(|number: u32| if number == 1 { stem.clone() } else { format!("{stem}-{number}") });
        let mut free = numbered.filter(|label| tests.iter().all(|test| test.label != *label));
        let label = free.next().unwrap_or_default();
        tests.push(TestFile { label, path });
    }
    tests
}

pub(super) fn tuning(written: RawTuning) -> Result<Tuning, ProtocolError> {
    let RawTuning { folds: written_folds, fold: written_fold } = written;
    let folds = written_folds.text.parse().ok().filter(|folds| (1..=FOLDS_MAX).contains(folds));
    let folds = folds.ok_or_else(|| {
        ProtocolError::value("folds", &written_folds, &format!("a whole number from 1 to {FOLDS_MAX}"))
    })?;
    let fold_nanos = parse_duration(&written_fold.text)
        .map_err(|_| ProtocolError::value("fold", &written_fold, "a duration such as 1d or 7d"))?;
    Ok(Tuning { folds, fold_nanos })
}
