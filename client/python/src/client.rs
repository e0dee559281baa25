//! The connection to a daemon, and its requests with many numbers: these are passed as arrays, all others as JSON.
//!
//! Invariant: arrays have one row for each state and one column for each time, in the order of the request.

use std::{
    collections::HashMap,
    path::PathBuf,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

use numpy::{PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray4, ndarray::Array2};
use pyo3::{prelude::*, types::PyDict};
use tidemap_client::{
    Client,
    connection::Credentials,
    observe::{Producer, ProducerOptions, QueueOptions, QueuedProducer, SightingReport, TraversalReport},
    queries::{GridOutput, GridQuery, PredictionRun, Predictions},
};

use crate::{
    failure, grids,
    observe::{CATEGORICAL, Columns, Outcome, Rows, SentCounts, send, states_of},
    open_producer::{Driven, OpenProducer},
    queue::NativeQueue,
    reports::GivenReporting,
    room::Room,
    rpc::{self, Replies, model_named},
    waiting::{Maker, runtime, wait},
};

/// Predicted values, bounds of the intervals if requested, entropies, the evidence of each row, and its name: the name
/// of a state, or `STATE/LABEL` for a label of a categorical state.
type PredictedArrays<'py> = (
    Bound<'py, PyArray2<f64>>,
    Option<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>)>,
    Bound<'py, PyArray2<f64>>,
    Vec<Evidence>,
    Vec<String>,
);

/// The evidence for the predictions of a state: the model that answered, its order, the number of observations and of
/// observations that no update has learned, and the time of the newest observation.
type Evidence = (Option<String>, u32, u64, u64, Option<i64>);

fn evidence(run: &PredictionRun) -> Evidence {
    let model = run.answered_by.map(|model| model.to_string());
    (model, run.order, run.observations, run.pending, run.last_nanos)
}

/// Predictions of a state, or of a label, at all times.
struct PredictedRow {
    name: String,
    values: Vec<f64>,
    lower: Vec<f64>,
    upper: Vec<f64>,
    entropies: Vec<f64>,
    behind: Evidence,
}

impl PredictedRow {
    fn new(name: String, times: usize) -> Self {
        let empty = || vec![f64::NAN; times];
        Self { name, values: empty(), lower: empty(), upper: empty(), entropies: empty(), behind: Evidence::default() }
    }

    fn put(&mut self, run: &PredictionRun) {
        self.behind = evidence(run);
        let put = |numbers: &[f64], into: &mut [f64]| {
            into.iter_mut().skip(run.first_time).zip(numbers).for_each(|(place, number)| *place = *number);
        };
        put(&run.probabilities, &mut self.values);
        put(&run.lower, &mut self.lower);
        put(&run.upper, &mut self.upper);
        put(&run.entropies_bits, &mut self.entropies);
    }
}

/// The rows of all states, or the name of a state that is a position.
async fn predicted_rows(
    mut predictions: Predictions,
    count: usize,
) -> Result<Result<Vec<PredictedRow>, String>, tidemap_client::Error> {
    let mut rows: Vec<PredictedRow> = Vec::with_capacity(predictions.states().len());
    // The row of each state and label: long runs of times come in pieces.
    let mut places = HashMap::new();
    while let Some(run) = predictions.next().await? {
        let state = &predictions.states()[run.state];
        let name = match &run.label {
            Some(label) => format!("{state}/{label}"),
            None if run.axis.is_some() => return Ok(Err(state.clone())),
            None => state.clone(),
        };
        let place = *places.entry((run.state, run.axis)).or_insert_with(|| {
            rows.push(PredictedRow::new(name, count));
            rows.len() - 1
        });
        rows[place].put(&run);
    }
    Ok(Ok(rows))
}

/// A sighting of landmarks: place, part of the edge, time, names seen, names out of view.
type Sighted = (String, Option<f64>, Option<f64>, i64, Vec<String>, Vec<String>);

/// A client of a daemon.
#[pyclass(frozen)]
pub(crate) struct NativeClient {
    server: String,
    credentials: Credentials,
    // This lock is taken only with the interpreter's lock, so that a child of a fork never finds it held.
    held: Mutex<Held>,
}

impl Drop for NativeClient {
    fn drop(&mut self) {
        self.close();
    }
}

/// The connections of a client.
struct Held {
    maker: Maker,
    /// `None`: it is closed.
    client: Option<(Client, Room)>,
}

/// Connections that are made when they are needed.
fn connected(py: Python<'_>, server: &str, credentials: &Credentials) -> PyResult<(Client, Room)> {
    // Connections belong to the runtime.
    let _entered = runtime()?.enter();
    let client = Client::with_credentials(server, credentials).map_err(|error| failure::request(py, &error))?;
    Ok((client, Room::new()))
}

impl NativeClient {
    /// The client of the library, and its turns. A child of a fork gets connections of its own.
    ///
    /// # Errors
    /// The client is closed.
    pub(crate) fn client(&self, py: Python<'_>) -> PyResult<(Client, Room)> {
        let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        if held.client.is_none() {
            let message = "the client is closed: make another one with tidemap.connect()";
            return Err(failure::exception(py, "FAILED_PRECONDITION", message));
        }
        if held.maker != Maker::here() {
            let client = connected(py, &self.server, &self.credentials)?;
            // The connections belong to the parent: to drop them here would touch threads that do not exist here.
            std::mem::forget(held.client.replace(client));
            held.maker = Maker::here();
        }
        // Checked above.
        let closed = || failure::exception(py, "FAILED_PRECONDITION", "the client is closed");
        held.client.clone().ok_or_else(closed)
    }

    /// Sends rows and waits until they are durable; `progress` as of `observe`.
    fn send_rows<'py>(
        &self,
        py: Python<'py>,
        options: ProducerOptions,
        rows: Rows,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let all = rows.len();
        let counts = Arc::new(Mutex::new(SentCounts::default()));
        let sent = send(self.client(py)?.0, options, rows, Arc::clone(&counts));
        let outcome = wait(py, sent, |_| {
            let durable = counts.lock().unwrap_or_else(PoisonError::into_inner).durable;
            progress.map_or(Ok(()), |progress| progress.call1((durable, all)).map(|_| ()))
        })?;
        let report = report(py, all, outcome)?;
        if let Some(progress) = progress {
            progress.call1((all, all))?;
        }
        Ok(report)
    }
}

/// The counts of the rows that were sent, or the exception.
fn report(py: Python<'_>, all: usize, outcome: Outcome) -> PyResult<Bound<'_, PyDict>> {
    let counts = match outcome {
        Outcome::Whole(counts) => counts,
        Outcome::Differs(message) => return Err(failure::exception(py, "FAILED_PRECONDITION", &message)),
        Outcome::Stopped(error) => return Err(failure::producer(py, &error)),
    };
    let report = PyDict::new(py);
    report.set_item("read", all)?;
    report.set_item("accepted", counts.accepted)?;
    report.set_item("duplicate", counts.duplicate)?;
    report.set_item("refused", counts.refused)?;
    report.set_item("refusals", counts.refusals)?;
    Ok(report)
}

#[pymethods]
impl NativeClient {
    /// Makes a client that connects at its first request.
    #[new]
    #[pyo3(signature = (server, token=None, ca=None, certificate=None, key=None))]
    fn new(
        py: Python<'_>,
        server: &str,
        token: Option<String>,
        ca: Option<Vec<u8>>,
        certificate: Option<Vec<u8>>,
        key: Option<Vec<u8>>,
    ) -> PyResult<Self> {
        let credentials = Credentials { token, ca, identity: certificate.zip(key) };
        let client = connected(py, server, &credentials)?;
        let server = client.0.server().to_owned();
        let held = Mutex::new(Held { maker: Maker::here(), client: Some(client) });
        Ok(Self { server, credentials, held })
    }

    #[getter]
    fn server(&self) -> &str {
        &self.server
    }

    /// Closes the connections. What waits for an answer gets it; later calls are refused.
    fn close(&self) {
        let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        let client = held.client.take();
        if held.maker != Maker::here() {
            std::mem::forget(client);
        }
    }

    /// The replies of `SERVICE/METHOD` to a request in JSON.
    fn call(&self, py: Python<'_>, method: &str, request: &str) -> PyResult<Replies> {
        let Some(descriptor) = rpc::method(method) else {
            let message = format!("there is no method {method:?} that takes one request, as SERVICE/METHOD");
            return Err(failure::invalid(py, &message));
        };
        let message = rpc::request(&descriptor, request)
            .map_err(|error| failure::invalid(py, &format!("the request of {method}: {error}")))?;
        let kind = descriptor.output();
        match wait(py, rpc::call(self.client(py)?, descriptor, message), |_| Ok(()))? {
            Ok(replies) => Ok(Replies::new(self.server.clone(), kind, replies)),
            Err(status) => Err(rpc::raised(py, &self.server, &status)),
        }
    }

    /// Checks that a kind exists and fits the reporting of the states, before anything is withdrawn or sent.
    #[pyo3(signature = (kind, reporting=None))]
    #[expect(clippy::unused_self, reason = "Python has the client at hand")]
    fn check_states(&self, py: Python<'_>, kind: Option<&str>, reporting: Option<GivenReporting>) -> PyResult<()> {
        states_of(py, kind, reporting).map(drop)
    }

    /// Sends observations, each exactly once; observations that the daemon has are compared. `positions` has the
    /// coordinates of vectors, one row each, in place of the values. `progress` is called with the number of durable
    /// observations and of all. NaN in changes and events: no value is known from then on.
    #[pyo3(signature = (
        map, states, state_indices, times_nanos, values, producer, label, kind, nightly, positions=None, progress=None,
        reporting=None
    ))]
    #[expect(clippy::too_many_arguments, reason = "Python names them")]
    fn observe<'py>(
        &self,
        py: Python<'py>,
        map: &str,
        states: Vec<String>,
        state_indices: PyReadonlyArray1<'py, u32>,
        times_nanos: PyReadonlyArray1<'py, i64>,
        values: PyReadonlyArray1<'py, f64>,
        producer: &str,
        label: &str,
        kind: Option<&str>,
        nightly: bool,
        positions: Option<PyReadonlyArray2<'py, f64>>,
        progress: Option<Bound<'py, PyAny>>,
        reporting: Option<GivenReporting>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let are_labels = kind == Some(CATEGORICAL);
        let (kind, reporting) = states_of(py, kind, reporting)?;
        let options = ProducerOptions { kind, reporting, nightly, ..ProducerOptions::new(producer, label, map) };
        let columns = Columns::of(states, &state_indices, &times_nanos, &values);
        columns.check(py)?;
        let rows = match positions {
            Some(places) if places.as_array().nrows() != columns.times_nanos.len() => {
                let message = format!("{} positions, {} times", places.as_array().nrows(), columns.times_nanos.len());
                return Err(failure::invalid(py, &message));
            }
            Some(places) => Rows::Positions(columns, places.as_array().to_owned()),
            None if are_labels => Rows::Labels(columns),
            None => Rows::Values(columns),
        };
        self.send_rows(py, options, rows, progress.as_ref())
    }

    /// Sends traversals of edges, each exactly once.
    fn traverse<'py>(
        &self,
        py: Python<'py>,
        map: &str,
        driven: Vec<Driven>,
        producer: &str,
        label: &str,
        nightly: bool,
    ) -> PyResult<Bound<'py, PyDict>> {
        let options = ProducerOptions { nightly, ..ProducerOptions::new(producer, label, map) };
        let report = |(from, to, action, start_nanos, end_nanos, success, reason)| TraversalReport {
            from,
            to,
            action,
            start_nanos,
            end_nanos,
            success,
            reason,
        };
        self.send_rows(py, options, Rows::Traversals(driven.into_iter().map(report).collect()), None)
    }

    /// Sends sightings of landmarks, each exactly once.
    fn sight<'py>(
        &self,
        py: Python<'py>,
        map: &str,
        sightings: Vec<Sighted>,
        producer: &str,
        label: &str,
        nightly: bool,
    ) -> PyResult<Bound<'py, PyDict>> {
        let options = ProducerOptions { nightly, ..ProducerOptions::new(producer, label, map) };
        let report = |(place, from_m, to_m, time_nanos, seen, out_of_view)| SightingReport {
            place,
            from_m,
            to_m,
            time_nanos,
            seen,
            out_of_view,
            traversal: None,
        };
        self.send_rows(py, options, Rows::Sightings(sightings.into_iter().map(report).collect()), None)
    }

    /// Sends grids that were seen, each exactly once; axes time, z, y, x; below 0 not seen, 0 free, above 0 occupied.
    #[expect(clippy::too_many_arguments, reason = "Python names them")]
    fn observe_grids<'py>(
        &self,
        py: Python<'py>,
        map: &str,
        times_nanos: PyReadonlyArray1<'py, i64>,
        cells: PyReadonlyArray4<'py, i8>,
        first_cell: [i32; 3],
        producer: &str,
        label: &str,
        nightly: bool,
    ) -> PyResult<Bound<'py, PyDict>> {
        let options = ProducerOptions { nightly, ..ProducerOptions::new(producer, label, map) };
        let grids = grids::SeenGrids {
            times_nanos: times_nanos.as_array().to_vec(),
            cells: cells.as_array().to_owned(),
            first_cell,
        };
        let all = grids.times_nanos.len();
        if grids.cells.shape()[0] != all {
            return Err(failure::invalid(py, &format!("{all} times, {} grids", grids.cells.shape()[0])));
        }
        let outcome = wait(py, grids::send(self.client(py)?.0, options, grids), |_| Ok(()))?;
        report(py, all, outcome)
    }

    /// Predictions of states at times.
    #[pyo3(signature = (map, states, times_nanos, model, interval=None))]
    fn predict<'py>(
        &self,
        py: Python<'py>,
        map: &str,
        states: Vec<String>,
        times_nanos: PyReadonlyArray1<'py, i64>,
        model: &str,
        interval: Option<f64>,
    ) -> PyResult<PredictedArrays<'py>> {
        let model = model_named(py, model)?;
        let times = times_nanos.as_array().to_vec();
        let count = times.len();
        let (client, room) = self.client(py)?;
        let map = map.to_owned();
        let request = async move {
            let ask = || {
                let predictions = client.predict(&map, states.clone(), times.clone(), model);
                predicted_rows(predictions.with_intervals(interval.unwrap_or(0.0)), count)
            };
            room.ask(ask).await.map(|(rows, _)| rows)
        };
        let predicted = wait(py, request, |_| Ok(()))?.map_err(|error| failure::request(py, &error))?;
        let rows = predicted.map_err(|name| {
            let message = format!("{name} is a position: request QueryService/PredictPositions with call()");
            failure::invalid(py, &message)
        })?;
        let array = |column: fn(&PredictedRow) -> &Vec<f64>| {
            let numbers: Vec<f64> = rows.iter().flat_map(|row| column(row).iter().copied()).collect();
            let array = Array2::from_shape_vec((rows.len(), count), numbers);
            PyArray2::from_owned_array(py, array.unwrap_or_default())
        };
        let bounds = interval.map(|_| (array(|row| &row.lower), array(|row| &row.upper)));
        let (values, entropies) = (array(|row| &row.values), array(|row| &row.entropies));
        let (behind, names) = rows.iter().map(|row| (row.behind.clone(), row.name.clone())).unzip();
        Ok((values, bounds, entropies, behind, names))
    }

    /// A grid at one time.
    #[pyo3(signature = (map, time_nanos, model, output, threshold, region, project))]
    #[expect(clippy::too_many_arguments, reason = "Python names them")]
    fn predict_grid<'py>(
        &self,
        py: Python<'py>,
        map: &str,
        time_nanos: i64,
        model: &str,
        output: &str,
        threshold: f64,
        region: Option<[i32; 6]>,
        project: bool,
    ) -> PyResult<Bound<'py, PyDict>> {
        let output = match output {
            "probability" => GridOutput::Probability,
            "entropy" => GridOutput::Entropy,
            "threshold" => GridOutput::Threshold(threshold),
            other => {
                let message = format!("output {other:?}: probability, entropy or threshold");
                return Err(failure::invalid(py, &message));
            }
        };
        let query = GridQuery {
            map: map.to_owned(),
            time_nanos,
            model: model_named(py, model)?,
            region: region.map(grids::cell_box),
            is_projected: project,
            output,
        };
        let ((client, room), request) = (self.client(py)?, query.clone());
        let answered = async move {
            let ask = || async { client.predict_grid(&request).await?.whole().await };
            room.ask(ask).await.map(|(answer, _)| answer)
        };
        let answer = wait(py, answered, |_| Ok(()))?;
        grids::arrays(py, &answer.map_err(|error| failure::request(py, &error))?, &query)
    }

    /// A producer that stays open, for observations as they come.
    #[pyo3(signature = (map, producer, label, kind=None, reporting=None, patience_secs=60.0))]
    #[expect(clippy::too_many_arguments, reason = "Python names them")]
    fn open_producer(
        &self,
        py: Python<'_>,
        map: &str,
        producer: &str,
        label: &str,
        kind: Option<&str>,
        reporting: Option<GivenReporting>,
        patience_secs: f64,
    ) -> PyResult<OpenProducer> {
        let (kind, reporting) = states_of(py, kind, reporting)?;
        let Ok(patience) = Duration::try_from_secs_f64(patience_secs) else {
            return Err(failure::invalid(py, &format!("a patience of {patience_secs} s: use 0 or more seconds")));
        };
        let options = ProducerOptions { kind, reporting, patience, ..ProducerOptions::new(producer, label, map) };
        let client = self.client(py)?.0;
        let opened = wait(py, async move { Producer::open(&client, options).await }, |_| Ok(()))?;
        let producer = opened.map_err(|error| failure::producer(py, &error))?;
        Ok(OpenProducer::new(producer))
    }

    /// A producer whose observations wait in a folder until the daemon has them; does not wait for the daemon.
    #[pyo3(signature = (map, producer, label, folder, bytes_max, sync_secs, kind=None, reporting=None))]
    #[expect(clippy::too_many_arguments, reason = "Python names them")]
    fn open_queue(
        &self,
        py: Python<'_>,
        map: &str,
        producer: &str,
        label: &str,
        folder: PathBuf,
        bytes_max: u64,
        sync_secs: f64,
        kind: Option<&str>,
        reporting: Option<GivenReporting>,
    ) -> PyResult<NativeQueue> {
        let (kind, reporting) = states_of(py, kind, reporting)?;
        let sync_every = Duration::try_from_secs_f64(sync_secs).ok().filter(|interval| !interval.is_zero());
        let Some(sync_every) = sync_every else {
            return Err(failure::invalid(py, &format!("an interval of {sync_secs} s: use a number above 0")));
        };
        let options = ProducerOptions { kind, reporting, ..ProducerOptions::new(producer, label, map) };
        let queue = QueueOptions { folder, bytes_max, sync_every };
        let client = self.client(py)?.0;
        let opened = wait(py, async move { QueuedProducer::open(&client, options, &queue) }, |_| Ok(()))?;
        Ok(NativeQueue::new(opened.map_err(|error| failure::queue(py, &error))?))
    }
}
