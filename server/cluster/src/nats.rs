//! The engine NATS JetStream.
//!
//! Each stream is a JetStream stream of one subject; each bucket is a key-value bucket with a history of one. Appends
//! carry the number of the last message that they expect, and writes of keys the revision.
//!
//! The server that believes to be the leader serves the reads. A server that has just been cut off from the others, or
//! was frozen, believes so until it notices: its reads may miss the newest writes. The quorum checks the conditions.
//!
//! Invariant: nothing is assumed that a reply does not contain. A request that may have reached a server and has no
//! reply is [`EngineError::Unknown`].

mod calls;
mod check;
mod check_error;
mod follow;
mod keys;
mod settings;
#[cfg(test)]
mod tests;

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use async_nats::{
    HeaderMap, HeaderValue, header,
    jetstream::{
        self,
        stream::{Config, DiscardPolicy, Info, RetentionPolicy, StorageType},
    },
};
use bytes::Bytes;
use serde_json::json;

use self::{
    calls::{CallError, NatsCalls, Published},
    follow::FollowedStreams,
};
pub use self::{
    check::check,
    check_error::{NatsCheckError, VERSION_LEAST},
    settings::{NatsCredentials, NatsSettings, NatsTls},
};
use crate::engine::{
    AppendIfError, Bucket, Engine, EngineError, EngineServer, KeyEntry, MESSAGE_BYTES_MAX, Message, SetError,
    StreamEnds, StreamHealth,
};

/// Whether this build can connect to NATS JetStream.
pub const IS_BUILT: bool = true;

/// Room for headers above the content of a message.
const HEADER_BYTES_MAX: usize = 1024;

/// Time limit for the creation or deletion of a stream: the servers elect its leader meanwhile.
const ADMIN_PATIENCE: Duration = Duration::from_secs(10);

/// A connection to NATS JetStream. Clones share it, but each follows streams on its own.
pub struct NatsEngine {
    calls: NatsCalls,
    settings: Arc<NatsSettings>,
    followed: FollowedStreams,
}

impl Clone for NatsEngine {
    fn clone(&self) -> Self {
        let (calls, settings) = (self.calls.clone(), Arc::clone(&self.settings));
        Self { followed: FollowedStreams::default(), calls, settings }
    }
}

impl NatsEngine {
    /// Connects to one of the servers. The connection is made again when it breaks, for ever.
    pub async fn connect(settings: NatsSettings) -> Result<Self, EngineError> {
        settings.check()?;
        let calls = NatsCalls::connect(&settings).await?;
        Ok(Self { calls, settings: Arc::new(settings), followed: FollowedStreams::default() })
    }

    /// The name of a stream in JetStream. It keeps several clusters apart that share one engine.
    fn stream_name(&self, stream: &str) -> String {
        format!("{}_{stream}", self.settings.cluster)
    }

    fn subject(&self, stream: &str) -> String {
        format!("{}.{stream}", self.settings.cluster)
    }

    /// The state of a stream or of a bucket's stream, by its name in JetStream.
    async fn info(&self, name: &str) -> Result<Info, EngineError> {
        Ok(self.calls.api(&format!("STREAM.INFO.{name}"), &json!({}), self.settings.request_time_out).await?)
    }

    /// Creates a stream, and checks that it has the requested configuration.
    async fn create(&self, config: &Config) -> Result<(), EngineError> {
        let api = format!("STREAM.CREATE.{}", config.name);
        let info = match self.calls.api::<Info>(&api, config, ADMIN_PATIENCE).await {
            // The stream exists with other limits.
            Err(CallError::Api(error)) if error.error_code() == jetstream::ErrorCode::STREAM_NAME_EXIST => {
                self.info(&config.name).await?
            }
            outcome => outcome?,
        };
        let wrong = if info.config.num_replicas != config.num_replicas {
            format!("{} replicas instead of {}", info.config.num_replicas, config.num_replicas)
        } else if info.config.storage != StorageType::File {
            "no files".to_owned()
        } else if info.config.discard != DiscardPolicy::New || !info.config.max_age.is_zero() {
            "messages that are discarded".to_owned()
        } else {
            return Ok(());
        };
        Err(EngineError::Refused(format!("the stream {} exists, with {wrong}", config.name)))
    }

    /// The configuration that streams and buckets have in common.
    fn config(&self, name: String, subject: String, replicas: usize) -> Config {
        Config {
            name,
            subjects: vec![subject],
            retention: RetentionPolicy::Limits,
            storage: StorageType::File,
            num_replicas: replicas,
            discard: DiscardPolicy::New,
            deny_delete: true,
            allow_direct: false,
            max_bytes: self.settings.stream_bytes_max.and_then(|bytes| bytes.try_into().ok()).unwrap_or(-1),
            max_message_size: i32::try_from(MESSAGE_BYTES_MAX + HEADER_BYTES_MAX).unwrap_or(i32::MAX),
            ..Config::default()
        }
    }

    /// Publishes to a subject of a stream. Returns the number that the message got.
    async fn publish(
        &self,
        name: &str,
        subject: String,
        headers: HeaderMap,
        content: Bytes,
        patience: Duration,
    ) -> Result<Published, EngineError> {
        if content.len() > MESSAGE_BYTES_MAX {
            return Err(EngineError::Refused(format!("a message of {} bytes is too large", content.len())));
        }
        match self.calls.publish(subject, headers, content, patience).await {
            // No server listens to the subject: there is no stream, or it has no leader.
            Err(EngineError::Unavailable(reason)) => match self.info(name).await {
                Err(error @ EngineError::Missing(_)) => Err(error),
                _ => Err(EngineError::Unavailable(reason)),
            },
            outcome => outcome,
        }
    }
}

fn ends_of(info: &Info) -> StreamEnds {
    let last = info.state.last_sequence;
    let first = if info.state.messages == 0 { last + 1 } else { info.state.first_sequence };
    // The time of the last message, to the nanosecond.
    let stamp = info.state.last_timestamp.unix_timestamp_nanos() as u64;
    StreamEnds { first, last, stamp }
}

impl Engine for NatsEngine {
    async fn create_stream(&self, stream: &str, replicas: usize) -> Result<(), EngineError> {
        self.create(&self.config(self.stream_name(stream), self.subject(stream), replicas)).await
    }

    async fn delete_stream(&self, stream: &str) -> Result<(), EngineError> {
        self.followed.forget(stream).await;
        let api = format!("STREAM.DELETE.{}", self.stream_name(stream));
        match self.calls.api::<serde_json::Value>(&api, &json!({}), ADMIN_PATIENCE).await.map_err(EngineError::from) {
            Ok(_) | Err(EngineError::Missing(_)) => Ok(()),
            Err(error) => Err(error),
        }
    }

    async fn append_if(
        &self,
        stream: &str,
        expected_last: u64,
        content: Bytes,
        patience: Duration,
    ) -> Result<u64, AppendIfError> {
        let mut headers = HeaderMap::new();
        headers.insert(header::NATS_EXPECTED_LAST_SEQUENCE, HeaderValue::from(expected_last));
        let name = self.stream_name(stream);
        let begun = Instant::now();
        let published = self.publish(&name, self.subject(stream), headers, content, patience).await;
        metrics::histogram!("tidemap_cluster_append_seconds").record(begun.elapsed());
        match published? {
            Published::Appended(sequence) => Ok(sequence),
            Published::NotExpected => Err(AppendIfError::NotExpected),
        }
    }

    async fn ends(&self, stream: &str) -> Result<StreamEnds, EngineError> {
        let info = self.info(&self.stream_name(stream)).await?;
        // If most servers are lost, a server that is left replies for the stream without the messages of the others.
        let has_leader = info.cluster.as_ref().is_some_and(|cluster| cluster.leader.is_some());
        if info.config.num_replicas > 1 && !has_leader {
            return Err(EngineError::Unavailable(format!("stream {stream} has no leader")));
        }
        Ok(ends_of(&info))
    }

    async fn read(&self, stream: &str, sequence: u64) -> Result<Option<Message>, EngineError> {
        let message = self.calls.message(&self.stream_name(stream), &json!({ "seq": sequence })).await?;
        Ok(message.map(|message| Message { sequence: message.sequence, content: message.payload }))
    }

    async fn read_from(
        &self,
        stream: &str,
        sequence: u64,
        bytes_max: usize,
        patience: Duration,
    ) -> Result<Vec<Message>, EngineError> {
        self.followed.read_from(&self.calls, stream, &self.stream_name(stream), sequence, bytes_max, patience).await
    }

    async fn purge_before(&self, stream: &str, sequence: u64) -> Result<(), EngineError> {
        // JetStream goes on from the end where a request gives a number behind the end.
        let end = self.ends(stream).await?.last + 1;
        let api = format!("STREAM.PURGE.{}", self.stream_name(stream));
        let request = json!({ "seq": sequence.min(end) });
        self.calls.api::<serde_json::Value>(&api, &request, ADMIN_PATIENCE).await?;
        Ok(())
    }

    async fn health(&self, stream: &str) -> Result<StreamHealth, EngineError> {
        let info = self.info(&self.stream_name(stream)).await?;
        let (leader, followers) = match info.cluster {
            Some(cluster) => (cluster.leader, cluster.replicas),
            None => (None, Vec::new()),
        };
        Ok(StreamHealth {
            leader: leader.or_else(|| (info.config.num_replicas == 1).then(|| self.calls.server().server_name)),
            replicas: info.config.num_replicas,
            followers: followers.into_iter().map(|peer| (peer.name, peer.lag.unwrap_or_default())).collect(),
            bytes: info.state.bytes,
        })
    }

    async fn servers(&self) -> Result<Vec<EngineServer>, EngineError> {
        self.calls.check_connection()?;
        Ok(check::servers(&self.calls).await)
    }

    async fn create_buckets(&self, replicas: usize) -> Result<(), EngineError> {
        for bucket in [Bucket::Members, Bucket::Maps, Bucket::Writers] {
            let name = self.bucket_name(bucket);
            let subject = format!("{}>", self.key_prefix(bucket));
            let common = self.config(name, subject, replicas);
            let config = Config { max_messages_per_subject: 1, allow_rollup: true, max_bytes: -1, ..common };
            self.create(&config).await?;
        }
        Ok(())
    }

    async fn get(&self, bucket: Bucket, key: &str) -> Result<Option<KeyEntry>, EngineError> {
        let newest = self.newest(bucket, key).await?;
        Ok(newest.filter(|newest| !newest.is_deleted).map(|newest| newest.entry))
    }

    async fn list(&self, bucket: Bucket) -> Result<Vec<(String, KeyEntry)>, EngineError> {
        self.list_keys(bucket).await
    }

    async fn set_if(&self, bucket: Bucket, key: &str, expected: u64, value: Bytes) -> Result<u64, SetError> {
        match self.write(bucket, key, Some(expected), Some(value.clone())).await {
            // A deleted key leaves a mark, which has a revision.
            Err(SetError::NotExpected) if expected == 0 => {
                let newest = self.newest(bucket, key).await?;
                let mark = newest.filter(|newest| newest.is_deleted).ok_or(SetError::NotExpected)?;
                self.write(bucket, key, Some(mark.entry.revision), Some(value)).await
            }
            outcome => outcome,
        }
    }

    async fn set(&self, bucket: Bucket, key: &str, value: Bytes) -> Result<u64, EngineError> {
        self.write(bucket, key, None, Some(value)).await.map_err(|error| match error {
            SetError::Engine(error) => error,
            SetError::NotExpected => EngineError::Refused("a condition that was not requested".to_owned()),
        })
    }

    async fn delete_if(&self, bucket: Bucket, key: &str, expected: u64) -> Result<(), SetError> {
        self.write(bucket, key, Some(expected), None).await.map(drop)
    }
}
