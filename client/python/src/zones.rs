//! Offsets of time zones, from the bundled database: the local name of an hour of a map.
//!
//! Invariant: the offsets are equal to the offsets of the models and the daemon, whatever zones the machine has
//! installed.

use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;
use tidemap_model::Zone;

use crate::failure;

/// The zone of an IANA name.
pub(crate) fn zone_named(py: Python<'_>, name: &str) -> PyResult<Zone> {
    Zone::named(name).map_err(|error| failure::invalid(py, &error.to_string()))
}

/// Seconds east of UTC at each time.
#[pyfunction]
pub(crate) fn zone_offsets<'py>(
    py: Python<'py>,
    zone: &str,
    times_nanos: PyReadonlyArray1<'py, i64>,
) -> PyResult<Bound<'py, PyArray1<i64>>> {
    let mut cache = zone_named(py, zone)?.offset_cache();
    let times = times_nanos.as_array().to_vec();
    let offsets: Vec<i64> =
        py.detach(|| times.into_iter().map(|utc_nanos| i64::from(cache.offset_secs(utc_nanos))).collect());
    Ok(PyArray1::from_vec(py, offsets))
}
