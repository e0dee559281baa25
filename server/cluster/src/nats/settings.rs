//! Settings to reach the servers of NATS, and the names of tidemap's streams and buckets there.
//!
//! Invariant: no message contains a secret; files with secrets are read when the connection is made.

use std::{path::PathBuf, time::Duration};

use crate::engine::EngineError;

/// The credentials with which the client authenticates itself to the servers, besides user and password in a URL.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum NatsCredentials {
    /// No credentials.
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
    /// URLs of the servers: `nats://HOST:PORT`, `tls://HOST:PORT`. User and password, or a token, may precede HOST,
    /// without characters that a URL escapes; the first URL that has them sets them for all servers.
    pub servers: Vec<String>,
    /// The credentials of the client.
    pub credentials: NatsCredentials,
    /// TLS, which is then required; `None`: the URLs decide.
    pub tls: Option<NatsTls>,
    /// Name of the cluster, in front of the names of all streams and buckets: letters, digits and `-`.
    pub cluster: String,
    /// Name of this client, which the servers show.
    pub client: String,
    /// Time limit of a call that has no patience of its own.
    pub request_time_out: Duration,
    /// Limit of a stream in bytes; `None`: the disk's.
    pub stream_bytes_max: Option<u64>,
}

impl NatsSettings {
    /// The default settings, for these servers.
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

    /// Checks that the values are valid. An underscore would let two clusters have streams with the same name.
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
