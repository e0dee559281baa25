//! The other daemons that share maps with this one: who they are, and how they prove it.
//!
//! Invariant: a daemon that shares no maps has no peers.

use std::{
    fmt, io,
    path::{Path, PathBuf},
    sync::Arc,
    time::{Duration, Instant},
};

use tidemap_map::name::MapName;

/// What a daemon needs to know of the daemons that share maps.
pub(crate) trait Peers: Send + Sync + fmt::Debug {
    /// The name of this daemon.
    fn name(&self) -> &str;

    /// Where a daemon is reached, as `http://HOST:PORT` or `https://HOST:PORT`.
    fn address_of(&self, member: &str) -> Option<String>;

    /// The names of the other daemons.
    fn others(&self) -> Vec<String>;

    /// Whether other daemons may hold a map that this one does not hold. They may while this one has not read the
    /// catalogue of the cluster.
    fn may_hold(&self, map: &str) -> bool;

    /// The daemon that writes a map which this one does not hold, if there is such a map and its writer is known.
    fn writer_of(&self, map: &str) -> Option<String>;

    /// The daemon that writes a map which this one holds, where that is known, also while its role does not say it.
    fn writer_of_held(&self, map: &MapName) -> Option<String>;

    /// When this daemon last heard where the log of a map ends.
    fn heard(&self, map: &MapName) -> Option<Instant>;

    /// After so long without that, a map is not shown.
    fn max_staleness(&self) -> Duration;
}

/// What two daemons prove to each other, in PEM form.
pub(crate) struct PeerTls {
    /// Certificates of the authorities that the other's certificate may come from.
    pub ca: Vec<u8>,
    /// This daemon's certificate and its private key.
    pub identity: Option<(Vec<u8>, Vec<u8>)>,
}

/// The files of [`PeerTls`]. They are read for each connection: they may have been replaced.
#[derive(Clone, Debug)]
pub(crate) struct PeerTlsFiles {
    /// The authorities.
    pub ca: PathBuf,
    /// This daemon's certificate and its private key.
    pub identity: Option<(PathBuf, PathBuf)>,
}

/// A file of [`PeerTlsFiles`] that cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("setting {setting}: {} cannot be read: {source}", .path.display())]
pub(crate) struct UnreadablePeerTls {
    setting: &'static str,
    path: PathBuf,
    source: io::Error,
}

impl PeerTlsFiles {
    /// What they hold now. Reads the disk.
    ///
    /// # Errors
    /// One cannot be read.
    pub(crate) fn read(&self) -> Result<PeerTls, UnreadablePeerTls> {
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
pub(crate) struct SharedMaps {
    /// Who they are.
    pub peers: Arc<dyn Peers>,
    /// For those with an address that begins with `https://`.
    pub tls: Option<PeerTlsFiles>,
    /// Whether tokens are sent to those with an address of another machine that begins with `http://`.
    pub tokens_in_clear: bool,
}
