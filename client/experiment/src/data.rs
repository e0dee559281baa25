//! The recordings of an experiment, by state and time.
//!
//! Invariant: every row of every file is valid, or the experiment fails. No test set starts before the end of the
//! training data, nor, if models learn test sets, before the end of the previous test set.

use std::{
    fs::File,
    io::{self, BufRead as _, BufReader},
    path::{Path, PathBuf},
};

use tidemap_map::time::{format_rfc3339, parse_time};
use tidemap_model::{OffsetCache, Sample, StateKind};

use super::protocol::{Protocol, Refit, RowFormat};
use tidemap_formats::observation_file::{RowError, RowItem, RowReader};

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
    #[error("{path} has no rows{of}", of = if states.is_empty() { String::new() } else { format!(" of {}", states.join(", ")) })]
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
    /// Its name in results.
    pub label: String,
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
fn extent(samples: &[Vec<Sample>]) -> Option<(i64, i64)> {
    let times = samples.iter().flatten().map(|sample| sample.utc_nanos);
    Some((times.clone().min()?, times.max()?))
}

impl Data {
    /// Reads the files of a protocol.
    pub fn read(protocol: &Protocol) -> Result<Self, DataError> {
        let mut reader = Reader {
            key: "train",
            format: protocol.format,
            kind: protocol.kind,
            asked: &protocol.states,
            offsets: protocol.zone.offset_cache(),
        };
        let mut states = protocol.states.clone();
        if states.is_empty() && protocol.format == RowFormat::Pairs {
            states.push(UNNAMED.to_owned());
        }
        let mut train: Vec<Vec<Sample>> = vec![Vec::new(); states.len()];
        for path in &protocol.train {
            reader.read(path, |state, sample| {
                let known = states.iter().position(|known| known == state);
                let index = known.unwrap_or_else(|| {
                    states.push(state.to_owned());
                    train.push(Vec::new());
                    states.len() - 1
                });
                train[index].push(sample);
                Ok(())
            })?;
        }
        for (state, samples) in states.iter().zip(&train) {
            if samples.is_empty() {
                let known = states.iter().zip(&train).filter(|(_, samples)| !samples.is_empty());
                let known = known.map(|(state, _)| state.clone()).collect();
                let path = protocol.train.first().cloned().unwrap_or_default();
                return Err(DataError::Untrained { state: state.clone(), path, known });
            }
        }
        sort(&mut train);
        reader.key = "test";
        let mut tests = Vec::with_capacity(protocol.test.len());
        for test in &protocol.test {
            let mut samples = vec![Vec::new(); states.len()];
            reader.read(&test.path, |state, sample| {
                let index = states.iter().position(|known| known == state).ok_or_else(|| DataError::Untrained {
                    state: state.to_owned(),
                    path: test.path.clone(),
                    known: states.clone(),
                })?;
                samples[index].push(sample);
                Ok(())
            })?;
            sort(&mut samples);
            tests.push(TestSet { label: test.label.clone(), samples });
        }
        let data = Self { states, train, tests };
        data.check_order(protocol)?;
        Ok(data)
    }

    /// Checks that models are scored on unseen data only. Adjacent recordings may share the time of their boundary.
    fn check_order(&self, protocol: &Protocol) -> Result<(), DataError> {
        let mut before = ("the training data".to_owned(), extent(&self.train));
        for (test, file) in self.tests.iter().zip(&protocol.test) {
            let (Some((begins, ends)), Some((_, known_until))) = (extent(&test.samples), before.1) else { continue };
            if begins < known_until {
                let right = match protocol.refit {
                    Refit::Never => "a test set must be after all training data",
                    Refit::Each => "with refit: each, test sets must follow one another",
                };
                let path = file.path.clone();
                return Err(DataError::Order { path, begins, before: before.0, ends: known_until, right });
            }
            if protocol.refit == Refit::Each {
                before = (format!("test set {}", test.label), Some((begins, ends)));
            }
        }
        Ok(())
    }

    /// First and last time of the training data.
    pub fn train_extent(&self) -> Option<(i64, i64)> {
        extent(&self.train)
    }
}

fn sort(samples: &mut [Vec<Sample>]) {
    for samples in samples {
        // A stable sort keeps readings with equal times in the order of the file.
        samples.sort_by_key(|sample| sample.utc_nanos);
    }
}

struct Reader<'a> {
    key: &'static str,
    format: RowFormat,
    kind: StateKind,
    asked: &'a [String],
    offsets: OffsetCache,
}

impl Reader<'_> {
    /// Calls `take` for each row of the protocol's states; refuses a file without any.
    fn read(
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
            return Err(DataError::Empty { path: path.to_owned(), states: self.asked.to_vec() });
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
            if self.asked.is_empty() || self.asked.contains(&row.state) {
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
        let state = self.asked.first().map_or(UNNAMED, String::as_str);
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
