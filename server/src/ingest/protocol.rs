//! The messages between a stream, the writer of its map and the committer of the log.
//!
//! Invariant: everything is bounded: a batch holds its buffer budget until it is durable and applied, and the messages
//! back to a stream are bounded by what it sent.

use std::sync::Arc;

use tidemap_grid::{
    index::TileIndex,
    log_head::StreamScan,
    paging::SavedTiles,
    sensors::{InvalidSensor, ProducerSensor},
    tile::TileSource,
};
use tidemap_map::{
    event::{Position, SequenceSpan, StateShape, UpdateCause},
    history::{HistoryPiece, Reading, Subject},
    ids::{ProducerId, RefusalReason},
    name::{ProducerKey, StateName},
    site::{InvalidEdit, SiteEdit},
    snapshot::{ContentMark, MapSnapshot, ProducerMark},
    traversal::Traversal,
    update::UpdateResult,
};
use tidemap_store::AppendError;
use tokio::sync::{OwnedSemaphorePermit, mpsc, oneshot};

use super::{
    anomaly_feed::{CellFeed, FeedReceiver},
    ending::Ending,
    probe::Probe,
};
use crate::jobs::UpdateJob;

/// The number of a stream at its map's writer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(crate) struct SessionId(pub u64);

/// A producer opens a stream.
#[derive(Debug)]
pub(crate) struct Hello {
    pub key: ProducerKey,
    /// 0: a new incarnation is requested.
    pub incarnation: u64,
    /// How to ask this stream's client whether it is still there, if it answers.
    pub probe: Option<Probe>,
    /// The stream of the key that did not answer; this one takes over.
    pub takes_over: Option<SessionId>,
    /// Whether the stream announces data time.
    pub nightly: bool,
    /// The announced sensor.
    pub sensor: Option<ProducerSensor>,
    /// The channel of messages back to the stream.
    pub events: mpsc::UnboundedSender<SessionEvent>,
    pub reply: oneshot::Sender<Result<Welcome, HelloError>>,
}

/// The answer to an accepted stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Welcome {
    pub session: SessionId,
    pub incarnation: u64,
    /// Everything up to this sequence number is durable.
    pub durable_sequence: u64,
    /// Running CRC up to it.
    pub content_crc: u32,
    /// Running CRCs that are known, ascending, up to it.
    pub content_marks: Vec<ContentMark>,
}

#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(crate) enum HelloError {
    #[error(
        "producer {:?} already streams to this map with label {:?}: stop that stream first, or use another producer \
         or label", key.producer(), key.label()
    )]
    AlreadyStreaming {
        key: ProducerKey,
        /// The stream, and how to ask its client.
        open: Option<(SessionId, Probe)>,
    },
    #[error("incarnation {got} of producer {:?} is fenced: incarnation {current} was seen", key.producer())]
    Fenced { key: ProducerKey, got: u64, current: u64 },
    #[error("the map has {max} producer keys, as many as setting max_producers_per_map allows")]
    TooManyProducers { max: usize },
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
    Storage(#[from] AppendError),
    #[error("the map is closing")]
    Closing,
}

/// A refused observation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct RefusedObservation {
    pub sequence: u64,
    /// The reason for programs.
    pub reason: RefusalReason,
    /// The reason for people.
    pub detail: String,
}

/// A name of a stream's table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct NewName {
    pub name: StateName,
    /// The shape that the message declares for the state; `None`: not declared.
    pub shape: Option<StateShape>,
}

impl From<StateName> for NewName {
    /// A name without a declared shape.
    fn from(name: StateName) -> Self {
        Self { name, shape: None }
    }
}

/// Checked observations of one message, with their states as indices into the stream's table.
#[derive(Debug, Default)]
pub(crate) struct ObservationBatch {
    /// What is new of the message; may be empty.
    pub span: SequenceSpan,
    /// Names added to the stream's table since the last batch; an invalid name keeps its index.
    pub new_names: Vec<Option<NewName>>,
    /// Per accepted observation: sequence number minus the first one of `span`. Empty if all were accepted.
    pub kept: Vec<u32>,
    /// Per accepted observation: index into the stream's table; its name is valid.
    pub table_indices: Vec<u32>,
    /// Per accepted observation: nanoseconds UTC.
    pub times_nanos: Vec<i64>,
    /// Per accepted observation: a value that the declared kind allows, or any kind if none is declared; 0 for a
    /// position.
    pub values: Vec<f64>,
    /// The positions, ascending, each with the index of its observation among the accepted ones, and with the declared
    /// number of coordinates.
    pub positions: Vec<(u32, Position)>,
    /// The refused observations.
    pub refused: Vec<RefusedObservation>,
}

/// Which of a stream's two tables of tiles a scan refers to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum ScanOrigin {
    /// The table that the client extends.
    #[default]
    Stream,
    /// The table of the scans that the server has ray-cast.
    Cast,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct CheckedScan {
    pub sequence: u64,
    /// Running CRC up to it.
    pub content_crc: u32,
    /// The table that its slots refer to.
    pub origin: ScanOrigin,
    /// Whether it is logged. Other scans are only remembered, because later ones refer to them.
    pub is_taken: bool,
    pub scan: StreamScan,
    /// Tiles added to the table before this scan.
    pub new_tiles: Vec<TileIndex>,
    /// Whether the table restarts before that.
    pub restarts: bool,
}

impl Default for CheckedScan {
    fn default() -> Self {
        let scan =
            StreamScan { utc_nanos: 0, seen: Arc::from([]), observed_flips: Vec::new(), occupied_flips: Vec::new() };
        let origin = ScanOrigin::default();
        Self { sequence: 0, content_crc: 0, origin, is_taken: false, scan, new_tiles: Vec::new(), restarts: false }
    }
}

/// Checked scans of one message, or some of them.
#[derive(Debug, Default)]
pub(crate) struct ScanBatch {
    /// The new scans of the message, or of a part of it; may be empty.
    pub span: SequenceSpan,
    /// Tiles added to the client's table before the scans.
    pub new_tiles: Vec<TileIndex>,
    /// The scans, in order.
    pub scans: Vec<CheckedScan>,
    /// The refused scans among the new ones.
    pub refused: Vec<RefusedObservation>,
    /// Memory of the batch, about.
    pub bytes: usize,
}

/// Checked traversals of one message.
#[derive(Debug, Default)]
pub(crate) struct TraversalBatch {
    /// What is new of the message; not empty.
    pub span: SequenceSpan,
    /// The valid traversals with their sequence numbers. The map's writer checks whether the edges exist.
    pub traversals: Vec<(u64, Traversal)>,
    /// The refused traversals.
    pub refused: Vec<RefusedObservation>,
}

/// Room in the buffers of a stream and of all streams; dropping it gives it back.
pub(crate) type BufferBudget = [OwnedSemaphorePermit; 2];

/// The tiles that a save has stored, and where to read them, if the map has a grid.
pub(crate) type SavedGrid = Option<(Arc<dyn TileSource>, SavedTiles)>;

/// A message from a writer to a stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum SessionEvent {
    /// Everything up to the sequence number is durable.
    Ack {
        durable_sequence: u64,
        /// Refused since the last acknowledgement.
        refused: Vec<RefusedObservation>,
    },
    /// The stream ends.
    End(Ending),
}

/// A state to add.
#[derive(Debug)]
pub(crate) struct AddState {
    pub name: StateName,
    pub shape: StateShape,
    /// The answer, after the state is durable and published.
    pub reply: oneshot::Sender<Result<(), AddStateError>>,
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum AddStateError {
    #[error("state {name:?} exists and is {found}, not {asked}: the kind of a state never changes", name = .name.as_str(), found = .found.with_article(), asked = .asked.with_article())]
    OtherKind { name: StateName, found: StateShape, asked: StateShape },
    #[error("the map has {max} states, as many as setting max_states_per_map allows")]
    TooMany { max: usize },
    #[error(transparent)]
    Storage(#[from] AppendError),
    #[error("the map is closing")]
    Closing,
}

/// An edit of the site.
#[derive(Debug)]
pub(crate) struct EditSite {
    pub edit: SiteEdit,
    /// The answer, after the edit is durable and published.
    pub reply: oneshot::Sender<Result<(), EditSiteError>>,
}

#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(crate) enum EditSiteError {
    #[error(transparent)]
    Invalid(#[from] InvalidEdit),
    #[error(transparent)]
    Storage(#[from] AppendError),
    #[error("the map is closing")]
    Closing,
}

/// What a stream hands to its map's writer, with its room in the buffers until it is durable and applied.
#[derive(Debug)]
pub(crate) enum StreamData {
    /// Checked observations.
    Observations(ObservationBatch, BufferBudget),
    /// Checked scans.
    Scans(ScanBatch, BufferBudget),
    /// Checked traversals.
    Traversals(TraversalBatch, BufferBudget),
    /// The end of the stream.
    End {
        /// Whether the producer ended it on purpose.
        clean: bool,
    },
}

/// A producer of a map.
#[derive(Clone, Debug)]
pub(crate) struct KnownProducer {
    /// Number of the producer within the map.
    pub id: ProducerId,
    /// How far its sequence is durable.
    pub mark: ProducerMark,
    /// Whether a stream of it is open.
    pub is_connected: bool,
}

/// A request for what was observed and is not in the store's history yet.
#[derive(Debug)]
pub(crate) struct ReadHistory {
    /// The state or cell.
    pub subject: Subject,
    /// First instant, nanoseconds UTC.
    pub from_nanos: i64,
    /// Beyond the last instant.
    pub to_nanos: i64,
    /// Maximum number of pending observations to return.
    pub at_most: usize,
    /// The answer; it waits while an update has observations of that time.
    pub reply: oneshot::Sender<HistoryTail>,
}

/// The observations that are not in the store's history yet.
#[derive(Debug)]
pub(crate) struct HistoryTail {
    /// Those that no update has learned.
    pub pending: Vec<Reading>,
    /// Those that updates have learned and no save has stored.
    pub unsaved: Vec<Arc<HistoryPiece>>,
    /// Generations before this one are in the store's history.
    pub stored_before: u64,
    /// Greatest time of any observation, nanoseconds UTC.
    pub newest_nanos: i64,
}

/// A command to a writer.
#[derive(Debug)]
pub(crate) enum Command {
    /// Open a stream.
    Hello(Hello),
    /// Take what a stream hands over.
    StreamData { session: SessionId, data: StreamData },
    /// Update the map.
    Update {
        /// Learn observations before this time; `None`: all.
        until_nanos: Option<i64>,
        cause: UpdateCause,
        job: Arc<UpdateJob>,
    },
    /// The committer has answered the oldest append.
    Committed(Result<u64, AppendError>),
    /// The running update has ended; `Err`: it failed.
    UpdateDone { job: Arc<UpdateJob>, result: Result<Box<UpdateResult>, String> },
    /// A save has ended; `Err`: it failed, and gives the snapshot back.
    Saved(Result<SavedGrid, (String, MapSnapshot)>),
    /// Add a state.
    AddState(AddState),
    /// Edit the site.
    EditSite(EditSite),
    /// Return what is not in the store's history yet.
    ReadHistory(ReadHistory),
    /// Return the producers.
    ListProducers(oneshot::Sender<Vec<KnownProducer>>),
    /// Subscribe to what is applied from now on. The answer: a receiver, and the number of observations sent before.
    Watch(oneshot::Sender<(FeedReceiver, u64)>),
    /// Subscribe to scans that are applied from now on.
    WatchCells(oneshot::Sender<CellFeed>),
    /// End all streams and stop.
    Stop {
        /// The reason for the streams.
        ending: Ending,
        /// Answered when the writer has stopped.
        done: oneshot::Sender<()>,
    },
}
