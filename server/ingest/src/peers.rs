//! The other daemons that share maps with this one: their names and addresses, and how they authenticate themselves.
//!
//! Invariant: a daemon that shares no maps has no peers.

use std::{
    fmt, io,
    path::{Path, PathBuf},
    sync::Arc,
    time::{Duration, Instant},
};

use tidemap_map::name::MapName;

/// The data about the daemons that share maps.
pub trait Peers: Send + Sync + fmt::Debug {
    /// The name of this daemon.
    fn name(&self) -> &str;

    /// The address of a daemon, as `http://HOST:PORT` or `https://HOST:PORT`.
    fn address_of(&self, member: &str) -> Option<String>;

    /// The names of the other daemons.
    fn others(&self) -> Vec<String>;

    /// Whether other daemons may hold a map that this one does not hold. This is `true` while this daemon has not read
    /// the catalogue of the cluster.
    fn may_hold(&self, map: &str) -> bool;

    /// The daemon that writes a map which this one does not hold, if there is such a map and its writer is known.
    fn writer_of(&self, map: &str) -> Option<String>;

    /// The daemon that writes a map which this one holds, where that is known, also while its role does not show it.
    fn writer_of_held(&self, map: &MapName) -> Option<String>;

    /// The time at which this daemon last received the end of a map's log.
    fn last_contact(&self, map: &MapName) -> Option<Instant>;

    /// Time without the end of its log after which a map is not shown.
    fn max_staleness(&self) -> Duration;
}

/// The credentials with which two daemons authenticate each other, in PEM form.
pub struct PeerTls {
    /// Certificates of the authorities that may have signed the other's certificate.
    pub ca: Vec<u8>,
    /// This daemon's certificate and its private key.
    pub identity: Option<(Vec<u8>, Vec<u8>)>,
}

/// The files of [`PeerTls`]. They are read for each connection, because they may have been replaced.
#[derive(Clone, Debug)]
pub struct PeerTlsFiles {
    /// The authorities.
    pub ca: PathBuf,
    /// This daemon's certificate and its private key.
    pub identity: Option<(PathBuf, PathBuf)>,
}

/// A file of [`PeerTlsFiles`] that cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("setting {setting}: {} cannot be read: {source}", .path.display())]
pub struct UnreadablePeerTls {
    setting: &'static str,
    path: PathBuf,
    source: io::Error,
}

impl PeerTlsFiles {
    /// The current content of the files. Reads the disk.
    ///
    /// # Errors
    /// A file cannot be read.
    pub fn read(&self) -> Result<PeerTls, UnreadablePeerTls> {
        let read = |setting, path: &Path| {
            std::fs::read(path).map_err(|source| UnreadablePeerTls { setting, path: path.to_owned(), source })
        };
        let identity = match &self.identity {
            Some((certificate, key)) => Some((read("tls_certificate", certificate)?, read("tls_key", key)?)),
            None => None,
        };
        Ok(PeerTls { ca: read("cluster.peer_ca", &self.ca)?, identity })
    }
}

/// The daemons that share maps.
#[derive(Clone, Debug)]
pub struct SharedMaps {
    /// The daemons.
    pub peers: Arc<dyn Peers>,
    /// TLS for the daemons with an address that begins with `https://`.
    pub tls: Option<PeerTlsFiles>,
    /// Whether tokens are sent to daemons on another machine whose address begins with `http://`.
    pub tokens_in_clear: bool,
}
