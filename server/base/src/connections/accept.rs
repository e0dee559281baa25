//! Accepts connections and hands them to the server of a port.
//!
//! Invariant: an accept that fails never spins: it is logged now and then, a connection makes room, and the next try
//! comes after a pause. A connection beyond the limits is refused, or goes to the reserve of a port that has one.

use std::{io, time::Duration};

use tokio::{
    net::{TcpListener, UnixListener},
    sync::mpsc,
};
use tracing::{error, warn};

use super::{Connections, Peer, guard::GuardedConnection, socket::Socket, tls::Tls};
use crate::telemetry::occasional::Occasional;

/// A connection as the server receives it.
pub type Accepted = GuardedConnection<Socket>;

/// Number of connections that wait for the server.
const WAITING: usize = 64;
/// The pause after an accept that failed.
const PAUSE: Duration = Duration::from_millis(100);

static FAILURES: Occasional = Occasional::new();
static REFUSALS: Occasional = Occasional::new();

/// Accepts the connections of a port until the receiver is dropped.
#[derive(Debug)]
pub struct Acceptor {
    door: Door,
    /// The door for connections beyond the limits of the first door.
    reserve: Option<Door>,
}

/// Connections, and the channel to the server that receives them.
#[derive(Clone, Debug)]
struct Door {
    connections: Connections,
    accepted: mpsc::Sender<io::Result<Accepted>>,
}

impl Door {
    fn new(connections: Connections) -> (Self, mpsc::Receiver<io::Result<Accepted>>) {
        let (accepted, receiver) = mpsc::channel(WAITING);
        (Self { connections, accepted }, receiver)
    }
}

impl Acceptor {
    /// Creates an acceptor for a port, and the receiver of the connections that it accepts.
    pub fn new(connections: Connections) -> (Self, mpsc::Receiver<io::Result<Accepted>>) {
        let (door, receiver) = Door::new(connections);
        (Self { door, reserve: None }, receiver)
    }

    /// Adds a reserve to this acceptor. The connections of the reserve come from the returned receiver.
    pub fn with_reserve(self, connections: Connections) -> (Self, mpsc::Receiver<io::Result<Accepted>>) {
        let (reserve, receiver) = Door::new(connections);
        (Self { reserve: Some(reserve), ..self }, receiver)
    }

    /// Accepts the connections of a listener; a port may have several listeners.
    pub fn listen(&self, listener: Listener) {
        let (door, reserve) = (self.door.clone(), self.reserve.clone());
        crate::task::spawn(async move {
            loop {
                let next = tokio::select! {
                    next = listener.accept() => next,
                    () = door.accepted.closed() => return,
                };
                let (socket, peer) = match next {
                    Ok(next) => next,
                    Err(error) => {
                        pause(&error, &door.connections).await;
                        continue;
                    }
                };
                let slot = door.connections.admit(peer).map(|slot| (&door, slot));
                if slot.is_none()
                    && let Some(left_out) = REFUSALS.next()
                {
                    let port = door.connections.port().name();
                    warn!(port, %peer, left_out, "a connection was refused: all others are busy");
                }
                let in_reserve = || reserve.as_ref().and_then(|door| Some((door, door.connections.admit(peer)?)));
                if let Some((door, slot)) = slot.or_else(in_reserve) {
                    // The server is gone only when the daemon stops.
                    drop(door.accepted.send(Ok(GuardedConnection::new(socket, slot))).await);
                }
            }
        });
    }
}

/// The source of connections.
pub enum Listener {
    /// A TCP port, with TLS if there is one.
    Tcp(TcpListener, Option<Tls>),
    /// A Unix socket.
    Unix(UnixListener),
}

impl Listener {
    async fn accept(&self) -> io::Result<(Socket, Peer)> {
        match self {
            Self::Tcp(listener, tls) => {
                let (socket, address) = listener.accept().await?;
                // Replies are small and must not wait for each other.
                let _ = socket.set_nodelay(true);
                let socket = match tls {
                    Some(tls) => Socket::Tls(Box::new(tls.accept(socket, address))),
                    None => Socket::Tcp(socket),
                };
                Ok((socket, Peer::Address(address.ip().to_canonical())))
            }
            Self::Unix(listener) => Ok((Socket::Unix(listener.accept().await?.0), Peer::Local)),
        }
    }
}

/// Waits after an accept that failed.
async fn pause(error: &io::Error, connections: &Connections) {
    metrics::counter!("tidemap_accept_errors").increment(1);
    if let Some(left_out) = FAILURES.next() {
        error!(%error, left_out, "connections cannot be accepted; one makes room for the next");
    }
    connections.make_room();
    tokio::time::sleep(PAUSE).await;
}
