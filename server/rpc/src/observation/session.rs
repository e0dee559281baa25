//! An open session at the writer of a map: the messages that it takes, and the events that it waits for.
//!
//! Invariant: room is reserved for a batch before it is handed to the writer, and acknowledgements are passed on
//! meanwhile, because they free room. A session that was opened is ended at the writer.

use std::{collections::VecDeque, sync::Arc, time::Instant};

use tidemap_base::shares::{Share, Taken};
use tidemap_ingest::{
    handle::MapHandle,
    intake::{Intake, IntakeError},
    protocol::{BufferBudget, Command, RefusedObservation, ScanBatch, SessionEvent, StreamData, Welcome},
};
use tidemap_model::StatedReporting;
use tidemap_proto::convert::{
    observe::{ObservationMessage, StreamMessage},
    reports::ReportMessage,
    scans::ScanMessage,
};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tracing::warn;

use super::{
    Observations,
    acknowledgements::Acknowledgements,
    memory::{REPORT_BYTES_MAX, bytes_of, bytes_of_reports},
    open_streams::StreamEntry,
};
use crate::status::RpcError;

/// An open session.
pub(super) struct OpenSession<'a> {
    pub(super) handle: Arc<MapHandle>,
    pub(super) opened: Welcome,
    /// `None` while it works in another thread.
    intake: Option<Intake>,
    pub(super) service: &'a Observations,
    /// Room for this session's table of tiles and its unfinished scan.
    held: Option<Taken>,
    /// The session's own room for data that is not durable, and the rooms that it shares.
    buffers: Vec<Arc<Semaphore>>,
    events: mpsc::UnboundedReceiver<SessionEvent>,
    acknowledgements: Acknowledgements<'a>,
    durable: u64,
    handed_over: u64,
    /// The last sequence number of each batch in flight, and when it was handed over.
    in_flight: VecDeque<(u64, Instant)>,
    pub(super) entry: &'a mut StreamEntry,
}

impl<'a> OpenSession<'a> {
    /// Creates a session that was opened. `opened`: the writer's answer, and its messages.
    pub(super) fn new(
        service: &'a Observations,
        handle: Arc<MapHandle>,
        (opened, events): (Welcome, mpsc::UnboundedReceiver<SessionEvent>),
        reporting: Option<StatedReporting>,
        acknowledgements: Acknowledgements<'a>,
        entry: &'a mut StreamEntry,
    ) -> Self {
        let (durable, limits) = (opened.durable_sequence, service.limits);
        let mut buffers = vec![Arc::new(Semaphore::new(limits.max_stream_buffer))];
        buffers.extend(service.buffers.of(entry.client(), handle.id));
        let intake = Intake::new(durable, opened.content_crc, limits.intake, handle.spec.grid.as_ref())
            .with_known_content(opened.content_marks.clone())
            .with_earliest_time(handle.spec.earliest_nanos())
            .with_reporting(reporting);
        Self {
            intake: Some(intake),
            buffers,
            durable,
            handed_over: durable,
            in_flight: VecDeque::new(),
            handle,
            opened,
            service,
            held: None,
            events,
            acknowledgements,
            entry,
        }
    }

    /// Everything up to this sequence number is durable.
    pub(super) fn durable(&self) -> u64 {
        self.durable
    }

    /// Waits until the map takes more.
    ///
    /// # Errors
    /// The reason why the session ends before.
    pub(super) async fn ready(&mut self) -> Result<(), RpcError> {
        let mut saturated = self.handle.saturated();
        while *saturated.borrow_and_update() {
            tokio::select! {
                biased;
                event = self.event() => {
                    let event = event?;
                    self.pass_on(event).await?;
                }
                _ = saturated.changed() => {}
            }
        }
        Ok(())
    }

    /// Takes a message of observations, scans or reports.
    ///
    /// # Errors
    /// The reason why the session ends.
    pub(super) async fn take(&mut self, message: StreamMessage) -> Result<(), RpcError> {
        match message {
            StreamMessage::Observations(message) => self.take_observations(message).await,
            StreamMessage::Scans(message) => self.take_scans(message).await,
            StreamMessage::Reports(message) => self.take_reports(message).await,
            StreamMessage::Alive => Ok(()),
        }
    }

    fn intake(&mut self) -> Result<&mut Intake, RpcError> {
        self.intake.as_mut().ok_or(RpcError::Stopping)
    }

    async fn take_observations(&mut self, message: ObservationMessage) -> Result<(), RpcError> {
        let Some(batch) = self.intake()?.take(message)? else { return self.repeat_durable().await };
        let only_names = batch.span.is_empty();
        let budget = self.budget(bytes_of(&batch)).await?;
        self.note(batch.span.last);
        self.hand_over(StreamData::Observations(batch, budget))?;
        // The writer does not acknowledge names.
        if only_names { self.repeat_durable().await } else { Ok(()) }
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
        // The writer acknowledges neither tiles nor observations that it has taken before; an unfinished scan waits for
        // its end.
        if is_any_new { Ok(()) } else { self.repeat_durable().await }
    }

    async fn take_reports(&mut self, message: ReportMessage) -> Result<(), RpcError> {
        let max = self.intake()?.batch_max();
        message.check_count(max)?;
        let mut is_any_new = false;
        // A sighting may be thousands of observations: each part becomes one record of the log.
        let view = self.handle.view();
        for part in message.parts(REPORT_BYTES_MAX, view.site()) {
            let Some(batch) = self.intake()?.take_reports(part)? else { continue };
            is_any_new = true;
            let budget = self.budget(bytes_of_reports(&batch, view.site())).await?;
            self.note(batch.span.last);
            self.hand_over(StreamData::Reports(batch, budget))?;
        }
        if is_any_new { Ok(()) } else { self.repeat_durable().await }
    }

    /// Reserves room for the tiles that the session's scans refer to, for the life of the session. The reservation does
    /// not wait, because other sessions may hold the room for ever.
    fn hold_tables(&mut self) -> Result<(), RpcError> {
        let wanted = self.intake()?.held_bytes();
        let held = self.held.as_ref().map_or(0, Taken::amount);
        if wanted <= held {
            return Ok(());
        }
        // The room grows in large steps, because a table grows by a tile at a time.
        let more = wanted.next_multiple_of(1024) - held;
        match &mut self.held {
            Some(held) => held.grow(more)?,
            none => {
                let whose = (self.entry.client(), self.handle.id);
                *none = Some(self.service.shares.take_for(Share::TableBytes, whose, more)?);
            }
        }
        Ok(())
    }

    /// The next scans of the message, from a blocking thread if rays are cast.
    async fn next_scans(&mut self, is_much_work: bool) -> Result<Option<ScanBatch>, RpcError> {
        if !is_much_work {
            return Ok(self.intake()?.next_scans()?);
        }
        let mut intake = self.intake.take().ok_or(RpcError::Stopping)?;
        let work = tidemap_base::task::blocking(move || {
            let batch = intake.next_scans();
            (intake, batch)
        });
        let (intake, batch) = work.await?;
        self.intake = Some(intake);
        Ok(batch?)
    }

    /// Records that a batch up to this sequence number is handed over now.
    fn note(&mut self, last_sequence: u64) {
        if last_sequence > self.handed_over {
            self.in_flight.push_back((last_sequence, Instant::now()));
        }
        self.handed_over = last_sequence;
        self.entry.set_unacknowledged(self.durable < self.handed_over);
    }

    /// Hands something to the writer.
    fn hand_over(&self, data: StreamData) -> Result<(), RpcError> {
        if self.handle.send(Command::StreamData { session: self.opened.session, data }) {
            Ok(())
        } else {
            Err(RpcError::Stopping)
        }
    }

    /// Ends the session at the writer. `error` is the reason if it ends before its client has ended it.
    pub(super) fn end(&self, error: Option<&RpcError>) {
        // A writer that has stopped has no session to remove.
        let _ = self.hand_over(StreamData::End { clean: error.is_none() });
        if let Some(RpcError::Intake(mismatch @ IntakeError::DataMismatch { .. })) = error {
            metrics::counter!("tidemap_data_mismatches_total").increment(1);
            warn!(map = self.handle.id.0, "a producer has sent other content again: {mismatch}");
        }
    }

    /// Reserves room for a batch; a batch that is larger than the whole room of a session reserves all of it.
    async fn budget(&mut self, bytes: usize) -> Result<BufferBudget, RpcError> {
        let bytes = bytes.min(self.service.limits.max_stream_buffer);
        let mut budget = BufferBudget::with_capacity(self.buffers.len());
        for number in 0..self.buffers.len() {
            let buffer = Arc::clone(&self.buffers[number]);
            budget.push(self.room(&buffer, bytes).await?);
        }
        Ok(budget)
    }

    /// Waits for room, and passes acknowledgements on meanwhile, because they free room.
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

    /// Answers a message without new observations.
    async fn repeat_durable(&mut self) -> Result<(), RpcError> {
        let position = self.position();
        self.acknowledgements.add((self.durable, self.durable), Vec::new(), position).await
    }

    /// A log position at which the map has all that is durable, if daemons share the map; else 0.
    fn position(&self) -> u64 {
        // The view is published before an acknowledgement is sent.
        if self.handle.role().is_shared() { self.handle.position() } else { 0 }
    }

    /// Waits until all that was handed over is durable, and passes acknowledgements on.
    ///
    /// # Errors
    /// The reason why the session ends before.
    pub(super) async fn drain(&mut self) -> Result<(), RpcError> {
        while self.durable < self.handed_over {
            let event = self.events.recv().await;
            self.pass_on(event).await?;
        }
        Ok(())
    }

    /// The next message of the writer; can be cancelled.
    ///
    /// # Errors
    /// The session has to make room for another.
    pub(super) async fn event(&mut self) -> Result<Option<SessionEvent>, RpcError> {
        tokio::select! {
            biased;
            event = self.events.recv() => Ok(event),
            ended = self.entry.displaced() => Err(ended),
        }
    }

    /// Passes a message of the writer on.
    ///
    /// # Errors
    /// The session ends.
    pub(super) async fn pass_on(&mut self, event: Option<SessionEvent>) -> Result<(), RpcError> {
        match event {
            Some(SessionEvent::Ack { durable_sequence, refused }) => {
                let before = std::mem::replace(&mut self.durable, durable_sequence);
                self.entry.set_unacknowledged(self.durable < self.handed_over);
                while let Some((_, sent)) = self.in_flight.pop_front_if(|(last, _)| *last <= durable_sequence) {
                    metrics::histogram!("tidemap_acknowledgement_seconds").record(sent.elapsed());
                }
                let position = self.position();
                self.acknowledgements.add((before, durable_sequence), refused, position).await
            }
            Some(SessionEvent::End(ending)) => Err(RpcError::Ended(ending)),
            None => Err(RpcError::Stopping),
        }
    }

    /// Takes the refused observations of all messages, if they were not sent to a stream.
    pub(super) fn take_refused(&mut self) -> Vec<RefusedObservation> {
        self.acknowledgements.take_refused()
    }
}
