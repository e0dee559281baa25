//! The recordings of an experiment, by state and ascending by time.
//!
//! Invariant: every row of every file was read, or the experiment does not run; no test set begins before the training
//! data ends, nor, where models learn test sets, before the one before it ends.

use std::{
    fs::File,
    io::{self, BufRead as _, BufReader},
    path::{Path, PathBuf},
};

use tidemap_map::time::{format_rfc3339, parse_time};
use tidemap_model::{OffsetCache, Sample, StateKind};

use super::protocol::{Protocol, Refit, RowFormat};
use tidemap_formats::observation_file::{RowError, RowItem, RowReader};

/// Name of the state of files without names.
const UNNAMED: &str = "value";

/// Why data cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum DataError {
    /// A file cannot be read.
    #[error("{key} file {} cannot be read: {why}; paths are relative to the protocol's folder", path.display())]
    Io {
        /// Of the protocol: train or test.
        key: &'static str,
        /// Which.
        path: PathBuf,
        /// Why; it is in the message, so that a chain of causes does not say it twice.
        why: io::Error,
    },
    /// A file is no recording.
    #[error("{}: {why}", path.display())]
    Rows {
        /// Which.
        path: PathBuf,
        /// Why.
        why: RowError,
    },
    /// A row cannot be used.
    #[error("{}: line {line}: {wrong}", path.display())]
    Row {
        /// Which file.
        path: PathBuf,
        /// Which line, from 1.
        line: u64,
        /// What is wrong, and what would be right.
        wrong: String,
    },
    /// A file without rows of the states asked for.
    #[error("{path} has no rows{of}", of = if states.is_empty() { String::new() } else { format!(" of {}", states.join(", ")) })]
    Empty {
        /// Which.
        path: PathBuf,
        /// The states asked for; all where empty.
        states: Vec<String>,
    },
    /// A state that cannot be learned.
    #[error("state {state:?} of {path} is not in the training data, which has {}", known.join(", "))]
    Untrained {
        /// Which.
        state: String,
        /// Where it was found or asked for.
        path: PathBuf,
        /// States of the training data.
        known: Vec<String>,
    },
    /// Test data that is not ahead.
    #[error("{path} begins at {}, before {before} ends at {}: {right}", format_rfc3339(*begins), format_rfc3339(*ends))]
    Order {
        /// Which.
        path: PathBuf,
        /// Its first time.
        begins: i64,
        /// What has to come before it.
        before: String,
        /// The last time of that.
        ends: i64,
        /// What would be right.
        right: &'static str,
    },
}

/// A test set.
#[derive(Clone, Debug)]
pub struct TestSet {
    /// What it is called.
    pub label: String,
    /// Readings of each state, ascending by time.
    pub samples: Vec<Vec<Sample>>,
}

/// All readings of an experiment.
#[derive(Clone, Debug)]
pub struct Data {
    /// Names of the states, in the order of their first training readings, or as the protocol has them.
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

    /// A model is judged by what it has not seen. Recordings that were cut in two may share the instant of the cut.
    fn check_order(&self, protocol: &Protocol) -> Result<(), DataError> {
        let mut before = ("the training data".to_owned(), extent(&self.train));
        for (test, file) in self.tests.iter().zip(&protocol.test) {
            let (Some((begins, ends)), Some((_, known_until))) = (extent(&test.samples), before.1) else { continue };
            if begins < known_until {
                let right = match protocol.refit {
                    Refit::Never => "a test set has to come after all training data",
                    Refit::Each => "with refit: each, test sets have to follow one another",
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
        // Stable: readings at the same time stay in the order of the file.
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
    /// Hands on each row of the states asked for; a file without any is refused.
    fn read(
        &mut self,
        path: &Path,
        mut take: impl FnMut(&str, Sample) -> Result<(), DataError>,
    ) -> Result<(), DataError> {
        let mut taken = 0_u64;
        let mut count = |state: &str, sample: Sample| {
            taken += 1;
            take(state, sample)
        };
        match self.format {
            RowFormat::Csv => self.read_csv(path, &mut count)?,
            RowFormat::Pairs => self.read_pairs(path, &mut count)?,
        }
        if taken == 0 {
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
        while let Some(item) = rows.next().map_err(file)? {
            let row = match item {
                RowItem::Row(row) => row,
                RowItem::Torn { line, text } => {
                    return Err(wrong(
                        line,
                        format!("{text:?} has no line end and makes no row: is the file cut off?"),
                    ));
                }
            };
            // What is only out of the range of a probability may suit another kind.
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
