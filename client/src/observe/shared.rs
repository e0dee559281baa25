//! The state that the handle of a producer shares with the task that exchanges messages with the daemon.
//!
//! Invariant: the lock of the state is never held across an await.

use std::{
    sync::{Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use tokio::sync::{Notify, watch};

use super::{
    ProducerError, ProducerSensor, Refusal,
    window::{WINDOW_BYTES, Window},
};
use crate::{
    error::Error,
    maps::{StateShape, StatedReporting},
};

/// Producer, label, map and options of a stream.
#[derive(Clone, Debug)]
pub struct ProducerOptions {
    /// Name of the producer; the same across restarts.
    pub producer: String,
    /// Name of the sequence of this producer; may be empty.
    pub label: String,
    /// Name of the map.
    pub map: String,
    /// Whether the nightly update follows the time of the data.
    pub nightly: bool,
    /// Kind of its values: new states are created with it, and observations of states of another kind are refused.
    /// `None`: existing kinds apply, and new states are probabilities.
    pub kind: Option<StateShape>,
    /// The reporting of the states of this producer: new states get it, and observations of states with another
    /// reporting are refused. `None`: each state keeps its reporting, and new states are reported by samples.
    pub reporting: Option<StatedReporting>,
    /// Sensor of its scans. `None`: the sensor that the daemon knows for this producer and label, or the sensor of the
    /// map for a new one. The sensor is fixed once known: announcing another one is refused.
    pub sensor: Option<ProducerSensor>,
    /// Maximum number of observations and scans kept until they are durable; sending more waits.
    pub window: usize,
    /// Maximum number of their bytes; a single scan may exceed it.
    pub window_bytes: usize,
    /// The time for which the producer tries again when the daemon cannot be reached.
    pub patience: Duration,
    /// The time that the producer waits at first for the key (producer, label, map) if another stream holds it: the
    /// daemon needs a moment to notice that a stream has ended.
    pub key_patience: Duration,
    /// The incarnation that the producer presents at first; 0, the usual value: the daemon gives it a new one. With the
    /// incarnation of an earlier run it continues that run, and is refused if the producer has begun anew since.
    pub incarnation: u64,
}

impl ProducerOptions {
    /// Options with the usual window (65,536 observations, 64 MiB), patience (a minute) and key patience (30 s).
    #[must_use]
    pub fn new(producer: &str, label: &str, map: &str) -> Self {
        Self {
            producer: producer.to_owned(),
            label: label.to_owned(),
            map: map.to_owned(),
            nightly: false,
            kind: None,
            reporting: None,
            sensor: None,
            window: 65_536,
            window_bytes: WINDOW_BYTES,
            patience: Duration::from_secs(60),
            key_patience: Duration::from_secs(30),
            incarnation: 0,
        }
    }
}

/// Whether the daemon can be reached.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Phase {
    /// The first connection is being made.
    #[default]
    Connecting,
    /// Connected.
    Connected,
    /// Not reachable now; tries again.
    Waiting(Error),
    /// Ended.
    Ended(ProducerError),
}

/// Progress of a producer.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Progress {
    /// Whether the daemon can be reached.
    pub phase: Phase,
    /// All observations up to this number are durable, or refused.
    pub durable_sequence: u64,
    /// The durable sequence number when the last connection began.
    pub resumed_at: u64,
    /// Checksum of the daemon over the observations 1..=`resumed_at`.
    pub content_crc: u32,
    /// Id of the data folder of the daemon.
    pub store_id: String,
    /// The number of times that the daemon came back with another data folder, such as a restored backup or an empty
    /// disk. Data that was acknowledged before may be missing there; for the data of this producer,
    /// [`ProducerError::Lost`] reports it.
    pub store_changes: u64,
    /// Number of observations that became durable while the connection broke, so that refusals of them are unknown.
    pub unreported: u64,
    /// Number of refusals that were dropped because the earlier ones were not collected; see
    /// [`Producer::take_refusals`]. Their observations are at most `durable_sequence`.
    pub dropped_refusals: u64,
}

/// Maximum number of refusals kept until they are collected: as many as the usual window has observations.
pub(super) const REFUSALS_MAX: usize = 65_536;

/// The state that the handle and the task share.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) options: ProducerOptions,
    pub(super) state: Mutex<SharedState>,
    /// Wakes the task: there is more to send, or more urgently.
    pub(super) more: Notify,
    pub(super) progress: watch::Sender<Progress>,
}

#[derive(Debug)]
pub(super) struct SharedState {
    /// Absent until the first Welcome.
    pub(super) window: Option<Window>,
    /// A caller waits for everything up to this number.
    pub(super) urgent: u64,
    /// The stream must end once everything is durable.
    pub(super) closing: bool,
    /// At most [`REFUSALS_MAX`].
    pub(super) refusals: Vec<Refusal>,
}

impl SharedState {
    /// Keeps refusals until they are collected, as far as there is room; returns the number of dropped ones.
    pub(super) fn keep_refusals(&mut self, refusals: impl ExactSizeIterator<Item = Refusal>) -> u64 {
        let room = REFUSALS_MAX.saturating_sub(self.refusals.len());
        let dropped = refusals.len().saturating_sub(room);
        self.refusals.extend(refusals.take(room));
        dropped as u64
    }
}

impl Shared {
    /// Locks the state: the caller while an observation is pushed, the task while a batch is taken.
    pub(super) fn state(&self) -> MutexGuard<'_, SharedState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
