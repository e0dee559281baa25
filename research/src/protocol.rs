//! The protocol of a comparison of models: data, models, tuning and baseline.
//!
//! Invariant: a protocol that was read is consistent in itself: every model can be trained, every list can be tuned,
//! labels are unique. The files it names may be missing. Paths are relative to the protocol's file.

use std::path::{Component, Path, PathBuf};

use tidemap_model::{StateKind, Zone, time::parse_duration};

mod ahead;
mod error;
pub(super) mod keys;
pub(super) mod model_entry;
pub(super) mod raw;

#[cfg(test)]
mod tests;

pub use ahead::Ahead;
pub use error::ProtocolError;
pub(crate) use model_entry::ModelEntry;

use keys::{ProtocolFile, from_yaml, parsed, required, whole};
use model_entry::Allowed;
use raw::{RawProtocol, RawTuning, Word, Words};

/// The meaning of the key `out`.
pub(super) const OUT: &str = "the folder that results are written to";

/// The value of the key `lists` that makes a model of every value.
pub(super) const EACH: &str = "each";

/// Maximum number of folds; each trains every parameter set once.
const FOLDS_MAX: usize = 1000;

/// The layout of data files.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RowFormat {
    /// Columns time, state and value, with a header.
    #[default]
    Csv,
    /// `time value`, for one state, without a header.
    Pairs,
}

/// The times at which models are trained again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Retrain {
    /// Once, on the training data.
    #[default]
    Never,
    /// Before each test set, on all earlier data.
    Each,
}

/// The purpose of lists of parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Lists {
    /// Tuning chooses one value.
    #[default]
    Tuned,
    /// Every value is a model of its own.
    Each,
}

/// Rolling origin: the last folds of the training data are predicted, each from the data before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tuning {
    /// Number of folds.
    pub folds: usize,
    /// Length of each.
    pub fold_nanos: i64,
}

/// The predictions that are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Predictions {
    /// One for every reading.
    #[default]
    All,
    /// One for the first reading of each interval of `nanos`.
    #[allow(missing_docs, reason = "see the variant")]
    Every { nanos: i64 },
    /// None.
    Off,
}

/// A test set.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TestFile {
    /// The name of the test set in results.
    pub label: String,
    pub path: PathBuf,
    /// Whether the test set is a file of the training data, so that its errors are errors of models that have learned
    /// it.
    pub is_learned: bool,
}

/// The protocol of a comparison of models.
#[derive(Debug)]
pub struct Protocol {
    /// Name of the experiment.
    pub name: String,
    /// The time zone of the recordings.
    pub zone: Zone,
    /// The kind of the values.
    pub kind: StateKind,
    /// The layout of the files.
    pub format: RowFormat,
    /// The states on which models are compared; empty: all.
    pub states: Vec<String>,
    /// Files of training data, at least one.
    pub train: Vec<PathBuf>,
    /// Test sets, at least one, in temporal order.
    pub test: Vec<TestFile>,
    /// The times at which models are trained again.
    pub retrain: Retrain,
    /// The lead times of predictions. Empty: the trained models alone predict, without a newest reading.
    pub ahead: Vec<Ahead>,
    /// The models, at least one.
    pub models: Vec<ModelEntry>,
    /// Tuning of parameters.
    pub tuning: Option<Tuning>,
    /// Index in `models` of the model with which all others are compared.
    pub baseline: usize,
    /// Significance level of the tests; intervals have the confidence 1 - `significance`.
    pub significance: f64,
    /// The predictions that are written.
    pub predictions: Predictions,
    /// Folder of the results.
    pub out: PathBuf,
}

/// Reads a protocol.
///
/// # Errors
/// [`ProtocolError`], with line, key, the value found and the values allowed.
pub fn read(path: &Path) -> Result<Protocol, ProtocolError> {
    let file = ProtocolFile::read(path)?;
    parse(&file.text, &file.name, &file.folder)
}

/// Parses a protocol; `name` is its name if the text has none.
pub(crate) fn parse(text: &str, name: &str, folder: &Path) -> Result<Protocol, ProtocolError> {
    let written: RawProtocol = from_yaml(text)?;
    let right = "the IANA time zone of the recordings, such as Europe/London or UTC";
    let zone = parsed(&required(written.zone, "zone", right)?, "zone", right, |text| Zone::named(text).ok())?;
    let kind = choice(written.kind, "kind", &StateKind::ALL.map(|kind| (kind.name(), kind)))?;
    let format = choice(written.format, "format", &[("csv", RowFormat::Csv), ("pairs", RowFormat::Pairs)])?;
    let states = states(written.states, format)?;
    let train: Vec<PathBuf> = paths(written.train, "train", folder)?.into_iter().map(|(_, path)| path).collect();
    let test = labelled(paths(written.test, "test", folder)?, &train);
    let retrain = choice(written.retrain, "retrain", &[("never", Retrain::Never), ("each", Retrain::Each)])?;
    let tuning = written.tuning.as_ref().map(tuning).transpose()?;
    let ahead = ahead::read(written.ahead)?;
    let lists = lists(written.lists, tuning.is_some())?;
    let allowed = Allowed { values: kind, tunes: tuning.is_some(), lists, has_newest: !ahead.is_empty() };
    let models = model_entry::read(written.models, allowed)?;
    let baseline = match written.baseline {
        Some(word) => models.iter().position(|model| model.label == word.text).ok_or_else(|| {
            let labels: Vec<&str> = models.iter().map(|model| model.label.as_str()).collect();
            ProtocolError::value("baseline", &word, &format!("one of the models: {}", labels.join(", ")))
        })?,
        None => 0,
    };
    let significance = match written.significance {
        Some(word) => parsed(&word, "significance", "a number from 0.001 to 0.5, such as 0.05", |text| {
            text.parse().ok().filter(|number| (1e-3..=0.5).contains(number))
        })?,
        None => 0.05,
    };
    let predictions = match written.predictions.as_ref().map(|word| (word, word.text.as_str())) {
        None | Some((_, "all")) => Predictions::All,
        Some((_, "off")) => Predictions::Off,
        Some((word, _)) => {
            let right = "all, off, or a duration such as 5m";
            Predictions::Every { nanos: parsed(word, "predictions", right, |text| parse_duration(text).ok())? }
        }
    };
    let out = required(written.out, "out", OUT)?;
    Ok(Protocol {
        name: written.name.map_or_else(|| name.to_owned(), |word| word.text),
        zone,
        kind,
        format,
        states,
        train,
        test,
        retrain,
        ahead,
        models,
        tuning,
        baseline,
        significance,
        predictions,
        out: folder.join(out.text),
    })
}

/// The purpose of lists of parameters. With tuning, lists are for tuning.
fn lists(word: Option<Word>, tunes: bool) -> Result<Lists, ProtocolError> {
    match word {
        Some(word) if tunes && word.text == EACH => {
            let right = "left out beside tuning, which chooses one value of each list";
            Err(ProtocolError::value("lists", &word, right))
        }
        word => choice(word, "lists", &[("tuned", Lists::Tuned), (EACH, Lists::Each)]),
    }
}

/// One of several words; the default if the key is missing.
fn choice<T: Copy + Default>(
    word: Option<Word>,
    key: &'static str,
    choices: &[(&'static str, T)],
) -> Result<T, ProtocolError> {
    let Some(word) = word else { return Ok(T::default()) };
    let names: Vec<&str> = choices.iter().map(|(name, _)| *name).collect();
    parsed(&word, key, &format!("one of: {}", names.join(", ")), |text| {
        choices.iter().find(|(name, _)| *name == text).map(|(_, choice)| *choice)
    })
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

/// Test sets have the names of their files, numbered where two names are equal.
fn labelled(paths: Vec<(Word, PathBuf)>, train: &[PathBuf]) -> Vec<TestFile> {
    // ./train.csv and train.csv are one file.
    let same = |one: &Path, other: &Path| {
        let named = |part: &Component<'_>| *part != Component::CurDir;
        one.components().filter(named).eq(other.components().filter(named))
    };
    let mut tests: Vec<TestFile> = Vec::with_capacity(paths.len());
    for (word, path) in paths {
        let stem = path.file_stem().map_or_else(|| word.text.clone(), |stem| stem.to_string_lossy().into_owned());
        let numbered = (1..).map(|number: u32| if number == 1 { stem.clone() } else { format!("{stem}-{number}") });
        let mut free = numbered.filter(|label| tests.iter().all(|test| test.label != *label));
        let label = free.next().unwrap_or_default();
        let is_learned = train.iter().any(|other| same(other, &path));
        tests.push(TestFile { label, path, is_learned });
    }
    tests
}

pub(super) fn tuning(written: &RawTuning) -> Result<Tuning, ProtocolError> {
    let folds = whole(&written.folds, "folds", 1..=FOLDS_MAX)?;
    let fold_nanos = parsed(&written.fold, "fold", "a duration such as 1d or 7d", |text| parse_duration(text).ok())?;
    Ok(Tuning { folds, fold_nanos })
}
