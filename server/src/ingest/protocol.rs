//! What passes between a stream, the writer of its map and the committer of the log.
//!
//! Invariant: all of it is bounded: a batch holds a permit for its bytes until it is durable and applied, and what goes
//! back to a stream is bounded by what it sent.

use std::sync::Arc;

use tidemap_map::{
    event::{Position, StateShape, UpdateCause},
    grid::{
        front::SentScan,
        index::TileIndex,
        paging::SavedTiles,
        sensors::{InvalidSensor, ProducerSensor},
        tile::TileSource,
    },
    history::{HistoryPiece, Reading, Subject},
    ids::RefusalReason,
    name::{ProducerKey, StateName},
    site::{InvalidEdit, SiteEdit},
    snapshot::MapSnapshot,
    traversal::Traversal,
    update::UpdateResult,
};
use tidemap_store::AppendError;
use tokio::sync::{OwnedSemaphorePermit, mpsc, oneshot};

use super::{anomaly_feed::FeedReceiver, ending::Ending};
use crate::jobs::UpdateJob;

/// A stream, as its map's writer knows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(crate) struct SessionId(pub u64);

/// A producer introduces itself.
#[derive(Debug)]
pub(crate) struct Hello {
    /// Whose sequence.
    pub key: ProducerKey,
    /// 0: a new incarnation is wanted.
    pub incarnation: u64,
    /// Whether data time is announced.
    pub nightly: bool,
    /// The sensor that is announced.
    pub sensor: Option<ProducerSensor>,
    /// Where the writer's messages to the stream go.
    pub events: mpsc::UnboundedSender<SessionEvent>,
    /// The answer.
    pub reply: oneshot::Sender<Result<Welcome, HelloError>>,
}

/// A stream that was accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Welcome {
    /// The stream.
    pub session: SessionId,
    /// Its incarnation.
    pub incarnation: u64,
    /// Everything up to this one is durable.
    pub durable_sequence: u64,
    /// Running CRC over it.
    pub content_crc: u32,
}

/// Why a stream is not accepted.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(crate) enum HelloError {
    #[error(
        "producer {:?} already streams to this map with label {:?}: stop that stream first, or use another producer \
         or label", .0.producer(), .0.label()
    )]
    AlreadyStreaming(ProducerKey),
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

/// An observation that was refused.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct RefusedObservation {
    /// Its sequence number.
    pub sequence: u64,
    /// Why, to act on.
    pub reason: RefusalReason,
    /// Why, to read.
    pub detail: String,
}

/// A name of a stream's table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct NewName {
    /// The name.
    pub name: StateName,
    /// What it is said to be.
    pub shape: Option<StateShape>,
}

impl From<StateName> for NewName {
    /// A name of which nothing is said.
    fn from(name: StateName) -> Self {
        Self { name, shape: None }
    }
}

/// Checked observations of one message, with their states as indices into the stream's table.
#[derive(Debug, Default)]
pub(crate) struct ObservationBatch {
    /// First sequence number that is new.
    pub first_sequence: u64,
    /// Last sequence number.
    pub last_sequence: u64,
    /// Running CRC up to it.
    pub content_crc: u32,
    /// Names added to the stream's table since the last batch; an invalid one keeps its place.
    pub new_names: Vec<Option<NewName>>,
    /// Per accepted observation: sequence number minus `first_sequence`. Empty where all were accepted.
    pub kept: Vec<u32>,
    /// Per accepted observation: index into the stream's table; its name is valid.
    pub table_indices: Vec<u32>,
    /// Per accepted observation: nanoseconds UTC.
    pub times_nanos: Vec<i64>,
    /// Per accepted observation: a value that some kind of state may have, and the named kind where one was named; of a
    /// position 0.
    pub values: Vec<f64>,
    /// The positions, each with the place of its observation among the accepted ones, ascending; each is one that a vector
    /// may have, and of as many coordinates as its name is said to have.
    pub positions: Vec<(u32, Position)>,
    /// The others.
    pub refused: Vec<RefusedObservation>,
}

/// Which of a stream's two tables of tiles a scan refers to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum ScanOrigin {
    /// The table that the client extends.
    #[default]
    Stream,
    /// That of the scans which the server has cast for it.
    Cast,
}

/// A checked scan of a stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct CheckedScan {
    /// Its sequence number.
    pub sequence: u64,
    /// Running CRC up to it.
    pub content_crc: u32,
    /// What its slots refer to.
    pub origin: ScanOrigin,
    /// Whether it is to be logged. The others are only remembered, because later ones refer to them.
    pub is_taken: bool,
    /// What it shows.
    pub scan: SentScan,
    /// Tiles added to its table before it.
    pub new_tiles: Vec<TileIndex>,
    /// Whether its table begins anew before that.
    pub restarts: bool,
}

impl Default for CheckedScan {
    fn default() -> Self {
        let scan =
            SentScan { utc_nanos: 0, seen: Arc::from([]), observed_flips: Vec::new(), occupied_flips: Vec::new() };
        let origin = ScanOrigin::default();
        Self { sequence: 0, content_crc: 0, origin, is_taken: false, scan, new_tiles: Vec::new(), restarts: false }
    }
}

/// Checked scans of one message, or some of them.
#[derive(Debug, Default)]
pub(crate) struct ScanBatch {
    /// First sequence number that is new.
    pub first_sequence: u64,
    /// Last sequence number; less than the first where nothing is new.
    pub last_sequence: u64,
    /// Running CRC up to it.
    pub content_crc: u32,
    /// Tiles added to the client's table before the scans.
    pub new_tiles: Vec<TileIndex>,
    /// The scans, in their order.
    pub scans: Vec<CheckedScan>,
    /// Those of them that are new and refused.
    pub refused: Vec<RefusedObservation>,
    /// Memory that it takes, about.
    pub bytes: usize,
}

/// Checked traversals of one message.
#[derive(Debug, Default)]
pub(crate) struct TraversalBatch {
    /// First sequence number that is new.
    pub first_sequence: u64,
    /// Last sequence number; not less than the first.
    pub last_sequence: u64,
    /// Running CRC up to it.
    pub content_crc: u32,
    /// Those that may be taken, with their sequence numbers. Whether there are such edges is for the map's writer to say.
    pub traversals: Vec<(u64, Traversal)>,
    /// The others.
    pub refused: Vec<RefusedObservation>,
}

/// Room in the buffers of a stream and of all streams, given back when it is dropped.
pub(crate) type BufferBudget = [OwnedSemaphorePermit; 2];

/// What a save has kept, and where its tiles can be read from, where the map has a grid.
pub(crate) type SavedGrid = Option<(Arc<dyn TileSource>, SavedTiles)>;

/// What a writer tells a stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum SessionEvent {
    /// Everything up to the sequence number is durable.
    Ack {
        /// That number.
        durable_sequence: u64,
        /// RefusedObservation since the last one.
        refused: Vec<RefusedObservation>,
    },
    /// The stream ends.
    End(Ending),
}

/// A state to add.
#[derive(Debug)]
pub(crate) struct AddState {
    /// Its name.
    pub name: StateName,
    /// What it is to be.
    pub shape: StateShape,
    /// The answer, when it is durable and shown.
    pub reply: oneshot::Sender<Result<(), AddStateError>>,
}

/// Why a state is not added.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum AddStateError {
    #[error("state {name:?} exists and is a {found}, not a {asked}: the kind of a state never changes", name = .name.as_str(), found = .found.name(), asked = .asked.name())]
    OtherKind { name: StateName, found: StateShape, asked: StateShape },
    #[error("the map has {max} states, as many as setting max_states_per_map allows")]
    TooMany { max: usize },
    #[error(transparent)]
    Storage(#[from] AppendError),
    #[error("the map is closing")]
    Closing,
}

/// A change of what is known of the place.
#[derive(Debug)]
pub(crate) struct EditSite {
    /// What changes.
    pub edit: SiteEdit,
    /// The answer, when it is durable and shown.
    pub reply: oneshot::Sender<Result<(), EditSiteError>>,
}

/// Why the site is not changed.
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
pub(crate) enum Handover {
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
    HandOver {
        /// The stream.
        session: SessionId,
        /// What it hands over.
        what: Handover,
    },
    /// Update the map.
    Update {
        /// Fold in what is older; `None`: all there is.
        until_nanos: Option<i64>,
        /// Why.
        cause: UpdateCause,
        /// The job.
        job: Arc<UpdateJob>,
    },
    /// The committer answers the oldest append that is not answered.
    Committed(Result<u64, AppendError>),
    /// The update that was out is back; `Err` where it failed.
    UpdateDone {
        /// The job.
        job: Arc<UpdateJob>,
        /// What it learned.
        result: Result<Box<UpdateResult>, String>,
    },
    /// The store has, or has not, saved a snapshot.
    Saved(Result<SavedGrid, (String, MapSnapshot)>),
    /// Add a state.
    AddState(AddState),
    /// Change what is known of the place.
    EditSite(EditSite),
    /// Return what is not in the store's history yet.
    ReadHistory(ReadHistory),
    /// Subscribe to what is applied from now on. The answer: a receiver, and the number of observations sent before.
    Watch(oneshot::Sender<(FeedReceiver, u64)>),
    /// End all streams and stop.
    Stop {
        /// What to tell the streams.
        ending: Ending,
        /// Told when everything is done.
        done: oneshot::Sender<()>,
    },
}
