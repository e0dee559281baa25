//! `ObservationService`: a stream of observations in, acknowledgements out.
//!
//! Invariant: what a stream has sent and is not durable yet is bounded, per stream and in total, because room is
//! reserved before the next message is read. A stream has its own task: nothing that was handed to the writer is lost
//! when a client goes away.

use std::{
    collections::VecDeque,
    convert::Infallible,
    sync::Arc,
    time::{Duration, Instant},
};

use tidemap_grid::sensors::ProducerSensor;
use tidemap_map::{
    name::ProducerKey,
    traversal::{EdgeFailure, Traversal},
};
use tidemap_model::time::FUTURE_MAX_NANOS;
use tidemap_proto::{
    convert::{InvalidField, OverLimit, time::duration},
    v1::{
        self, observation_service_server::ObservationService, observe_request::Message as Up,
        observe_response::Message as Down,
    },
};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc, oneshot, watch};
use tokio_stream::{StreamExt as _, wrappers::ReceiverStream};
use tonic::{Code, Request, Response, Status, Streaming};
use tracing::{debug, warn};

use super::{RpcReply, acks::acks, status::RpcError};
use crate::{
    access::Caller,
    catalog::Catalog,
    ingest::{
        ending::{Ending, is_fatal},
        handle::MapHandle,
        intake::{Intake, IntakeError, IntakeLimits},
        probe::{Probed, probe},
        protocol::{
            BufferBudget, Command, Hello, HelloError, ObservationBatch, ScanBatch, SessionEvent, StreamData,
            TraversalBatch, Welcome,
        },
    },
    rpc::lookup::{check_producer, find_map},
    telemetry::traces::Span,
};

pub(crate) mod open_streams;
mod report;

use open_streams::{OpenStreams, StreamEntry};

/// A stream must say hello within this time.
const HELLO_WITHIN: Duration = Duration::from_secs(10);
/// A client must read its replies within this time.
const READ_WITHIN: Duration = Duration::from_secs(30);
/// After waiting this long, the daemon reports to a stream that the map is saturated.
const BUSY_AFTER: Duration = Duration::from_secs(1);
/// Replies that wait for the client.
const REPLIES_AHEAD: usize = 16;
/// Memory of a decoded observation, in bytes.
const OBSERVATION_BYTES: usize = 24;
/// Additional memory of a position: its coordinates, and an observation of each axis.
const POSITION_BYTES: usize = 112;
/// Memory of a refused observation with its reason, in bytes, about.
const REFUSED_BYTES: usize = 300;
/// Memory of a name besides its text, in bytes, about.
const NAME_BYTES: usize = 64;

/// Limits of streams.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StreamLimits {
    /// Limits of what a stream sends.
    pub intake: IntakeLimits,
    /// Maximum size of one message, in bytes.
    pub max_message_bytes: usize,
    /// Maximum size of what one stream has sent and is not durable yet, in bytes.
    pub max_stream_buffer: usize,
}

#[derive(Debug)]
pub(crate) struct Observations {
    pub catalog: Arc<Catalog>,
    pub limits: StreamLimits,
    /// Room for all streams together, in bytes.
    pub buffers: Arc<Semaphore>,
    /// Room for the tables of tiles and the unfinished scans of all streams together, in units of 1 KiB.
    pub tables: Arc<Semaphore>,
    /// The open streams.
    pub streams: OpenStreams,
    /// Becomes true when the daemon stops.
    pub stopping: watch::Receiver<bool>,
}

#[tonic::async_trait]
impl ObservationService for Observations {
    type ObserveStream = ReceiverStream<Result<v1::ObserveResponse, Status>>;

    async fn observe(&self, request: Request<Streaming<v1::ObserveRequest>>) -> RpcReply<Self::ObserveStream> {
        Ok(Response::new(ReceiverStream::new(self.start(request.into_inner())?)))
    }

    async fn report(&self, request: Request<v1::ReportRequest>) -> RpcReply<v1::ReportResponse> {
        Ok(Response::new(self.take_report(request.into_inner()).await?))
    }
}

impl Observations {
    /// Starts a stream and gives its replies. The stream has a task of its own, which works for the same caller.
    fn start(
        &self,
        mut requests: impl Requests + 'static,
    ) -> Result<mpsc::Receiver<Result<v1::ObserveResponse, Status>>, RpcError> {
        let mut entry = self.streams.enter()?;
        let (replies, stream) = mpsc::channel(REPLIES_AHEAD);
        let catalog = Arc::clone(&self.catalog);
        let limits = self.limits;
        let room = (Arc::clone(&self.buffers), Arc::clone(&self.tables));
        let stopping = self.stopping.clone();
        tokio::spawn(Span::current().scope(Caller::current().scope(async move {
            let result = open_and_serve(catalog, limits, room, &mut entry, stopping, &mut requests, &replies).await;
            if let Err(error) = result {
                debug!(%error, "stream ended");
                // The client may be gone.
                let _ = tokio::time::timeout(READ_WITHIN, replies.send(Err(error.into()))).await;
            }
            drop(entry);
        })));
        Ok(stream)
    }
}

/// The messages of a stream.
trait Requests: tokio_stream::Stream<Item = Result<v1::ObserveRequest, Status>> + Send + Unpin {}

impl<T: tokio_stream::Stream<Item = Result<v1::ObserveRequest, Status>> + Send + Unpin> Requests for T {}

type Replies = mpsc::Sender<Result<v1::ObserveResponse, Status>>;

async fn reply(replies: &Replies, message: Down) -> Result<(), RpcError> {
    let response = v1::ObserveResponse { message: Some(message) };
    match tokio::time::timeout(READ_WITHIN, replies.send(Ok(response))).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(_)) => Err(RpcError::Broken),
        Err(_) => Err(RpcError::SlowReader(READ_WITHIN.as_secs())),
    }
}

/// The error of a message that could not be read.
fn unread(status: &Status, limits: &StreamLimits) -> RpcError {
    match status.code() {
        Code::OutOfRange => {
            let (what, max) = ("bytes of one message", limits.max_message_bytes as u64);
            OverLimit { what, got: None, max, setting: "setting max_message_bytes" }.into()
        }
        // The codec's bound of elements.
        Code::ResourceExhausted => InvalidField::new("message", status.message()).into(),
        // With a source it is the connection's error, not the message's.
        Code::Internal | Code::InvalidArgument if std::error::Error::source(status).is_none() => {
            InvalidField::new("message", status.message()).into()
        }
        // The guard's, which ends both bodies of a request; whichever is seen first, the client hears the same.
        Code::Unauthenticated => RpcError::Revoked,
        _ => {
            debug!(%status, "stream broke");
            RpcError::Broken
        }
    }
}

fn key(hello: &v1::Hello) -> Result<ProducerKey, InvalidField> {
    // One after the other, to name the invalid field.
    ProducerKey::new(&hello.producer, "").map_err(|error| InvalidField::new("hello.producer", error))?;
    ProducerKey::new(&hello.producer, &hello.label).map_err(|error| InvalidField::new("hello.label", error))
}

/// A sensor, with defaults; the map's writer checks it.
fn sensor(wire: &v1::ProducerSensor) -> ProducerSensor {
    ProducerSensor { hit: wire.hit.unwrap_or(1.0), false_alarm: wire.false_alarm.unwrap_or(0.0) }
}

/// Memory of a batch until it is durable, about.
fn bytes_of(batch: &ObservationBatch) -> usize {
    let names =
        batch.new_names.iter().map(|name| NAME_BYTES + name.as_ref().map_or(0, |name| name.name.as_str().len()));
    64 + OBSERVATION_BYTES * batch.values.len()
        + POSITION_BYTES * batch.positions.len()
        + REFUSED_BYTES * batch.refused.len()
        + names.sum::<usize>()
}

/// Memory of traversals until they are durable, about: as they are, as observations with the names of their states, and
/// as failures.
fn bytes_of_traversals(batch: &TraversalBatch) -> usize {
    let texts = |traversal: &Traversal| 3 * traversal.edge.to_string().len() + 2 * traversal.reason.len();
    let each = |(_, traversal): &(u64, Traversal)| {
        size_of::<Traversal>() + 2 * (OBSERVATION_BYTES + NAME_BYTES) + texts(traversal) + size_of::<EdgeFailure>()
    };
    64 + batch.traversals.iter().map(each).sum::<usize>() + REFUSED_BYTES * batch.refused.len()
}

async fn open_and_serve(
    catalog: Arc<Catalog>,
    limits: StreamLimits,
    (buffers, tables): (Arc<Semaphore>, Arc<Semaphore>),
    entry: &mut StreamEntry,
    stopping: watch::Receiver<bool>,
    requests: &mut impl Requests,
    replies: &Replies,
) -> Result<(), RpcError> {
    if *stopping.borrow() {
        return Err(RpcError::Stopping);
    }
    let first = tokio::select! {
        first = tokio::time::timeout(HELLO_WITHIN, requests.next()) => first,
        () = entry.displaced() => return Err(RpcError::Idle(entry.idle_after())),
    };
    entry.mark_active();
    let first = match first {
        Ok(Some(Ok(v1::ObserveRequest { message: Some(Up::Hello(hello)) }))) => hello,
        Ok(None) => return Ok(()),
        Ok(Some(Err(status))) => return Err(unread(&status, &limits)),
        Ok(Some(Ok(_))) => {
            let text = "the first message of a stream must be a Hello";
            return Err(InvalidField::new("hello", text).into());
        }
        Err(_) => return Err(InvalidField::new("hello", "no Hello within 10 seconds").into()),
    };
    let handle = find_map(&catalog, &first.map).await?;
    let key = key(&first)?;
    check_producer(key.producer())?;
    let (probe, probed, questions) = probe();
    let probe = first.answers_probes.then_some(probe);
    let mut takes_over = None;
    let (opened, events) = loop {
        let (events_sender, events) = mpsc::unbounded_channel();
        let (answer, answered) = oneshot::channel();
        let hello = Hello {
            key: key.clone(),
            incarnation: first.incarnation,
            probe: probe.clone(),
            takes_over,
            nightly: first.nightly,
            sensor: first.sensor.as_ref().map(sensor),
            events: events_sender,
            reply: answer,
        };
        if !handle.send(Command::Hello(hello)) {
            return Err(RpcError::Stopping);
        }
        match answered.await.map_err(|_| RpcError::Stopping)? {
            Ok(opened) => break (opened, events),
            Err(HelloError::AlreadyStreaming { open: Some((session, probe)), .. })
                if takes_over != Some(session) && !probe.is_alive().await =>
            {
                takes_over = Some(session);
            }
            Err(error) => return Err(error.into()),
        }
    };
    entry.mark_active();
    let mut stream = Stream {
        intake: Some(
            Intake::new(opened.durable_sequence, opened.content_crc, limits.intake, handle.spec.grid.as_ref())
                .with_known_content(opened.content_marks.clone())
                .with_earliest_time(handle.spec.earliest_nanos()),
        ),
        own_buffer: Arc::new(Semaphore::new(limits.max_stream_buffer)),
        durable: opened.durable_sequence,
        handed_over: opened.durable_sequence,
        in_flight: VecDeque::new(),
        handle,
        opened,
        limits,
        buffers,
        tables,
        held: None,
        events,
        replies,
        probed,
        entry,
    };
    let result = tokio::select! {
        result = stream.serve(catalog.context().store.store_id(), requests) => result,
        never = pass_on_questions(questions, replies) => match never {},
    };
    let clean = matches!(result, Ok(()));
    // A writer that has stopped has no session to forget.
    let _ = stream.handle.send(Command::StreamData { session: stream.opened.session, data: StreamData::End { clean } });
    if let Err(error) = &result {
        stream.say_goodbye(error).await;
    }
    result
}

/// Sends a Probe whenever another stream wants this key. A client that does not read its replies does not answer
/// either.
async fn pass_on_questions(mut questions: mpsc::Receiver<()>, replies: &Replies) -> Infallible {
    while questions.recv().await.is_some() {
        // The stream's own replies fail as well, and end it.
        let _ = reply(replies, Down::Probe(v1::Probe {})).await;
    }
    std::future::pending().await
}

struct Stream<'a> {
    handle: Arc<MapHandle>,
    opened: Welcome,
    /// Taken out while it works in another thread.
    intake: Option<Intake>,
    limits: StreamLimits,
    buffers: Arc<Semaphore>,
    tables: Arc<Semaphore>,
    /// Room for this stream's table of tiles and its unfinished scan.
    held: Option<OwnedSemaphorePermit>,
    own_buffer: Arc<Semaphore>,
    events: mpsc::UnboundedReceiver<SessionEvent>,
    replies: &'a Replies,
    durable: u64,
    handed_over: u64,
    /// The last sequence number of each batch in flight, and when it was handed over.
    in_flight: VecDeque<(u64, Instant)>,
    probed: Probed,
    entry: &'a mut StreamEntry,
}

impl Stream<'_> {
    async fn serve(&mut self, store_id: &str, requests: &mut impl Requests) -> Result<(), RpcError> {
        let welcome = v1::Welcome {
            store_id: store_id.to_owned(),
            incarnation: self.opened.incarnation,
            durable_sequence: self.opened.durable_sequence,
            content_crc: self.opened.content_crc,
            max_batch_observations: u32::try_from(self.limits.intake.batch).unwrap_or(u32::MAX),
            max_batch_scans: u32::try_from(self.limits.intake.scans.batch_scans).unwrap_or(u32::MAX),
            max_scan_points: u32::try_from(self.limits.intake.scans.points).unwrap_or(u32::MAX),
            max_scan_tiles: u32::try_from(self.limits.intake.scans.tiles).unwrap_or(u32::MAX),
            max_message_bytes: u32::try_from(self.limits.max_message_bytes).unwrap_or(u32::MAX),
            max_ahead: Some(duration(FUTURE_MAX_NANOS)),
        };
        reply(self.replies, Down::Welcome(welcome)).await?;
        let mut saturated = self.handle.saturated();
        loop {
            let wait = *saturated.borrow_and_update();
            self.probed.pause(wait);
            tokio::select! {
                biased;
                event = self.events.recv() => self.pass_on(event).await?,
                () = self.entry.displaced() => {
                    self.drain().await?;
                    return Err(RpcError::Idle(self.entry.idle_after()));
                }
                _ = saturated.changed(), if wait => {}
                () = tokio::time::sleep(BUSY_AFTER), if wait => {
                    let retry_after = Some(duration(1_000_000_000));
                    reply(self.replies, Down::Busy(v1::Busy { retry_after })).await?;
                }
                request = requests.next(), if !wait => match request {
                    Some(Ok(request)) => self.take(request).await?,
                    // The producer has sent everything: what is in flight is acknowledged before the stream ends.
                    None => return self.drain().await,
                    Some(Err(status)) => return Err(unread(&status, &self.limits)),
                },
            }
        }
    }

    async fn take(&mut self, request: v1::ObserveRequest) -> Result<(), RpcError> {
        self.entry.mark_active();
        // Answers are not read until the message is taken.
        self.probed.pause(true);
        match request.message {
            Some(Up::Batch(batch)) => self.take_observations(batch).await,
            Some(Up::Scans(scans)) => self.take_scans(scans).await,
            Some(Up::Traversals(traversals)) => self.take_traversals(&traversals).await,
            Some(Up::Alive(v1::Alive {})) => {
                self.probed.answer();
                Ok(())
            }
            Some(Up::Hello(_)) | None => {
                let text = "after the Hello a message must be a batch, of observations, scans or traversals";
                Err(InvalidField::new("message", text).into())
            }
        }
    }

    fn intake(&mut self) -> Result<&mut Intake, RpcError> {
        self.intake.as_mut().ok_or(RpcError::Stopping)
    }

    async fn take_observations(&mut self, message: v1::ObservationBatch) -> Result<(), RpcError> {
        let Some(batch) = self.intake()?.take(message)? else { return self.say_durable().await };
        let only_names = batch.span.is_empty();
        let budget = self.budget(bytes_of(&batch)).await?;
        self.note(batch.span.last);
        self.hand_over(StreamData::Observations(batch, budget))?;
        // The writer does not acknowledge names.
        if only_names { self.say_durable().await } else { Ok(()) }
    }

    async fn take_scans(&mut self, message: v1::ScanBatch) -> Result<(), RpcError> {
        let is_much_work = self.intake()?.begin_scans(message)?;
        self.hold_tables()?;
        let mut is_any_new = false;
        while let Some(batch) = self.next_scans(is_much_work).await? {
            let budget = self.budget(batch.bytes).await?;
            is_any_new |= !batch.span.is_empty();
            self.note(batch.span.last);
            self.hand_over(StreamData::Scans(batch, budget))?;
        }
        // The writer acknowledges neither tiles nor what was taken before; an unfinished scan waits for its end.
        if is_any_new { Ok(()) } else { self.say_durable().await }
    }

    async fn take_traversals(&mut self, message: &v1::TraversalBatch) -> Result<(), RpcError> {
        let Some(batch) = self.intake()?.take_traversals(message)? else { return self.say_durable().await };
        let budget = self.budget(bytes_of_traversals(&batch)).await?;
        self.note(batch.span.last);
        self.hand_over(StreamData::Traversals(batch, budget))
    }

    /// Reserves room for the tiles that the stream's scans refer to, for the life of the stream. It does not wait,
    /// because other streams may hold the room for ever.
    fn hold_tables(&mut self) -> Result<(), RpcError> {
        let wanted = u32::try_from(self.intake()?.held_bytes().div_ceil(1024)).unwrap_or(u32::MAX);
        let held = self.held.as_ref().map_or(0, |held| u32::try_from(held.num_permits()).unwrap_or(u32::MAX));
        if wanted <= held {
            return Ok(());
        }
        let Ok(more) = Arc::clone(&self.tables).try_acquire_many_owned(wanted - held) else {
            let free = (held as usize).saturating_add(self.tables.available_permits()) as u64 * 1024;
            let what = "bytes of this stream's tiles and unfinished scan, beside those of other streams";
            let got = Some(u64::from(wanted) * 1024);
            return Err(OverLimit { what, got, max: free, setting: "setting max_stream_tables_bytes" }.into());
        };
        match &mut self.held {
            Some(held) => held.merge(more),
            none => *none = Some(more),
        }
        Ok(())
    }

    /// The next scans of the message, from a blocking thread if rays are cast.
    async fn next_scans(&mut self, is_much_work: bool) -> Result<Option<ScanBatch>, RpcError> {
        if !is_much_work {
            return Ok(self.intake()?.next_scans()?);
        }
        let mut intake = self.intake.take().ok_or(RpcError::Stopping)?;
        let work = tokio::task::spawn_blocking(move || {
            let batch = intake.next_scans();
            (intake, batch)
        });
        let (intake, batch) = work.await.map_err(|_| RpcError::Stopping)?;
        self.intake = Some(intake);
        Ok(batch?)
    }

    /// A batch up to this sequence number is handed over now.
    fn note(&mut self, last_sequence: u64) {
        if last_sequence > self.handed_over {
            self.in_flight.push_back((last_sequence, Instant::now()));
        }
        self.handed_over = last_sequence;
        self.entry.set_unacknowledged(self.durable < self.handed_over);
    }

    fn hand_over(&self, data: StreamData) -> Result<(), RpcError> {
        if self.handle.send(Command::StreamData { session: self.opened.session, data }) {
            Ok(())
        } else {
            Err(RpcError::Stopping)
        }
    }

    /// Reserves room for a batch; one that is larger than the whole room of a stream reserves all of it.
    async fn budget(&mut self, bytes: usize) -> Result<BufferBudget, RpcError> {
        let bytes = bytes.min(self.limits.max_stream_buffer);
        let own = self.room(&Arc::clone(&self.own_buffer), bytes).await?;
        Ok([own, self.room(&Arc::clone(&self.buffers), bytes).await?])
    }

    /// Answers a message without new observations.
    async fn say_durable(&self) -> Result<(), RpcError> {
        let ack = v1::Ack { durable_sequence: self.durable, refused: Vec::new() };
        reply(self.replies, Down::Ack(ack)).await
    }

    /// Waits for room, and forwards acknowledgements meanwhile, because they free room.
    async fn room(&mut self, semaphore: &Arc<Semaphore>, bytes: usize) -> Result<OwnedSemaphorePermit, RpcError> {
        let acquire = Arc::clone(semaphore).acquire_many_owned(u32::try_from(bytes).unwrap_or(u32::MAX));
        tokio::pin!(acquire);
        loop {
            tokio::select! {
                permit = &mut acquire => return permit.map_err(|_| RpcError::Stopping),
                event = self.events.recv() => self.pass_on(event).await?,
            }
        }
    }

    async fn drain(&mut self) -> Result<(), RpcError> {
        self.probed.pause(true);
        while self.durable < self.handed_over {
            let event = self.events.recv().await;
            self.pass_on(event).await?;
        }
        Ok(())
    }

    async fn pass_on(&mut self, event: Option<SessionEvent>) -> Result<(), RpcError> {
        match event {
            Some(SessionEvent::Ack { durable_sequence, refused }) => {
                let before = std::mem::replace(&mut self.durable, durable_sequence);
                self.entry.set_unacknowledged(self.durable < self.handed_over);
                while let Some((_, sent)) = self.in_flight.pop_front_if(|(last, _)| *last <= durable_sequence) {
                    metrics::histogram!("tidemap_acknowledgement_seconds").record(sent.elapsed());
                }
                for ack in acks(before, durable_sequence, refused) {
                    reply(self.replies, Down::Ack(ack)).await?;
                }
                Ok(())
            }
            Some(SessionEvent::End(ending)) => Err(RpcError::Ended(ending)),
            None => Err(RpcError::Stopping),
        }
    }

    async fn say_goodbye(&self, error: &RpcError) {
        let reason = match error {
            // The status says it. Clients connect again after it, as they do when a connection breaks.
            RpcError::Revoked | RpcError::Idle(_) => return,
            RpcError::Ended(Ending::Shutdown | Ending::Erasure) | RpcError::Stopping => v1::GoodbyeReason::Shutdown,
            RpcError::Ended(Ending::Superseded | Ending::Unanswered) => v1::GoodbyeReason::Superseded,
            RpcError::Ended(Ending::MapDeleted) => v1::GoodbyeReason::MapDeleted,
            RpcError::Ended(Ending::Storage(error)) if is_fatal(error) => v1::GoodbyeReason::Storage,
            RpcError::Ended(Ending::Storage(_)) => v1::GoodbyeReason::DiskFull,
            RpcError::Intake(IntakeError::OutOfSequence { .. }) => v1::GoodbyeReason::OutOfSequence,
            RpcError::Intake(IntakeError::DataMismatch { .. }) => v1::GoodbyeReason::DataMismatch,
            _ => v1::GoodbyeReason::Invalid,
        };
        if let RpcError::Intake(mismatch @ IntakeError::DataMismatch { .. }) = error {
            metrics::counter!("tidemap_data_mismatches_total").increment(1);
            warn!(map = self.handle.id.0, "a producer has sent other content again: {mismatch}");
        }
        let goodbye = v1::Goodbye { reason: reason.into(), durable_sequence: self.durable, detail: error.message() };
        // The status that follows says the same; the client may be gone.
        let _ = reply(self.replies, Down::Goodbye(goodbye)).await;
    }
}
