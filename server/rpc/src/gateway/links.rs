//! Connections to the other daemons that share maps with this one.
//!
//! Invariant: connections are kept and used again, their number is bounded, and a call holds its place on a connection
//! until its reply has ended. No token goes over a network without TLS, unless an operator has allowed that.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use axum::http::{Uri, uri::Scheme};
use tidemap_base::config::is_local;
use tidemap_ingest::peers::{PeerTlsFiles, UnreadablePeerTls};
use tonic::transport::{Certificate, Channel, ClientTlsConfig, Endpoint, Identity};

/// Maximum time for a daemon to answer a connection.
const CONNECT_WITHIN: Duration = Duration::from_secs(1);
/// The failure of a daemon's machine is noticed after the interval and the timeout.
const KEEPALIVE_INTERVAL: Duration = Duration::from_secs(2);
const KEEPALIVE_TIMEOUT: Duration = Duration::from_secs(2);
/// Number of calls that share a connection: fewer than the other daemon allows.
const CALLS_PER_CONNECTION: usize = 48;
/// Maximum number of connections to one daemon.
const CONNECTIONS_MAX: usize = 64;
/// Number of idle connections to one daemon that are kept.
const IDLE_KEPT: usize = 2;
/// Maximum number of bytes of a call that are sent and not read yet.
const WINDOW: u32 = 256 * 1024;

/// A place on a connection; it is free again when it is dropped.
#[derive(Debug)]
pub(crate) struct PeerPlace {
    pub channel: Channel,
    place: Arc<()>,
}

#[derive(Debug)]
struct PeerChannel {
    channel: Channel,
    /// This structure holds one reference, and each place holds one.
    places: Arc<()>,
}

impl PeerChannel {
    fn calls(&self) -> usize {
        Arc::strong_count(&self.places) - 1
    }

    fn place(&self) -> PeerPlace {
        PeerPlace { channel: self.channel.clone(), place: Arc::clone(&self.places) }
    }
}

/// The connections to one daemon.
#[derive(Debug, Default)]
struct PeerLinks {
    /// Held while a connection is made, so that only one is made at a time.
    connecting: tokio::sync::Mutex<()>,
    // A lock, because calls come from all tasks; it is held only to count.
    open: Mutex<Vec<PeerChannel>>,
}

impl PeerLinks {
    fn open(&self) -> MutexGuard<'_, Vec<PeerChannel>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn free_place(&self) -> Option<PeerPlace> {
        let mut open = self.open();
        let mut idle = 0;
        open.retain(|link| {
            idle += usize::from(link.calls() == 0);
            link.calls() > 0 || idle <= IDLE_KEPT
        });
        // The fullest connection with room is taken, so that others become idle.
        let with_room = open.iter().filter(|link| link.calls() < CALLS_PER_CONNECTION);
        with_room.max_by_key(|link| link.calls()).map(PeerChannel::place)
    }
}

/// The connections to all daemons, by address.
#[derive(Debug)]
pub(crate) struct Links {
    tls: Option<PeerTlsFiles>,
    tokens_in_clear: bool,
    by_address: Mutex<HashMap<String, Arc<PeerLinks>>>,
}

/// There is no connection to a daemon.
#[derive(Debug, thiserror::Error)]
pub enum NoLink {
    #[error("{}", root_cause(.0))]
    Transport(#[from] tonic::transport::Error),
    #[error("all connections to it are in use")]
    Full,
    #[error(
        "a token is not sent to {address} without TLS, because others could read it: give that daemon an https:// \
         address, or set allow_insecure_remote here"
    )]
    InClear { address: String },
    #[error("its address is {address}, and setting cluster.peer_ca, which https:// needs, is not set here")]
    NoAuthority { address: String },
    #[error(transparent)]
    Files(#[from] UnreadablePeerTls),
    #[error("this daemon stops")]
    Stopping,
}

/// Whether others could read what is sent to an address.
fn is_in_clear(address: &str) -> bool {
    let Ok(uri) = address.parse::<Uri>() else { return true };
    uri.scheme() != Some(&Scheme::HTTPS) && !uri.authority().is_some_and(|authority| is_local(authority.as_str()))
}

/// The first cause of a chain of errors: the other errors only state that there is one.
fn root_cause(error: &dyn std::error::Error) -> String {
    error.source().map_or_else(|| error.to_string(), root_cause)
}

impl Links {
    pub(crate) fn new(tls: Option<PeerTlsFiles>, tokens_in_clear: bool) -> Self {
        Self { tls, tokens_in_clear, by_address: Mutex::default() }
    }

    fn of(&self, address: &str) -> Arc<PeerLinks> {
        let mut all = self.by_address.lock().unwrap_or_else(PoisonError::into_inner);
        Arc::clone(all.entry(address.to_owned()).or_default())
    }

    /// Takes a place on a connection to an address, for a call with or without a token. The connection is made if there
    /// is none with room.
    ///
    /// # Errors
    /// See [`NoLink`].
    pub(crate) async fn place(&self, address: &str, has_token: bool) -> Result<PeerPlace, NoLink> {
        if has_token && !self.tokens_in_clear && is_in_clear(address) {
            return Err(NoLink::InClear { address: address.to_owned() });
        }
        let links = self.of(address);
        if let Some(place) = links.free_place() {
            return Ok(place);
        }
        let _turn = links.connecting.lock().await;
        // Another call may have made a connection meanwhile.
        if let Some(place) = links.free_place() {
            return Ok(place);
        }
        if links.open().len() >= CONNECTIONS_MAX {
            return Err(NoLink::Full);
        }
        let channel = self.endpoint(address).await?.connect().await?;
        let link = PeerChannel { channel, places: Arc::new(()) };
        let place = link.place();
        links.open().push(link);
        Ok(place)
    }

    async fn endpoint(&self, address: &str) -> Result<Endpoint, NoLink> {
        let mut endpoint = Endpoint::from_shared(address.to_owned())?
            .connect_timeout(CONNECT_WITHIN)
            .http2_keep_alive_interval(KEEPALIVE_INTERVAL)
            .keep_alive_timeout(KEEPALIVE_TIMEOUT)
            .keep_alive_while_idle(true)
            .initial_stream_window_size(WINDOW)
            // A call whose reply is not read does not block the others.
            .initial_connection_window_size(WINDOW * CALLS_PER_CONNECTION as u32)
            .tcp_nodelay(true);
        if address.starts_with("https:") {
            let no_authority = || NoLink::NoAuthority { address: address.to_owned() };
            let files = self.tls.clone().ok_or_else(no_authority)?;
            let tls = tidemap_base::task::blocking(move || files.read()).await.map_err(|_| NoLink::Stopping)??;
            let config = ClientTlsConfig::new().ca_certificate(Certificate::from_pem(&tls.ca)).timeout(CONNECT_WITHIN);
            endpoint = endpoint.tls_config(match &tls.identity {
                Some((certificate, key)) => config.identity(Identity::from_pem(certificate, key)),
                None => config,
            })?;
        }
        Ok(endpoint)
    }

    /// Removes the connection of a place that has failed, so that no other call takes it.
    pub(crate) fn forget(&self, address: &str, failed: &PeerPlace) {
        self.of(address).open().retain(|link| !Arc::ptr_eq(&link.places, &failed.place));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn the_files_of_tls_are_read_for_each_connection() {
        let dir = tempfile::tempdir().expect("temporary folder");
        let ca = dir.path().join("ca.pem");
        let links = Links::new(Some(PeerTlsFiles { ca: ca.clone(), identity: None }), false);
        let place = || links.place("https://127.0.0.1:1", true);
        assert!(matches!(place().await, Err(NoLink::Files(_))), "there is no file");
        std::fs::write(&ca, "no certificate").expect("written");
        assert!(matches!(place().await, Err(NoLink::Transport(_))), "there is one");
    }
}
