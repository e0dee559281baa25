//! The open streams of one map, and what their batches in flight will add to the map.
//!
//! Invariant: at most one stream of a key accepts batches. A stream with batches in flight is remembered until the last
//! of them is answered, and no other stream of its key opens before that, so that no batch can be taken twice.

use std::collections::{BTreeMap, HashMap};

use tidemap_grid::{
    log_head::{LogHead, StreamTiles},
    sensors::ProducerSensor,
};
use tidemap_map::{
    event::{Envelope, Event, NewState, Reporting, SequenceSpan, StateKind, StateSensor},
    ids::{NewProducer, ProducerId, StateId},
    live_map::LiveMap,
    name::{ProducerKey, StateName},
};
use tidemap_model::OffsetCache;
use tokio::sync::mpsc;

use super::{
    ending::Ending,
    probe::Probe,
    protocol::{Hello, HelloError, RefusedObservation, SessionEvent, SessionId, Welcome},
};

mod observations;
mod reports;
mod scans;
mod sensors;
mod states;

use states::StreamState;

/// An event of a stream, to be appended to the log.
#[derive(Debug)]
pub(super) struct StreamEvent {
    pub event: Event,
    /// Its refused observations or scans.
    pub refused: Vec<RefusedObservation>,
    /// Tiles of its scans that wait because their time is in the future.
    pub tiles_ahead: u64,
}

#[derive(Debug)]
pub(super) struct Session {
    key: ProducerKey,
    producer: Option<ProducerId>,
    /// The sensor of all its scans; `None`: the map's default.
    sensor: Option<ProducerSensor>,
    incarnation: u64,
    probe: Option<Probe>,
    events: mpsc::UnboundedSender<SessionEvent>,
    table: Vec<StreamState>,
    /// What its scans have shown: the tiles that it sent, and those that were ray-cast for it.
    sent_tiles: StreamTiles,
    raycast_tiles: StreamTiles,
    in_flight: usize,
    open: bool,
    /// If the stream announces data time: the greatest time so far, nanoseconds UTC.
    data_time: Option<i64>,
}

impl Session {
    /// The producer of the observations; a new one if nothing of the key is durable or in flight.
    fn producer(&mut self, map: &LiveMap, in_flight: &mut usize) -> (ProducerId, Option<NewProducer>) {
        if let Some(producer) = self.producer {
            return (producer, None);
        }
        let producer = ProducerId(u32::try_from(map.producers() + *in_flight).unwrap_or(u32::MAX));
        *in_flight += 1;
        self.producer = Some(producer);
        (producer, Some(NewProducer { key: self.key.clone(), sensor: self.sensor }))
    }

    /// The envelope of an event of the stream, which is in flight from now on. Sorts what was refused.
    fn envelope(
        &mut self,
        map: &LiveMap,
        producers_in_flight: &mut usize,
        now: i64,
        span: SequenceSpan,
        refused: &mut [RefusedObservation],
    ) -> Envelope {
        refused.sort_by_key(|refused| refused.sequence);
        let (producer, new_producer) = self.producer(map, producers_in_flight);
        self.in_flight += 1;
        Envelope {
            producer,
            new_producer,
            incarnation: self.incarnation,
            span,
            received_nanos: now,
            refused: refused.iter().map(|refused| (refused.sequence, refused.reason)).collect(),
        }
    }

    /// Sends the stream a message, if it is still there.
    fn tell(&self, event: SessionEvent) {
        // The receiver is gone when the client is: nobody needs the message.
        let _ = self.events.send(event);
    }
}

/// Limits of what the streams of a map add to it.
#[derive(Clone, Copy, Debug)]
pub(super) struct SessionLimits {
    /// States of the map.
    pub states: usize,
    /// Producer keys of the map.
    pub producers: usize,
    /// Observations, or tiles of scans, that wait because their time is in the future.
    pub ahead: u64,
    /// Tiles of the map.
    pub tiles: usize,
}

/// All streams of a map.
#[derive(Debug)]
pub(super) struct Sessions {
    next_id: u64,
    sessions: BTreeMap<SessionId, Session>,
    open_by_key: HashMap<ProducerKey, SessionId>,
    states_in_flight: HashMap<StateName, (StateId, StateKind)>,
    /// Sensors of states in flight, where they are known.
    sensors_in_flight: HashMap<StateId, StateSensor>,
    /// How states in flight are reported that do not report samples.
    reportings_in_flight: HashMap<StateId, Reporting>,
    /// Categorical states in flight: the first label of each, and how many there are.
    categorical_in_flight: HashMap<StateName, (StateId, u8)>,
    /// New names in flight, of states that still have their old names.
    renames_in_flight: HashMap<StateName, (StateId, StateKind)>,
    producers_in_flight: usize,
    /// The highest incarnation given to keys that have nothing durable yet.
    issued: HashMap<ProducerKey, u64>,
    /// Streams that announced data time and broke, with the greatest time of their data.
    broken: Vec<(ProducerKey, i64)>,
    offsets: OffsetCache,
    /// The map's tiles after everything in flight is applied; `None` until a scan comes.
    log_head: Option<LogHead>,
    /// Tiles of scans in flight that wait because their time is in the future.
    tiles_ahead: u64,
    limits: SessionLimits,
}

impl Sessions {
    pub(super) fn new(offsets: OffsetCache, limits: SessionLimits) -> Self {
        Self {
            next_id: 1,
            sessions: BTreeMap::new(),
            open_by_key: HashMap::new(),
            states_in_flight: HashMap::new(),
            sensors_in_flight: HashMap::new(),
            reportings_in_flight: HashMap::new(),
            categorical_in_flight: HashMap::new(),
            renames_in_flight: HashMap::new(),
            producers_in_flight: 0,
            issued: HashMap::new(),
            broken: Vec::new(),
            offsets,
            log_head: None,
            tiles_ahead: 0,
            limits,
        }
    }

    /// Whether a stream of the key is open.
    pub(super) fn is_open(&self, key: &ProducerKey) -> bool {
        self.open_by_key.contains_key(key)
    }

    /// Opens a stream, which replaces an open one of the same key if the hello allows that. `Ok(None)`: batches of the
    /// key are still in flight; ask again when they are answered.
    pub(super) fn open(&mut self, hello: &Hello, map: &LiveMap) -> Result<Option<Welcome>, HelloError> {
        let mark = map.producer(&hello.key);
        let open = self.open_by_key.get(&hello.key).and_then(|id| self.sessions.get(id));
        let seen = mark.map_or(0, |(_, mark)| mark.incarnation);
        let issued = self.issued.get(&hello.key).copied().unwrap_or(0);
        let current = open.map_or(0, |session| session.incarnation).max(seen).max(issued);
        let open_id = self.open_of(&hello.key);
        let takes_over = open_id.is_some() && hello.takes_over == open_id;
        if hello.incarnation == 0
            && let Some(session) = open
            && !takes_over
        {
            let open = open_id.zip(session.probe.clone());
            return Err(HelloError::AlreadyStreaming { key: hello.key.clone(), open });
        }
        if hello.incarnation != 0 && hello.incarnation < current {
            return Err(HelloError::Fenced { key: hello.key.clone(), got: hello.incarnation, current });
        }
        let sensor = self.sensor(hello, map)?;
        if let Some(id) = open_id {
            self.end(id, if takes_over { &Ending::Unanswered } else { &Ending::Superseded });
        }
        if self.sessions.values().any(|session| session.key == hello.key && session.in_flight > 0) {
            return Ok(None);
        }
        let new_keys = self.open_by_key.keys().filter(|key| map.producer(key).is_none()).count();
        if mark.is_none() && map.producers() + new_keys >= self.limits.producers {
            return Err(HelloError::TooManyProducers { max: self.limits.producers });
        }
        let id = SessionId(self.next_id);
        self.next_id += 1;
        let incarnation = if hello.incarnation == 0 { current.saturating_add(1) } else { hello.incarnation };
        self.sessions.insert(
            id,
            Session {
                key: hello.key.clone(),
                producer: mark.map(|(id, _)| id),
                sensor,
                incarnation,
                probe: hello.probe.clone(),
                events: hello.events.clone(),
                table: Vec::new(),
                sent_tiles: StreamTiles::default(),
                raycast_tiles: StreamTiles::default(),
                in_flight: 0,
                open: true,
                data_time: hello.nightly.then_some(i64::MIN),
            },
        );
        self.open_by_key.insert(hello.key.clone(), id);
        if mark.is_none() {
            if self.issued.len() >= self.limits.producers {
                // Keys that never sent anything; forgetting them costs a fence, not an observation.
                self.issued.clear();
            }
            self.issued.insert(hello.key.clone(), incarnation);
        }
        let (durable_sequence, content_crc) = mark.map_or((0, 0), |(_, m)| (m.durable_sequence, m.content_crc));
        let content_marks = mark.map_or_else(Vec::new, |(_, mark)| mark.content_marks());
        Ok(Some(Welcome { session: id, incarnation, durable_sequence, content_crc, content_marks }))
    }

    /// An event of the stream was applied to the map. `tiles_ahead`: its tiles that wait for their time.
    pub(super) fn applied(&mut self, id: SessionId, event: &Event, tiles_ahead: u64) {
        self.tiles_ahead = self.tiles_ahead.saturating_sub(tiles_ahead);
        let Some(envelope) = event.envelope() else { return };
        // A time in the future does not close the days before it.
        let plausible = envelope.plausible_nanos();
        let newest = match event {
            Event::Observations(_, event) => {
                for (id, name, _) in event.new_states.iter().flat_map(NewState::states) {
                    self.states_in_flight.remove(&name);
                    self.reportings_in_flight.remove(&id);
                }
                event.times_nanos.iter().copied().filter(|time| *time <= plausible).max()
            }
            Event::Scans(_, event) => {
                event.scans.iter().map(|scan| scan.utc_nanos).filter(|time| *time <= plausible).max()
            }
            Event::UpdateStart(_)
            | Event::AddState(_)
            | Event::EditSite(_)
            | Event::Epoch(_)
            | Event::UpdateDone(_) => None,
        };
        self.producers_in_flight -= usize::from(envelope.new_producer.is_some());
        if let Some(session) = self.sessions.get_mut(&id) {
            session.in_flight -= 1;
            self.issued.remove(&session.key);
            if let (Some(reached), Some(newest)) = (session.data_time.as_mut(), newest) {
                *reached = (*reached).max(newest);
            }
        }
        self.forget(id);
    }

    /// An event of the stream could not be logged: the stream ends.
    pub(super) fn failed(&mut self, id: SessionId, ending: &Ending) {
        if let Some(session) = self.sessions.get_mut(&id) {
            session.in_flight -= 1;
        }
        self.end(id, ending);
        self.forget(id);
    }

    /// All batches in flight have failed: forgets what they would have added.
    pub(super) fn roll_back(&mut self) {
        self.states_in_flight.clear();
        self.sensors_in_flight.clear();
        self.reportings_in_flight.clear();
        self.categorical_in_flight.clear();
        self.renames_in_flight.clear();
        self.producers_in_flight = 0;
        self.tiles_ahead = 0;
        self.log_head = None;
        for session in self.sessions.values_mut() {
            session.sent_tiles.forget_tiles();
            session.raycast_tiles.forget_tiles();
        }
    }

    /// Ends an open stream and reports why.
    pub(super) fn end(&mut self, id: SessionId, ending: &Ending) {
        if let Some(session) = self.sessions.get_mut(&id).filter(|session| session.open) {
            session.tell(SessionEvent::End(ending.clone()));
        }
        let announced = self.leave(id);
        self.broken.extend(announced);
    }

    /// The open stream of a key.
    pub(super) fn open_of(&self, key: &ProducerKey) -> Option<SessionId> {
        self.open_by_key.get(key).copied()
    }

    /// Sends a message to a stream that is open or has batches in flight.
    pub(super) fn tell(&self, id: SessionId, event: SessionEvent) {
        if let Some(session) = self.sessions.get(&id) {
            session.tell(event);
        }
    }

    /// Streams that announced data time and were ended by the server, since the last call.
    pub(super) fn take_broken(&mut self) -> Vec<(ProducerKey, i64)> {
        std::mem::take(&mut self.broken)
    }

    /// Ends all streams.
    pub(super) fn end_all(&mut self, ending: &Ending) {
        for id in self.sessions.keys().copied().collect::<Vec<_>>() {
            self.end(id, ending);
        }
    }

    /// Closes the stream. Gives its key and data time if it announced data time.
    pub(super) fn leave(&mut self, id: SessionId) -> Option<(ProducerKey, i64)> {
        let session = self.sessions.get_mut(&id)?;
        if session.open {
            session.open = false;
            self.open_by_key.remove(&session.key);
        }
        let announced = session.data_time.take().map(|reached| (session.key.clone(), reached));
        self.forget(id);
        announced
    }

    fn forget(&mut self, id: SessionId) {
        if self.sessions.get(&id).is_some_and(|session| !session.open && session.in_flight == 0) {
            self.sessions.remove(&id);
        }
    }

    /// Streams that announce data time, with the greatest time of their data.
    pub(super) fn data_times(&self) -> impl Iterator<Item = (&ProducerKey, i64)> {
        self.sessions.values().filter_map(|session| session.data_time.map(|reached| (&session.key, reached)))
    }
}
