//! The commands to the writer of a map. Each group of commands has its own file.
//!
//! Invariant: all queues and messages are bounded.

use std::sync::Arc;

use tidemap_cluster::replica::ReplicaEvent;
use tidemap_grid::{paging::SavedTiles, tile::TileSource};
use tidemap_map::{
    event::{Digest, UpdateCause},
    ids::ProducerId,
    snapshot::{MapSnapshot, ProducerMark},
    update::UpdateResult,
};
use tidemap_store::AppendError;
use tokio::sync::oneshot;

use super::{
    anomaly_feed::{CellFeed, FeedReceiver},
    ending::Ending,
};
use crate::jobs::UpdateJob;

mod batches;
mod edits;
mod history;
mod streams;

pub use batches::{CheckedScan, NewName, ObservationBatch, RefusedObservation, ReportBatch, ScanBatch, ScanOrigin};
pub use edits::{AddState, AddStateError, EditSite, EditSiteError, ForgetError, ForgetProducers, NoRoom};
pub use history::{HistoryTail, PendingExtract, ReadHistory, ReadPending};
pub use streams::{BufferBudget, Hello, HelloError, SessionEvent, SessionId, StreamData, Welcome};

/// The tiles that a save has stored, and the source to read them from, if the map has a grid.
pub(crate) type SavedGrid = Option<(Arc<dyn TileSource>, SavedTiles)>;

/// A producer of a map.
#[derive(Clone, Debug)]
pub struct KnownProducer {
    /// Number of the producer within the map.
    pub id: ProducerId,
    /// The sequence number up to which the producer's observations are durable.
    pub mark: ProducerMark,
    /// Whether the producer has an open stream.
    pub is_connected: bool,
}

/// A command to a writer.
#[derive(Debug)]
pub enum Command {
    /// Open a stream.
    Hello(Hello),
    /// Take the data that a stream hands over.
    StreamData {
        /// The session of the stream.
        session: SessionId,
        /// The data.
        data: StreamData,
    },
    /// Update the map.
    Update {
        /// Learn observations before this time; `None`: all.
        until_nanos: Option<i64>,
        /// The cause of the update.
        cause: UpdateCause,
        /// The job that shows the progress.
        job: Arc<UpdateJob>,
    },
    /// The committer has completed the oldest append.
    Committed(Result<u64, AppendError>),
    /// The running update has ended; `Err`: it failed.
    UpdateDone {
        /// The job of the update.
        job: Arc<UpdateJob>,
        /// The result.
        result: Result<Box<UpdateResult>, String>,
    },
    /// The digest of an update's result, or the reason why there is none.
    Digested {
        /// Number of the generation.
        generation: u64,
        /// The digest.
        digest: Result<Digest, String>,
    },
    /// An event from the replica of a shared log.
    Replica(ReplicaEvent),
    /// A save has ended; `Err`: it failed, and returns the snapshot.
    Saved(Result<SavedGrid, (String, MapSnapshot)>),
    /// Add a state.
    AddState(AddState),
    /// Edit the site.
    EditSite(EditSite),
    /// Let producers give their places up.
    ForgetProducers(ForgetProducers),
    /// Return the observations that are not in the store's history yet.
    ReadHistory(ReadHistory),
    /// Return an extract of the data that the next update could learn.
    ReadPending(ReadPending),
    /// Return the producers.
    ListProducers(oneshot::Sender<Vec<KnownProducer>>),
    /// Subscribe to observations that are applied from now on. The reply: a receiver, and the number of observations
    /// sent before.
    Watch(oneshot::Sender<(FeedReceiver, u64)>),
    /// Subscribe to scans that are applied from now on.
    WatchCells(oneshot::Sender<CellFeed>),
    /// End all streams and stop.
    Stop {
        /// The reason that the streams receive.
        ending: Ending,
        /// Notified when the writer has stopped.
        done: oneshot::Sender<()>,
    },
}
