//! Comparisons with given observations, and the history of observations.
//!
//! Invariant: one entry for each row of the answer, in the order of the daemon.

use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::{prelude::*, types::PyDict};
use tidemap_client::queries::EvaluateOptions;

use crate::{client::NativeClient, failure, observe::Columns, rpc::model_named, waiting::wait};

/// Rows of an answer.
type Dicts<'py> = Vec<Bound<'py, PyDict>>;

/// Compares models with observations, which are not learned: a row for each state, model and order, and the states that
/// could not be compared.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "Python names them")]
pub(crate) fn evaluate<'py>(
    py: Python<'py>,
    client: &NativeClient,
    map: &str,
    states: Vec<String>,
    state_indices: PyReadonlyArray1<'py, u32>,
    times_nanos: PyReadonlyArray1<'py, i64>,
    values: PyReadonlyArray1<'py, f64>,
    models: Vec<String>,
    max_order: Option<u32>,
) -> PyResult<(Dicts<'py>, Dicts<'py>)> {
    let models = models.iter().map(|name| model_named(py, name)).collect::<PyResult<Vec<_>>>()?;
    let columns = Columns::of(states, &state_indices, &times_nanos, &values);
    columns.check(py)?;
    let ((client, _), options) = (client.client(py)?, EvaluateOptions { map: map.to_owned(), models, max_order });
    let compared = async move {
        let mut evaluator = client.evaluate(options);
        for row in 0..columns.times_nanos.len() {
            let (state, time_nanos, value) = columns.row(row);
            if !evaluator.add(state, time_nanos, value).await {
                break;
            }
        }
        evaluator.finish().await
    };
    let compared = wait(py, compared, |_| Ok(()))?.map_err(|error| failure::request(py, &error))?;
    let row = |evaluation: &tidemap_client::queries::StateEvaluation| {
        let row = PyDict::new(py);
        row.set_item("state", &evaluation.state)?;
        row.set_item("model", evaluation.model.to_string())?;
        row.set_item("order", evaluation.model.order)?;
        row.set_item("n", evaluation.observations)?;
        row.set_item("mse", evaluation.mean_squared_error)?;
        row.set_item("error_rate", evaluation.error_rate)?;
        Ok(row)
    };
    let missing = |missing: &tidemap_client::queries::Unavailable| {
        let row = PyDict::new(py);
        row.set_item("model", missing.model.to_string())?;
        row.set_item("reason", &missing.reason)?;
        row.set_item("states", &missing.states)?;
        Ok(row)
    };
    let rows = compared.evaluations.iter().map(row).collect::<PyResult<Vec<_>>>()?;
    let missing = compared.unavailable.iter().map(missing).collect::<PyResult<Vec<_>>>()?;
    Ok((rows, missing))
}

/// Times and values.
type Series<'py> = (Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<f64>>);

/// The observations of a state from one time up to, not including, another.
#[pyfunction]
pub(crate) fn history<'py>(
    py: Python<'py>,
    client: &NativeClient,
    map: &str,
    state: &str,
    from_nanos: i64,
    to_nanos: i64,
) -> PyResult<Series<'py>> {
    let ((client, room), map, state) = (client.client(py)?, map.to_owned(), state.to_owned());
    let read = async move {
        let ask = || async {
            let (mut times, mut values) = (Vec::new(), Vec::new());
            let mut pieces = client.reconstruct(&map, &state, from_nanos, to_nanos).await?;
            while let Some(piece) = pieces.next().await? {
                times.extend(piece.iter().map(|(time, _)| *time));
                values.extend(piece.iter().map(|(_, value)| *value));
            }
            Ok::<_, tidemap_client::Error>((times, values))
        };
        room.ask(ask).await.map(|(series, _)| series)
    };
    let (times, values) = wait(py, read, |_| Ok(()))?.map_err(|error| failure::request(py, &error))?;
    Ok((PyArray1::from_vec(py, times), PyArray1::from_vec(py, values)))
}
