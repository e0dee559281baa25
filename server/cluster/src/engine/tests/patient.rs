//! An engine that repeats a call while the engine is unavailable: a busy machine may elect a new leader at any time.
//!
//! Invariant: repeats only calls that had no effect.

use std::{future::Future, time::Duration};

use bytes::Bytes;
use tokio::time::{Instant, sleep};

use crate::engine::{
    AppendIfError, Bucket, Engine, EngineError, EngineServer, KeyEntry, Message, SetError, StreamEnds, StreamHealth,
};

/// Longest time for which an engine may be unavailable.
const PATIENCE: Duration = Duration::from_secs(60);

/// An engine whose calls wait for a leader.
#[derive(Clone)]
pub(crate) struct Patient<E>(pub(crate) E);

trait MayBeUnavailable {
    fn is_unavailable(&self) -> bool;
}

impl MayBeUnavailable for EngineError {
    fn is_unavailable(&self) -> bool {
        matches!(self, Self::Unavailable(_))
    }
}

impl MayBeUnavailable for AppendIfError {
    fn is_unavailable(&self) -> bool {
        matches!(self, Self::Engine(error) if error.is_unavailable())
    }
}

impl MayBeUnavailable for SetError {
    fn is_unavailable(&self) -> bool {
        matches!(self, Self::Engine(error) if error.is_unavailable())
    }
}

/// Makes a call until the engine is available.
async fn persist<T, F: MayBeUnavailable, C: Future<Output = Result<T, F>>>(call: impl Fn() -> C) -> Result<T, F> {
    let deadline = Instant::now() + PATIENCE;
    loop {
        match call().await {
            Err(error) if error.is_unavailable() && Instant::now() < deadline => {
                sleep(Duration::from_millis(50)).await;
            }
            outcome => return outcome,
        }
    }
}

impl<E: Engine> Engine for Patient<E> {
    async fn create_stream(&self, stream: &str, replicas: usize) -> Result<(), EngineError> {
        persist(|| self.0.create_stream(stream, replicas)).await
    }

    async fn delete_stream(&self, stream: &str) -> Result<(), EngineError> {
        persist(|| self.0.delete_stream(stream)).await
    }

    async fn append_if(
        &self,
        stream: &str,
        expected_last: u64,
        content: Bytes,
        patience: Duration,
    ) -> Result<u64, AppendIfError> {
        persist(|| self.0.append_if(stream, expected_last, content.clone(), patience)).await
    }

    async fn ends(&self, stream: &str) -> Result<StreamEnds, EngineError> {
        persist(|| self.0.ends(stream)).await
    }

    async fn read(&self, stream: &str, sequence: u64) -> Result<Option<Message>, EngineError> {
        persist(|| self.0.read(stream, sequence)).await
    }

    async fn read_from(
        &self,
        stream: &str,
        sequence: u64,
        bytes_max: usize,
        patience: Duration,
    ) -> Result<Vec<Message>, EngineError> {
        persist(|| self.0.read_from(stream, sequence, bytes_max, patience)).await
    }

    async fn purge_before(&self, stream: &str, sequence: u64) -> Result<(), EngineError> {
        persist(|| self.0.purge_before(stream, sequence)).await
    }

    async fn health(&self, stream: &str) -> Result<StreamHealth, EngineError> {
        persist(|| async {
            let health = self.0.health(stream).await?;
            if health.leader.is_none() {
                return Err(EngineError::Unavailable("no leader".to_owned()));
            }
            Ok(health)
        })
        .await
    }

    async fn servers(&self) -> Result<Vec<EngineServer>, EngineError> {
        persist(|| self.0.servers()).await
    }

    async fn create_buckets(&self, replicas: usize) -> Result<(), EngineError> {
        persist(|| self.0.create_buckets(replicas)).await
    }

    async fn get(&self, bucket: Bucket, key: &str) -> Result<Option<KeyEntry>, EngineError> {
        persist(|| self.0.get(bucket, key)).await
    }

    async fn list(&self, bucket: Bucket) -> Result<Vec<(String, KeyEntry)>, EngineError> {
        persist(|| self.0.list(bucket)).await
    }

    async fn set_if(&self, bucket: Bucket, key: &str, expected: u64, value: Bytes) -> Result<u64, SetError> {
        persist(|| self.0.set_if(bucket, key, expected, value.clone())).await
    }

    async fn set(&self, bucket: Bucket, key: &str, value: Bytes) -> Result<u64, EngineError> {
        persist(|| self.0.set(bucket, key, value.clone())).await
    }

    async fn delete_if(&self, bucket: Bucket, key: &str, expected: u64) -> Result<(), SetError> {
        persist(|| self.0.delete_if(bucket, key, expected)).await
    }
}
