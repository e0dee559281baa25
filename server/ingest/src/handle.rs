//! The handle of a map, for all users except its writer.
//!
//! A map that is being opened has a handle before it has a writer: readers get the view that the index publishes, and
//! commands wait for the writer.
//!
//! Invariant: reading never waits, and the map changes only by commands to its writer.

use std::{
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc,
    },
    time::Duration,
};

use arc_swap::ArcSwap;
use tidemap_base::clock::Clock;
use tidemap_cluster::replica::ReplicaListener;
use tidemap_map::{spec::MapSpec, view::MapView};
use tidemap_store::MapId;
use tokio::sync::{oneshot, watch};

use super::{digests::DigestStatus, ending::Ending, protocol::Command, role::MapRole, tile_totals::TileTotals};

/// The number of the next handle.
static HANDLES: AtomicU64 = AtomicU64::new(1);

/// The progress of opening a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OpenProgress {
    /// The checkpoint is being loaded, or records of the log are being replayed.
    Replay {
        /// Number of replayed records.
        done: u64,
        /// Number of records to replay; 0 while the checkpoint is loaded.
        total: u64,
    },
    /// The map is open.
    Open,
}

/// The position and generation of a view.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Shown {
    /// Log position of the last event in the view.
    pub position: u64,
    /// Number of the generation in the view.
    pub generation: u64,
}

impl Shown {
    /// The position and generation of this view.
    pub(super) fn of(view: &MapView) -> Self {
        Self { position: view.position(), generation: view.generation() }
    }
}

/// The endpoints of a map's writer, which it shares with the handle.
pub struct WriterEndpoints {
    pub(super) view: Arc<ArcSwap<MapView>>,
    pub(super) commands: mpsc::Sender<Command>,
    pub(super) inbox: mpsc::Receiver<Command>,
    pub(super) saturated: watch::Sender<bool>,
    pub(super) tile_bytes: Arc<AtomicU64>,
    /// The progress of the start of the map.
    pub opening: watch::Sender<OpenProgress>,
    /// The role of this daemon for the map.
    pub role: watch::Sender<MapRole>,
    pub(super) digest: watch::Sender<Option<DigestStatus>>,
    pub(super) shown: watch::Sender<Shown>,
}

impl WriterEndpoints {
    /// A listener that passes the events of a replica to the writer. After the writer has stopped, the events are
    /// ignored.
    pub fn replica_listener(&self) -> ReplicaListener {
        let commands = self.commands.clone();
        Arc::new(move |event| drop(commands.send(Command::Replica(event))))
    }
}

/// The handle of a map.
#[derive(Debug)]
pub struct MapHandle {
    /// Number of the map in the store.
    pub id: MapId,
    /// Number of this handle; each handle has a different one.
    pub number: u64,
    /// The fixed properties of the map.
    pub spec: Arc<MapSpec>,
    /// Number of the map in the cluster; `None`: the log belongs to this daemon alone.
    pub shared_uid: Option<u64>,
    view: Arc<ArcSwap<MapView>>,
    clock: Arc<dyn Clock>,
    commands: mpsc::Sender<Command>,
    saturated: watch::Receiver<bool>,
    tile_bytes: Arc<AtomicU64>,
    opening: watch::Receiver<OpenProgress>,
    role: watch::Receiver<MapRole>,
    digest: watch::Receiver<Option<DigestStatus>>,
    shown: watch::Receiver<Shown>,
    /// Whether the map has another handle, and may have other ids of states.
    replaced: AtomicBool,
    // The totals have a lock, because those of a generation are counted once; it is held to copy them, not while
    // counting.
    tile_totals: Mutex<Option<(u64, TileTotals)>>,
}

impl MapHandle {
    /// The handle of a map that shows `view`, and the endpoints of its writer. A map with a number in a cluster counts
    /// as written by another daemon until its replica reports something else.
    pub(crate) fn with_endpoints(
        (id, shared_uid): (MapId, Option<u64>),
        spec: Arc<MapSpec>,
        view: MapView,
        clock: &Arc<dyn Clock>,
    ) -> (Self, WriterEndpoints) {
        let (shown_sender, shown) = watch::channel(Shown::of(&view));
        let view = Arc::new(ArcSwap::from_pointee(view));
        let (commands, inbox) = mpsc::channel();
        let (saturated_sender, saturated) = watch::channel(false);
        let (opening_sender, opening) = watch::channel(OpenProgress::Replay { done: 0, total: 0 });
        let tile_bytes = Arc::new(AtomicU64::new(0));
        let (role_sender, role) = watch::channel(MapRole::at_first(shared_uid.is_some()));
        let (digest_sender, digest) = watch::channel(None);
        let endpoints = WriterEndpoints {
            view: Arc::clone(&view),
            commands: commands.clone(),
            inbox,
            saturated: saturated_sender,
            tile_bytes: Arc::clone(&tile_bytes),
            opening: opening_sender,
            role: role_sender,
            digest: digest_sender,
            shown: shown_sender,
        };
        let tile_totals = Mutex::new(None);
        let number = HANDLES.fetch_add(1, Ordering::Relaxed);
        let replaced = AtomicBool::new(false);
        let clock = Arc::clone(clock);
        let handle = Self {
            id,
            number,
            spec,
            shared_uid,
            view,
            clock,
            commands,
            saturated,
            tile_bytes,
            opening,
            role,
            digest,
            shown,
            replaced,
            tile_totals,
        };
        (handle, endpoints)
    }

    /// Marks this handle as replaced by another one.
    pub fn replace(&self) {
        self.replaced.store(true, Ordering::SeqCst);
    }

    /// Whether another handle has the map. If this returns `false` after a read of the store, the read data belongs to
    /// the view.
    pub fn is_replaced(&self) -> bool {
        self.replaced.load(Ordering::SeqCst)
    }

    /// The progress of opening the map.
    pub fn opening(&self) -> OpenProgress {
        *self.opening.borrow()
    }

    /// Waits until the map is open; `false`: the daemon stops before.
    pub async fn opened(&self) -> bool {
        self.opening.clone().wait_for(|opening| *opening == OpenProgress::Open).await.is_ok()
    }

    /// Memory of the models and sums of tiles, in bytes, approximately.
    pub fn tile_bytes(&self) -> u64 {
        self.tile_bytes.load(Ordering::Relaxed)
    }

    /// The totals of the tiles that the generation in force has learned. Reads tiles that are not in memory once per
    /// generation.
    pub(crate) fn tile_totals(&self) -> TileTotals {
        let view = self.view();
        let known = *self.tile_totals.lock().unwrap_or_else(PoisonError::into_inner);
        match known {
            Some((generation, totals)) if generation == view.generation() => totals,
            _ => {
                let totals = TileTotals::of(&view);
                *self.tile_totals.lock().unwrap_or_else(PoisonError::into_inner) = Some((view.generation(), totals));
                totals
            }
        }
    }

    /// The current view; never waits. For states that report changes, the view has the current value by the clock.
    pub fn view(&self) -> Arc<MapView> {
        let view = self.view.load_full();
        if view.depends_on_now() { Arc::new(view.as_of(self.clock.now_nanos())) } else { view }
    }

    /// The role of this daemon for the map.
    pub fn role(&self) -> MapRole {
        self.role.borrow().clone()
    }

    /// The newest digest of an update here; `None` before the first update, and where the log is not shared.
    pub fn digest(&self) -> Option<DigestStatus> {
        *self.digest.borrow()
    }

    /// A receiver of this daemon's role for the map.
    pub fn watch_role(&self) -> watch::Receiver<MapRole> {
        self.role.clone()
    }

    /// The position and generation of the current view.
    pub fn shown(&self) -> Shown {
        Shown::of(&self.view.load())
    }

    /// Waits until the view reaches a state, for a bounded time; returns whether it does.
    pub async fn shows(&self, reaches: impl Fn(Shown) -> bool, within: Duration) -> bool {
        // The writer may have stopped: then the view stays as it is.
        let _ = tokio::time::timeout(within, self.shown.clone().wait_for(|shown| reaches(*shown))).await;
        reaches(self.shown())
    }

    /// Log position of the last event in the view.
    pub fn position(&self) -> u64 {
        self.view.load().position()
    }

    /// Number of the generation in the view.
    #[cfg(test)]
    pub(crate) fn generation(&self) -> u64 {
        self.view.load().generation()
    }

    /// Sends the writer a command. `false`: the writer has stopped.
    pub fn send(&self, command: Command) -> bool {
        self.commands.send(command).is_ok()
    }

    /// Whether streams should wait, because updates do not keep up.
    pub fn saturated(&self) -> watch::Receiver<bool> {
        self.saturated.clone()
    }

    /// Stops the writer, after all records in flight are acknowledged.
    pub async fn stop(&self, ending: Ending) {
        let (done, stopped) = oneshot::channel();
        if self.send(Command::Stop { ending, done }) {
            // An error means that the writer has already gone.
            let _ = stopped.await;
        }
    }
}
