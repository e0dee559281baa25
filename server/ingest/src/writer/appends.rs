//! Appends in flight: they are handed to the log, then applied when they are durable, or they fail together.
//!
//! Invariant: the committer completes the appends in their order. After one append has failed, every append in flight
//! fails with it, and no append starts before the last of them is completed.

use std::{collections::VecDeque, sync::Arc, time::Instant};

use tidemap_grid::scan::LoggedScan;
use tidemap_map::{event::Event, update::UpdateWork};
use tidemap_store::AppendError;
use tokio::sync::oneshot;
use tracing::{error, warn};

use super::Writer;
use crate::{
    ending::is_fatal,
    jobs::{JobCause, UpdateJob},
    protocol::{AddStateError, BufferBudget, Command, EditSiteError, ForgetError, RefusedObservation, SessionId},
};

#[cfg(test)]
mod tests;

/// Memory of the scans in flight above which no more scans are taken from the backlog.
const IN_FLIGHT_BYTES_MAX: usize = 64 << 20;

/// Reports the outcome of a request to its client.
pub(super) type Reply<E> = oneshot::Sender<Result<(), E>>;

/// An append that the committer has not completed.
pub(super) enum InFlight {
    /// Observations or scans of a stream.
    Stream {
        session: SessionId,
        event: Event,
        refused: Vec<RefusedObservation>,
        tiles_ahead: u64,
        _budget: Arc<BufferBudget>,
    },
    /// The start of an update.
    UpdateStart { event: Event, job: Arc<UpdateJob> },
    /// The end of an update, in a shared log.
    UpdateDone { event: Event },
    /// A state to add.
    AddState { event: Event, client: String, reply: Reply<AddStateError> },
    /// An edit of the site.
    EditSite { event: Event, reply: Reply<EditSiteError> },
    /// Producers that give their places up, and their number.
    ForgetProducers { event: Event, count: u64, reply: oneshot::Sender<Result<u64, ForgetError>> },
}

/// The map and its log disagree, and the daemon stops.
#[derive(Clone, Copy, Debug)]
pub(super) struct Disagreement;

impl InFlight {
    fn event(&self) -> &Event {
        let (Self::Stream { event, .. }
        | Self::UpdateStart { event, .. }
        | Self::UpdateDone { event }
        | Self::AddState { event, .. }
        | Self::EditSite { event, .. }
        | Self::ForgetProducers { event, .. }) = self;
        event
    }

    /// Memory of the scans of the event, in bytes. All other data is bounded by the buffer budgets.
    fn bytes(&self) -> usize {
        let Event::Scans(_, event) = self.event() else { return 0 };
        let of_scan = |scan: &LoggedScan| {
            let flips = scan.observed_flips.len() + scan.occupied_flips.len();
            size_of::<LoggedScan>() + 4 * (flips + scan.seen.as_ref().map_or(0, |seen| seen.len()))
        };
        event.scans.iter().map(of_scan).sum::<usize>() + size_of_val(event.new_tiles.as_slice())
    }
}

/// Appends that have failed.
pub(super) struct AppendFailure {
    /// The first error: later appends fail because of it.
    pub(super) cause: AppendError,
    /// Whether no failure was known before.
    pub(super) is_first: bool,
    /// Whether this is the first failure after which the content of the disk is unknown.
    pub(super) is_newly_fatal: bool,
    /// The failed appends, in their order.
    pub(super) appends: Vec<InFlight>,
}

/// The appends in flight, and the failure to which they belong, if any.
pub(super) struct Appends {
    in_flight: VecDeque<InFlight>,
    /// Memory of the scans in flight, and the limit above which no more are taken.
    bytes: usize,
    bytes_max: usize,
    /// Appends that the log has refused because of an earlier failure that is not reported yet.
    failed_behind: Vec<InFlight>,
    /// The failure, until all appends in flight are completed.
    failure: Option<AppendError>,
}

impl Default for Appends {
    fn default() -> Self {
        Self {
            in_flight: VecDeque::new(),
            bytes: 0,
            bytes_max: IN_FLIGHT_BYTES_MAX,
            failed_behind: Vec::new(),
            failure: None,
        }
    }
}

impl Appends {
    /// Adds an append that the log has accepted.
    pub(super) fn push(&mut self, append: InFlight) {
        self.bytes += append.bytes();
        self.in_flight.push_back(append);
    }

    /// Removes the oldest append, which the committer has completed.
    pub(super) fn pop(&mut self) -> Option<InFlight> {
        let append = self.in_flight.pop_front()?;
        self.bytes = self.bytes.saturating_sub(append.bytes());
        Some(append)
    }

    /// An append has failed. `None`: it failed because of an earlier append whose completion is outstanding; it is
    /// kept, and fails with that append.
    pub(super) fn fail(&mut self, error: AppendError, append: InFlight) -> Option<AppendFailure> {
        if self.failure.is_none() && error == AppendError::AfterFailure && !self.in_flight.is_empty() {
            self.failed_behind.push(append);
            return None;
        }
        let is_first = self.failure.is_none();
        let is_newly_fatal = is_fatal(&error) && !self.failure.as_ref().is_some_and(is_fatal);
        if is_newly_fatal {
            self.failure = Some(error.clone());
        }
        let cause = self.failure.get_or_insert(error).clone();
        let mut appends = vec![append];
        appends.append(&mut self.failed_behind);
        Some(AppendFailure { cause, is_first, is_newly_fatal, appends })
    }

    /// Ends a failure when all appends in flight are completed; returns whether it did.
    pub(super) fn end_failure(&mut self) -> bool {
        self.in_flight.is_empty() && self.failure.take().is_some()
    }

    /// The failure that is not over yet: no append starts.
    pub(super) fn failure(&self) -> Option<&AppendError> {
        self.failure.as_ref()
    }

    pub(super) fn is_empty(&self) -> bool {
        self.in_flight.is_empty()
    }

    /// Whether the memory of the scans in flight allows more appends.
    pub(super) fn has_room(&self) -> bool {
        self.bytes <= self.bytes_max && self.failed_behind.is_empty()
    }

    /// Whether the start of an update is in flight.
    pub(super) fn is_update_starting(&self) -> bool {
        self.in_flight.iter().any(|append| matches!(append, InFlight::UpdateStart { .. }))
    }

    /// Whether the end of an update is in flight, or is part of the current failure.
    pub(super) fn is_update_ending(&self) -> bool {
        let mut appends = self.in_flight.iter().chain(&self.failed_behind);
        appends.any(|append| matches!(append, InFlight::UpdateDone { .. }))
    }
}

impl Writer {
    /// Hands an event to the log; returns whether the log has accepted it.
    pub(super) fn append(&mut self, append: InFlight) -> bool {
        let commands = self.commands.clone();
        // A writer that has stopped does not need the completion.
        let answer = Box::new(move |result| drop(commands.send(Command::Committed(result))));
        match self.log.append(append.event(), answer) {
            Ok(()) => {
                self.appends.push(append);
                true
            }
            // The event never joined the queue: the committer sends no completion for it. Earlier appends wait for
            // theirs.
            Err(error) => {
                self.append_failed(error, append);
                false
            }
        }
    }

    /// Fails an event that follows an event which the log has not accepted; returns `false`, because the log has not
    /// accepted it.
    pub(super) fn fail_after(&mut self, append: InFlight) -> bool {
        self.append_failed(AppendError::AfterFailure, append);
        false
    }

    /// The committer has completed the oldest append: a durable event is applied, then acknowledged by `publish`.
    pub(super) fn committed(&mut self, result: Result<u64, AppendError>) {
        let Some(append) = self.appends.pop() else { return };
        match (result, append) {
            (Ok(position), InFlight::Stream { session, event, refused, tiles_ahead, .. }) => {
                if self.apply(position, &event).is_err() {
                    return;
                }
                self.report_applied(&event);
                let Some(envelope) = event.envelope() else { return };
                let ack = self.acks.entry(session).or_default();
                ack.durable_sequence = envelope.span.last;
                ack.refused.extend(refused);
                self.sessions.applied(session, &event, tiles_ahead);
            }
            (Ok(position), InFlight::UpdateStart { event, job }) => match self.apply(position, &event) {
                Ok(Some(work)) => self.run_update(work, &job),
                _ => job.end(Err("the update did not start".to_owned())),
            },
            (Ok(position), InFlight::UpdateDone { event }) => {
                if self.apply(position, &event).is_ok() {
                    self.note_logged_update_end(&event);
                }
            }
            (Ok(position), InFlight::AddState { event, client, reply }) => {
                if self.apply(position, &event).is_ok() {
                    self.state_added(&event, &client, reply);
                }
            }
            (Ok(position), InFlight::EditSite { event, reply }) => {
                if self.apply(position, &event).is_ok() {
                    self.site_edited(reply, Ok(()));
                }
            }
            (Ok(position), InFlight::ForgetProducers { event, count, reply }) => {
                if self.apply(position, &event).is_ok() {
                    self.producers_forgotten(count, reply);
                }
            }
            (Err(error), append) => self.append_failed(error, append),
        }
    }

    /// Notifies the watchers of the applied observations of a producer, and counts them.
    pub(super) fn report_applied(&mut self, event: &Event) {
        let Some(envelope) = event.envelope() else { return };
        match event {
            Event::Observations(_, event) => {
                self.feed.applied(event);
                metrics::counter!("tidemap_observations_total").increment(event.states.len() as u64);
            }
            Event::Scans(_, event) => {
                self.feed.scanned(event);
                metrics::counter!("tidemap_scans_total").increment(event.scans.len() as u64);
            }
            Event::UpdateStart(_)
            | Event::AddState(_)
            | Event::EditSite(_)
            | Event::Epoch(_)
            | Event::UpdateDone(_)
            | Event::ForgetProducers(_) => {}
        }
        metrics::counter!("tidemap_refused_total").increment(envelope.refused.len() as u64);
    }

    fn append_failed(&mut self, error: AppendError, append: InFlight) {
        let reason = error.to_string();
        let Some(AppendFailure { cause, is_first, is_newly_fatal, appends }) = self.appends.fail(error, append) else {
            return;
        };
        // Earlier appends that became durable are acknowledged before the streams receive their end.
        self.publish();
        if is_first {
            warn!(map = %self.map.spec().name, error = reason, "the log could not be written: its appends are not acknowledged");
        }
        let not_writer = self.not_writer();
        for append in appends {
            let error = cause.clone();
            match append {
                InFlight::Stream { session, .. } => self.sessions.failed(session, &error.into()),
                InFlight::UpdateStart { job, .. } => {
                    if let JobCause::Update(cause) = job.cause {
                        self.updates.not_started(cause, Instant::now());
                    }
                    job.end(Err(error.to_string()));
                }
                InFlight::UpdateDone { .. } => self.updates.wait(Instant::now()),
                InFlight::AddState { reply, .. } => {
                    let error = not_writer.clone().map_or(AddStateError::Storage(error), AddStateError::NotWriter);
                    // The client may have gone away.
                    let _ = reply.send(Err(error));
                }
                InFlight::ForgetProducers { reply, .. } => {
                    let error = not_writer.clone().map_or(ForgetError::Storage(error), ForgetError::NotWriter);
                    // The client may have gone away.
                    let _ = reply.send(Err(error));
                }
                InFlight::EditSite { reply, .. } => {
                    let error = not_writer.clone().map_or(EditSiteError::Storage(error), EditSiteError::NotWriter);
                    self.site_edited(reply, Err(error));
                }
            }
        }
        // This comes last, so that streams receive this reason and not that the daemon stops.
        if is_newly_fatal {
            self.fatal(reason);
        }
    }

    pub(super) fn fatal(&self, reason: String) {
        // If nobody listens, the daemon is already stopping.
        let _ = self.context.fatal.send(reason);
    }

    /// Applies a durable event; returns the work of an update that begins.
    ///
    /// # Errors
    /// The map and its log disagree, and the daemon stops.
    pub(super) fn apply(&mut self, position: u64, event: &Event) -> Result<Option<UpdateWork>, Disagreement> {
        self.changed = true;
        match self.map.apply(position, event) {
            Ok(work) => Ok(work),
            Err(inconsistent) => {
                error!(map = %self.map.spec().name, error = %inconsistent, "the map and its log disagree");
                self.fatal(inconsistent.to_string());
                Err(Disagreement)
            }
        }
    }
}
