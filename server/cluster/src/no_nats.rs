//! Stands in for the engine NATS JetStream in builds without the feature `nats`: nobody can connect.
//!
//! Invariant: there is no value of [`NatsEngine`], so that no call of it can run.

use std::{convert::Infallible, time::Duration};

use bytes::Bytes;

pub use self::{
    check_error::{NatsCheckError, VERSION_LEAST},
    settings::{NatsCredentials, NatsSettings, NatsTls},
};
use crate::engine::{
    AppendIfError, Bucket, Engine, EngineError, EngineServer, KeyEntry, Message, SetError, StreamEnds, StreamHealth,
};

#[path = "nats/check_error.rs"]
mod check_error;
#[path = "nats/settings.rs"]
mod settings;

/// Whether this build can connect to NATS JetStream.
pub const IS_BUILT: bool = false;

/// A connection to NATS JetStream, of which this build has none.
#[derive(Clone)]
pub struct NatsEngine(Infallible);

impl NatsEngine {
    /// Returns an error: this build cannot connect.
    pub async fn connect(settings: NatsSettings) -> Result<Self, EngineError> {
        settings.check()?;
        Err(EngineError::Refused("this program was built without clusters".to_owned()))
    }
}

/// Checks that the servers have the properties on which tidemap relies.
pub async fn check(engine: &NatsEngine, _: bool) -> Result<Vec<EngineServer>, NatsCheckError> {
    match engine.0 {}
}

impl Engine for NatsEngine {
    async fn create_stream(&self, _: &str, _: usize) -> Result<(), EngineError> {
        match self.0 {}
    }

    async fn delete_stream(&self, _: &str) -> Result<(), EngineError> {
        match self.0 {}
    }

    async fn append_if(&self, _: &str, _: u64, _: Bytes, _: Duration) -> Result<u64, AppendIfError> {
        match self.0 {}
    }

    async fn ends(&self, _: &str) -> Result<StreamEnds, EngineError> {
        match self.0 {}
    }

    async fn read(&self, _: &str, _: u64) -> Result<Option<Message>, EngineError> {
        match self.0 {}
    }

    async fn read_from(&self, _: &str, _: u64, _: usize, _: Duration) -> Result<Vec<Message>, EngineError> {
        match self.0 {}
    }

    async fn purge_before(&self, _: &str, _: u64) -> Result<(), EngineError> {
        match self.0 {}
    }

    async fn health(&self, _: &str) -> Result<StreamHealth, EngineError> {
        match self.0 {}
    }

    async fn servers(&self) -> Result<Vec<EngineServer>, EngineError> {
        match self.0 {}
    }

    async fn create_buckets(&self, _: usize) -> Result<(), EngineError> {
        match self.0 {}
    }

    async fn get(&self, _: Bucket, _: &str) -> Result<Option<KeyEntry>, EngineError> {
        match self.0 {}
    }

    async fn list(&self, _: Bucket) -> Result<Vec<(String, KeyEntry)>, EngineError> {
        match self.0 {}
    }

    async fn set_if(&self, _: Bucket, _: &str, _: u64, _: Bytes) -> Result<u64, SetError> {
        match self.0 {}
    }

    async fn set(&self, _: Bucket, _: &str, _: Bytes) -> Result<u64, EngineError> {
        match self.0 {}
    }

    async fn delete_if(&self, _: Bucket, _: &str, _: u64) -> Result<(), SetError> {
        match self.0 {}
    }
}
