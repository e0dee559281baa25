//! The operations that tidemap needs from an engine: conditional appends to streams of messages, and conditional writes
//! of keys.
//!
//! A stream is a log of messages numbered from 1 without gaps. A bucket holds keys; each write of a key gets a revision
//! that is higher than all before it in the bucket.
//!
//! Invariant: a call whose outcome is not known returns [`EngineError::Unknown`] and never guesses. The leader serves
//! the reads, so that they see every write that was acknowledged before they began.

#[cfg(test)]
pub(crate) mod tests;

use std::{future::Future, time::Duration};

use bytes::Bytes;

/// Limit of a message, in bytes.
pub const MESSAGE_BYTES_MAX: usize = 1 << 20;

/// The reason why a call to the engine has failed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EngineError {
    /// The engine did not reply in time, or the connection broke: the call may have had its effect or not.
    #[error("the engine did not respond: {0}")]
    Unknown(String),
    /// The call has had no effect, and may succeed later: no leader, no connection.
    #[error("the engine is not available: {0}")]
    Unavailable(String),
    /// There is no such stream or bucket.
    #[error("the engine has no {0}")]
    Missing(String),
    /// The engine has no room: a stream at its limit, or a full disk. The call has had no effect.
    #[error("the engine has no room: {0}")]
    Full(String),
    /// The engine refuses the call, and will refuse it again: its version, its configuration, or the permissions.
    #[error("the engine refuses the call: {0}")]
    Refused(String),
}

/// The reason why a conditional append was not made.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AppendIfError {
    /// The stream's last message has another number: nothing was appended.
    #[error("the stream does not end with the expected message")]
    NotExpected,
    /// Another reason.
    #[error(transparent)]
    Engine(#[from] EngineError),
}

/// The reason why a key was not set.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SetError {
    /// The key has another revision: nothing was set.
    #[error("the key has another revision than expected")]
    NotExpected,
    /// Another reason.
    #[error(transparent)]
    Engine(#[from] EngineError),
}

/// A message of a stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// Number of the message in the stream, from 1.
    pub sequence: u64,
    /// The bytes that were appended.
    pub content: Bytes,
}

/// The ends of a stream.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StreamEnds {
    /// Number of the first message that is kept; `last` + 1 where none is.
    pub first: u64,
    /// Number of the last message; 0 before the first.
    pub last: u64,
    /// A stamp of the last message. It differs if the stream has forgotten messages and another message has got the
    /// same number.
    pub stamp: u64,
}

/// The value of a key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeyEntry {
    /// The value.
    pub value: Bytes,
    /// Revision of the key, which the next conditional write expects.
    pub revision: u64,
}

/// The buckets of a cluster.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Bucket {
    /// The daemons: name → address, version, ends of logs.
    Members,
    /// The catalogue: maps by name.
    Maps,
    /// The leases: map → writer, epoch, counter.
    Writers,
}

/// The data that one server of the engine reports about itself.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct EngineServer {
    /// Name of the server.
    pub name: String,
    /// Version of the server.
    pub version: String,
    /// Whether the server makes messages durable before it acknowledges them; `None` where it does not report this.
    pub syncs_always: Option<bool>,
}

/// The state of a stream, as the engine reports it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StreamHealth {
    /// The server that leads the stream; `None` during an election.
    pub leader: Option<String>,
    /// Number of servers that are configured to hold the stream.
    pub replicas: usize,
    /// Servers that hold the stream, each with the number of messages that it lacks; the leader is not among them.
    pub followers: Vec<(String, u64)>,
    /// Bytes that the stream keeps.
    pub bytes: u64,
}

/// An engine. All calls end within `patience`, with [`EngineError::Unknown`] if need be; clones share one connection.
pub trait Engine: Clone + Send + Sync + 'static {
    /// Creates a stream, held by `replicas` servers, unless it exists.
    fn create_stream(&self, stream: &str, replicas: usize) -> impl Future<Output = Result<(), EngineError>> + Send;

    /// Deletes a stream with its messages. Succeeds also if the stream does not exist.
    fn delete_stream(&self, stream: &str) -> impl Future<Output = Result<(), EngineError>> + Send;

    /// Appends a message if the stream's last message has the number `expected_last`. Returns its number.
    fn append_if(
        &self,
        stream: &str,
        expected_last: u64,
        content: Bytes,
        patience: Duration,
    ) -> impl Future<Output = Result<u64, AppendIfError>> + Send;

    /// The ends of a stream, as its leader knows them.
    fn ends(&self, stream: &str) -> impl Future<Output = Result<StreamEnds, EngineError>> + Send;

    /// One message, as the leader has it; `None` where the stream does not hold it.
    fn read(&self, stream: &str, sequence: u64) -> impl Future<Output = Result<Option<Message>, EngineError>> + Send;

    /// The messages from `sequence` on, up to `bytes_max` bytes but at least one; waits up to `patience` for the first.
    /// It may return fewer messages than the stream has, and none if none came in time. It does not return a message
    /// with a gap before it.
    fn read_from(
        &self,
        stream: &str,
        sequence: u64,
        bytes_max: usize,
        patience: Duration,
    ) -> impl Future<Output = Result<Vec<Message>, EngineError>> + Send;

    /// Deletes the messages before `sequence`.
    fn purge_before(&self, stream: &str, sequence: u64) -> impl Future<Output = Result<(), EngineError>> + Send;

    /// The state of a stream, as the engine reports it.
    fn health(&self, stream: &str) -> impl Future<Output = Result<StreamHealth, EngineError>> + Send;

    /// The servers that reply.
    fn servers(&self) -> impl Future<Output = Result<Vec<EngineServer>, EngineError>> + Send;

    /// Creates the buckets, held by `replicas` servers, unless they exist.
    fn create_buckets(&self, replicas: usize) -> impl Future<Output = Result<(), EngineError>> + Send;

    /// The value of a key, as the leader has it.
    fn get(&self, bucket: Bucket, key: &str) -> impl Future<Output = Result<Option<KeyEntry>, EngineError>> + Send;

    /// All keys of a bucket with their values. The values may be slightly out of date.
    fn list(&self, bucket: Bucket) -> impl Future<Output = Result<Vec<(String, KeyEntry)>, EngineError>> + Send;

    /// Sets a key if its revision is `expected`; 0: if it does not exist. Returns the new revision.
    fn set_if(
        &self,
        bucket: Bucket,
        key: &str,
        expected: u64,
        value: Bytes,
    ) -> impl Future<Output = Result<u64, SetError>> + Send;

    /// Sets a key without a condition.
    fn set(&self, bucket: Bucket, key: &str, value: Bytes) -> impl Future<Output = Result<u64, EngineError>> + Send;

    /// Deletes a key if its revision is `expected`.
    fn delete_if(&self, bucket: Bucket, key: &str, expected: u64) -> impl Future<Output = Result<(), SetError>> + Send;
}
