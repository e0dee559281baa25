//! An open stream: what it takes, what it waits for, and what it tells its client.
//!
//! Invariant: room is reserved for a batch before it is handed to the writer, and acknowledgements are passed on
//! meanwhile, because they free room.

use std::{
    collections::VecDeque,
    sync::Arc,
    time::{Duration, Instant},
};

use tidemap_model::{StatedReporting, time::FUTURE_MAX_NANOS};
use tidemap_proto::{
    convert::{
        OverLimit,
        observe::{ObservationMessage, StreamMessage, message_from_wire},
        reports::ReportMessage,
        scans::ScanMessage,
        time::duration,
    },
    v1::{self, observe_response::Message as Down},
};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tokio_stream::StreamExt as _;
use tracing::warn;

use super::{
    Observations,
    channel::{Replies, Requests, reply, unread},
    memory::{REPORT_BYTES_MAX, bytes_of, bytes_of_reports, bytes_of_sent},
    open_streams::StreamEntry,
};
use crate::{
    ingest::{
        ending::{Ending, is_fatal},
        handle::MapHandle,
        intake::{Intake, IntakeError},
        probe::Probed,
        protocol::{BufferBudget, Command, ScanBatch, SessionEvent, StreamData, Welcome},
    },
    rpc::{acks::acks, status::RpcError},
};

/// After waiting this long, the daemon reports to a stream that the map is saturated.
const BUSY_AFTER: Duration = Duration::from_secs(1);

/// An open stream.
pub(super) struct Stream<'a> {
    handle: Arc<MapHandle>,
    opened: Welcome,
    /// Taken out while it works in another thread.
    intake: Option<Intake>,
    service: &'a Observations,
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

impl<'a> Stream<'a> {
    /// A stream whose session was opened. `opened`: the writer's answer, and its messages.
    pub(super) fn new(
        service: &'a Observations,
        handle: Arc<MapHandle>,
        (opened, events): (Welcome, mpsc::UnboundedReceiver<SessionEvent>),
        reporting: Option<StatedReporting>,
        replies: &'a Replies,
        (probed, entry): (Probed, &'a mut StreamEntry),
    ) -> Self {
        let (durable, limits) = (opened.durable_sequence, service.limits);
        let intake = Intake::new(durable, opened.content_crc, limits.intake, handle.spec.grid.as_ref())
            .with_known_content(opened.content_marks.clone())
            .with_earliest_time(handle.spec.earliest_nanos())
            .with_reporting(reporting);
        Self {
            intake: Some(intake),
            own_buffer: Arc::new(Semaphore::new(limits.max_stream_buffer)),
            durable,
            handed_over: durable,
            in_flight: VecDeque::new(),
            handle,
            opened,
            service,
            held: None,
            events,
            replies,
            probed,
            entry,
        }
    }

    fn welcome(&self) -> v1::Welcome {
        let limits = self.service.limits;
        let direct = self.service.peers.as_ref().and_then(|peers| peers.address_of(peers.name()));
        v1::Welcome {
            store_id: self.service.catalog.context().identity().to_owned(),
            incarnation: self.opened.incarnation,
            durable_sequence: self.opened.durable_sequence,
            content_crc: self.opened.content_crc,
            max_batch_observations: u32::try_from(limits.intake.batch).unwrap_or(u32::MAX),
            max_batch_scans: u32::try_from(limits.intake.scans.batch_scans).unwrap_or(u32::MAX),
            max_scan_points: u32::try_from(limits.intake.scans.points).unwrap_or(u32::MAX),
            max_scan_tiles: u32::try_from(limits.intake.scans.tiles).unwrap_or(u32::MAX),
            max_message_bytes: u32::try_from(limits.max_message_bytes).unwrap_or(u32::MAX),
            max_ahead: Some(duration(FUTURE_MAX_NANOS)),
            direct: direct.unwrap_or_default(),
            map_uid: self.handle.shared_uid.unwrap_or_default(),
        }
    }

    /// Takes messages until the client ends the stream and all is acknowledged.
    ///
    /// # Errors
    /// Why the stream ends before.
    pub(super) async fn serve(&mut self, requests: &mut impl Requests) -> Result<(), RpcError> {
        reply(self.replies, Down::Welcome(self.welcome())).await?;
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
                    Some(Err(status)) => return Err(unread(&status, &self.service.limits)),
                },
            }
        }
    }

    async fn take(&mut self, request: v1::ObserveRequest) -> Result<(), RpcError> {
        self.entry.mark_active();
        // Answers are not read until the message is taken.
        self.probed.pause(true);
        match message_from_wire(request)? {
            StreamMessage::Observations(message) => self.take_observations(message).await,
            StreamMessage::Scans(message) => self.take_scans(message).await,
            StreamMessage::Reports(message) => self.take_reports(message).await,
            StreamMessage::Alive => {
                self.probed.answer();
                Ok(())
            }
        }
    }

    fn intake(&mut self) -> Result<&mut Intake, RpcError> {
        self.intake.as_mut().ok_or(RpcError::Stopping)
    }

    async fn take_observations(&mut self, message: ObservationMessage) -> Result<(), RpcError> {
        let Some(batch) = self.intake()?.take(message)? else { return self.say_durable().await };
        let only_names = batch.span.is_empty();
        let budget = self.budget(bytes_of(&batch)).await?;
        self.note(batch.span.last);
        self.hand_over(StreamData::Observations(batch, budget))?;
        // The writer does not acknowledge names.
        if only_names { self.say_durable().await } else { Ok(()) }
    }

    async fn take_scans(&mut self, message: ScanMessage) -> Result<(), RpcError> {
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

    async fn take_reports(&mut self, message: ReportMessage) -> Result<(), RpcError> {
        let max = self.intake()?.batch_max();
        message.check_count(max)?;
        let mut is_any_new = false;
        // A sighting stands for thousands of observations: each part becomes one record of the log.
        let view = self.handle.view();
        for part in message.parts(REPORT_BYTES_MAX, |report| bytes_of_sent(report, view.site())) {
            let Some(batch) = self.intake()?.take_reports(part)? else { continue };
            is_any_new = true;
            let budget = self.budget(bytes_of_reports(&batch, view.site())).await?;
            self.note(batch.span.last);
            self.hand_over(StreamData::Reports(batch, budget))?;
        }
        if is_any_new { Ok(()) } else { self.say_durable().await }
    }

    /// Reserves room for the tiles that the stream's scans refer to, for the life of the stream. It does not wait,
    /// because other streams may hold the room for ever.
    fn hold_tables(&mut self) -> Result<(), RpcError> {
        let wanted = u32::try_from(self.intake()?.held_bytes().div_ceil(1024)).unwrap_or(u32::MAX);
        let held = self.held.as_ref().map_or(0, |held| u32::try_from(held.num_permits()).unwrap_or(u32::MAX));
        if wanted <= held {
            return Ok(());
        }
        let Ok(more) = Arc::clone(&self.service.tables).try_acquire_many_owned(wanted - held) else {
            let free = (held as usize).saturating_add(self.service.tables.available_permits()) as u64 * 1024;
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
        let work = crate::task::blocking(move || {
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

    /// Hands something to the writer.
    ///
    /// # Errors
    /// The writer has stopped.
    pub(super) fn hand_over(&self, data: StreamData) -> Result<(), RpcError> {
        if self.handle.send(Command::StreamData { session: self.opened.session, data }) {
            Ok(())
        } else {
            Err(RpcError::Stopping)
        }
    }

    /// Reserves room for a batch; one that is larger than the whole room of a stream reserves all of it.
    async fn budget(&mut self, bytes: usize) -> Result<BufferBudget, RpcError> {
        let bytes = bytes.min(self.service.limits.max_stream_buffer);
        let own = self.room(&Arc::clone(&self.own_buffer), bytes).await?;
        Ok([own, self.room(&Arc::clone(&self.service.buffers), bytes).await?])
    }

    /// Answers a message without new observations.
    async fn say_durable(&self) -> Result<(), RpcError> {
        let ack = v1::Ack { durable_sequence: self.durable, refused: Vec::new(), position: self.position() };
        reply(self.replies, Down::Ack(ack)).await
    }

    /// A position in the log of a map that daemons share at which it has what is durable; else 0.
    fn position(&self) -> u64 {
        // What an acknowledgement tells is published before it is told.
        if self.handle.role().is_shared() { self.handle.position() } else { 0 }
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
                for ack in acks((before, durable_sequence), refused, self.position()) {
                    reply(self.replies, Down::Ack(ack)).await?;
                }
                Ok(())
            }
            Some(SessionEvent::End(ending)) => Err(RpcError::Ended(ending)),
            None => Err(RpcError::Stopping),
        }
    }

    /// Tells the client why the stream ends, and what is durable.
    pub(super) async fn say_goodbye(&self, error: &RpcError) {
        let reason = match error {
            // The status says it. Clients connect again after it, as they do when a connection breaks.
            RpcError::Revoked | RpcError::Idle(_) => return,
            // Clients connect again, and to another daemon if need be.
            RpcError::Ended(
                Ending::Shutdown | Ending::Erasure | Ending::Moved { .. } | Ending::Replaced | Ending::Forked { .. },
            )
            | RpcError::Stopping => v1::GoodbyeReason::Shutdown,
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
