//! The backlog: the handovers of streams and the requests of clients that have to wait.
//!
//! Invariant: the order of the handovers is kept. A handover in the backlog holds its buffer budget and nothing else.
//! Flips, which may be far larger than the scans that they are computed from, exist only for scans in flight, so memory
//! is bounded for any length of the backlog.

use std::{collections::VecDeque, sync::Arc};

use super::{Writer, appends::InFlight};
use crate::{
    ending::Ending,
    protocol::{Hello, ReadHistory, SessionId, StreamData},
    role::NotWriter,
    sessions::StreamEvent,
};

#[cfg(test)]
mod tests;

/// Nothing is taken from the backlog while the pending load exceeds this multiple of the limit.
pub(super) const PENDING_LOAD_MAX: f64 = 2.0;

/// Commands that wait.
#[derive(Default)]
pub(super) struct Backlog {
    handovers: VecDeque<(SessionId, StreamData)>,
    /// Streams that wait for the end of an earlier stream of their key.
    hellos: Vec<Hello>,
    /// Requests for observations that the running update has.
    history_reads: Vec<ReadHistory>,
}

impl Backlog {
    pub(super) fn push(&mut self, session: SessionId, handover: StreamData) {
        self.handovers.push_back((session, handover));
    }

    /// The oldest handover, if it may be taken now. The end of a stream needs no room. Traversals and sightings
    /// wait while an edit of the site is in flight, because their meaning depends on the site.
    pub(super) fn next(&mut self, has_room: bool, is_site_changing: bool) -> Option<(SessionId, StreamData)> {
        let may_take = match &self.handovers.front()?.1 {
            StreamData::End { .. } => true,
            StreamData::Reports(..) => has_room && !is_site_changing,
            StreamData::Observations(..) | StreamData::Scans(..) => has_room,
        };
        if may_take { self.handovers.pop_front() } else { None }
    }

    /// Drops all handovers.
    pub(super) fn clear(&mut self) {
        self.handovers.clear();
    }

    pub(super) fn is_empty(&self) -> bool {
        self.handovers.is_empty()
    }

    /// Whether any handover of the stream waits.
    pub(super) fn has(&self, session: SessionId) -> bool {
        self.handovers.iter().any(|(sender, _)| *sender == session)
    }

    /// Whether the end of the stream waits behind other handovers.
    pub(super) fn has_end(&self, session: SessionId) -> bool {
        self.handovers.iter().any(|(sender, handover)| *sender == session && matches!(handover, StreamData::End { .. }))
    }

    pub(super) fn wait_hello(&mut self, hello: Hello) {
        self.hellos.push(hello);
    }

    pub(super) fn take_hellos(&mut self) -> Vec<Hello> {
        std::mem::take(&mut self.hellos)
    }

    /// Each request holds one of a bounded number of permits; those whose clients have gone are dropped here.
    pub(super) fn wait_history_read(&mut self, read: ReadHistory) {
        self.history_reads.retain(|waiting| !waiting.reply.is_closed());
        self.history_reads.push(read);
    }

    pub(super) fn take_history_reads(&mut self) -> Vec<ReadHistory> {
        std::mem::take(&mut self.history_reads)
    }
}

impl Writer {
    /// Takes the data that a stream hands over, or enqueues it behind earlier handovers.
    pub(super) fn hand_over(&mut self, session: SessionId, data: StreamData) {
        match data {
            // The end of a stream without a backlog need not wait for other streams.
            StreamData::End { clean } if !self.backlog.has(session) => return self.leave(session, clean),
            // During a stop, and while the log accepts nothing, the stream is notified at once.
            data if self.stopping.is_some()
                || !self.follower.is_writing()
                || (self.appends.failure().is_some() && self.backlog.is_empty()) =>
            {
                self.take(session, data);
            }
            data => self.backlog.push(session, data),
        }
        self.drain_backlog(false);
    }

    /// Takes handovers from the backlog as long as there is room. `is_idle`: no running work could make room, so one
    /// handover is taken anyway.
    pub(super) fn drain_backlog(&mut self, mut is_idle: bool) {
        while self.appends.failure().is_none() && self.stopping.is_none() {
            let has_room = is_idle || (self.appends.has_room() && self.pending_load() <= PENDING_LOAD_MAX);
            let Some((session, data)) = self.backlog.next(has_room, self.edits.is_in_flight()) else { return };
            is_idle = is_idle && matches!(data, StreamData::End { .. });
            self.take(session, data);
        }
    }

    /// The pending observations, with those of the running update, relative to the limit.
    pub(super) fn pending_load(&self) -> f64 {
        self.map.pending_load(self.context.max_pending, true)
    }

    fn take(&mut self, session: SessionId, data: StreamData) {
        let is_end = matches!(data, StreamData::End { .. });
        if self.stopping.is_some() && !is_end {
            return;
        }
        if let Some(NotWriter { writer, .. }) = self.not_writer().filter(|_| !is_end) {
            return self.sessions.end(session, &Ending::Moved { writer });
        }
        if let Some(error) = self.appends.failure().filter(|_| !is_end) {
            return self.sessions.end(session, &error.clone().into());
        }
        let now = self.context.clock.now_nanos();
        let sessions = &mut self.sessions;
        let (events, budget) = match data {
            StreamData::Observations(batch, budget) => {
                (sessions.observation_event(session, batch, &self.map, now).into_iter().collect(), budget)
            }
            StreamData::Reports(batch, budget) => {
                (sessions.report_event(session, batch, &self.map, now).into_iter().collect(), budget)
            }
            StreamData::Scans(batch, budget) => (sessions.scan_events(session, batch, &self.map, now), budget),
            StreamData::End { clean } => return self.leave(session, clean),
        };
        let budget = Arc::new(budget);
        let mut is_accepted = true;
        for StreamEvent { event, refused, tiles_ahead } in events {
            let append = InFlight::Stream { session, event, refused, tiles_ahead, _budget: Arc::clone(&budget) };
            // An event that follows an event which the log has not accepted must not be in the log without it.
            is_accepted = if is_accepted { self.append(append) } else { self.fail_after(append) };
        }
    }

    fn leave(&mut self, session: SessionId, clean: bool) {
        if let Some((key, reached)) = self.sessions.leave(session)
            && !clean
        {
            self.updates.schedule.stream_broke(key, reached);
        }
    }
}
