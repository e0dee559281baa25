//! Connections: how many there are, how long one may be silent, and which one makes room for the next.
//!
//! Invariant: the number of connections is bounded, in total and per client. A connection that has not made a request
//! within [`REQUEST_WITHIN`] ends. When a bound is reached, a connection that works on no request makes room: first a
//! connection of which no request was served, then one that is idle for long enough. If all are busy, the new
//! connection is closed. A client that only holds connections open, or whose requests are refused, cannot keep others
//! out. On the HTTP port a connection whose reply nobody reads makes room like an idle one; and when all are busy, a
//! connection of the client that has the most makes room for a client that has few.

use std::{
    collections::HashMap,
    fmt,
    net::IpAddr,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering},
    },
    task::Waker,
    time::{Duration, Instant},
};

pub mod accept;
mod certificate;
pub mod guard;
pub mod http1;
pub mod socket;
mod stall;
#[cfg(test)]
mod tests;
pub mod tls;
pub mod unread;

/// A connection must make its first request within this time.
const REQUEST_WITHIN: Duration = Duration::from_secs(5);
/// A connection whose client takes nothing of its reply for this time may make room for another.
const STALLED_AFTER: Duration = Duration::from_secs(2);
/// A client has few connections if another client has more than this many times as many.
const FEW: usize = 4;

/// Limits of a port's connections.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConnectionLimits {
    /// Maximum number of connections.
    pub total: usize,
    /// Maximum number of connections of one client.
    pub per_client: usize,
    /// A connection that works on no request for this long may make room for another.
    pub idle_after: Duration,
}

/// Limits of the HTTP port. Browsers and scripts connect again where they find an idle connection closed.
pub const HTTP_CONNECTIONS: ConnectionLimits =
    ConnectionLimits { total: 256, per_client: 128, idle_after: Duration::from_secs(1) };

/// The kind of connections, as the metrics name it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Port {
    /// Connections of the gRPC port and of the Unix socket.
    Grpc,
    /// Connections of the HTTP port.
    Http,
    /// Connections of the HTTP port beyond its limits, which may only read whether the daemon lives. They last
    /// [`REQUEST_WITHIN`] at most, and each may make room for the next.
    Probes,
    /// Connections of the programs that import recordings.
    Imports,
}

impl Port {
    /// The value of the label `port` in metrics.
    pub fn name(self) -> &'static str {
        match self {
            Self::Grpc => "grpc",
            Self::Http => "http",
            Self::Probes => "probes",
            Self::Imports => "imports",
        }
    }
}

/// The client at the other end of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Peer {
    /// A client with this address.
    Address(IpAddr),
    /// A process of this machine, over the Unix socket.
    Local,
}

impl fmt::Display for Peer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Address(address) => address.fmt(f),
            Self::Local => f.write_str("the Unix socket"),
        }
    }
}

impl Peer {
    /// Whether the peer is a process of this machine.
    pub fn is_of_this_machine(self) -> bool {
        match self {
            Self::Address(address) => address.is_loopback(),
            Self::Local => true,
        }
    }
}

/// The open connections of a port. Clones share them.
#[derive(Clone, Debug)]
pub struct Connections {
    port: Port,
    limits: ConnectionLimits,
    open: Arc<Mutex<Open>>,
}

#[derive(Debug, Default)]
struct Open {
    seats: HashMap<u64, Arc<Seat>>,
    per_client: HashMap<Peer, usize>,
    next: u64,
}

/// The state of a connection.
#[derive(Debug)]
struct Seat {
    peer: Peer,
    opened: Instant,
    /// Number of requests that are worked on.
    requests: AtomicUsize,
    /// Whether a request has arrived, whether it is served or not.
    has_request: AtomicBool,
    /// Milliseconds from `opened` to the end of the last request that was served, plus one; 0 if there was none.
    served_after_millis: AtomicU64,
    /// Milliseconds from `opened` to when the client ceased to take its reply, plus one; 0 while the client takes it.
    stalled_after_millis: AtomicU64,
    /// Whether the connection has to make room for another.
    is_displaced: AtomicBool,
    waker: Mutex<Option<Waker>>,
}

/// The other end of a connection. Requests carry it as an extension.
#[derive(Clone, Debug)]
pub struct Remote(Arc<Seat>);

impl Remote {
    /// The client at the other end.
    pub fn peer(&self) -> Peer {
        self.0.peer
    }

    /// Records that the connection has made a request, whether it is served or not.
    pub fn note_request(&self) {
        self.0.has_request.store(true, Ordering::Release);
    }

    /// Makes the connection end.
    fn displace(&self) {
        self.0.displace();
    }

    /// Keeps the connection busy until the result is dropped. `is_served`: the caller of the request is allowed to make
    /// it, so that the connection counts as one in use afterwards.
    pub fn busy(&self, is_served: bool) -> Busy {
        self.0.requests.fetch_add(1, Ordering::AcqRel);
        Busy { seat: Arc::clone(&self.0), is_served }
    }
}

/// A request that is worked on.
#[derive(Debug)]
pub struct Busy {
    seat: Arc<Seat>,
    is_served: bool,
}

impl Drop for Busy {
    fn drop(&mut self) {
        if self.is_served {
            self.seat.served_after_millis.store(self.seat.millis_of(Instant::now()), Ordering::Release);
        }
        self.seat.requests.fetch_sub(1, Ordering::AcqRel);
    }
}

/// One of the connections that a port may have open; it is free again when dropped.
#[derive(Debug)]
pub struct ConnectionSlot {
    number: u64,
    seat: Arc<Seat>,
    port: Port,
    open: Arc<Mutex<Open>>,
}

impl ConnectionSlot {
    /// The other end of this connection.
    pub fn remote(&self) -> Remote {
        Remote(Arc::clone(&self.seat))
    }
}

impl Drop for ConnectionSlot {
    fn drop(&mut self) {
        let mut open = lock(&self.open);
        open.seats.remove(&self.number);
        if let Some(count) = open.per_client.get_mut(&self.seat.peer) {
            *count -= 1;
            if *count == 0 {
                open.per_client.remove(&self.seat.peer);
            }
        }
        metrics::gauge!("tidemap_connections", "port" => self.port.name()).set(open.seats.len() as f64);
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Seat {
    fn has_request(&self) -> bool {
        self.has_request.load(Ordering::Acquire)
    }

    /// A moment as milliseconds since the connection was opened, plus one.
    fn millis_of(&self, moment: Instant) -> u64 {
        let since = moment.saturating_duration_since(self.opened).as_millis();
        u64::try_from(since).unwrap_or(u64::MAX).saturating_add(1)
    }

    /// The time since a moment that [`Seat::millis_of`] returned; `None` for 0.
    fn since(&self, millis: &AtomicU64, now: Instant) -> Option<Duration> {
        let millis = millis.load(Ordering::Acquire).checked_sub(1)?;
        Some(now.saturating_duration_since(self.opened + Duration::from_millis(millis)))
    }

    /// Records since when the client takes nothing of its reply; `None`: the client takes it.
    fn note_stall(&self, since: Option<tokio::time::Instant>) {
        let millis = since.map_or(0, |since| self.millis_of(since.into_std()));
        self.stalled_after_millis.store(millis, Ordering::Release);
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

    /// The rank of the connection for making room: first connections of which no request was served, then those idle
    /// for longest. `None`: the connection is in use.
    fn rank(&self, idle_after: Duration, now: Instant) -> Option<(bool, Duration)> {
        let stalled = self.since(&self.stalled_after_millis, now).filter(|stalled| *stalled >= STALLED_AFTER);
        if stalled.is_none() && self.requests.load(Ordering::Acquire) > 0 {
            return None;
        }
        let Some(idle) = self.since(&self.served_after_millis, now) else {
            return Some((true, now.saturating_duration_since(self.opened)));
        };
        let idle = stalled.unwrap_or(idle);
        (stalled.is_some() || idle >= idle_after).then_some((false, idle))
    }
}

impl Open {
    /// Number of open connections that do not have to make room, of all clients or of one.
    fn staying(&self, peer: Option<Peer>) -> usize {
        let stays =
            |seat: &&Arc<Seat>| peer.is_none_or(|peer| seat.peer == peer) && !seat.is_displaced.load(Ordering::Acquire);
        self.seats.values().filter(stays).count()
    }
}

impl Connections {
    /// Creates an empty set of connections.
    pub fn new(port: Port, limits: ConnectionLimits) -> Self {
        Self { port, limits, open: Arc::default() }
    }

    /// The kind of these connections.
    pub fn port(&self) -> Port {
        self.port
    }

    /// Makes a connection of any client, or of one client, make room.
    fn displace(&self, open: &Open, peer: Option<Peer>, now: Instant) -> bool {
        let rank = |seat: &Seat| match self.port {
            Port::Probes => Some((true, now.saturating_duration_since(seat.opened))),
            Port::Grpc | Port::Http | Port::Imports => seat.rank(self.limits.idle_after, now),
        };
        let candidates = open.seats.values().filter(|seat| peer.is_none_or(|peer| seat.peer == peer));
        let ranked = candidates
            .filter(|seat| !seat.is_displaced.load(Ordering::Acquire))
            .filter_map(|seat| Some((rank(seat)?, seat)));
        let Some((_, seat)) = ranked.max_by_key(|(rank, _)| *rank) else { return false };
        self.make_way(seat);
        true
    }

    /// Makes the newest connection of the client that has the most make room for a client that has few.
    fn displace_of_largest(&self, open: &Open, newcomer: Peer) -> bool {
        if self.port != Port::Http {
            return false;
        }
        let of_newcomer = open.staying(Some(newcomer)) + 1;
        let largest =
            open.per_client.keys().map(|peer| (open.staying(Some(*peer)), *peer)).max_by_key(|(count, _)| *count);
        let Some((_, largest)) = largest.filter(|(count, _)| *count > FEW * of_newcomer) else { return false };
        let staying =
            open.seats.iter().filter(|(_, seat)| seat.peer == largest && !seat.is_displaced.load(Ordering::Acquire));
        let Some((_, seat)) = staying.max_by_key(|(number, _)| **number) else { return false };
        self.make_way(seat);
        true
    }

    fn make_way(&self, seat: &Seat) {
        seat.displace();
        metrics::counter!("tidemap_connections_displaced", "port" => self.port.name()).increment(1);
    }

    /// A slot for a new connection; another connection makes room if necessary. `None` if all others are busy.
    pub fn admit(&self, peer: Peer) -> Option<ConnectionSlot> {
        let now = Instant::now();
        let mut open = lock(&self.open);
        let of_peer = open.per_client.get(&peer).copied().unwrap_or(0);
        // Usually both bounds are far away, and connections are not counted one by one.
        let is_full_for_peer = of_peer >= self.limits.per_client && open.staying(Some(peer)) >= self.limits.per_client;
        let has_room = !is_full_for_peer || self.displace(&open, Some(peer), now);
        let is_full = open.seats.len() >= self.limits.total && open.staying(None) >= self.limits.total;
        let gets_room = || self.displace(&open, None, now) || self.displace_of_largest(&open, peer);
        if !has_room || (is_full && !gets_room()) {
            metrics::counter!("tidemap_connections_refused", "port" => self.port.name()).increment(1);
            return None;
        }
        let seat = Arc::new(Seat {
            peer,
            opened: now,
            requests: AtomicUsize::new(0),
            has_request: AtomicBool::new(false),
            served_after_millis: AtomicU64::new(0),
            stalled_after_millis: AtomicU64::new(0),
            is_displaced: AtomicBool::new(false),
            waker: Mutex::new(None),
        });
        let number = open.next;
        open.next += 1;
        open.seats.insert(number, Arc::clone(&seat));
        *open.per_client.entry(peer).or_default() += 1;
        metrics::gauge!("tidemap_connections", "port" => self.port.name()).set(open.seats.len() as f64);
        drop(open);
        Some(ConnectionSlot { number, seat, port: self.port, open: Arc::clone(&self.open) })
    }

    /// Makes one connection make room, because the process has no descriptors left.
    pub(crate) fn make_room(&self) {
        self.displace(&lock(&self.open), None, Instant::now());
    }
}
