//! The commands to the writer of a map. Each conversation with it has its file.
//!
//! Invariant: everything is bounded.

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

pub(crate) use batches::{
    CheckedScan, NewName, ObservationBatch, RefusedObservation, ReportBatch, ScanBatch, ScanOrigin,
};
pub(crate) use edits::{AddState, AddStateError, EditSite, EditSiteError, ForgetError, ForgetProducers, NoRoom};
pub(crate) use history::{HistoryTail, PendingExtract, ReadHistory, ReadPending};
pub(crate) use streams::{BufferBudget, Hello, HelloError, SessionEvent, SessionId, StreamData, Welcome};

/// The tiles that a save has stored, and where to read them, if the map has a grid.
pub(crate) type SavedGrid = Option<(Arc<dyn TileSource>, SavedTiles)>;

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
    /// The digest of what an update has made, or why there is none.
    Digested { generation: u64, digest: Result<Digest, String> },
    /// The replica of a log that daemons share tells something.
    Replica(ReplicaEvent),
    /// A save has ended; `Err`: it failed, and gives the snapshot back.
    Saved(Result<SavedGrid, (String, MapSnapshot)>),
    /// Add a state.
    AddState(AddState),
    /// Edit the site.
    EditSite(EditSite),
    /// Let producers give their places up.
    ForgetProducers(ForgetProducers),
    /// Return what is not in the store's history yet.
    ReadHistory(ReadHistory),
    /// Return some of what the next update could learn.
    ReadPending(ReadPending),
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
