//! The open streams of one map, and the additions of their batches in flight to the map.
//!
//! Invariant: at most one stream of a key accepts batches. A stream with batches in flight is remembered until the last
//! of them is completed, and no other stream of its key opens before that, so that no batch can be taken twice.

use std::collections::{BTreeMap, HashMap};

use tidemap_grid::{
    log_head::{LogHead, StreamTiles},
    sensors::ProducerSensor,
};
use tidemap_map::{
    event::{Envelope, Event, SequenceSpan},
    ids::{NewProducer, ProducerId},
    live_map::LiveMap,
    name::ProducerKey,
};
use tidemap_model::OffsetCache;
use tokio::sync::mpsc;

use super::{
    ending::Ending,
    probe::Probe,
    protocol::{ForgetError, ForgetProducers, Hello, HelloError, RefusedObservation, SessionEvent, SessionId, Welcome},
};

mod observations;
mod places;
mod reports;
mod scans;
mod sensors;
mod states;
mod states_in_flight;

use places::{PlaceKind, Places};
use states::StreamState;
use states_in_flight::StatesInFlight;

/// Number of keys that may be forgotten for each place of a producer key: the observations that they sent keep their
/// numbers, which takes memory.
const FORGOTTEN_PER_PLACE: usize = 10;

/// An event of a stream, to be appended to the log.
#[derive(Debug)]
pub(super) struct StreamEvent {
    pub event: Event,
    /// The refused observations or scans of the event.
    pub refused: Vec<RefusedObservation>,
    /// Number of the tiles of the event's scans that wait because their time is in the future.
    pub tiles_ahead: u64,
}

#[derive(Debug)]
pub(super) struct Session {
    key: ProducerKey,
    producer: Option<ProducerId>,
    /// The sensor of all scans of the stream; `None`: the map's default.
    sensor: Option<ProducerSensor>,
    /// The client, by its name in the shares; empty: it has no share of its own.
    client: String,
    incarnation: u64,
    probe: Option<Probe>,
    events: mpsc::UnboundedSender<SessionEvent>,
    table: Vec<StreamState>,
    /// The tiles that the scans of the stream have shown: the ones that it sent, and the ones that were ray-cast for
    /// it.
    sent_tiles: StreamTiles,
    raycast_tiles: StreamTiles,
    in_flight: usize,
    open: bool,
    /// If the stream announces data time: the greatest time so far, nanoseconds UTC.
    data_time: Option<i64>,
}

impl Session {
    /// The producer of the observations; a new producer if nothing of the key is durable or in flight.
    fn producer(&mut self, map: &LiveMap, in_flight: &mut usize) -> (ProducerId, Option<NewProducer>) {
        if let Some(producer) = self.producer {
            return (producer, None);
        }
        let producer = ProducerId(u32::try_from(map.producers() + *in_flight).unwrap_or(u32::MAX));
        *in_flight += 1;
        self.producer = Some(producer);
        let introduced_by = self.client.clone();
        (producer, Some(NewProducer { key: self.key.clone(), sensor: self.sensor, introduced_by }))
    }

    /// The envelope of an event of the stream, which is in flight from now on. Sorts the refusals.
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

    /// Sends a message to the stream, if it is still there.
    fn notify(&self, event: SessionEvent) {
        // When the client is gone, the receiver is gone: nobody needs the message.
        let _ = self.events.send(event);
    }
}

/// The limits for the additions of streams to a map.
#[derive(Clone, Copy, Debug)]
pub(super) struct SessionLimits {
    /// Maximum number of states of the map.
    pub states: usize,
    /// Maximum number of producer keys of the map.
    pub producers: usize,
    /// Maximum number of producer keys of the map that one client has introduced.
    pub producers_of_client: usize,
    /// Maximum number of observations, or tiles of scans, that wait because their time is in the future.
    pub ahead: u64,
    /// Maximum number of tiles of the map.
    pub tiles: usize,
}

/// All streams of a map.
#[derive(Debug)]
pub(super) struct Sessions {
    next_id: u64,
    sessions: BTreeMap<SessionId, Session>,
    open_by_key: HashMap<ProducerKey, SessionId>,
    states_in_flight: StatesInFlight,
    producers_in_flight: usize,
    /// The highest incarnation given to keys that have nothing durable yet.
    issued: HashMap<ProducerKey, u64>,
    /// Streams that announced data time and broke, with the greatest time of their data.
    broken: Vec<(ProducerKey, i64)>,
    offsets: OffsetCache,
    /// The map's tiles after all events in flight are applied; `None` until a scan comes.
    log_head: Option<LogHead>,
    /// Tiles of scans in flight that wait because their time is in the future.
    tiles_ahead: u64,
    state_places: Places,
    tile_places: Places,
    limits: SessionLimits,
}

impl Sessions {
    pub(super) fn new(offsets: OffsetCache, limits: SessionLimits) -> Self {
        Self {
            next_id: 1,
            sessions: BTreeMap::new(),
            open_by_key: HashMap::new(),
            states_in_flight: StatesInFlight::default(),
            producers_in_flight: 0,
            issued: HashMap::new(),
            broken: Vec::new(),
            offsets,
            log_head: None,
            tiles_ahead: 0,
            state_places: Places::new(PlaceKind::States, limits.states),
            tile_places: Places::new(PlaceKind::Tiles, limits.tiles),
            limits,
        }
    }

    /// Whether a stream of the key is open.
    pub(super) fn is_open(&self, key: &ProducerKey) -> bool {
        self.open_by_key.contains_key(key)
    }

    /// Opens a stream, which replaces an open one of the same key if the hello allows that. `Ok(None)`: batches of the
    /// key are still in flight; call this again when they are completed.
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
            if mark.is_some_and(|(_, mark)| mark.is_forgotten) {
                return Err(HelloError::Forgotten { key: hello.key.clone() });
            }
            return Err(HelloError::Fenced { key: hello.key.clone(), got: hello.incarnation, current });
        }
        let sensor = self.sensor(hello, map)?;
        if let Some(id) = open_id {
            self.end(id, if takes_over { &Ending::Unanswered } else { &Ending::Superseded });
        }
        if self.sessions.values().any(|session| session.key == hello.key && session.in_flight > 0) {
            return Ok(None);
        }
        if mark.is_none_or(|(_, mark)| mark.is_forgotten) {
            self.check_place(hello, map)?;
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
                client: hello.client.clone(),
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
                // These keys never sent anything; forgetting them loses a fence, not an observation.
                self.issued.clear();
            }
            self.issued.insert(hello.key.clone(), incarnation);
        }
        let (durable_sequence, content_crc) = mark.map_or((0, 0), |(_, m)| (m.durable_sequence, m.content_crc));
        let content_marks = mark.map_or_else(Vec::new, |(_, mark)| mark.content_marks());
        Ok(Some(Welcome { session: id, incarnation, durable_sequence, content_crc, content_marks }))
    }

    /// Checks that there is a place for a producer key that has none.
    fn check_place(&self, hello: &Hello, map: &LiveMap) -> Result<(), HelloError> {
        let has_place = |key: &ProducerKey| map.producer(key).is_some_and(|(_, mark)| !mark.is_forgotten);
        let new = || self.sessions.values().filter(|session| session.open && !has_place(&session.key));
        if map.producer_places() + new().count() >= self.limits.producers {
            return Err(HelloError::TooManyProducers { max: self.limits.producers });
        }
        let (client, max) = (&hello.client, self.limits.producers_of_client);
        let marks = map.producer_marks().iter().filter(|mark| !mark.is_forgotten && mark.introduced_by == *client);
        if !client.is_empty() && marks.count() + new().filter(|session| session.client == *client).count() >= max {
            return Err(HelloError::TooManyOfClient { client: client.clone(), max });
        }
        Ok(())
    }

    /// The keys of a producer that can give their places up.
    ///
    /// # Errors
    /// There is no such key, one has a stream, or too many are forgotten.
    pub(super) fn forgettable(&self, forget: &ForgetProducers, map: &LiveMap) -> Result<Vec<ProducerId>, ForgetError> {
        let ForgetProducers { producer, label, .. } = forget;
        let is_meant =
            |key: &ProducerKey| key.producer() == producer && label.as_ref().is_none_or(|label| key.label() == label);
        let busy = |session: &&Session| is_meant(&session.key) && (session.open || session.in_flight > 0);
        if let Some(session) = self.sessions.values().find(busy) {
            let label = session.key.label().to_owned();
            return Err(ForgetError::Streaming { producer: producer.clone(), label });
        }
        let marks = (0..).map(ProducerId).zip(map.producer_marks());
        let meant = marks.filter(|(_, mark)| !mark.is_forgotten && is_meant(&mark.key));
        let found: Vec<ProducerId> = meant.map(|(id, _)| id).collect();
        if found.is_empty() {
            return Err(ForgetError::Unknown { producer: producer.clone(), label: label.clone() });
        }
        let (forgotten, max) = (map.forgotten_producers(), FORGOTTEN_PER_PLACE * self.limits.producers);
        if forgotten + found.len() > max {
            return Err(ForgetError::TooMany { forgotten, max });
        }
        Ok(found)
    }

    /// An event of the stream was applied to the map. `tiles_ahead`: the number of its tiles that wait for their time.
    pub(super) fn applied(&mut self, id: SessionId, event: &Event, tiles_ahead: u64) {
        self.tiles_ahead = self.tiles_ahead.saturating_sub(tiles_ahead);
        let Some(envelope) = event.envelope() else { return };
        // A time in the future does not close the days before it.
        let plausible = envelope.plausible_nanos();
        let (mut new_states, mut new_tiles) = (0, 0);
        let newest = match event {
            Event::Observations(_, event) => {
                new_states = event.new_states.iter().map(|new| self.states_in_flight.remove(new)).sum();
                event.times_nanos.iter().copied().filter(|time| *time <= plausible).max()
            }
            Event::Scans(_, event) => {
                new_tiles = event.new_tiles.len();
                event.scans.iter().map(|scan| scan.utc_nanos).filter(|time| *time <= plausible).max()
            }
            Event::UpdateStart(_)
            | Event::AddState(_)
            | Event::EditSite(_)
            | Event::Epoch(_)
            | Event::UpdateDone(_)
            | Event::ForgetProducers(_) => None,
        };
        self.producers_in_flight -= usize::from(envelope.new_producer.is_some());
        if let Some(session) = self.sessions.get_mut(&id) {
            session.in_flight -= 1;
            self.state_places.applied(&session.client, new_states);
            self.tile_places.applied(&session.client, new_tiles);
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

    /// All batches in flight have failed: forgets their additions.
    pub(super) fn roll_back(&mut self) {
        self.states_in_flight.clear();
        self.producers_in_flight = 0;
        self.tiles_ahead = 0;
        self.state_places.roll_back();
        self.tile_places.roll_back();
        self.log_head = None;
        for session in self.sessions.values_mut() {
            session.sent_tiles.forget_tiles();
            session.raycast_tiles.forget_tiles();
        }
    }

    /// Ends an open stream and sends it the reason.
    pub(super) fn end(&mut self, id: SessionId, ending: &Ending) {
        if let Some(session) = self.sessions.get_mut(&id).filter(|session| session.open) {
            session.notify(SessionEvent::End(ending.clone()));
        }
        let announced = self.leave(id);
        self.broken.extend(announced);
    }

    /// The open stream of a key.
    pub(super) fn open_of(&self, key: &ProducerKey) -> Option<SessionId> {
        self.open_by_key.get(key).copied()
    }

    /// Sends a message to a stream that is open or has batches in flight.
    pub(super) fn notify(&self, id: SessionId, event: SessionEvent) {
        if let Some(session) = self.sessions.get(&id) {
            session.notify(event);
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

    /// Closes the stream. Returns its key and data time if it announced data time.
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
