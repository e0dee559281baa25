//! What a producer's handle shares with the task that talks to the daemon.
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
use crate::{error::Error, maps::StateKind};

/// Who sends, what, and to which map.
#[derive(Clone, Debug)]
pub struct ProducerOptions {
    /// Who streams; kept by the producer across restarts.
    pub producer: String,
    /// Which of the producer's sequences; may be empty.
    pub label: String,
    /// Name of the map.
    pub map: String,
    /// Lets the nightly update run in the time of the data.
    pub nightly: bool,
    /// What the values of its states mean: states that are new become of that kind, and observations of states of another
    /// kind are refused. `None`: each state is as it is, and a probability where it is new.
    pub kind: Option<StateKind>,
    /// How far its scans are believed; `None`: as the daemon knows of this producer and label, of a new one as the map's
    /// grid says. What the daemon knows does not change any more: announcing something else is refused.
    pub sensor: Option<ProducerSensor>,
    /// Most observations and scans kept until they are durable; sending more waits.
    pub window: usize,
    /// Most bytes of them; one scan may go beyond it.
    pub window_bytes: usize,
    /// How long to try again when the daemon cannot be reached.
    pub patience: Duration,
    /// How long to wait at first for the key (producer, label, map) where another stream holds it: the daemon takes a
    /// moment to notice that a stream has ended.
    pub key_patience: Duration,
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
            sensor: None,
            window: 65_536,
            window_bytes: WINDOW_BYTES,
            patience: Duration::from_secs(60),
            key_patience: Duration::from_secs(30),
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
    /// Not at the moment; tries again.
    Waiting(Error),
    /// No more.
    Ended(ProducerError),
}

/// How far a producer is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Progress {
    /// Whether the daemon can be reached.
    pub phase: Phase,
    /// Everything up to this number is durable, or refused.
    pub durable_sequence: u64,
    /// Where the last connection began: what the daemon had then.
    pub resumed_at: u64,
    /// Checksum that the daemon gave for the observations 1..=`resumed_at`.
    pub content_crc: u32,
    /// Identity of the daemon's data folder.
    pub store_id: String,
    /// Observations that became durable while the connection broke, so that it is not known whether they were refused.
    pub unreported: u64,
    /// Refusals that were dropped because nobody took those before them; see [`Producer::take_refusals`]. Their
    /// observations are at most `durable_sequence`.
    pub dropped_refusals: u64,
}

/// Most refusals kept until somebody takes them: as many as the usual window holds observations.
pub(super) const REFUSALS_MAX: usize = 65_536;

/// What the handle and the task share.
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
    /// Somebody waits for everything up to this number.
    pub(super) urgent: u64,
    /// The stream is to end once everything is durable.
    pub(super) closing: bool,
    /// At most [`REFUSALS_MAX`].
    pub(super) refusals: Vec<Refusal>,
}

impl SharedState {
    /// Keeps refusals for whoever takes them, as far as there is room; gives the number of those dropped.
    pub(super) fn keep_refusals(&mut self, refusals: impl ExactSizeIterator<Item = Refusal>) -> u64 {
        let room = REFUSALS_MAX.saturating_sub(self.refusals.len());
        let dropped = refusals.len().saturating_sub(room);
        self.refusals.extend(refusals.take(room));
        dropped as u64
    }
}

impl Shared {
    /// Locks the window: held by the caller while an observation is put in, by the task while a batch is taken out.
    pub(super) fn state(&self) -> MutexGuard<'_, SharedState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
