//! Connections: how many there are, how long one may be silent, and which one makes room for the next.
//!
//! Invariant: the number of connections is bounded, in total and per client. A connection that has not made a request
//! within [`REQUEST_WITHIN`] ends. When a bound is reached, one that never made a request makes room, or one that made
//! none for [`IDLE_AFTER`]; if all are busy, the new one is closed. A client that only holds connections open cannot
//! keep others out.

use std::{
    collections::HashMap,
    net::IpAddr,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    task::Waker,
    time::{Duration, Instant},
};

pub(crate) mod accept;
pub(crate) mod guard;
pub(crate) mod request_scan;
pub(crate) mod socket;
#[cfg(test)]
mod tests;
pub(crate) mod tls;
mod validity;

/// A connection must make its first request within this time.
const REQUEST_WITHIN: Duration = Duration::from_secs(5);
/// A connection without a request for this long may make room for another.
const IDLE_AFTER: Duration = Duration::from_secs(60);

/// Limits of a port's connections.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ConnectionLimits {
    /// Maximum number of connections.
    pub total: usize,
    /// Maximum number of connections of one client.
    pub per_client: usize,
}

/// Who is at the other end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Peer {
    /// A client with this address.
    Address(IpAddr),
    /// A process of this machine, over the Unix socket.
    Local,
}

/// The open connections of a port. Clones share them.
#[derive(Clone, Debug)]
pub(crate) struct Connections {
    limits: ConnectionLimits,
    open: Arc<Mutex<Open>>,
}

#[derive(Debug, Default)]
struct Open {
    seats: HashMap<u64, Arc<Seat>>,
    per_client: HashMap<Peer, usize>,
    next: u64,
}

/// What the port knows of a connection.
#[derive(Debug)]
struct Seat {
    peer: Peer,
    opened: Instant,
    /// Milliseconds from `opened` to its last request, and one more; 0 if it made none.
    asked_after_millis: AtomicU64,
    /// The connection has to make room for another.
    is_displaced: AtomicBool,
    waker: Mutex<Option<Waker>>,
}

/// The place of an open connection; free again when dropped.
#[derive(Debug)]
pub(crate) struct Place {
    number: u64,
    seat: Arc<Seat>,
    open: Arc<Mutex<Open>>,
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut open = lock(&self.open);
        open.seats.remove(&self.number);
        if let Some(count) = open.per_client.get_mut(&self.seat.peer) {
            *count -= 1;
            if *count == 0 {
                open.per_client.remove(&self.seat.peer);
            }
        }
        metrics::gauge!("tidemap_connections").set(open.seats.len() as f64);
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Seat {
    /// The connection made a request now.
    fn asks(&self) {
        let millis = u64::try_from(self.opened.elapsed().as_millis()).unwrap_or(u64::MAX);
        self.asked_after_millis.store(millis.saturating_add(1), Ordering::Relaxed);
    }

    /// When the connection made its last request.
    fn asked(&self) -> Option<Instant> {
        let millis = self.asked_after_millis.load(Ordering::Relaxed).checked_sub(1)?;
        Some(self.opened + Duration::from_millis(millis))
    }

    fn displace(&self) {
        self.is_displaced.store(true, Ordering::Release);
        if let Some(waker) = lock(&self.waker).take() {
            waker.wake();
        }
    }

    /// Whether the connection has to end; if not, the task is woken when it has to.
    fn is_displaced(&self, waker: &Waker) -> bool {
        let mut slot = lock(&self.waker);
        if self.is_displaced.load(Ordering::Acquire) {
            return true;
        }
        match &mut *slot {
            Some(known) => known.clone_from(waker),
            none => *none = Some(waker.clone()),
        }
        false
    }

    /// Which of two connections makes room first: those that never made a request, then those idle for longest.
    fn rank(&self, now: Instant) -> Option<(bool, Duration)> {
        match self.asked() {
            None => Some((true, now.saturating_duration_since(self.opened))),
            Some(asked) => {
                let idle = now.saturating_duration_since(asked);
                (idle >= IDLE_AFTER).then_some((false, idle))
            }
        }
    }
}

impl Open {
    /// Lets a connection make room, of any client or of one.
    fn displace(&mut self, of: Option<Peer>, now: Instant) -> bool {
        let candidates = self.seats.iter().filter(|(_, seat)| of.is_none_or(|peer| seat.peer == peer));
        let ranked = candidates
            .filter(|(_, seat)| !seat.is_displaced.load(Ordering::Acquire))
            .filter_map(|(number, seat)| seat.rank(now).map(|rank| (rank, *number)));
        let Some((_, number)) = ranked.max() else { return false };
        if let Some(seat) = self.seats.get(&number) {
            seat.displace();
        }
        metrics::counter!("tidemap_connections_displaced").increment(1);
        true
    }

    /// Number of open connections that do not have to make room, of any client or of one.
    fn staying(&self, of: Option<Peer>) -> usize {
        let stays =
            |seat: &&Arc<Seat>| of.is_none_or(|peer| seat.peer == peer) && !seat.is_displaced.load(Ordering::Acquire);
        self.seats.values().filter(stays).count()
    }
}

impl Connections {
    /// No connections.
    pub(crate) fn new(limits: ConnectionLimits) -> Self {
        Self { limits, open: Arc::default() }
    }

    /// A place for a new connection; another one makes room if it has to. `None` if all others are busy.
    pub(crate) fn admit(&self, peer: Peer) -> Option<Place> {
        let now = Instant::now();
        let mut open = lock(&self.open);
        let of_peer = open.per_client.get(&peer).copied().unwrap_or(0);
        // Most of the time both bounds are far away, and nothing is counted one by one.
        let is_full_for_peer = of_peer >= self.limits.per_client && open.staying(Some(peer)) >= self.limits.per_client;
        let has_room = !is_full_for_peer || open.displace(Some(peer), now);
        let is_full = open.seats.len() >= self.limits.total && open.staying(None) >= self.limits.total;
        if !has_room || (is_full && !open.displace(None, now)) {
            metrics::counter!("tidemap_connections_refused").increment(1);
            return None;
        }
        let seat = Arc::new(Seat {
            peer,
            opened: now,
            asked_after_millis: AtomicU64::new(0),
            is_displaced: AtomicBool::new(false),
            waker: Mutex::new(None),
        });
        let number = open.next;
        open.next += 1;
        open.seats.insert(number, Arc::clone(&seat));
        *open.per_client.entry(peer).or_default() += 1;
        metrics::gauge!("tidemap_connections").set(open.seats.len() as f64);
        drop(open);
        Some(Place { number, seat, open: Arc::clone(&self.open) })
    }

    /// Lets one connection make room, because the process has no descriptors left.
    pub(crate) fn make_room(&self) {
        lock(&self.open).displace(None, Instant::now());
    }
}
