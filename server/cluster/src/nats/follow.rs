//! Reads a stream from a number on. A consumer per stream stays open between calls, so that the next message comes
//! without a request.
//!
//! At most [`PULLED_BYTES_MAX`] bytes and [`PULLED_MESSAGES_MAX`] messages are requested at once: the server stalls on
//! larger pulls.
//!
//! Invariant: messages are returned in order and without a gap from the requested number. A consumer that delivers
//! another number is dropped. A consumer that delivers nothing although the leader of the stream has the message is
//! dropped too: it is on a server that does not catch up. The messages are then read from the leader.

use std::{collections::HashMap, sync::Arc, time::Duration};

use async_nats::{
    error::Error,
    jetstream::{
        self,
        consumer::{AckPolicy, DeliverPolicy, pull},
        stream::ConsumerErrorKind,
    },
};
use serde_json::json;
use tokio::{
    sync::Mutex,
    time::{Instant, sleep_until, timeout_at},
};
use tokio_stream::StreamExt;

use super::calls::{NatsCalls, from_api};
use crate::engine::{EngineError, Message};

/// Bytes of one pull. The next pull is sent when half of them have arrived.
const PULLED_BYTES_MAX: usize = 4 << 20;

/// Messages of one pull.
const PULLED_MESSAGES_MAX: usize = 256;

/// Time for which the server keeps a consumer that nobody reads.
const LINGERS: Duration = Duration::from_secs(30);

/// Interval of the server's heartbeats for a consumer; without two of them the consumer is given up.
const HEARTBEAT: Duration = Duration::from_secs(1);

/// Time for which a pull waits for messages.
const EXPIRES: Duration = Duration::from_secs(20);

/// Pause before a call makes a consumer again, so that its caller does not repeat this without pause.
const PAUSE: Duration = Duration::from_millis(50);

/// Time without a message after which the leader is queried for more messages. It doubles with each query.
const SILENT: Duration = Duration::from_secs(1);

/// Number of messages that are read from the leader, one request each, when a consumer does not deliver them.
const READ_BY_LEADER_MAX: u64 = 64;

/// Time limit of the leader's reply.
const ANSWERS: Duration = Duration::from_millis(500);

/// The longest time between two such queries.
const SILENT_MAX: Duration = Duration::from_secs(30);

/// The state of a consumer after a read.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Then {
    GoesOn,
    /// The next message has another number than the requested one.
    Gap,
    Ended,
}

/// An open consumer.
struct Follow {
    messages: pull::Stream,
    next: u64,
    /// A message that had no room in the previous reply.
    left: Option<Message>,
    /// The time of the next query to the leader, and the waiting time before it.
    ask: Instant,
    silent: Duration,
}

/// The streams that an engine follows.
#[derive(Default)]
pub(super) struct FollowedStreams {
    streams: Mutex<HashMap<String, Arc<Mutex<Option<Follow>>>>>,
}

impl FollowedStreams {
    pub(super) async fn forget(&self, stream: &str) {
        self.streams.lock().await.remove(stream);
    }

    /// The messages of a stream from a number on; `name` is the stream's name in JetStream.
    pub(super) async fn read_from(
        &self,
        calls: &NatsCalls,
        stream: &str,
        name: &str,
        sequence: u64,
        bytes_max: usize,
        patience: Duration,
    ) -> Result<Vec<Message>, EngineError> {
        let deadline = Instant::now() + patience;
        let slot = Arc::clone(self.streams.lock().await.entry(stream.to_owned()).or_default());
        let Ok(mut slot) = timeout_at(deadline, slot.lock()).await else { return Ok(Vec::new()) };
        loop {
            // If the caller gives up, the content of the slot is lost: the consumer is then made again.
            let open = slot.take().filter(|follow| follow.next == sequence);
            let mut follow = match open {
                Some(follow) => follow,
                None => match timeout_at(deadline, open_at(calls, name, sequence)).await {
                    Ok(follow) => follow?,
                    Err(_) => return Ok(Vec::new()),
                },
            };
            let (messages, then) = follow.take(bytes_max, deadline).await;
            if then == Then::GoesOn {
                if messages.is_empty() && follow.is_to_be_doubted() {
                    let messages = read_by_leader(calls, name, sequence, bytes_max).await;
                    if !messages.is_empty() {
                        tracing::debug!(stream, sequence, "a consumer is silent, and its stream is not");
                        return Ok(messages);
                    }
                }
                *slot = Some(follow);
                return Ok(messages);
            }
            if !messages.is_empty() {
                return Ok(messages);
            }
            calls.check_connection()?;
            sleep_until(deadline.min(Instant::now() + PAUSE)).await;
            if then == Then::Gap || Instant::now() >= deadline {
                return Ok(Vec::new());
            }
        }
    }
}

impl Follow {
    /// The messages that have arrived, up to a number of bytes, and the state of the consumer. Waits for the first
    /// message.
    async fn take(&mut self, bytes_max: usize, deadline: Instant) -> (Vec<Message>, Then) {
        let mut messages: Vec<Message> = Vec::new();
        let mut bytes = 0;
        loop {
            let message = match self.left.take() {
                Some(message) => message,
                None => {
                    // After the first message, take only messages that have arrived already.
                    let until = if messages.is_empty() { deadline } else { Instant::now() };
                    match timeout_at(until, self.messages.next()).await {
                        Err(_) => return (messages, Then::GoesOn),
                        Ok(Some(Ok(message))) => match message_of(message) {
                            Some(message) if message.sequence == self.next => message,
                            _ => return (messages, Then::Gap),
                        },
                        Ok(Some(Err(error))) => {
                            tracing::debug!(%error, "a consumer ends");
                            return (messages, Then::Ended);
                        }
                        Ok(None) => return (messages, Then::Ended),
                    }
                }
            };
            bytes += message.content.len();
            if bytes > bytes_max && !messages.is_empty() {
                self.left = Some(message);
                return (messages, Then::GoesOn);
            }
            self.next = message.sequence + 1;
            messages.push(message);
            self.silent = SILENT;
            self.ask = Instant::now() + SILENT;
        }
    }

    /// Whether the consumer has been silent for so long that the leader must be queried.
    fn is_to_be_doubted(&mut self) -> bool {
        let is_due = Instant::now() >= self.ask;
        if is_due {
            self.silent = SILENT_MAX.min(self.silent * 2);
            self.ask = Instant::now() + self.silent;
        }
        is_due
    }
}

/// The messages from a number on, as far as the leader of the stream returns them.
async fn read_by_leader(calls: &NatsCalls, name: &str, sequence: u64, bytes_max: usize) -> Vec<Message> {
    let (mut messages, mut bytes) = (Vec::new(), 0);
    for sequence in sequence..sequence + READ_BY_LEADER_MAX {
        let wanted = json!({ "seq": sequence });
        let Ok(Ok(Some(read))) = timeout_at(Instant::now() + ANSWERS, calls.message(name, &wanted)).await else {
            break;
        };
        bytes += read.payload.len();
        if bytes > bytes_max && !messages.is_empty() {
            break;
        }
        messages.push(Message { sequence: read.sequence, content: read.payload });
    }
    messages
}

fn message_of(message: jetstream::Message) -> Option<Message> {
    let sequence = message.info().ok()?.stream_sequence;
    Some(Message { sequence, content: message.message.payload })
}

async fn open_at(calls: &NatsCalls, name: &str, sequence: u64) -> Result<Follow, EngineError> {
    calls.check_connection()?;
    let config = pull::Config {
        deliver_policy: DeliverPolicy::ByStartSequence { start_sequence: sequence.max(1) },
        ack_policy: AckPolicy::None,
        memory_storage: true,
        num_replicas: 1,
        inactive_threshold: LINGERS,
        ..pull::Config::default()
    };
    let consumer = calls.context().create_consumer_on_stream(config, name).await;
    let consumer = consumer.map_err(|error| from_consumer(&error))?;
    let pulls = consumer.stream().max_messages_per_batch(PULLED_MESSAGES_MAX).max_bytes_per_batch(PULLED_BYTES_MAX);
    let messages = pulls.heartbeat(HEARTBEAT).expires(EXPIRES).messages().await;
    let messages = messages.map_err(|error| EngineError::Unknown(error.to_string()))?;
    Ok(Follow { messages, next: sequence, left: None, ask: Instant::now() + SILENT, silent: SILENT })
}

/// The reason why a consumer could not be made. A consumer that was made although the call failed does no harm.
pub(super) fn from_consumer(error: &Error<ConsumerErrorKind>) -> EngineError {
    match error.kind() {
        ConsumerErrorKind::JetStream(reason) => from_api(&reason),
        _ => EngineError::Unknown(error.to_string()),
    }
}

/// The reason why messages could not be pulled.
pub(super) fn from_batch(error: &pull::BatchError) -> EngineError {
    EngineError::Unknown(error.to_string())
}
