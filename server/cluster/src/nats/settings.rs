//! How to reach the servers of NATS, and by which names tidemap's streams and buckets go there.
//!
//! Invariant: no secret is in a message; files with secrets are read when the connection is made.

use std::{path::PathBuf, time::Duration};

use crate::engine::EngineError;

/// What proves to the servers who connects, besides user and password in a URL.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum NatsCredentials {
    /// Nothing.
    #[default]
    None,
    /// A file with a JWT and a seed.
    File(PathBuf),
    /// A file with the seed of an nkey.
    NkeySeed(PathBuf),
}

/// Certificates for TLS.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NatsTls {
    /// The authority that has signed the servers' certificates; `None`: those that the system trusts.
    pub authority: Option<PathBuf>,
    /// The client's certificate and its key.
    pub client: Option<(PathBuf, PathBuf)>,
}

/// Settings of [`NatsEngine`](super::NatsEngine).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NatsSettings {
    /// URLs of the servers: `nats://HOST:PORT`, `tls://HOST:PORT`. User and password, or a token, may stand in front of
    /// HOST without characters that a URL escapes; those of the first URL that has them count for all.
    pub servers: Vec<String>,
    /// What proves who connects.
    pub credentials: NatsCredentials,
    /// TLS, which is then required; `None`: as the URLs say.
    pub tls: Option<NatsTls>,
    /// Name of the cluster, in front of the names of all streams and buckets: letters, digits and `-`.
    pub cluster: String,
    /// Name of this client, which the servers show.
    pub client: String,
    /// How long a call may take that has no patience of its own.
    pub request_time_out: Duration,
    /// Limit of a stream in bytes; `None`: the disk's.
    pub stream_bytes_max: Option<u64>,
}

impl NatsSettings {
    /// The defaults, for some servers.
    pub fn new(servers: Vec<String>) -> Self {
        Self {
            servers,
            credentials: NatsCredentials::None,
            tls: None,
            cluster: "tidemap".to_owned(),
            client: "tidemapd".to_owned(),
            request_time_out: Duration::from_millis(500),
            stream_bytes_max: None,
        }
    }

    /// Whether the values make sense. An underscore would let two clusters have streams of one name.
    pub(super) fn check(&self) -> Result<(), EngineError> {
        let is_plain = |character: char| character.is_ascii_alphanumeric() || character == '-';
        if self.cluster.is_empty() || !self.cluster.chars().all(is_plain) {
            let name = &self.cluster;
            return Err(EngineError::Refused(format!(
                "the name of the cluster is {name:?}, and may have letters, digits and '-' only"
            )));
        }
        if self.servers.is_empty() {
            return Err(EngineError::Refused("no server is named".to_owned()));
        }
        Ok(())
    }
}
