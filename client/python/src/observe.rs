//! Sends the rows of arrays. Rows that the daemon has already are compared, not sent.
//!
//! Invariant: nothing is sent before all rows that the daemon has are compared. Once a row is durable, it counts as
//! exactly one of accepted, duplicate and refused.

use std::sync::{Arc, Mutex, PoisonError};

use numpy::{PyReadonlyArray1, ndarray::Array2};
use pyo3::prelude::*;
use tidemap_client::{
    Client,
    maps::{RowKind, StateKind, StateShape, StatedReporting},
    observe::{Producer, ProducerError, ProducerOptions, SightingReport, TraversalReport, content::ContentCrc},
};

use crate::{
    failure,
    reports::{GivenReporting, stated},
};

/// Maximum number of refusals that are reported in words.
const REFUSALS_LISTED: usize = 100;
/// Rows between two checks of the refusals.
const CHUNK: usize = 32_768;

/// Observations in columns: row i is of `states[state_indices[i]]`.
pub(crate) struct Columns {
    pub(crate) states: Vec<String>,
    pub(crate) state_indices: Vec<u32>,
    pub(crate) times_nanos: Vec<i64>,
    pub(crate) values: Vec<f64>,
}

impl Columns {
    /// The columns of arrays.
    pub(crate) fn of(
        states: Vec<String>,
        state_indices: &PyReadonlyArray1<'_, u32>,
        times_nanos: &PyReadonlyArray1<'_, i64>,
        values: &PyReadonlyArray1<'_, f64>,
    ) -> Self {
        Self {
            states,
            state_indices: state_indices.as_array().to_vec(),
            times_nanos: times_nanos.as_array().to_vec(),
            values: values.as_array().to_vec(),
        }
    }

    /// Checks that the columns are of one length, and that states are there.
    pub(crate) fn check(&self, py: Python<'_>) -> PyResult<()> {
        let rows = self.times_nanos.len();
        if self.state_indices.len() != rows || self.values.len() != rows {
            let message = format!(
                "{rows} times, {} values and {} states: they must be as many",
                self.values.len(),
                self.state_indices.len()
            );
            return Err(failure::invalid(py, &message));
        }
        match self.state_indices.iter().find(|index| **index as usize >= self.states.len()) {
            Some(index) => {
                Err(failure::invalid(py, &format!("state number {index}, but there are {}", self.states.len())))
            }
            None => Ok(()),
        }
    }

    pub(crate) fn row(&self, row: usize) -> (&str, i64, f64) {
        (&self.states[self.state_indices[row] as usize], self.times_nanos[row], self.values[row])
    }
}

/// The items to send, one number of the sequence each.
pub(crate) enum Rows {
    Values(Columns),
    /// Coordinates in metres, one row each, in the place of the values.
    Positions(Columns, Array2<f64>),
    /// Labels of categorical states: each name is `STATE/LABEL`.
    Labels(Columns),
    Traversals(Vec<TraversalReport>),
    Sightings(Vec<SightingReport>),
}

impl Rows {
    pub(crate) fn len(&self) -> usize {
        match self {
            Self::Values(columns) | Self::Positions(columns, _) | Self::Labels(columns) => columns.times_nanos.len(),
            Self::Traversals(reports) => reports.len(),
            Self::Sightings(reports) => reports.len(),
        }
    }

    fn add_to(&self, crc: &mut ContentCrc, row: usize) {
        match self {
            Self::Values(columns) | Self::Labels(columns) => {
                let (state, time_nanos, value) = columns.row(row);
                crc.add(state, time_nanos, value);
            }
            Self::Positions(columns, places) => {
                let (state, time_nanos, _) = columns.row(row);
                crc.add_position(state, time_nanos, &places.row(row).to_vec());
            }
            Self::Traversals(reports) => crc.add_traversal(&reports[row]),
            Self::Sightings(reports) => crc.add_sighting(&reports[row]),
        }
    }

    async fn send(&self, producer: &mut Producer, row: usize) -> Result<u64, ProducerError> {
        match self {
            Self::Values(columns) => {
                let (state, time_nanos, value) = columns.row(row);
                producer.send(state, time_nanos, value).await
            }
            Self::Labels(columns) => {
                let (name, time_nanos, _) = columns.row(row);
                let (state, label) = name.split_once('/').unwrap_or((name, ""));
                producer.send_label(state, time_nanos, label).await
            }
            Self::Positions(columns, places) => {
                let (state, time_nanos, _) = columns.row(row);
                producer.send_position(state, time_nanos, &places.row(row).to_vec()).await
            }
            Self::Traversals(reports) => producer.send_traversal(&reports[row]).await,
            Self::Sightings(reports) => producer.send_sighting(&reports[row]).await,
        }
    }
}

/// The counts of the rows that were sent.
#[derive(Clone, Debug, Default)]
pub(crate) struct SentCounts {
    /// Rows that are durable now, of this call or before.
    pub(crate) durable: u64,
    pub(crate) accepted: u64,
    pub(crate) duplicate: u64,
    pub(crate) refused: u64,
    /// Row, counted from 0, and why it was refused; the first ones.
    pub(crate) refusals: Vec<(u64, String)>,
}

/// The end of sending.
pub(crate) enum Outcome {
    Whole(SentCounts),
    /// The rows differ from the rows that were sent before; the text states how.
    Differs(String),
    Stopped(ProducerError),
}

/// The kind of that name.
fn kind_named(py: Python<'_>, name: &str) -> PyResult<StateShape> {
    let mut kinds = StateKind::ALL.into_iter().map(StateShape::from).chain([StateShape::Angle]);
    kinds.find(|kind| kind.name() == name).ok_or_else(|| {
        failure::invalid(py, &format!("kind {name:?}: probability, continuous, count, angle or categorical"))
    })
}

/// The kind whose rows are labels.
pub(crate) const CATEGORICAL: &str = "categorical";

/// The states of a producer: their kind and their reporting, which go together.
pub(crate) fn states_of(
    py: Python<'_>,
    kind: Option<&str>,
    given: Option<GivenReporting>,
) -> PyResult<(Option<StateShape>, Option<StatedReporting>)> {
    if kind == Some(CATEGORICAL) && given.is_some() {
        return Err(failure::invalid(py, "kind=\"categorical\" does not go with reports: labels are samples"));
    }
    let kind = kind.filter(|name| *name != CATEGORICAL).map(|name| kind_named(py, name)).transpose()?;
    let reporting = given.map(|given| stated(py, given)).transpose()?;
    if let (Some(kind), Some(reporting)) = (kind, reporting)
        && !kind.may_report(reporting.for_new())
    {
        let advice = if reporting.kind() == RowKind::Events { ": events are of kind \"count\"" } else { "" };
        let (kind, reports) = (kind.name(), reporting.kind().name());
        let message = format!("kind={kind:?} does not go with reports={reports:?}{advice}");
        return Err(failure::invalid(py, &message));
    }
    Ok((kind, reporting))
}

/// Sends all rows and waits until they are durable.
pub(crate) async fn send(
    client: Client,
    options: ProducerOptions,
    content: Rows,
    shared: Arc<Mutex<SentCounts>>,
) -> Outcome {
    let (name, label) = (options.producer.clone(), options.label.clone());
    let mut producer = match Producer::open(&client, options).await {
        Ok(producer) => producer,
        Err(error) => return Outcome::Stopped(error),
    };
    let progress = producer.progress();
    let (before, dropped_before) = (progress.resumed_at, progress.dropped_refusals);
    let rows = content.len();
    if let Err(how) = compare(&content, before, progress.content_crc) {
        let may_replace = matches!(content, Rows::Values(_) | Rows::Positions(..));
        return differs(&name, &label, &how, may_replace);
    }
    let first = usize::try_from(before).unwrap_or(usize::MAX).min(rows);
    let mut counts = SentCounts { durable: before, duplicate: before.min(rows as u64), ..SentCounts::default() };
    for row in first..rows {
        if let Err(error) = content.send(&mut producer, row).await {
            return Outcome::Stopped(error);
        }
        if row % CHUNK == 0 {
            collect(&mut producer, &mut counts);
            shared.lock().unwrap_or_else(PoisonError::into_inner).durable = producer.progress().durable_sequence;
        }
    }
    let closed = producer.close().await;
    collect(&mut producer, &mut counts);
    let progress = match closed {
        Ok(progress) => progress,
        Err(error) => return Outcome::Stopped(error),
    };
    counts.refused += progress.dropped_refusals.saturating_sub(dropped_before);
    counts.durable = progress.durable_sequence;
    counts.accepted = progress.durable_sequence.saturating_sub(before).saturating_sub(counts.refused);
    Outcome::Whole(counts)
}

/// The exception if the data that was sent before is not the beginning of this data.
pub(crate) fn differs(producer: &str, label: &str, how: &str, may_replace: bool) -> Outcome {
    let label = if label.is_empty() { String::new() } else { format!(", label {label:?},") };
    let replace = if may_replace { ", or replace the data sent before (replace=True)" } else { "" };
    Outcome::Differs(format!(
        "this does not continue what producer {producer:?}{label} has sent to the map: {how}. Send everything from the \
         first, or give the data a label of its own (label=\"…\"){replace}"
    ))
}

/// Compares the rows that the daemon has with the first of these.
fn compare(content: &Rows, before: u64, content_crc: u32) -> Result<(), String> {
    let rows = content.len();
    if before > rows as u64 {
        return Err(format!("there are {rows} rows, but {before} were sent before"));
    }
    let mut crc = ContentCrc::default();
    for row in 0..before as usize {
        content.add_to(&mut crc, row);
    }
    if before > 0 && crc.value() != content_crc {
        return Err(format!("the first {before} rows are not the {before} that were sent before"));
    }
    Ok(())
}

/// Takes the refusals that have arrived.
pub(crate) fn collect(producer: &mut Producer, counts: &mut SentCounts) {
    for refusal in producer.take_refusals() {
        counts.refused += 1;
        if counts.refusals.len() < REFUSALS_LISTED {
            counts.refusals.push((refusal.sequence.saturating_sub(1), refusal.detail));
        }
    }
}
