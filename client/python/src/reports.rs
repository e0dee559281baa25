//! The reporting of states, the words for values, and durations with a unit.
//!
//! Invariant: the stated reporting is checked before anything is sent.

use pyo3::prelude::*;
use tidemap_client::maps::{RowKind, StatedReporting};
use tidemap_model::{
    time::{NANOS_PER_SEC, parse_duration},
    words,
};

use crate::failure;

/// The kind of rows, the longest time for which a row is valid, and the time between two readings that are learned;
/// nanoseconds.
pub(crate) type GivenReporting = (String, Option<i64>, Option<i64>);

/// The stated reporting of states, checked.
pub(crate) fn stated(py: Python<'_>, (word, hold_max, hold_step): GivenReporting) -> PyResult<StatedReporting> {
    let kind = RowKind::ALL.into_iter().find(|kind| kind.name() == word).ok_or_else(|| {
        failure::invalid(py, &format!("reports={word:?} is not known: use \"samples\", \"changes\" or \"events\""))
    })?;
    let secs = |name: &str, nanos: Option<i64>| {
        let whole = |nanos: i64| u32::try_from(nanos / NANOS_PER_SEC).ok().filter(|_| nanos % NANOS_PER_SEC == 0);
        let wrong = || failure::invalid(py, &format!("{name} takes whole seconds, up to 366d"));
        nanos.map(|nanos| whole(nanos).ok_or_else(wrong)).transpose()
    };
    let stated = StatedReporting::new(kind, secs("hold_max", hold_max)?, secs("hold_step", hold_step)?);
    stated.map_err(|error| failure::invalid(py, &error.to_string()))
}

/// The stated reporting of states, checked: the kind of rows, and both durations in seconds if they are stated.
#[pyfunction]
#[pyo3(signature = (reports, hold_max_nanos=None, hold_step_nanos=None))]
pub(crate) fn stated_reporting(
    py: Python<'_>,
    reports: String,
    hold_max_nanos: Option<i64>,
    hold_step_nanos: Option<i64>,
) -> PyResult<(&'static str, Option<u32>, Option<u32>)> {
    let stated = stated(py, (reports, hold_max_nanos, hold_step_nanos))?;
    Ok((stated.kind().name(), stated.max_secs(), stated.step_secs()))
}

/// Nanoseconds of a duration such as `90s`, `15m`, `7d`.
#[pyfunction]
pub(crate) fn duration_nanos(py: Python<'_>, text: &str) -> PyResult<i64> {
    parse_duration(text).map_err(|error| failure::invalid(py, &error.to_string()))
}

/// Words for 1, for 0, and for no value, in lower case.
#[pyfunction]
pub(crate) fn usual_words() -> (Vec<&'static str>, Vec<&'static str>, Vec<&'static str>) {
    (words::ONES.to_vec(), words::ZEROS.to_vec(), words::NO_VALUE.to_vec())
}
