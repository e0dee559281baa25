//! Events on their way into the log: handed over, applied when they are durable, or failed together.
//!
//! Invariant: the committer answers in the order of the appends. Once one has failed, all in flight fail with it, and
//! nothing new starts before the last of them is answered.

use std::sync::Arc;

use tidemap_map::{event::Event, grid::scan::LoggedScan, update::UpdateWork};
use tidemap_store::AppendError;
use tracing::{error, warn};

use super::{
    super::protocol::{AddStateError, BufferBudget, Command, EditSiteError, Ending, Refused, SessionId, is_fatal},
    Instant, Job, UPDATE_RETRY, Writer,
    site::Edited,
    states::Added,
};

/// An append that the committer has not answered.
pub(super) enum Flight {
    /// Observations or scans of a stream.
    Taken { session: SessionId, event: Event, refused: Vec<Refused>, tiles_ahead: u64, _budget: Arc<BufferBudget> },
    /// The start of an update.
    UpdateStart { event: Event, job: Arc<Job> },
    /// A state to add.
    AddState { event: Event, reply: Added },
    /// A change of the site.
    EditSite { event: Event, reply: Edited },
}

/// What a stream is to be told once it is public.
#[derive(Default)]
pub(super) struct PendingAck {
    pub(super) durable_sequence: u64,
    pub(super) refused: Vec<Refused>,
}

impl Flight {
    /// Memory of what was made of scans, in bytes; all else is bounded by the permits.
    fn bytes(&self) -> usize {
        let Flight::Taken { event: Event::Scans(event), .. } = self else { return 0 };
        let of_scan = |scan: &LoggedScan| {
            let flips = scan.observed_flips.len() + scan.occupied_flips.len();
            size_of::<LoggedScan>() + 4 * (flips + scan.seen.as_ref().map_or(0, |seen| seen.len()))
        };
        event.scans.iter().map(of_scan).sum::<usize>() + size_of_val(event.new_tiles.as_slice())
    }
}

impl Writer {
    /// Hands an event to the log; gives whether the log has it on its way.
    pub(super) fn launch(&mut self, flight: Flight) -> bool {
        let (Flight::Taken { event, .. }
        | Flight::UpdateStart { event, .. }
        | Flight::AddState { event, .. }
        | Flight::EditSite { event, .. }) = &flight;
        match self.append(event) {
            Ok(()) => {
                self.flight_bytes += flight.bytes();
                self.flights.push_back(flight);
                true
            }
            // It never joined the queue: the committer owes no answer for it, and those before it wait for theirs.
            Err(error) => {
                self.append_failed(error, flight);
                false
            }
        }
    }

    /// Fails what follows an event that the log has not taken; gives that it is not on its way.
    pub(super) fn ground(&mut self, flight: Flight) -> bool {
        self.append_failed(AppendError::AfterFailure, flight);
        false
    }

    /// Whether the start of an update is on its way into the log.
    pub(super) fn is_update_starting(&self) -> bool {
        self.flights.iter().any(|flight| matches!(flight, Flight::UpdateStart { .. }))
    }

    fn append(&self, event: &Event) -> Result<(), AppendError> {
        let commands = self.commands.clone();
        // A writer that has stopped does not need the answer.
        self.log.append(event, Box::new(move |result| drop(commands.send(Command::Committed(result)))))
    }

    pub(super) fn committed(&mut self, result: Result<u64, AppendError>) {
        let Some(flight) = self.flights.pop_front() else { return };
        self.flight_bytes = self.flight_bytes.saturating_sub(flight.bytes());
        match (result, flight) {
            (Ok(position), Flight::Taken { session, event, refused, tiles_ahead, .. }) => {
                if self.apply(position, &event).is_none() {
                    return;
                }
                let last = match &event {
                    Event::Observations(event) => {
                        self.watchers.applied(event);
                        metrics::counter!("tidemap_observations_total").increment(event.states.len() as u64);
                        metrics::counter!("tidemap_refused_total").increment(event.refused.len() as u64);
                        event.last_sequence
                    }
                    Event::Scans(event) => {
                        metrics::counter!("tidemap_scans_total").increment(event.scans.len() as u64);
                        metrics::counter!("tidemap_refused_total").increment(event.refused.len() as u64);
                        event.last_sequence
                    }
                    Event::UpdateStart(_) | Event::AddState(_) | Event::EditSite(_) => return,
                };
                let ack = self.acks.entry(session).or_default();
                ack.durable_sequence = last;
                ack.refused.extend(refused);
                self.sessions.applied(session, &event, tiles_ahead);
            }
            (Ok(position), Flight::UpdateStart { event, job }) => match self.apply(position, &event) {
                Some(Some(work)) => self.run_update(work, &job),
                _ => job.end(Err("the update did not start".to_owned())),
            },
            (Ok(position), Flight::AddState { event, reply }) => {
                if self.apply(position, &event).is_some() {
                    self.state_added(&event, reply);
                }
            }
            (Ok(position), Flight::EditSite { event, reply }) => {
                if self.apply(position, &event).is_some() {
                    self.site_edited(reply, Ok(()));
                }
            }
            (Err(error), flight) => self.append_failed(error, flight),
        }
    }

    fn append_failed(&mut self, error: AppendError, flight: Flight) {
        if self.failing.is_none() && error == AppendError::AfterFailure && !self.flights.is_empty() {
            // The answer that says what has failed is on its way.
            return self.grounded.push(flight);
        }
        // What became durable before this is acknowledged before the streams hear of the end.
        self.publish();
        if self.failing.is_none() {
            warn!(map = %self.map.spec().name, %error, "the log could not be written; nothing of it is acknowledged");
        }
        if is_fatal(&error) && !self.failing.as_ref().is_some_and(is_fatal) {
            self.fatal(error.to_string());
            self.failing = Some(error.clone());
        }
        // Those that fail because one before them failed are told of that one.
        let first = self.failing.get_or_insert(error).clone();
        match flight {
            Flight::Taken { session, .. } => self.sessions.failed(session, &Ending::Storage(first)),
            Flight::UpdateStart { job, .. } => {
                self.updates.failed(job.cause);
                self.updates_wait_until = Some(Instant::now() + UPDATE_RETRY);
                job.end(Err(first.to_string()));
            }
            // Who asked may have gone away.
            Flight::AddState { reply, .. } => drop(reply.send(Err(AddStateError::Storage(first)))),
            Flight::EditSite { reply, .. } => self.site_edited(reply, Err(EditSiteError::Storage(first))),
        }
        for flight in std::mem::take(&mut self.grounded) {
            self.append_failed(AppendError::AfterFailure, flight);
        }
    }

    pub(super) fn fatal(&self, reason: String) {
        // The daemon is stopping already if nobody listens.
        let _ = self.context.fatal.send(reason);
    }

    fn apply(&mut self, position: u64, event: &Event) -> Option<Option<UpdateWork>> {
        self.changed = true;
        match self.map.apply(position, event) {
            Ok(work) => Some(work),
            Err(inconsistent) => {
                error!(map = %self.map.spec().name, error = %inconsistent, "the map and its log disagree");
                self.fatal(inconsistent.to_string());
                None
            }
        }
    }
}
