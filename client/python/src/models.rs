//! The temporal models in process, without a daemon.
//!
//! Invariant: a model gives the numbers that the same model gives in the daemon for the same readings.

use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::{prelude::*, types::PyDict};
use tidemap_model::{
    Sample, StateKind, TrainedModel, Zone,
    catalogue::{ModelKind, ParameterSet},
    models::{Moment, TemporalModel as _},
};

use crate::failure;

/// A model that was trained on readings.
#[pyclass(frozen)]
pub(crate) struct NativeModel {
    model: TrainedModel,
    zone: Zone,
}

/// The kinds that can be trained: all but `auto`.
fn kinds() -> impl Iterator<Item = ModelKind> {
    ModelKind::ALL.into_iter().filter(|kind| *kind != ModelKind::Auto)
}

fn kind_of(py: Python<'_>, name: &str) -> PyResult<ModelKind> {
    kinds().find(|kind| kind.name() == name).ok_or_else(|| {
        let names: Vec<&str> = kinds().map(ModelKind::name).collect();
        failure::invalid(py, &format!("model {name:?}: one of {}", names.join(", ")))
    })
}

fn zone_named(py: Python<'_>, name: &str) -> PyResult<Zone> {
    Zone::named(name).map_err(|error| failure::invalid(py, &error.to_string()))
}

/// The parameters of each kind of model, by its name.
#[pyfunction]
pub(crate) fn model_parameters(py: Python<'_>) -> PyResult<Bound<'_, PyDict>> {
    let found = PyDict::new(py);
    for kind in kinds() {
        found.set_item(kind.name(), kind.info().parameters.to_vec())?;
    }
    Ok(found)
}

#[pymethods]
impl NativeModel {
    /// Trains a model of that kind on readings, ascending by time.
    #[staticmethod]
    fn fit<'py>(
        py: Python<'py>,
        kind: &str,
        parameters: Vec<(String, String)>,
        times_nanos: PyReadonlyArray1<'py, i64>,
        values: PyReadonlyArray1<'py, f64>,
        state_kind: &str,
        time_zone: &str,
    ) -> PyResult<Self> {
        let model_kind = kind_of(py, kind)?;
        let known = model_kind.info().parameters;
        let mut given: Vec<(&'static str, &str)> = Vec::new();
        for (name, text) in &parameters {
            match known.iter().find(|known| *known == name) {
                Some(name) => given.push((name, text)),
                None => {
                    let message = format!("{kind} has no parameter {name:?}; it has {}", known.join(", "));
                    return Err(failure::invalid(py, &message));
                }
            }
        }
        let set = ParameterSet::new(model_kind, &given)
            .map_err(|error| failure::invalid(py, &format!("{kind}: {error}")))?;
        let state_kind = StateKind::ALL.into_iter().find(|kind| kind.name() == state_kind).ok_or_else(|| {
            failure::invalid(py, &format!("kind {state_kind:?}: probability, continuous or count"))
        })?;
        let zone = zone_named(py, time_zone)?;
        let (times, values) = (times_nanos.as_array().to_vec(), values.as_array().to_vec());
        if times.len() != values.len() {
            return Err(failure::invalid(py, &format!("{} times and {} values", times.len(), values.len())));
        }
        if let Some(row) = values.iter().position(|value| !state_kind.bounds().contains(value)) {
            let message = format!("value {} in row {row} is not one of a {}", values[row], state_kind.name());
            return Err(failure::invalid(py, &message));
        }
        if let Some(row) = times.windows(2).position(|pair| pair[1] < pair[0]) {
            return Err(failure::invalid(py, &format!("times must ascend; row {} is earlier than row {row}", row + 1)));
        }
        let trained = py.detach(|| {
            let sample = |(&utc_nanos, &value): (&i64, &f64)| Sample {
                utc_nanos,
                offset_secs: zone.offset_secs(utc_nanos),
                value,
            };
            let samples: Vec<Sample> = times.iter().zip(&values).map(sample).collect();
            set.train(&samples, state_kind)
        });
        let model = trained.map_err(|error| failure::invalid(py, &format!("{kind}: {error}")))?;
        Ok(Self { model, zone })
    }

    /// The prediction at each time.
    fn predict<'py>(&self, py: Python<'py>, times_nanos: PyReadonlyArray1<'py, i64>) -> Bound<'py, PyArray1<f64>> {
        let times = times_nanos.as_array().to_vec();
        let predicted: Vec<f64> = py.detach(|| {
            let at = |utc_nanos: i64| Moment { utc_nanos, offset_secs: self.zone.offset_secs(utc_nanos) };
            times.into_iter().map(|time| self.model.predict(at(time))).collect()
        });
        PyArray1::from_vec(py, predicted)
    }
}
