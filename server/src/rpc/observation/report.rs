//! Single readings in one request: a stream of one batch.
//!
//! Invariant: the reply comes when the readings are durable or refused, as on a stream.

use std::{collections::HashMap, time::Duration};

use tidemap_proto::{
    bounds::READINGS,
    convert::{InvalidField, OverLimit, time::nanos_from_timestamp},
    v1::{self, observe_request::Message as Up, observe_response::Message as Down},
};
use tokio::{sync::mpsc, time::Instant};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Code, Status};

use super::Observations;
use crate::rpc::{lookup::find_map, status::RpcError};

/// How long a report waits for the stream of its key to end.
const KEY_WITHIN: Duration = Duration::from_secs(2);
const KEY_POLL: Duration = Duration::from_millis(20);

/// A state as the batch names it.
struct Named {
    index: u32,
    kind: v1::StateKind,
    dimensions: u32,
}

/// The columns of readings, whose default time is `now` in nanoseconds.
fn columns(readings: &[v1::Reading], now: i64) -> Result<v1::ObservationColumns, InvalidField> {
    let mut columns = v1::ObservationColumns { time_unit_nanos: 1, ..Default::default() };
    let mut named: HashMap<&str, Named> = HashMap::new();
    let mut before = None;
    for (i, reading) in readings.iter().enumerate() {
        let field = |name: &str| format!("readings[{i}].{name}");
        let time = reading.time.map_or(Ok(now), |time| nanos_from_timestamp(&field("time"), time))?;
        let dimensions = u32::try_from(reading.position.len()).unwrap_or(u32::MAX);
        if !matches!(dimensions, 0 | 2 | 3) {
            let text = format!("{dimensions} coordinates: a position has 2 or 3");
            return Err(InvalidField::new(field("position"), text));
        }
        let kind = match reading.kind() {
            v1::StateKind::Unspecified if dimensions > 0 => v1::StateKind::Vector,
            kind => kind,
        };
        let next = u32::try_from(named.len()).unwrap_or(u32::MAX);
        let state = named.entry(&reading.state).or_insert_with(|| {
            columns.new_states.push(reading.state.clone());
            columns.new_kinds.push(kind.into());
            columns.new_dimensions.push(dimensions);
            Named { index: next, kind, dimensions }
        });
        if state.kind != kind || state.dimensions != dimensions {
            let text = "all readings of a state have the same kind and number of coordinates";
            return Err(InvalidField::new(field("kind"), text));
        }
        columns.state_indices.push(state.index);
        let delta = time - *before.get_or_insert(time);
        before = Some(time);
        columns.first_time_nanos = if i == 0 { time } else { columns.first_time_nanos };
        columns.time_deltas.push(delta);
        columns.values.push(reading.value);
        columns.coordinates.extend_from_slice(&reading.position);
    }
    if columns.new_dimensions.iter().all(|dimensions| *dimensions == 0) {
        columns.new_dimensions.clear();
    }
    Ok(columns)
}

/// Whether another stream has the key.
fn is_taken(status: &Status) -> bool {
    status.code() == Code::AlreadyExists
}

impl Observations {
    /// Takes the readings of a request.
    pub(super) async fn take_report(&self, request: v1::ReportRequest) -> Result<v1::ReportResponse, Status> {
        // Whether the caller may see the map comes first.
        find_map(&self.catalog, &request.map).await?;
        if request.readings.is_empty() {
            let invalid = InvalidField::new("readings", "there is none: send at least one");
            return Err(RpcError::from(invalid).into());
        }
        OverLimit::check("readings", request.readings.len(), READINGS, "a report; use Observe for more")
            .map_err(RpcError::from)?;
        let now = self.catalog.context().clock.now_nanos();
        let observations = columns(&request.readings, now).map_err(RpcError::from)?;
        let deadline = Instant::now() + KEY_WITHIN;
        loop {
            match self.run_report(&request, &observations).await {
                Err(status) if is_taken(&status) && Instant::now() < deadline => tokio::time::sleep(KEY_POLL).await,
                result => return result,
            }
        }
    }

    /// Sends the readings through a stream of their key.
    async fn run_report(
        &self,
        request: &v1::ReportRequest,
        observations: &v1::ObservationColumns,
    ) -> Result<v1::ReportResponse, Status> {
        let (up, requests) = mpsc::channel(2);
        let send = |message| drop(up.try_send(Ok(v1::ObserveRequest { message: Some(message) })));
        let hello = v1::Hello {
            producer: request.producer.clone(),
            label: request.label.clone(),
            map: request.map.clone(),
            ..Default::default()
        };
        // The channel has room for both messages.
        send(Up::Hello(hello));
        let mut replies = self.start(ReceiverStream::new(requests))?;
        let mut reply = v1::ReportResponse::default();
        let welcome = loop {
            match replies.recv().await.ok_or(RpcError::Stopping)??.message {
                Some(Down::Welcome(welcome)) => break welcome,
                Some(Down::Goodbye(_)) | None => {}
                Some(_) => return Err(Status::internal("a stream began without a welcome")),
            }
        };
        let first_sequence = match request.first_sequence {
            0 => welcome.durable_sequence + 1,
            sequence => sequence,
        };
        send(Up::Batch(v1::ObservationBatch { first_sequence, observations: Some(observations.clone()) }));
        drop(up);
        while let Some(message) = replies.recv().await {
            if let Some(Down::Ack(ack)) = message?.message {
                reply.durable_sequence = ack.durable_sequence;
                reply.refused.extend(ack.refused);
            }
        }
        Ok(reply)
    }
}
