//! The open streams of observations: how many there are, and which one makes room for the next.
//!
//! A stream has a place among those that have not sent their hello, and with its hello it takes one among those that
//! have.
//!
//! Invariant: no more streams have a place than the limits allow, in total and per client. Where a limit is reached,
//! the oldest stream without a hello makes room for another stream without one. Among the streams with a hello, the one
//! that was silent for longest makes room, if it was silent for a given time and all that it sent is acknowledged. If
//! there is none, and all places are in use, a map that has fewer streams takes a place of the map that has most:
//! streams of one map never keep those of another out. Else the new stream is refused.

use std::{
    collections::HashMap,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use tidemap_base::shares::{Bound, Share, ShareFull, Shares, Taken, client::Client};
use tidemap_store::MapId;
use tokio::sync::watch;

use crate::status::RpcError;

/// The open streams. Clones share them.
#[derive(Clone, Debug)]
pub(crate) struct OpenStreams {
    shares: Shares,
    idle_after: Duration,
    open: Arc<Mutex<Open>>,
}

#[derive(Debug, Default)]
struct Open {
    streams: HashMap<u64, Arc<Activity>>,
    next: u64,
}

/// The reason why a stream has to end for another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Displaced {
    /// The stream was silent.
    Silent,
    /// The map of the stream had most of the streams.
    Crowded,
}

/// The place of a stream.
#[derive(Debug)]
struct StreamSeat {
    _taken: Taken,
    /// The map of the stream; `None` before its hello.
    map: Option<MapId>,
}

/// The state of an open stream.
#[derive(Debug)]
struct Activity {
    client: Client,
    opened: Instant,
    /// `None` after the stream was displaced. A lock, because other streams displace it; held only to read and to
    /// replace.
    place: Mutex<Option<StreamSeat>>,
    /// Milliseconds from `opened` to the last message of the stream, plus one; 0 before its first message.
    active_after_millis: AtomicU64,
    /// Whether something that the stream sent is not acknowledged.
    is_unacknowledged: AtomicBool,
    displaced: watch::Sender<Option<Displaced>>,
}

impl Activity {
    fn place(&self) -> MutexGuard<'_, Option<StreamSeat>> {
        self.place.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The map of the stream, if the stream has sent its hello and has a place.
    fn map(&self) -> Option<MapId> {
        self.place().as_ref()?.map
    }

    fn awaits_hello(&self) -> bool {
        self.place().as_ref().is_some_and(|place| place.map.is_none())
    }

    fn silent_for(&self, now: Instant) -> Duration {
        let millis = self.active_after_millis.load(Ordering::Acquire).saturating_sub(1);
        now.saturating_duration_since(self.opened + Duration::from_millis(millis))
    }

    fn is_unacknowledged(&self) -> bool {
        self.is_unacknowledged.load(Ordering::Acquire)
    }

    /// Frees the stream's place at once, and informs its task.
    fn displace(&self, why: Displaced) {
        drop(self.place().take());
        self.displaced.send_replace(Some(why));
        metrics::counter!("tidemap_streams_displaced_total").increment(1);
    }
}

/// The entry of an open stream; it is removed when it is dropped.
#[derive(Debug)]
pub(super) struct StreamEntry {
    number: u64,
    activity: Arc<Activity>,
    displaced: watch::Receiver<Option<Displaced>>,
    streams: OpenStreams,
}

impl Drop for StreamEntry {
    fn drop(&mut self) {
        let mut open = self.streams.lock();
        open.streams.remove(&self.number);
        drop(self.activity.place().take());
        metrics::gauge!("tidemap_streams").set(open.streams.len() as f64);
    }
}

impl Open {
    /// The streams that a full share counts.
    fn of<'a>(&'a self, full: &ShareFull, client: &Client) -> impl Iterator<Item = &'a Arc<Activity>> {
        let client = (full.bound == Bound::Client).then(|| client.clone());
        self.streams.values().filter(move |stream| client.as_ref().is_none_or(|client| stream.client == *client))
    }

    /// The stream that has waited for longest without a hello.
    fn without_hello(&self, full: &ShareFull, client: &Client) -> Option<&Arc<Activity>> {
        self.of(full, client).filter(|stream| stream.awaits_hello()).min_by_key(|stream| stream.opened)
    }

    /// The stream that was silent for longest, and for a given time.
    fn silent(&self, full: &ShareFull, client: &Client, idle_after: Duration, now: Instant) -> Option<&Arc<Activity>> {
        let is_silent = |stream: &&Arc<Activity>| {
            stream.map().is_some() && !stream.is_unacknowledged() && stream.silent_for(now) >= idle_after
        };
        self.of(full, client).filter(is_silent).max_by_key(|stream| stream.silent_for(now))
    }

    /// A stream of the map with the most streams, if that map has more than this map will have. Streams of the client
    /// with the most of them come first; among these, streams of which all is acknowledged; among these, the stream
    /// that was silent for longest.
    fn crowding(&self, map: MapId, now: Instant) -> Option<&Arc<Activity>> {
        let mut of_maps: HashMap<MapId, HashMap<&Client, usize>> = HashMap::new();
        for stream in self.streams.values() {
            if let Some(map) = stream.map() {
                *of_maps.entry(map).or_default().entry(&stream.client).or_default() += 1;
            }
        }
        let count = |clients: &HashMap<&Client, usize>| clients.values().sum::<usize>();
        let own = of_maps.get(&map).map_or(0, count);
        let (largest, clients) = of_maps.iter().max_by_key(|(_, clients)| count(clients))?;
        if count(clients) < own + 2 {
            return None;
        }
        let streams = self.streams.values().filter(|stream| stream.map() == Some(*largest));
        let of_client = |stream: &Activity| clients.get(&stream.client).copied().unwrap_or(0);
        streams.max_by_key(|stream| (of_client(stream), !stream.is_unacknowledged(), stream.silent_for(now)))
    }
}

impl OpenStreams {
    /// Creates an empty set of streams, which take from these shares. A stream that was silent for `idle_after` makes
    /// room.
    pub(crate) fn new(shares: Shares, idle_after: Duration) -> Self {
        Self { shares, idle_after, open: Arc::default() }
    }

    fn lock(&self) -> MutexGuard<'_, Open> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Enters a new stream of a client, which has to send its hello; another stream without one makes room if
    /// necessary.
    ///
    /// # Errors
    /// There is no room.
    pub(super) fn enter(&self, client: &Client) -> Result<StreamEntry, ShareFull> {
        let mut open = self.lock();
        let take = || self.shares.take(Share::Hellos, client, 1);
        let taken = match take() {
            Ok(taken) => taken,
            Err(full) => {
                open.without_hello(&full, client).ok_or(full)?.displace(Displaced::Silent);
                take()?
            }
        };
        let (sender, displaced) = watch::channel(None);
        let activity = Arc::new(Activity {
            client: client.clone(),
            opened: Instant::now(),
            place: Mutex::new(Some(StreamSeat { _taken: taken, map: None })),
            active_after_millis: AtomicU64::new(0),
            is_unacknowledged: AtomicBool::new(false),
            displaced: sender,
        });
        let number = open.next;
        open.next += 1;
        open.streams.insert(number, Arc::clone(&activity));
        metrics::gauge!("tidemap_streams").set(open.streams.len() as f64);
        drop(open);
        Ok(StreamEntry { number, activity, displaced, streams: self.clone() })
    }
}

impl StreamEntry {
    /// The client of the stream.
    pub(super) fn client(&self) -> &Client {
        &self.activity.client
    }

    /// Takes a place for the stream among those with a hello, after it has sent its hello for a map; another stream
    /// makes room if necessary.
    ///
    /// # Errors
    /// There is no room.
    pub(super) fn seat(&self, map: MapId) -> Result<(), RpcError> {
        let (streams, client, now) = (&self.streams, &self.activity.client, Instant::now());
        let open = streams.lock();
        if let Some(why) = *self.displaced.borrow() {
            return Err(self.end_of(why));
        }
        let take = || streams.shares.take(Share::Streams, client, 1);
        let taken = match take() {
            Ok(taken) => taken,
            Err(full) => {
                let silent = open.silent(&full, client, streams.idle_after, now).map(|one| (one, Displaced::Silent));
                let is_of_all = full.bound == Bound::All;
                let crowding = || open.crowding(map, now).filter(|_| is_of_all).map(|one| (one, Displaced::Crowded));
                let (other, why) = silent.or_else(crowding).ok_or(full)?;
                other.displace(why);
                take()?
            }
        };
        *self.activity.place() = Some(StreamSeat { _taken: taken, map: Some(map) });
        Ok(())
    }

    fn end_of(&self, why: Displaced) -> RpcError {
        match why {
            Displaced::Silent => RpcError::Idle(self.streams.idle_after),
            Displaced::Crowded => RpcError::Crowded,
        }
    }

    /// Records that the stream has sent something now.
    pub(super) fn mark_active(&self) {
        let millis = u64::try_from(self.activity.opened.elapsed().as_millis()).unwrap_or(u64::MAX);
        self.activity.active_after_millis.store(millis.saturating_add(1), Ordering::Release);
    }

    /// Sets whether something that the stream sent is not acknowledged.
    pub(super) fn set_unacknowledged(&self, is_unacknowledged: bool) {
        self.activity.is_unacknowledged.store(is_unacknowledged, Ordering::Release);
    }

    /// Waits until the stream has to make room; returns the reason.
    pub(super) async fn displaced(&mut self) -> RpcError {
        // The sender is part of the entry, so that it cannot be gone.
        let why = self.displaced.wait_for(Option::is_some).await.ok().and_then(|why| *why);
        self.end_of(why.unwrap_or(Displaced::Silent))
    }
}

#[cfg(test)]
mod tests {
    use tidemap_base::{config::Settings, shares::ShareLimits};

    use super::*;

    const OFFICE: MapId = MapId(1);

    fn streams(bounds: (usize, usize), idle_after: Duration) -> OpenStreams {
        OpenStreams::new(
            Shares::new(ShareLimits { streams: bounds, ..ShareLimits::of(&Settings::default()) }),
            idle_after,
        )
    }

    fn robot(number: usize) -> Client {
        Client::Token(number.to_string().into())
    }

    fn seated(streams: &OpenStreams, robot: &Client, map: MapId) -> Result<StreamEntry, RpcError> {
        let entry = streams.enter(robot)?;
        entry.mark_active();
        entry.seat(map)?;
        Ok(entry)
    }

    fn is_displaced(entry: &StreamEntry) -> bool {
        entry.displaced.borrow().is_some()
    }

    #[test]
    fn the_stream_that_was_silent_for_longest_makes_room() {
        let streams = streams((3, 3), Duration::ZERO);
        let [first, second, third] = [1, 2, 3].map(|number| seated(&streams, &robot(number), OFFICE).expect("room"));
        for entry in [&second, &first, &third] {
            entry.mark_active();
            std::thread::sleep(Duration::from_millis(2));
        }
        first.set_unacknowledged(true);
        let fourth = streams.enter(&robot(4)).expect("a place before its hello");
        assert!(!is_displaced(&second), "a stream without hello takes no place of others");
        fourth.seat(OFFICE).expect("the second makes room");
        assert!(is_displaced(&second) && !is_displaced(&first) && !is_displaced(&third));
        fourth.set_unacknowledged(true);
        let _fifth = seated(&streams, &robot(5), OFFICE).expect("the third makes room");
        assert!(is_displaced(&third) && !is_displaced(&first), "never one with something that is not acknowledged");
        drop((second, third));
        assert_eq!(streams.lock().streams.len(), 3);
    }

    #[test]
    fn streams_in_use_are_left_alone() {
        let streams = streams((1, 1), Duration::from_secs(60));
        let first = seated(&streams, &robot(1), OFFICE).expect("room");
        let error = seated(&streams, &robot(2), OFFICE).expect_err("the first has just sent something");
        assert!(error.to_string().contains("setting max_streams:"), "{error}");
        assert!(!is_displaced(&first));
        drop(first);
        assert!(seated(&streams, &robot(2), OFFICE).is_ok());
    }

    #[test]
    fn one_that_sends_no_hello_makes_room_for_the_next() {
        let streams = streams((2, 1), Duration::from_secs(60));
        let silent = streams.enter(&robot(1)).expect("room");
        let next = streams.enter(&robot(1)).expect("the first makes room");
        assert!(is_displaced(&silent) && !is_displaced(&next));
        assert!(silent.seat(OFFICE).is_err());
        next.seat(OFFICE).expect("a place");
    }

    #[test]
    fn one_client_leaves_places_to_others() {
        let streams = streams((4, 2), Duration::from_secs(60));
        let held = [(); 2].map(|()| seated(&streams, &robot(1), OFFICE).expect("room"));
        let error = seated(&streams, &robot(1), OFFICE).expect_err("it has its share");
        assert!(error.to_string().contains("max_streams_per_client"), "{error}");
        let _others = [2, 3].map(|number| seated(&streams, &robot(number), OFFICE).expect("room"));
        assert!(!held.iter().any(is_displaced));
    }

    #[test]
    fn streams_of_one_map_never_keep_those_of_another_out() {
        let streams = streams((6, 3), Duration::from_secs(60));
        let open = |client: usize, map| seated(&streams, &robot(client), MapId(map));
        let crowd: Vec<_> = [1, 1, 1, 2, 2, 3].map(|client| open(client, 1).expect("room")).into();
        crowd.iter().for_each(|entry| entry.set_unacknowledged(true));
        let others: Vec<_> = (0..3).map(|number| open(10 + number, 2).expect("a place of the other map")).collect();
        let of_first = crowd[..3].iter().filter(|entry| is_displaced(entry)).count();
        assert!(of_first >= 1, "who has most gives first");
        assert_eq!(crowd.iter().filter(|entry| is_displaced(entry)).count(), 3);
        assert!(!others.iter().any(is_displaced));
        let refused = open(20, 2).expect_err("both maps have their half");
        assert!(refused.to_string().contains("max_streams"), "{refused}");
        assert!(open(20, 1).is_err(), "and no place goes to and fro");
    }
}
