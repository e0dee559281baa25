//! Checks that the servers have the properties on which tidemap relies.
//!
//! Older servers accept two messages at one position: nats-server 2.9.10 let two writers append after the same message.
//!
//! Invariant: a property that a server does not report is not assumed.

use std::{collections::BTreeMap, time::Duration};

use bytes::Bytes;
use serde::Deserialize;
use tokio::time::{Instant, timeout_at};
use tokio_stream::StreamExt;

use super::{HEADER_BYTES_MAX, NatsCheckError, NatsEngine, VERSION_LEAST, calls::NatsCalls};
use crate::engine::{Engine, EngineServer, MESSAGE_BYTES_MAX};

/// Every server replies to this subject, if the account has the permission.
const VARZ: &str = "$SYS.REQ.SERVER.PING.VARZ";

/// Time limit for the report of the next server, after one has replied.
const NEXT_PATIENCE: Duration = Duration::from_millis(300);

#[derive(Deserialize)]
struct Varz {
    server: VarzServer,
    #[serde(default)]
    data: VarzData,
}

#[derive(Deserialize)]
struct VarzServer {
    name: String,
    ver: String,
}

#[derive(Default, Deserialize)]
struct VarzData {
    #[serde(default)]
    jetstream: VarzJetStream,
}

#[derive(Default, Deserialize)]
struct VarzJetStream {
    config: Option<VarzConfig>,
}

#[derive(Deserialize)]
struct VarzConfig {
    #[serde(default)]
    sync_always: bool,
}

/// All servers that reply; at least the server to which the client is connected.
pub(super) async fn servers(calls: &NatsCalls) -> Vec<EngineServer> {
    let own = calls.server();
    let own = EngineServer { name: own.server_name, version: own.version, syncs_always: None };
    let mut found = BTreeMap::from([(own.name.clone(), own)]);
    for varz in ping(calls).await {
        let syncs_always = varz.data.jetstream.config.map(|config| config.sync_always);
        let server = EngineServer { name: varz.server.name, version: varz.server.ver, syncs_always };
        found.insert(server.name.clone(), server);
    }
    found.into_values().collect()
}

/// The reports of the servers, where this client's account has the permission to request them.
async fn ping(calls: &NatsCalls) -> Vec<Varz> {
    let client = calls.client();
    let inbox = client.new_inbox();
    let mut found = Vec::new();
    let Ok(mut replies) = client.subscribe(inbox.clone()).await else { return found };
    if client.publish_with_reply(VARZ, inbox, Bytes::new()).await.is_err() {
        return found;
    }
    let mut deadline = Instant::now() + calls.request_time_out();
    while let Ok(Some(reply)) = timeout_at(deadline, replies.next()).await {
        match serde_json::from_slice(&reply.payload) {
            Ok(varz) => {
                found.push(varz);
                deadline = Instant::now() + NEXT_PATIENCE;
            }
            // No server listens.
            Err(_) => break,
        }
    }
    found
}

/// Whether a version is at least [`VERSION_LEAST`]. Text after the numbers, as in `2.16.0-beta`, does not count.
fn is_new_enough(version: &str) -> bool {
    let mut numbers = version.trim_start_matches('v').splitn(3, '.').map(|part| {
        let digits = part.split(|character: char| !character.is_ascii_digit()).next().unwrap_or_default();
        digits.parse::<u64>().ok()
    });
    let mut next = || numbers.next().flatten();
    match (next(), next(), next()) {
        (Some(major), Some(minor), Some(patch)) => (major, minor, patch) >= VERSION_LEAST,
        _ => false,
    }
}

/// Checks the servers before the first call. Logs a server that does not report whether it makes messages durable
/// before it acknowledges them. Returns the reports of the servers.
pub async fn check(engine: &NatsEngine, require_synced: bool) -> Result<Vec<EngineServer>, NatsCheckError> {
    let servers = engine.servers().await?;
    for server in &servers {
        if !is_new_enough(&server.version) {
            return Err(NatsCheckError::Version { server: server.name.clone(), version: server.version.clone() });
        }
        match server.syncs_always {
            Some(false) if require_synced => return Err(NatsCheckError::NotSynced { server: server.name.clone() }),
            None => tracing::warn!(
                server = server.name,
                "the engine's server does not report whether it writes to its disk before it acknowledges: let this \
                 account request {VARZ}, and set sync_interval: always"
            ),
            _ => {}
        }
    }
    let own = engine.calls.server();
    if own.max_payload < MESSAGE_BYTES_MAX + HEADER_BYTES_MAX {
        return Err(NatsCheckError::Payload { server: own.server_name, bytes: own.max_payload });
    }
    Ok(servers)
}
