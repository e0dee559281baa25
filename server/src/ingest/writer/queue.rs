//! What streams hand over, in its order: taken at once where there is room, else kept until there is.
//!
//! Invariant: what is kept holds its permits and nothing else. Flips, which may be far larger than the scans that they
//! are made of, exist only for what is on its way into the log; however much waits, they are bounded.

use std::sync::Arc;

use tidemap_map::event::Event;

use super::{
    super::{
        protocol::{BufferBudget, Ending, Hello, ObservationBatch, ScanBatch, SessionId, TraversalBatch},
        sessions::ScanEvent,
    },
    Flight, Writer,
};

/// Memory of scans on their way into the log above which no more are taken.
pub(super) const FLIGHT_BYTES: usize = 64 << 20;
/// Nothing is taken while what is pending exceeds the limit this many times.
pub(super) const CROWDING_MAX: f64 = 2.0;

/// What a stream has handed over.
pub(super) enum Deferred {
    /// Observations.
    Batch(SessionId, ObservationBatch, BufferBudget),
    /// Scans.
    Scans(SessionId, ScanBatch, BufferBudget),
    /// Traversals.
    Traversals(SessionId, TraversalBatch, BufferBudget),
    /// That it ended, and whether on purpose.
    Leave(SessionId, bool),
}

impl Writer {
    /// Takes what a stream hands over when its turn has come.
    pub(super) fn defer(&mut self, deferred: Deferred) {
        match deferred {
            // The end of a stream that has nothing here need not wait for others.
            Deferred::Leave(session, clean) if !self.defers_of(session) => return self.leave(session, clean),
            // At a stop, and while the log takes nothing, the stream hears of that.
            other if self.stopping.is_some() || (self.failing.is_some() && self.deferred.is_empty()) => {
                self.take_one(other);
            }
            other => self.deferred.push_back(other),
        }
        self.take_deferred(false);
    }

    fn defers_of(&self, session: SessionId) -> bool {
        self.deferred.iter().any(|deferred| match deferred {
            Deferred::Batch(of, ..)
            | Deferred::Scans(of, ..)
            | Deferred::Traversals(of, ..)
            | Deferred::Leave(of, _) => *of == session,
        })
    }

    /// Whether the open stream of the key has ended, behind observations that wait.
    pub(super) fn defers_end_of(&self, hello: &Hello) -> bool {
        let Some(open) = self.sessions.open_of(&hello.key) else { return false };
        self.deferred.iter().any(|deferred| matches!(deferred, Deferred::Leave(session, _) if *session == open))
    }

    /// Takes what waits, as far as there is room. `is_idle`: nothing goes on that could make room; one is taken then.
    pub(super) fn take_deferred(&mut self, is_idle: bool) {
        let mut is_idle = is_idle;
        while self.failing.is_none() && self.stopping.is_none() {
            // The end of a stream takes no room.
            let is_end = matches!(self.deferred.front(), Some(Deferred::Leave(..)));
            if !is_end && !is_idle && !self.has_room() {
                return;
            }
            // What a traversal says depends on the topology, which may be changing.
            if matches!(self.deferred.front(), Some(Deferred::Traversals(..))) && self.edits.is_in_flight() {
                return;
            }
            let Some(deferred) = self.deferred.pop_front() else { return };
            is_idle = is_idle && is_end;
            self.take_one(deferred);
        }
    }

    fn has_room(&self) -> bool {
        self.flight_bytes <= self.flight_bytes_max
            && self.grounded.is_empty()
            && self.map.crowding(self.context.max_pending, true) <= CROWDING_MAX
    }

    fn take_one(&mut self, deferred: Deferred) {
        match deferred {
            Deferred::Batch(session, batch, budget) => self.batch(session, batch, budget),
            Deferred::Scans(session, batch, budget) => self.scans(session, batch, budget),
            Deferred::Traversals(session, batch, budget) => self.traversals(session, batch, budget),
            Deferred::Leave(session, clean) => self.leave(session, clean),
        }
    }

    /// Whether a stream may hand something over now; it is told where it may not.
    fn takes(&mut self, session: SessionId) -> bool {
        if let Some(error) = self.failing.clone().filter(|_| self.stopping.is_none()) {
            self.sessions.end(session, &Ending::Storage(error));
            return false;
        }
        self.stopping.is_none()
    }

    fn batch(&mut self, session: SessionId, batch: ObservationBatch, budget: BufferBudget) {
        if !self.takes(session) {
            return;
        }
        let now = self.context.clock.now_nanos();
        let Some((observations, refused)) = self.sessions.event(session, batch, &self.map, now) else { return };
        let event = Event::Observations(observations);
        self.launch(Flight::Taken { session, event, refused, tiles_ahead: 0, _budget: Arc::new(budget) });
    }

    fn traversals(&mut self, session: SessionId, batch: TraversalBatch, budget: BufferBudget) {
        if !self.takes(session) {
            return;
        }
        let now = self.context.clock.now_nanos();
        let taken = self.sessions.traversal_event(session, batch, &self.map, now);
        let Some((observations, refused)) = taken else { return };
        let event = Event::Observations(observations);
        self.launch(Flight::Taken { session, event, refused, tiles_ahead: 0, _budget: Arc::new(budget) });
    }

    fn scans(&mut self, session: SessionId, batch: ScanBatch, budget: BufferBudget) {
        if !self.takes(session) {
            return;
        }
        let now = self.context.clock.now_nanos();
        let budget = Arc::new(budget);
        let mut is_launched = true;
        for taken in self.sessions.scan_events(session, batch, &self.map, now) {
            let ScanEvent { event, refused, tiles_ahead } = taken;
            let flight = Flight::Taken { session, event, refused, tiles_ahead, _budget: Arc::clone(&budget) };
            // What follows one that the log has not taken must not be in the log without it.
            is_launched = if is_launched { self.launch(flight) } else { self.ground(flight) };
        }
    }

    fn leave(&mut self, session: SessionId, clean: bool) {
        if let Some((key, reached)) = self.sessions.leave(session)
            && !clean
        {
            self.updates.stream_broke(key, reached);
        }
    }
}
