//! The section `[cluster]` of the config file: the daemon is one of several that share the logs of their maps.
//!
//! Invariant: without the section nothing of the cluster runs.

use std::{net::SocketAddr, path::PathBuf};

use anyhow::{bail, ensure};
use http::uri::Scheme;
use serde::{Deserialize, Serialize};
use tidemap_cluster::nats;

/// The section `[cluster]`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClusterSettings {
    /// Name of the cluster.
    #[serde(default = "default_name")]
    pub name: String,
    /// Name of this daemon.
    pub member: String,
    /// URLs of the engine's servers.
    pub servers: Vec<String>,
    /// The address by which other daemons and clients reach this one.
    #[serde(default)]
    pub advertise: String,
    /// A file with the credentials for the engine, as `nsc` writes it.
    #[serde(default)]
    pub credentials_file: PathBuf,
    /// A file with the seed of an nkey.
    #[serde(default)]
    pub nkey_file: PathBuf,
    /// The authority of the engine's certificates.
    #[serde(default)]
    pub tls_ca: PathBuf,
    /// This daemon's certificate for the engine.
    #[serde(default)]
    pub tls_certificate: PathBuf,
    /// The key of that certificate.
    #[serde(default)]
    pub tls_key: PathBuf,
    /// The authority of the certificates of the other daemons.
    #[serde(default)]
    pub peer_ca: PathBuf,
    /// Number of daemons that hold each map.
    #[serde(default = "three")]
    pub replicas: usize,
    /// Number of servers of the engine that hold each log.
    #[serde(default = "three")]
    pub engine_replicas: usize,
    /// This daemon's share of the maps.
    #[serde(default = "one")]
    pub capacity: u32,
    /// Maximum time that a writer may be silent before another daemon takes its place.
    #[serde(default = "default_lease")]
    pub lease_ms: u64,
    /// Maximum time that a new writer waits for a daemon whose log is longer.
    #[serde(default = "default_heal_wait")]
    pub heal_wait_secs: u64,
    /// Maximum time that a follower answers without a message about the end of the log.
    #[serde(default = "default_staleness")]
    pub max_staleness_ms: u64,
    /// Number of bytes of records that are sent together.
    #[serde(default = "default_group")]
    pub group_bytes: usize,
    /// Mebibytes of a log that the engine keeps, also where checkpoints cover them.
    #[serde(default = "default_kept")]
    pub keep_log_mib: u64,
    /// Whether the engine has to write to its disk before it acknowledges.
    #[serde(default = "yes")]
    pub require_synced_engine: bool,
}

fn default_name() -> String {
    "tidemap".to_owned()
}
fn three() -> usize {
    3
}
fn one() -> u32 {
    1
}
fn default_lease() -> u64 {
    3000
}
fn default_heal_wait() -> u64 {
    30
}
fn default_staleness() -> u64 {
    10_000
}
fn default_group() -> usize {
    512 << 10
}
fn default_kept() -> u64 {
    256
}
fn yes() -> bool {
    true
}

/// The section as the example config shows it.
pub(crate) const EXAMPLE: &str = r#"
# --- cluster: see the page Clusters of the guide ----------------------------------------------------------------------
#
# With this section the daemon is one of several that share the logs of their maps through NATS JetStream (nats-server
# 2.15.1 or newer). All daemons of a cluster have the same section except `member`, `advertise`, `capacity`, and the
# certificate and the key for the engine. The environment may set `member`, `advertise` and `servers`
# (TIDEMAP_CLUSTER_MEMBER and so on). `member` and `servers` must be set.

#[cluster]

# Name of the cluster: letters, digits and -. Two clusters may share one engine.
#name = "tidemap"

# Name of this daemon: letters, digits and -. Each member has its own name; a second one of that name does not start.
#member = ""

# URLs of the engine's servers, for example ["nats://10.0.0.1:4222", "nats://10.0.0.2:4222"]. A URL may contain user and
# password, as nats://USER:PASSWORD@HOST:PORT; they are not logged.
#servers = []

# Address at which the other daemons and clients reach the gRPC port of this daemon, as http://HOST:PORT or
# https://HOST:PORT. Empty: http:// and the value of `listen`; set it if the daemon has TLS or listens on all addresses.
# A daemon with tokens passes requests on over https:// or within its machine; with allow_insecure_remote also without
# TLS.
#advertise = ""

# A file with the JWT and the seed that identify this daemon to the engine; empty: none. If nkey_file is set too, this
# file is used.
#credentials_file = ""

# A file with the seed of an nkey that identifies this daemon to the engine; empty: none.
#nkey_file = ""

# TLS to the engine: the authority of its certificates, and this daemon's certificate and key; empty: as in the URLs.
#tls_ca = ""
#tls_certificate = ""
#tls_key = ""

# A file with the authority of the daemons' certificates. It must be set where daemons are reached by https.
#peer_ca = ""

# Number of daemons that hold each map: one writes it, the others follow and can replace it. From 1 to 16.
#replicas = 3

# Number of servers of the engine that hold each log: 1, 3 or 5. 1 is for trials: what is acknowledged is lost with that
# server. It cannot be changed later.
#engine_replicas = 3

# This daemon's share of the maps is proportional to it; 0: it holds none and passes requests on. From 0 to 1000.
#capacity = 1

# Maximum time that a writer may be silent before another daemon replaces it, in milliseconds. From 1000 to 60000.
#lease_ms = 3000

# Maximum time that a new writer waits for a daemon with a longer log, in seconds. That daemon appends again the records
# that the engine has lost. From 0 to 3600.
#heal_wait_secs = 30

# Maximum time that a daemon that follows a map answers queries without a message about the end of the shared log, in
# milliseconds. After that it refuses queries with UNAVAILABLE, reason STALE. From 2000 to 600000.
#max_staleness_ms = 10000

# Maximum number of bytes of records that are sent to the engine together. From 4096 to 524288.
#group_bytes = 524288

# Approximate number of MiB of the log of each map that the engine keeps. Older records are removed when the checkpoints
# of two daemons have them. A daemon that was absent for longer fetches a copy of the map. From 1 to 1048576.
#keep_log_mib = 256

# Refuse to start with an engine that reports that it acknowledges before it has written to its disk.
#require_synced_engine = true
"#;

fn check_name(key: &str, name: &str) -> anyhow::Result<()> {
    let is_plain = |character: char| character.is_ascii_alphanumeric() || character == '-';
    if name.is_empty() || name.len() > 63 || !name.chars().all(is_plain) {
        bail!("setting cluster.{key} is {name:?}: it must be 1 to 63 letters, digits and -");
    }
    Ok(())
}

impl ClusterSettings {
    /// The host by which other daemons reach this one over TLS, if they do.
    pub(crate) fn tls_host(&self) -> Option<String> {
        let uri = self.advertise.parse::<http::Uri>().ok().filter(|uri| uri.scheme() == Some(&Scheme::HTTPS))?;
        Some(uri.host()?.trim_start_matches('[').trim_end_matches(']').to_owned())
    }

    /// Checks that other daemons can reach this one, whose gRPC port is at `listen`, with TLS or not.
    fn check_address(&self, listen: &str, has_tls: bool) -> anyhow::Result<()> {
        let advertise = &self.advertise;
        if advertise.is_empty()
            && let Ok(address) = listen.parse::<SocketAddr>()
            && (address.ip().is_unspecified() || address.port() == 0)
        {
            bail!(
                "setting cluster.advertise is empty, and other daemons cannot reach this one at {listen}, its setting \
                 listen: set cluster.advertise to http://HOST:PORT or https://HOST:PORT"
            );
        }
        let is_https = advertise.starts_with("https://");
        if !advertise.is_empty() && !advertise.starts_with("http://") && !is_https {
            bail!("setting cluster.advertise is {advertise:?}: it must be http://HOST:PORT or https://HOST:PORT");
        }
        if has_tls && !is_https {
            bail!(
                "setting cluster.advertise is {advertise:?}, and tls_certificate is set: it must be https://HOST:PORT, \
                 with a name or an address that is in the certificate"
            );
        }
        if is_https && self.peer_ca.as_os_str().is_empty() {
            bail!(
                "setting cluster.advertise is {advertise:?}, and cluster.peer_ca is not set: name the file with the \
                 authority of the daemons' certificates"
            );
        }
        Ok(())
    }

    /// Checks that a certificate for the engine comes with its key, and the other way around.
    fn check_tls(&self) -> anyhow::Result<()> {
        for (set, key, other, missing) in [
            (&self.tls_certificate, "tls_certificate", &self.tls_key, "tls_key"),
            (&self.tls_key, "tls_key", &self.tls_certificate, "tls_certificate"),
        ] {
            if !set.as_os_str().is_empty() && other.as_os_str().is_empty() {
                let set = set.display().to_string();
                bail!("setting cluster.{key} is {set:?}, and cluster.{missing} is not set: the engine requires both");
            }
        }
        Ok(())
    }

    /// Checks that the values are consistent, for a gRPC port at `listen` with TLS or without.
    ///
    /// # Errors
    /// The problem, with the key.
    pub fn check(&self, listen: &str, has_tls: bool) -> anyhow::Result<()> {
        ensure!(
            nats::IS_BUILT,
            "the config file has a section [cluster], and this tidemapd was built without clusters: build it with \
             --features cluster"
        );
        check_name("name", &self.name)?;
        check_name("member", &self.member)?;
        if self.servers.is_empty() {
            bail!(
                "setting cluster.servers is empty: name the engine's servers, for example [\"nats://10.0.0.1:4222\"]"
            );
        }
        self.check_address(listen, has_tls)?;
        self.check_tls()?;
        for (key, value, min, max) in [
            ("replicas", self.replicas as u64, 1, 16),
            ("capacity", u64::from(self.capacity), 0, 1000),
            ("lease_ms", self.lease_ms, 1000, 60_000),
            ("heal_wait_secs", self.heal_wait_secs, 0, 3600),
            ("max_staleness_ms", self.max_staleness_ms, 2000, 600_000),
            ("group_bytes", self.group_bytes as u64, 4096, 512 << 10),
            ("keep_log_mib", self.keep_log_mib, 1, 1 << 20),
        ] {
            super::check_range(&format!("cluster.{key}"), value, min, max)?;
        }
        if !matches!(self.engine_replicas, 1 | 3 | 5) {
            bail!("setting cluster.engine_replicas is {}: it must be 1, 3 or 5", self.engine_replicas);
        }
        Ok(())
    }
}
