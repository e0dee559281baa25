//! Single readings in one request: a stream of one batch.
//!
//! Invariant: the reply comes when the readings are durable or refused, as on a stream.

use std::time::Duration;

use tidemap_proto::{
    bounds::READINGS,
    convert::{OverLimit, observe::readings_to_columns},
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

/// Whether another stream has the key.
fn is_taken(status: &Status) -> bool {
    status.code() == Code::AlreadyExists
}

impl Observations {
    /// Takes the readings of a request.
    pub(super) async fn take_report(&self, request: v1::ReportRequest) -> Result<v1::ReportResponse, Status> {
        self.take_readings(request, false).await
    }

    /// As [`Observations::take_report`], for readings that may differ when they are sent again: what was taken with
    /// their numbers stays.
    pub(super) async fn take_report_once(&self, request: v1::ReportRequest) -> Result<v1::ReportResponse, Status> {
        self.take_readings(request, true).await
    }

    async fn take_readings(&self, request: v1::ReportRequest, may_differ: bool) -> Result<v1::ReportResponse, Status> {
        // Whether the caller may see the map comes first.
        find_map(&self.catalog, &request.map).await?;
        OverLimit::check("readings", request.readings.len(), READINGS, "a report; use Observe for more")
            .map_err(RpcError::from)?;
        let now = self.catalog.context().clock.now_nanos();
        let observations = readings_to_columns(&request.readings, now).map_err(RpcError::from)?;
        let hello = v1::Hello {
            producer: request.producer,
            label: request.label,
            map: request.map,
            reporting: request.reporting,
            ..Default::default()
        };
        let observations = Some(observations);
        let batch =
            |first_sequence| Up::Batch(v1::ObservationBatch { first_sequence, observations: observations.clone() });
        let once = may_differ.then_some(request.readings.len() as u64);
        self.report_within(&hello, request.first_sequence, once, &batch).await
    }

    /// Takes one batch, as a stream of its own, and tries until no other stream has the key. `first_sequence`: 0 for
    /// the next number. `once`: the number of items that are not compared if the map has all of their numbers.
    pub(in crate::rpc) async fn report_within(
        &self,
        hello: &v1::Hello,
        first_sequence: u64,
        once: Option<u64>,
        batch: &(impl Fn(u64) -> Up + Send + Sync),
    ) -> Result<v1::ReportResponse, Status> {
        let deadline = Instant::now() + KEY_WITHIN;
        loop {
            match self.run_report(hello, first_sequence, once, batch).await {
                Err(status) if is_taken(&status) && Instant::now() < deadline => tokio::time::sleep(KEY_POLL).await,
                result => return result,
            }
        }
    }

    /// Sends a batch through a stream of its key.
    async fn run_report(
        &self,
        hello: &v1::Hello,
        first_sequence: u64,
        once: Option<u64>,
        batch: &(impl Fn(u64) -> Up + Send + Sync),
    ) -> Result<v1::ReportResponse, Status> {
        let (up, requests) = mpsc::channel(2);
        let send = |message| drop(up.try_send(Ok(v1::ObserveRequest { message: Some(message) })));
        // The channel has room for both messages.
        send(Up::Hello(hello.clone()));
        let mut replies = self.start(ReceiverStream::new(requests))?;
        let mut reply = v1::ReportResponse::default();
        let welcome = loop {
            match replies.recv().await.ok_or(RpcError::Stopping)??.message {
                Some(Down::Welcome(welcome)) => break welcome,
                Some(Down::Goodbye(_)) | None => {}
                Some(_) => return Err(Status::internal("a stream began without a welcome")),
            }
        };
        let first_sequence = match first_sequence {
            0 => welcome.durable_sequence + 1,
            sequence => sequence,
        };
        let last = once.map(|count| first_sequence.saturating_add(count.saturating_sub(1)));
        if last.is_some_and(|last| last <= welcome.durable_sequence) {
            reply.durable_sequence = welcome.durable_sequence;
            return Ok(reply);
        }
        send(batch(first_sequence));
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
