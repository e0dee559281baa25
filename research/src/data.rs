//! The recordings of an experiment, by state and time.
//!
//! The first reading of the files keeps all readings, or counts them if there are too many; then the states are read
//! again in portions.
//!
//! Invariant: every row of every file is valid, or the experiment fails. No test set starts before the end of the
//! training data unless it is a file of the training data, nor, if models learn test sets, before the end of the
//! previous test set. A portion has at most the given number of readings, or one state.

use std::{
    borrow::Cow,
    collections::{HashMap, HashSet},
    fs::File,
    io::{self, BufRead as _, BufReader},
    ops::Range,
    path::{Path, PathBuf},
};

use tidemap_formats::observation_file::{RowError, RowItem, RowReader};
use tidemap_model::{
    OffsetCache, Sample, StateKind, Zone,
    time::{format_rfc3339, parse_time},
};

use super::protocol::{Protocol, Retrain, RowFormat, TestFile};

/// Name of the state of files without state names.
const UNNAMED: &str = "value";

/// Why data is invalid.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message of each variant names its fields")]
pub enum DataError {
    /// A file cannot be read.
    #[error("{key} file {} cannot be read: {why}; paths are relative to the protocol's folder", path.display())]
    // The cause is part of the message, so it is not a `source`.
    Io { key: &'static str, path: PathBuf, why: io::Error },
    /// A file has an invalid header or cannot be read to its end.
    #[error("{}: {why}", path.display())]
    Rows { path: PathBuf, why: RowError },
    /// A row is invalid.
    #[error("{}: line {line}: {wrong}", path.display())]
    Row { path: PathBuf, line: u64, wrong: String },
    /// A file has no rows of the protocol's states.
    #[error("{path} has no rows{of_states}", of_states = if states.is_empty() { String::new() } else { format!(" of {}", states.join(", ")) })]
    Empty { path: PathBuf, states: Vec<String> },
    /// A state has no training data.
    #[error("state {state:?} of {path} is not in the training data, which has {}", known.join(", "))]
    Untrained { state: String, path: PathBuf, known: Vec<String> },
    /// A test set starts too early.
    #[error("{path} begins at {}, before {before} ends at {}: {right}", format_rfc3339(*begins), format_rfc3339(*ends))]
    Order { path: PathBuf, begins: i64, before: String, ends: i64, right: &'static str },
}

/// A test set.
#[derive(Clone, Debug)]
pub struct TestSet {
    /// The name of the data in results.
    pub label: String,
    /// Whether the data is training data.
    pub is_learned: bool,
    /// Readings of each state, ascending by time.
    pub samples: Vec<Vec<Sample>>,
}

/// All readings of an experiment.
#[derive(Clone, Debug)]
pub struct Data {
    /// Names of the states, in the order of the protocol, or else of their first training readings.
    pub states: Vec<String>,
    /// Training readings of each state, ascending by time.
    pub train: Vec<Vec<Sample>>,
    /// The test sets.
    pub tests: Vec<TestSet>,
}

/// First and last time.
type TimeExtent = Option<(i64, i64)>;

fn extend(extent: &mut TimeExtent, time: i64) {
    let (first, last) = extent.unwrap_or((time, time));
    *extent = Some((first.min(time), last.max(time)));
}

impl Data {
    fn empty(states: Vec<String>, protocol: &Protocol) -> Self {
        let samples = vec![Vec::new(); states.len()];
        let test = |file: &TestFile| TestSet {
            label: file.label.clone(),
            is_learned: file.is_learned,
            samples: samples.clone(),
        };
        let tests = protocol.test.iter().map(test).collect();
        Self { train: samples, tests, states }
    }

    fn sort(&mut self) {
        sort(&mut self.train);
        self.tests.iter_mut().for_each(|test| sort(&mut test.samples));
    }
}

/// All states of an experiment, in portions.
#[derive(Debug)]
pub(crate) struct DataPortions<'a> {
    protocol: &'a Protocol,
    /// Names of all states; with all readings if there is a single portion, else with none.
    pub(crate) all: Data,
    /// First and last time of the training data.
    pub(crate) train_extent: (i64, i64),
    ranges: Vec<Range<usize>>,
}

impl<'a> DataPortions<'a> {
    /// Reads the files of a protocol; a portion has at most `readings_max` readings.
    pub(crate) fn read(protocol: &'a Protocol, readings_max: usize) -> Result<Self, DataError> {
        let mut states = protocol.states.clone();
        if states.is_empty() && protocol.format == RowFormat::Pairs {
            states.push(UNNAMED.to_owned());
        }
        let mut indices: HashMap<String, usize> =
            (0..).zip(&states).map(|(index, name)| (name.clone(), index)).collect();
        let mut all = Data::empty(states, protocol);
        let mut counts = vec![0_usize; all.states.len()];
        let (mut trained, mut total) = (0, 0);
        let mut extents: Vec<TimeExtent> = vec![None; 1 + protocol.test.len()];
        let is_fixed = !protocol.states.is_empty() || protocol.format == RowFormat::Pairs;
        for_each_row(protocol, |source, path, state, sample| {
            let index = match (indices.get(state), source) {
                (Some(&index), _) => index,
                (None, None) if !is_fixed => {
                    let index = all.states.len();
                    indices.insert(state.to_owned(), index);
                    all.states.push(state.to_owned());
                    all.train.push(Vec::new());
                    all.tests.iter_mut().for_each(|test| test.samples.push(Vec::new()));
                    counts.push(0);
                    index
                }
                (None, _) => return Err(untrained(state, path, &all.states)),
            };
            if source.is_none() {
                trained += usize::from(counts[index] == 0);
            } else if trained < all.states.len() {
                let lacking = (0..all.states.len()).find(|&index| counts[index] == 0).unwrap_or_default();
                let known: Vec<String> = all
                    .states
                    .iter()
                    .zip(&counts)
                    .filter(|(_, count)| **count > 0)
                    .map(|(state, _)| state.clone())
                    .collect();
                let path = protocol.train.first().cloned().unwrap_or_default();
                return Err(untrained(&all.states[lacking], &path, &known));
            }
            counts[index] += 1;
            extend(&mut extents[source.map_or(0, |test| test + 1)], sample.utc_nanos);
            total += 1;
            if total == readings_max + 1 {
                all = Data::empty(std::mem::take(&mut all.states), protocol);
            } else if total <= readings_max {
                all.samples(source)[index].push(sample);
            }
            Ok(())
        })?;
        all.sort();
        check_order(protocol, &extents)?;
        Ok(Self { protocol, all, train_extent: extents[0].unwrap_or_default(), ranges: ranges(&counts, readings_max) })
    }

    /// Number of portions.
    pub(crate) fn len(&self) -> usize {
        self.ranges.len()
    }

    /// The data of each portion, in the order of the states.
    pub(crate) fn portions(&self) -> impl Iterator<Item = Result<Cow<'_, Data>, DataError>> {
        self.ranges.iter().map(|range| match self.ranges.len() {
            1 => Ok(Cow::Borrowed(&self.all)),
            _ => self.portion(range.clone()).map(Cow::Owned),
        })
    }

    fn portion(&self, range: Range<usize>) -> Result<Data, DataError> {
        let names = &self.all.states[range];
        let indices: HashMap<&str, usize> = names.iter().map(String::as_str).zip(0..).collect();
        let mut data = Data::empty(names.to_vec(), self.protocol);
        for_each_row(self.protocol, |source, _, state, sample| {
            if let Some(&index) = indices.get(state) {
                data.samples(source)[index].push(sample);
            }
            Ok(())
        })?;
        data.sort();
        Ok(data)
    }
}

impl Data {
    /// The training data, or a test set.
    fn samples(&mut self, source: Option<usize>) -> &mut Vec<Vec<Sample>> {
        match source {
            None => &mut self.train,
            Some(test) => &mut self.tests[test].samples,
        }
    }
}

fn untrained(state: &str, path: &Path, known: &[String]) -> DataError {
    DataError::Untrained { state: state.to_owned(), path: path.to_owned(), known: known.to_vec() }
}

/// Consecutive states with at most `max` readings together, or one state.
fn ranges(counts: &[usize], max: usize) -> Vec<Range<usize>> {
    let mut ranges: Vec<Range<usize>> = Vec::new();
    let mut readings = 0_usize;
    for (index, &count) in counts.iter().enumerate() {
        readings += count;
        match ranges.last_mut() {
            Some(last) if readings <= max => last.end = index + 1,
            _ => {
                ranges.push(index..index + 1);
                readings = count;
            }
        }
    }
    ranges
}

/// Checks that models are scored on unseen data only, except on the files of the training data. Adjacent recordings may
/// share the time of their boundary.
fn check_order(protocol: &Protocol, extents: &[TimeExtent]) -> Result<(), DataError> {
    let [train, tests @ ..] = extents else { return Ok(()) };
    let mut before = ("the training data".to_owned(), *train);
    for (&test, file) in tests.iter().zip(&protocol.test).filter(|(_, file)| !file.is_learned) {
        let (Some((begins, ends)), Some((_, known_until))) = (test, before.1) else { continue };
        if begins < known_until {
            let right = match protocol.retrain {
                Retrain::Never => "a test set must be after all training data, or be a file of it",
                Retrain::Each => "with retrain: each, test sets must follow one another",
            };
            let path = file.path.clone();
            return Err(DataError::Order { path, begins, before: before.0, ends: known_until, right });
        }
        if protocol.retrain == Retrain::Each {
            before = (format!("test set {}", file.label), Some((begins, ends)));
        }
    }
    Ok(())
}

/// Calls `take` for each row of the protocol's states, with the index of its test set and its file.
fn for_each_row(
    protocol: &Protocol,
    mut take: impl FnMut(Option<usize>, &Path, &str, Sample) -> Result<(), DataError>,
) -> Result<(), DataError> {
    let mut reader = Reader {
        key: "train",
        format: protocol.format,
        kind: protocol.kind,
        requested: &protocol.states,
        wanted: protocol.states.iter().map(String::as_str).collect(),
        offsets: protocol.zone.offset_cache(),
    };
    for path in &protocol.train {
        reader.read(path, |state, sample| take(None, path, state, sample))?;
    }
    reader.key = "test";
    for (index, test) in protocol.test.iter().enumerate() {
        reader.read(&test.path, |state, sample| take(Some(index), &test.path, state, sample))?;
    }
    Ok(())
}

fn sort(samples: &mut [Vec<Sample>]) {
    for samples in samples {
        // A stable sort keeps readings with equal times in the order of the file.
        samples.sort_by_key(|sample| sample.utc_nanos);
    }
}

/// A reader of files of readings.
pub(crate) struct Reader<'a> {
    key: &'static str,
    format: RowFormat,
    kind: StateKind,
    requested: &'a [String],
    /// The states of `requested` as a set; empty: all states.
    wanted: HashSet<&'a str>,
    offsets: OffsetCache,
}

impl Reader<'static> {
    /// A reader of all states of files whose states have one kind.
    pub(crate) fn all_states(format: RowFormat, kind: StateKind, zone: &Zone) -> Self {
        let offsets = zone.offset_cache();
        Reader { key: "data", format, kind, requested: &[], wanted: HashSet::new(), offsets }
    }
}

impl Reader<'_> {
    /// Calls `take` for each row of the protocol's states; refuses a file without any.
    pub(crate) fn read(
        &mut self,
        path: &Path,
        mut take: impl FnMut(&str, Sample) -> Result<(), DataError>,
    ) -> Result<(), DataError> {
        let mut rows = 0_u64;
        let mut count = |state: &str, sample: Sample| {
            rows += 1;
            take(state, sample)
        };
        match self.format {
            RowFormat::Csv => self.read_csv(path, &mut count)?,
            RowFormat::Pairs => self.read_pairs(path, &mut count)?,
        }
        if rows == 0 {
            return Err(DataError::Empty { path: path.to_owned(), states: self.requested.to_vec() });
        }
        Ok(())
    }

    fn open(&self, path: &Path) -> Result<BufReader<File>, DataError> {
        let file = File::open(path).map_err(|why| DataError::Io { key: self.key, path: path.to_owned(), why })?;
        Ok(BufReader::with_capacity(256 * 1024, file))
    }

    fn read_csv(
        &mut self,
        path: &Path,
        take: &mut impl FnMut(&str, Sample) -> Result<(), DataError>,
    ) -> Result<(), DataError> {
        let file = |why| DataError::Rows { path: path.to_owned(), why };
        let wrong = |line, wrong| DataError::Row { path: path.to_owned(), line, wrong };
        let mut rows = RowReader::new(self.open(path)?).and_then(RowReader::values_only).map_err(file)?;
        while let Some(item) = rows.next_item().map_err(file)? {
            let row = match item {
                RowItem::Row(row) => row,
                RowItem::Torn { line, text } => {
                    return Err(wrong(
                        line,
                        format!("{text:?} has no line end and is no complete row: is the file cut off?"),
                    ));
                }
            };
            // A value out of the range of a probability is valid for other kinds.
            let refused = row.wrong.filter(|_| self.kind == StateKind::Probability || !row.value.is_finite());
            if let Some(refused) = refused {
                return Err(wrong(row.line, refused));
            }
            if self.wanted.is_empty() || self.wanted.contains(row.state.as_str()) {
                let sample = self.sample(row.time_nanos, row.value).map_err(|refused| wrong(row.line, refused))?;
                take(&row.state, sample)?;
            }
        }
        Ok(())
    }

    fn read_pairs(
        &mut self,
        path: &Path,
        take: &mut impl FnMut(&str, Sample) -> Result<(), DataError>,
    ) -> Result<(), DataError> {
        let state = self.requested.first().map_or(UNNAMED, String::as_str);
        for (number, line) in (1..).zip(self.open(path)?.lines()) {
            let line = line.map_err(|why| DataError::Io { key: self.key, path: path.to_owned(), why })?;
            if !line.trim().is_empty() {
                let sample = self.pair(&line);
                let wrong = |wrong| DataError::Row { path: path.to_owned(), line: number, wrong };
                take(state, sample.map_err(wrong)?)?;
            }
        }
        Ok(())
    }

    fn pair(&mut self, line: &str) -> Result<Sample, String> {
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let &[time, value] = &words[..] else {
            let shown: String = line.chars().take(60).collect();
            return Err(format!(
                "{shown:?} has {} words: a row is a time and a value, as 1404836670 0.458",
                words.len()
            ));
        };
        let time_nanos = parse_time(time).map_err(|wrong| format!("time {wrong}"))?;
        let number: f64 = value.parse().map_err(|_| format!("value {value:?} is not a number"))?;
        self.sample(time_nanos, number)
    }

    fn sample(&mut self, utc_nanos: i64, value: f64) -> Result<Sample, String> {
        let (suits, right) = match self.kind {
            StateKind::Probability => {
                ((0.0..=1.0).contains(&value), "between 0 and 1; for other values write kind: continuous or count")
            }
            StateKind::Continuous => (value.is_finite(), "a finite number"),
            StateKind::Count => {
                (value.is_finite() && value >= 0.0, "a count from 0; for other values write kind: continuous")
            }
        };
        if suits {
            // Minus zero is zero.
            Ok(Sample { utc_nanos, offset_secs: self.offsets.offset_secs(utc_nanos), value: value + 0.0 })
        } else {
            Err(format!("value {value} has to be {right}"))
        }
    }
}
