//! The messages between a stream and its map's writer: the stream opens, hands data over, is acknowledged and ends.
//!
//! Invariant: a batch holds its buffer budget until it is durable and applied, and the messages back to a stream are
//! bounded by what it sent.

use tidemap_grid::sensors::{InvalidSensor, ProducerSensor};
use tidemap_map::{name::ProducerKey, snapshot::ContentMark};
use tidemap_store::AppendError;
use tokio::sync::{OwnedSemaphorePermit, mpsc, oneshot};

use super::batches::{ObservationBatch, RefusedObservation, ReportBatch, ScanBatch};
use crate::{ending::Ending, probe::Probe, role::NotWriter};

/// The number of a stream at its map's writer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct SessionId(pub u64);

/// A producer opens a stream.
#[derive(Debug)]
pub struct Hello {
    /// The producer and its label.
    pub key: ProducerKey,
    /// The requested incarnation; 0: a new one.
    /// The incarnation of the producer.
    pub incarnation: u64,
    /// The client, by its name in the shares; empty: it has no share of its own.
    pub client: String,
    /// The probe of this stream's client, if the client replies to probes.
    pub probe: Option<Probe>,
    /// The stream of the key that did not reply; this one takes over.
    pub takes_over: Option<SessionId>,
    /// Whether the stream announces data time.
    pub nightly: bool,
    /// The announced sensor.
    pub sensor: Option<ProducerSensor>,
    /// The channel of messages back to the stream.
    pub events: mpsc::UnboundedSender<SessionEvent>,
    /// The receiver of the result.
    pub reply: oneshot::Sender<Result<Welcome, HelloError>>,
}

/// The reply to an accepted stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Welcome {
    /// The session of the stream.
    pub session: SessionId,
    /// Number of the start of the producer.
    pub incarnation: u64,
    /// All observations up to this sequence number are durable.
    pub durable_sequence: u64,
    /// Running CRC up to the durable sequence number.
    pub content_crc: u32,
    /// Known running CRCs up to the durable sequence number, ascending.
    pub content_marks: Vec<ContentMark>,
}

#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the variants and fields")]
pub enum HelloError {
    #[error(
        "producer {:?} already streams to this map with label {:?}: stop that stream first, or use another producer \
         or label", key.producer(), key.label()
    )]
    AlreadyStreaming {
        key: ProducerKey,
        /// The open stream, and the probe of its client.
        open: Option<(SessionId, Probe)>,
    },
    #[error("incarnation {got} of producer {:?} is fenced: incarnation {current} was seen", key.producer())]
    Fenced { key: ProducerKey, got: u64, current: u64 },
    #[error("the map has {max} producer keys, as many as setting max_producers_per_map allows")]
    TooManyProducers { max: usize },
    #[error(
        "{client} has introduced {max} producer keys of the map, as many as setting max_producers_per_client allows. \
         tidemap producer forget frees the places of those that will not return"
    )]
    TooManyOfClient { client: String, max: usize },
    #[error(
        "producer {:?} with label {:?} was forgotten, and begins anew: open the stream with incarnation 0. Its \
         sequence continues after what it has sent", key.producer(), key.label()
    )]
    Forgotten { key: ProducerKey },
    #[error(transparent)]
    Sensor(#[from] InvalidSensor),
    #[error("the map has no grid: a sensor has nothing to observe there")]
    SensorWithoutGrid,
    #[error(
        "producer {:?} has a sensor of {fixed} with label {:?} since its first observation, and announces {announced}: \
         announce the same or none, or use another label", key.producer(), key.label()
    )]
    OtherSensor { key: ProducerKey, fixed: ProducerSensor, announced: ProducerSensor },
    #[error(transparent)]
    NotWriter(#[from] NotWriter),
    #[error(transparent)]
    Storage(#[from] AppendError),
    #[error("the map is closing")]
    Closing,
}

/// A message from a writer to a stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SessionEvent {
    /// All observations up to the sequence number are durable.
    Ack {
        /// The sequence number.
        durable_sequence: u64,
        /// The observations refused since the last acknowledgement.
        refused: Vec<RefusedObservation>,
    },
    /// The stream ends.
    End(Ending),
}

/// Room in the buffers of a stream, its client, its map and all streams; dropping it gives it back.
pub type BufferBudget = Vec<OwnedSemaphorePermit>;

/// The data that a stream hands to its map's writer, with its room in the buffers until it is durable and applied.
#[derive(Debug)]
pub enum StreamData {
    /// Checked observations.
    Observations(ObservationBatch, BufferBudget),
    /// Checked scans.
    Scans(ScanBatch, BufferBudget),
    /// Checked reports.
    Reports(ReportBatch, BufferBudget),
    /// The end of the stream.
    End {
        /// Whether the producer ended it on purpose.
        clean: bool,
    },
}
