//! The task behind a producer: one connection after the other; on each it sends a Hello and then batches, and receives
//! acknowledgements.
//!
//! Invariant: the task decides nothing about observations; the window does. [`ending`] and [`refused`] alone decide
//! whether an end is final or followed by another attempt, unless the producer may leave anyway.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use tidemap_proto::{
    convert::{map::refusal_from_wire, reporting::stated_reporting_to_wire},
    read_token::ReadToken,
    v1::{
        Ack, Alive, Goodbye, GoodbyeReason, Hello, ObserveRequest, ObserveResponse, ProducerSensor, Welcome,
        observation_service_client::ObservationServiceClient, observe_request, observe_response,
    },
};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Code, Status, Streaming};
use tonic_types::StatusExt as _;

use super::{
    Phase, ProducerError, Refusal,
    outgoing::{MessageLimits, Outgoing},
    retry::Outage,
    shared::Shared,
    window::Window,
};
use crate::{
    connection::{Client, StreamPlace},
    error::{Error, ServerError},
};

/// Number of batches that wait to be written to the connection. More would only be in memory twice.
const QUEUED_BATCHES: usize = 2;
/// Pause between two attempts to get a key that another stream holds.
const KEY_PAUSE: Duration = Duration::from_millis(200);

/// The end of a connection.
enum End {
    /// Try again.
    Broken(Error),
    /// The daemon needs the place while nothing is sent: try again when there is more to send.
    Idle,
    Final(ProducerError),
}

impl From<ProducerError> for End {
    fn from(error: ProducerError) -> Self {
        Self::Final(error)
    }
}

pub(super) struct Link {
    client: Client,
    place: StreamPlace,
    shared: Arc<Shared>,
    /// Number of the map in its cluster, from the last Welcome.
    map_uid: u64,
    /// The incarnation of the last Welcome; before the first Welcome, the incarnation of the options.
    incarnation: u64,
    outage: Outage,
    epoch: Instant,
}

impl Link {
    pub(super) fn new(client: Client, shared: Arc<Shared>) -> Self {
        let (place, outage) = (client.stream_place(), Outage::new(shared.options.patience));
        let incarnation = shared.options.incarnation;
        Self { client, place, shared, map_uid: 0, incarnation, outage, epoch: Instant::now() }
    }

    pub(super) async fn run(mut self) {
        let mut has_sent_hello = false;
        let mut key_deadline = None;
        loop {
            let error = match self.connection().await {
                // The daemon may not have noticed yet that an earlier stream of the key has ended.
                End::Final(ProducerError::KeyInUse(_)) if self.waits_for_key(&mut key_deadline) => {
                    if self.left_during(KEY_PAUSE).await {
                        return self.finish(ProducerError::Closed);
                    }
                    continue;
                }
                // An earlier Hello, whose Welcome was lost with its connection, may hold the key until the daemon
                // notices.
                End::Final(ProducerError::KeyInUse(detail)) if has_sent_hello && self.incarnation == 0 => {
                    Error::Server(ServerError::new(Code::AlreadyExists, detail))
                }
                End::Final(error) => return self.finish(error),
                End::Idle if self.left_while_idle().await => return self.finish(ProducerError::Closed),
                End::Idle => continue,
                End::Broken(error) => error,
            };
            if self.may_leave() {
                return self.finish(ProducerError::Closed);
            }
            has_sent_hello = true;
            let Some(delay) = self.outage.failed(self.epoch.elapsed()) else {
                let waited_secs = self.outage.lasted(self.epoch.elapsed()).as_secs();
                return self.finish(ProducerError::GaveUp { waited_secs, last: error });
            };
            self.shared.progress.send_modify(|progress| progress.phase = Phase::Waiting(error));
            if self.left_during(delay).await {
                return self.finish(ProducerError::Closed);
            }
        }
    }

    /// Whether to try again for a key that another stream holds; the deadline is set the first time.
    fn waits_for_key(&self, deadline: &mut Option<Duration>) -> bool {
        let now = self.epoch.elapsed();
        let deadline = *deadline.get_or_insert_with(|| now + self.shared.options.key_patience);
        self.incarnation == 0 && now < deadline
    }

    /// Whether the producer may end without the daemon: everything is durable, and the nightly updates of the daemon do
    /// not wait for this producer.
    fn may_leave(&self) -> bool {
        !self.shared.options.nightly && self.is_closing()
    }

    /// Waits before the next attempt; returns `true` early if none is needed any more.
    async fn left_during(&self, delay: Duration) -> bool {
        let pause = tokio::time::sleep(delay);
        tokio::pin!(pause);
        loop {
            tokio::select! {
                () = &mut pause => return false,
                // Other reasons, such as more to send, are handled by the next connection.
                () = self.shared.more.notified() => if self.may_leave() {
                    return true;
                }
            }
        }
    }

    /// Waits until there is more to send; returns `true` if the producer ends without that.
    async fn left_while_idle(&self) -> bool {
        loop {
            if self.may_leave() {
                return true;
            }
            let is_needed = {
                let state = self.shared.state();
                state.closing || state.window.as_ref().is_none_or(|window| window.durable() < window.last())
            };
            if is_needed {
                return false;
            }
            self.shared.more.notified().await;
        }
    }

    fn finish(&self, error: ProducerError) {
        self.shared.progress.send_modify(|progress| progress.phase = Phase::Ended(error));
    }

    async fn connection(&mut self) -> End {
        match self.stream().await {
            Ok(never) => match never {},
            Err(end) => end,
        }
    }

    async fn stream(&mut self) -> Result<std::convert::Infallible, End> {
        let (requests, outgoing) = mpsc::channel(QUEUED_BATCHES);
        // A new channel has room: this cannot fail.
        let _ = requests.try_send(hello(&self.shared, self.incarnation));
        let mut service = ObservationServiceClient::new(self.place.connection());
        let answer = service.observe(ReceiverStream::new(outgoing)).await;
        let mut replies = answer.map_err(|status| refused(self.client.error(&status)))?.into_inner();
        let welcome = match self.reply(&mut replies).await? {
            observe_response::Message::Welcome(welcome) => welcome,
            observe_response::Message::Goodbye(goodbye) => return Err(ending(goodbye)),
            _ => return Err(protocol("no Welcome")),
        };
        let mut messages = self.welcome(&welcome)?;
        let mut is_probed = false;
        loop {
            if self.is_closing() {
                drop(requests);
                return Err(self.drained(&mut replies).await);
            }
            let ready = messages.is_ready(&self.shared.state());
            tokio::select! {
                reply = self.reply(&mut replies) => match reply? {
                    observe_response::Message::Ack(ack) => self.acknowledge(ack)?,
                    observe_response::Message::Goodbye(goodbye) => {
                        self.acknowledge(Ack { durable_sequence: goodbye.durable_sequence, refused: Vec::new(), position: 0 })?;
                        return Err(ending(goodbye));
                    }
                    // For information: the flow control of the connection throttles sending.
                    observe_response::Message::Busy(_) => {}
                    observe_response::Message::Probe(_) => is_probed = true,
                    observe_response::Message::Welcome(_) => return Err(protocol("a second Welcome")),
                },
                // If the connection is closing, the replies contain the reason.
                Ok(permit) = requests.reserve(), if ready || is_probed => {
                    if std::mem::take(&mut is_probed) {
                        permit.send(ObserveRequest { message: Some(observe_request::Message::Alive(Alive {})) });
                    } else if let Some(message) = messages.next(&mut self.shared.state()) {
                        permit.send(message);
                    }
                }
                () = self.shared.more.notified(), if !ready && !is_probed => {}
            }
        }
    }

    /// Whether the stream must end, and everything is acknowledged.
    fn is_closing(&self) -> bool {
        let state = self.shared.state();
        state.closing && state.window.as_ref().is_none_or(|window| window.durable() == window.last())
    }

    /// Waits until the daemon has ended the stream. Its reason does not matter: everything is durable.
    async fn drained(&self, replies: &mut Streaming<ObserveResponse>) -> End {
        while let Ok(Some(_)) = replies.message().await {}
        End::Final(ProducerError::Closed)
    }

    async fn reply(&self, replies: &mut Streaming<ObserveResponse>) -> Result<observe_response::Message, End> {
        match replies.message().await {
            Ok(Some(ObserveResponse { message: Some(message) })) => Ok(message),
            Ok(Some(_)) => Err(protocol("an empty message")),
            Ok(None) => Err(End::Broken(Error::Unreachable {
                server: self.client.server().to_owned(),
                detail: "the daemon ended the stream".to_owned(),
            })),
            Err(status) if is_idle(&status) => Err(End::Idle),
            Err(status) => Err(refused(self.client.error(&status))),
        }
    }

    fn welcome(&mut self, welcome: &Welcome) -> Result<Outgoing, End> {
        let options = &self.shared.options;
        let unreported = {
            let mut state = self.shared.state();
            let (durable, crc) = (welcome.durable_sequence, welcome.content_crc);
            let unreported = state.window.as_mut().map_or(Ok(0), |window| window.welcomed(durable, crc))?;
            let new = || Window::new(options.window, durable, crc).with_bytes(options.window_bytes);
            state.window.get_or_insert_with(new);
            unreported
        };
        self.incarnation = welcome.incarnation;
        self.map_uid = welcome.map_uid;
        self.outage.connected(self.epoch.elapsed());
        if unreported > 0 {
            self.outage.progressed();
        }
        self.shared.progress.send_modify(|progress| {
            progress.phase = Phase::Connected;
            progress.durable_sequence = welcome.durable_sequence;
            progress.resumed_at = welcome.durable_sequence;
            progress.content_crc = welcome.content_crc;
            progress.store_changes += u64::from(!progress.store_id.is_empty() && progress.store_id != welcome.store_id);
            progress.store_id.clone_from(&welcome.store_id);
            progress.unreported += unreported;
        });
        Ok(Outgoing::new(MessageLimits::of(welcome), self.shared.options.kind))
    }

    fn acknowledge(&mut self, ack: Ack) -> Result<(), End> {
        let seen = ReadToken { map_uid: self.map_uid, position: ack.position, generation: 0 };
        self.client.tokens().saw(&self.shared.options.map, seen);
        let dropped = {
            let mut state = self.shared.state();
            let dropped = state.keep_refusals(ack.refused.into_iter().map(refusal));
            if let Some(window) = &mut state.window {
                window.acknowledged(ack.durable_sequence)?;
            }
            dropped
        };
        self.shared.progress.send_if_modified(|progress| {
            let more = ack.durable_sequence > progress.durable_sequence;
            progress.durable_sequence = progress.durable_sequence.max(ack.durable_sequence);
            progress.dropped_refusals += dropped;
            if more {
                self.outage.progressed();
            }
            more || dropped > 0
        });
        Ok(())
    }
}

fn hello(shared: &Shared, incarnation: u64) -> ObserveRequest {
    let options = &shared.options;
    let hello = Hello {
        producer: options.producer.clone(),
        label: options.label.clone(),
        map: options.map.clone(),
        incarnation,
        nightly: options.nightly,
        sensor: options
            .sensor
            .map(|sensor| ProducerSensor { hit: Some(sensor.hit), false_alarm: Some(sensor.false_alarm) }),
        answers_probes: true,
        reporting: options.reporting.map(stated_reporting_to_wire),
    };
    ObserveRequest { message: Some(observe_request::Message::Hello(hello)) }
}

fn protocol(what: &'static str) -> End {
    End::Final(ProducerError::Other(Error::Protocol(what)))
}

/// The consequence of a Goodbye.
fn ending(goodbye: Goodbye) -> End {
    let reason = goodbye.reason();
    let detail = goodbye.detail;
    End::Final(match reason {
        GoodbyeReason::Shutdown => {
            let message = if detail.is_empty() { "the daemon is stopping".to_owned() } else { detail };
            return End::Broken(Error::Server(ServerError::new(Code::Unavailable, message)));
        }
        GoodbyeReason::DataMismatch => ProducerError::DataMismatch(detail),
        GoodbyeReason::OutOfSequence => ProducerError::OutOfSequence(detail),
        GoodbyeReason::Superseded => ProducerError::Superseded(detail),
        GoodbyeReason::DiskFull => ProducerError::Exhausted(detail),
        GoodbyeReason::Invalid => ProducerError::Invalid(detail),
        GoodbyeReason::MapDeleted => ProducerError::MapDeleted(detail),
        GoodbyeReason::Storage => ProducerError::Storage(detail),
        GoodbyeReason::Unspecified => ProducerError::Other(Error::Protocol("a Goodbye without a reason")),
    })
}

/// Whether the daemon ended the stream because nothing was sent for a long time.
fn is_idle(status: &Status) -> bool {
    status.code() == Code::Unavailable && status.get_details_error_info().is_some_and(|info| info.reason == "IDLE")
}

/// The consequence of a status.
fn refused(error: Error) -> End {
    let text = error.to_string();
    End::Final(match error.code() {
        Some(Code::Aborted) => ProducerError::Superseded(text),
        Some(Code::AlreadyExists) => ProducerError::KeyInUse(text),
        Some(Code::OutOfRange) => ProducerError::OutOfSequence(text),
        Some(Code::ResourceExhausted) => ProducerError::Exhausted(text),
        Some(Code::NotFound) => ProducerError::MapNotFound(text),
        Some(Code::InvalidArgument) => ProducerError::Invalid(text),
        Some(Code::DataLoss) => ProducerError::Storage(text),
        _ if error.is_transient() => return End::Broken(error),
        _ => ProducerError::Other(error),
    })
}

fn refusal(refusal: tidemap_proto::v1::Refusal) -> Refusal {
    Refusal { sequence: refusal.sequence, reason: refusal_from_wire(refusal.reason()), detail: refusal.detail }
}

#[cfg(test)]
mod tests;
