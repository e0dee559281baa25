//! Accepts connections and hands them to the server of a port.
//!
//! Invariant: an accept that fails never spins: it is logged now and then, a connection makes room, and the next try
//! comes after a pause.

use std::{
    io,
    net::SocketAddr,
    time::{Duration, Instant},
};

use axum::{extract::connect_info::Connected, serve::IncomingStream};
use tokio::{
    net::{TcpListener, UnixListener},
    sync::mpsc,
};
use tracing::{debug, error};

use super::{Connections, Peer, guard::GuardedConnection, request_scan::Protocol, socket::Socket, tls::Tls};

/// A connection as a server gets it.
pub(crate) type Accepted = GuardedConnection<Socket>;

/// Connections that wait for the server.
const WAITING: usize = 64;
/// The pause after an accept that failed.
const PAUSE: Duration = Duration::from_millis(100);
/// Failing accepts are logged this often.
const LOGGED_EVERY: Duration = Duration::from_secs(10);

/// Accepts the connections of a port until the receiver is dropped.
#[derive(Debug)]
pub(crate) struct Acceptor {
    connections: Connections,
    protocol: Protocol,
    accepted: mpsc::Sender<io::Result<Accepted>>,
}

impl Acceptor {
    /// An acceptor of a port, and the connections that it accepts.
    pub(crate) fn new(connections: Connections, protocol: Protocol) -> (Self, mpsc::Receiver<io::Result<Accepted>>) {
        let (accepted, receiver) = mpsc::channel(WAITING);
        (Self { connections, protocol, accepted }, receiver)
    }

    /// Accepts the connections of a listener; a port may have several.
    pub(crate) fn listen(&self, listener: Listener) {
        let (connections, protocol, accepted) = (self.connections.clone(), self.protocol, self.accepted.clone());
        tokio::spawn(async move {
            let mut failures = Failures::default();
            loop {
                let next = tokio::select! {
                    next = listener.accept() => next,
                    () = accepted.closed() => return,
                };
                match next.map(|(socket, peer)| (socket, connections.admit(peer))) {
                    // The server is gone only when the daemon stops.
                    Ok((socket, Some(place))) => {
                        drop(accepted.send(Ok(GuardedConnection::new(socket, place, protocol))).await);
                    }
                    Ok((_, None)) => debug!("a connection was refused: all others are busy"),
                    Err(error) => failures.pause(&error, &connections).await,
                }
            }
        });
    }
}

/// Where connections come from.
pub(crate) enum Listener {
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
                    Some(tls) => Socket::Tls(Box::new(tls.accept(socket))),
                    None => Socket::Tcp(socket),
                };
                Ok((socket, Peer::Address(address.ip().to_canonical())))
            }
            Self::Unix(listener) => Ok((Socket::Unix(listener.accept().await?.0), Peer::Local)),
        }
    }
}

/// Accepts that failed.
#[derive(Debug, Default)]
struct Failures {
    logged: Option<Instant>,
    since_logged: u64,
}

impl Failures {
    async fn pause(&mut self, error: &io::Error, connections: &Connections) {
        metrics::counter!("tidemap_accept_errors").increment(1);
        self.since_logged += 1;
        if self.logged.is_none_or(|logged| logged.elapsed() >= LOGGED_EVERY) {
            error!(%error, failures = self.since_logged, "connections cannot be accepted; one makes room for the next");
            (self.logged, self.since_logged) = (Some(Instant::now()), 0);
        }
        connections.make_room();
        tokio::time::sleep(PAUSE).await;
    }
}

/// A listener for axum: the connections of an acceptor.
#[derive(Debug)]
pub(crate) struct HttpListener {
    /// The address of the port.
    pub address: SocketAddr,
    /// The connections.
    pub accepted: mpsc::Receiver<io::Result<Accepted>>,
}

impl axum::serve::Listener for HttpListener {
    type Io = Accepted;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Accepted, SocketAddr) {
        loop {
            match self.accepted.recv().await {
                Some(Ok(connection)) => return (connection, self.address),
                Some(Err(_)) => {}
                None => std::future::pending().await,
            }
        }
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        Ok(self.address)
    }
}

impl Connected<IncomingStream<'_, HttpListener>> for Peer {
    fn connect_info(stream: IncomingStream<'_, HttpListener>) -> Self {
        stream.io().peer()
    }
}
