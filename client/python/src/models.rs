//! The temporal models in process, without a daemon.
//!
//! Invariant: a model gives the numbers that the same model gives in the daemon for the same readings.

use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::{
    prelude::*,
    types::{PyDict, PyTuple},
};
use tidemap_model::{
    Sample, StateKind, TrainedModel, Zone,
    catalogue::{ModelKind, ParameterSet},
    models::{Moment, TemporalModel as _},
};

use crate::{failure, zones::zone_named};

/// A model that was trained on readings, which it keeps: a copy of the model, in another process or from a file, is
/// trained anew on the same readings, and so gives the same numbers in every version of the package.
#[pyclass(frozen, module = "tidemap._native")]
pub(crate) struct NativeModel {
    model: TrainedModel,
    zone: Zone,
    kind: String,
    parameters: Vec<(String, String)>,
    state_kind: String,
    times_nanos: Vec<i64>,
    values: Vec<f64>,
}

/// The mean, and period in seconds, amplitude and phase in radians of each rhythm.
type Rhythms = (f64, Vec<(f64, f64, f64)>);

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
        let set =
            ParameterSet::new(model_kind, &given).map_err(|error| failure::invalid(py, &format!("{kind}: {error}")))?;
        let state_kind = StateKind::ALL
            .into_iter()
            .find(|kind| kind.name() == state_kind)
            .ok_or_else(|| failure::invalid(py, &format!("kind {state_kind:?}: probability, continuous or count")))?;
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
        let (kind, state_kind) = (kind.to_owned(), state_kind.name().to_owned());
        Ok(Self { model, zone, kind, parameters, state_kind, times_nanos: times, values })
    }

    /// The way in which pickle makes the model: by training.
    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let (py, this) = (slf.py(), slf.get());
        let arguments = (
            &this.kind,
            this.parameters.clone(),
            PyArray1::from_slice(py, &this.times_nanos),
            PyArray1::from_slice(py, &this.values),
            &this.state_kind,
            this.zone.name(),
        );
        // Pickle finds functions of Python by their names.
        Ok((py.import("tidemap.models")?.getattr("trained_anew")?, arguments.into_pyobject(py)?))
    }

    /// Returns the model itself, which never changes.
    fn __copy__(slf: Bound<'_, Self>) -> Bound<'_, Self> {
        slf
    }

    /// Returns the model itself, which never changes.
    fn __deepcopy__<'py>(slf: Bound<'py, Self>, _memo: &Bound<'py, PyAny>) -> Bound<'py, Self> {
        slf
    }

    /// The rhythms that predict, the strongest first; `None` for other models than the spectral one.
    fn rhythms(&self) -> Option<Rhythms> {
        match &self.model {
            TrainedModel::Spectral(model) => Some((model.mean(), model.rhythms())),
            _ => None,
        }
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
