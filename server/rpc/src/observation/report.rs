//! Observations and reports in one request, without a stream.
//!
//! Invariant: the reply is sent when all observations and reports are durable or refused. A request has a task of its
//! own: nothing that was handed to the writer is lost when the client goes away.

use std::time::Duration;

use tidemap_base::{shares::client::Client, telemetry::traces::Span};
use tidemap_ingest::protocol::{HelloError, RefusedObservation};
use tidemap_proto::{
    bounds::READINGS,
    convert::{
        InvalidField, OverLimit,
        observe::{StreamMessage, StreamStart, readings_from_wire, start_of_request},
    },
    v1,
};
use tokio::time::Instant;

use super::{
    Observations,
    acknowledgements::Acknowledgements,
    open_streams::StreamEntry,
    opening::{open_session, take_seat},
    session::OpenSession,
};
use crate::{acks::refusal_to_wire, guard::current_caller, lookup::find_map, status::RpcError};

/// Maximum time that a request waits for the stream of its key to end.
const KEY_WITHIN: Duration = Duration::from_secs(2);
const KEY_POLL: Duration = Duration::from_millis(20);

/// The sender of a request, and the sequence numbers of its items.
#[derive(Clone, Debug)]
pub(crate) struct SentAs {
    /// Name of the map.
    pub map: String,
    /// The producer, and how its states are reported.
    pub start: StreamStart,
    /// Number of the first item; 0: the next number.
    pub first_sequence: u64,
    /// The number of items that may differ when they are sent again: the daemon keeps the content that it has first
    /// taken with their numbers.
    pub may_differ: Option<u64>,
}

/// The outcome of a request.
#[derive(Clone, Debug, Default)]
pub(crate) struct TakenItems {
    /// All numbers up to this one are durable or refused.
    pub durable_sequence: u64,
    /// The refused items.
    pub refused: Vec<RefusedObservation>,
}

impl TakenItems {
    /// The refused items, for the wire.
    pub(crate) fn refused_to_wire(self) -> Vec<v1::Refusal> {
        self.refused.into_iter().map(refusal_to_wire).collect()
    }
}

impl Observations {
    /// Takes the readings of a request.
    pub(super) async fn take_readings(&self, request: v1::ReportRequest) -> Result<v1::ReportResponse, RpcError> {
        // The check whether the caller may see the map comes first.
        find_map(&self.catalog, &request.map).await?;
        OverLimit::check("readings", request.readings.len(), READINGS, "a report; use Observe for more")?;
        let readings = readings_from_wire(&request.readings, self.catalog.context().clock.now_nanos())?;
        let start = start_of_request(&request)?;
        let sent_as = SentAs { map: request.map, start, first_sequence: request.first_sequence, may_differ: None };
        let items = |first| Ok(StreamMessage::Observations(readings.numbered(first)?));
        let taken = self.take_items(sent_as, items).await?;
        Ok(v1::ReportResponse { durable_sequence: taken.durable_sequence, refused: taken.refused_to_wire() })
    }

    /// Takes the items of a request, which are made for the number of the first. Waits for a short time if a stream has
    /// the key.
    ///
    /// # Errors
    /// The reason why the items are not taken.
    pub(crate) async fn take_items(
        &self,
        sent_as: SentAs,
        items: impl FnOnce(u64) -> Result<StreamMessage, InvalidField> + Send + 'static,
    ) -> Result<TakenItems, RpcError> {
        let service = self.clone();
        let mut entry = self.streams.enter(&Client::current())?;
        let work = async move { take_items(&service, &mut entry, &sent_as, items).await };
        let task = tidemap_base::task::spawn(Span::current().scope(current_caller().scope(work)));
        task.await?
    }
}

async fn take_items(
    service: &Observations,
    entry: &mut StreamEntry,
    sent_as: &SentAs,
    items: impl FnOnce(u64) -> Result<StreamMessage, InvalidField>,
) -> Result<TakenItems, RpcError> {
    let SentAs { map, start, .. } = sent_as;
    let handle = take_seat(service, entry, map, start).await?;
    let deadline = Instant::now() + KEY_WITHIN;
    let opened = loop {
        match open_session(&handle, (start, entry.client()), None).await {
            Err(RpcError::Hello(HelloError::AlreadyStreaming { .. })) if Instant::now() < deadline => {
                tokio::time::sleep(KEY_POLL).await;
            }
            result => break result?,
        }
    };
    let acknowledgements = Acknowledgements::Request(Vec::new());
    let mut session = OpenSession::new(service, handle, opened, start.reporting, acknowledgements, entry);
    let result = take_in(&mut session, sent_as, items).await;
    session.end(result.as_ref().err());
    result?;
    Ok(TakenItems { durable_sequence: session.durable(), refused: session.take_refused() })
}

/// Takes the items in an open session, and waits until they are durable or refused.
async fn take_in(
    session: &mut OpenSession<'_>,
    SentAs { first_sequence, may_differ, .. }: &SentAs,
    items: impl FnOnce(u64) -> Result<StreamMessage, InvalidField>,
) -> Result<(), RpcError> {
    let durable = session.durable();
    let first_sequence = match first_sequence {
        0 => durable + 1,
        sequence => *sequence,
    };
    let last = may_differ.map(|count| first_sequence.saturating_add(count.saturating_sub(1)));
    if last.is_some_and(|last| last <= durable) {
        return Ok(());
    }
    session.ready().await?;
    session.take(items(first_sequence)?).await?;
    session.drain().await
}
