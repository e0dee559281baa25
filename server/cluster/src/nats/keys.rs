//! Keys in JetStream: the newest message of a key's subject is its value, and that message's number the revision.
//!
//! Invariant: a key is read from the leader, except in [`NatsEngine::list_keys`].

use std::time::Duration;

use async_nats::{
    HeaderMap, HeaderValue, header,
    jetstream::consumer::{AckPolicy, DeliverPolicy, pull},
};
use bytes::Bytes;
use serde_json::json;
use tokio::time::{Instant, timeout_at};
use tokio_stream::StreamExt;

use super::{
    NatsEngine,
    calls::Published,
    follow::{from_batch, from_consumer},
};
use crate::engine::{Bucket, EngineError, KeyEntry, SetError};

/// The header that marks a deleted key.
const OPERATION: &str = "KV-Operation";

/// Time for which the consumer of a list remains if the deletion of the consumer is lost.
const LIST_LINGERS: Duration = Duration::from_secs(5);
/// Pause after a request that a consumer has ended early.
const ASK_AGAIN: Duration = Duration::from_millis(50);

/// The newest write of a key.
pub(super) struct NewestWrite {
    pub(super) entry: KeyEntry,
    pub(super) is_deleted: bool,
}

fn is_deletion(headers: &HeaderMap) -> bool {
    headers.get(OPERATION).is_some_and(|operation| matches!(operation.as_str(), "DEL" | "PURGE"))
}

/// Refuses a key that is not valid in the name of a subject.
fn check_key(key: &str) -> Result<(), EngineError> {
    let is_plain = |character: char| character.is_ascii_alphanumeric() || "-_=/.".contains(character);
    let is_whole = !key.is_empty() && !key.starts_with('.') && !key.ends_with('.') && !key.contains("..");
    let is_key = is_whole && key.chars().all(is_plain);
    is_key.then_some(()).ok_or_else(|| EngineError::Refused(format!("{key:?} cannot be a key")))
}

impl NatsEngine {
    /// The name of a bucket's stream.
    pub(super) fn bucket_name(&self, bucket: Bucket) -> String {
        format!("KV_{}", self.bucket(bucket))
    }

    fn bucket(&self, bucket: Bucket) -> String {
        let name = match bucket {
            Bucket::Members => "members",
            Bucket::Maps => "maps",
            Bucket::Writers => "writers",
        };
        self.stream_name(name)
    }

    /// The prefix of the subjects of a bucket's keys.
    pub(super) fn key_prefix(&self, bucket: Bucket) -> String {
        format!("$KV.{}.", self.bucket(bucket))
    }

    pub(super) async fn newest(&self, bucket: Bucket, key: &str) -> Result<Option<NewestWrite>, EngineError> {
        check_key(key)?;
        let request = json!({ "last_by_subj": format!("{}{key}", self.key_prefix(bucket)) });
        let message = self.calls.message(&self.bucket_name(bucket), &request).await?;
        Ok(message.map(|message| NewestWrite {
            is_deleted: is_deletion(&message.headers),
            entry: KeyEntry { value: message.payload, revision: message.sequence },
        }))
    }

    /// Sets a key, or deletes it where `value` is `None`, if its subject's newest message has a number.
    pub(super) async fn write(
        &self,
        bucket: Bucket,
        key: &str,
        expected: Option<u64>,
        value: Option<Bytes>,
    ) -> Result<u64, SetError> {
        check_key(key)?;
        let mut headers = HeaderMap::new();
        if let Some(expected) = expected {
            headers.insert(header::NATS_EXPECTED_LAST_SUBJECT_SEQUENCE, HeaderValue::from(expected));
        }
        if value.is_none() {
            headers.insert(OPERATION, "DEL");
        }
        let (name, subject) = (self.bucket_name(bucket), format!("{}{key}", self.key_prefix(bucket)));
        let patience = self.settings.request_time_out;
        match self.publish(&name, subject, headers, value.unwrap_or_default(), patience).await? {
            Published::Appended(revision) => Ok(revision),
            Published::NotExpected => Err(SetError::NotExpected),
        }
    }

    /// All keys of a bucket, by a consumer that is deleted afterwards. The consumer may run on a server that lags.
    pub(super) async fn list_keys(&self, bucket: Bucket) -> Result<Vec<(String, KeyEntry)>, EngineError> {
        self.calls.check_connection()?;
        let (name, prefix) = (self.bucket_name(bucket), self.key_prefix(bucket));
        let config = pull::Config {
            deliver_policy: DeliverPolicy::LastPerSubject,
            filter_subject: format!("{prefix}>"),
            ack_policy: AckPolicy::None,
            memory_storage: true,
            num_replicas: 1,
            inactive_threshold: LIST_LINGERS,
            ..pull::Config::default()
        };
        let consumer = self.calls.context().create_consumer_on_stream(config, name.clone()).await;
        let consumer = consumer.map_err(|error| from_consumer(&error))?;
        let count = usize::try_from(consumer.cached_info().num_pending).unwrap_or(usize::MAX);
        let deadline = Instant::now() + self.settings.request_time_out;
        let (mut found, mut come) = (Vec::new(), 0);
        while come < count {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(EngineError::Unknown(format!("{come} of {count} keys have arrived")));
            }
            let batch = consumer.batch().max_messages(count - come).expires(left).messages().await;
            let mut messages = batch.map_err(|error| from_batch(&error))?;
            while come < count {
                let Ok(Some(Ok(message))) = timeout_at(deadline, messages.next()).await else {
                    // The server of a new consumer may not listen yet. It then refuses the request at once.
                    tokio::time::sleep(ASK_AGAIN.min(left)).await;
                    break;
                };
                come += 1;
                let revision = message.info().map_err(|error| EngineError::Refused(error.to_string()))?.stream_sequence;
                let key = message.subject.strip_prefix(&prefix).unwrap_or_default().to_owned();
                if !message.headers.as_ref().is_some_and(is_deletion) {
                    let value = message.message.payload;
                    found.push((key, KeyEntry { value, revision }));
                }
            }
        }
        // Nobody waits for the reply: a consumer whose deletion is lost expires by itself.
        let delete = format!("$JS.API.CONSUMER.DELETE.{name}.{}", consumer.cached_info().name);
        drop(self.calls.client().publish(delete, Bytes::new()).await);
        Ok(found)
    }
}
