//! The handle of a map, for everybody except its writer.
//!
//! Invariant: reading never waits, and the map changes only by commands to its writer.

use std::sync::{
    Arc, Mutex, PoisonError,
    atomic::{AtomicU64, Ordering},
    mpsc,
};

use arc_swap::ArcSwap;
use tidemap_map::{spec::MapSpec, view::MapView};
use tidemap_store::MapId;
use tokio::sync::{oneshot, watch};

use super::{ending::Ending, protocol::Command, tile_totals::TileTotals};

/// The handle of a map.
#[derive(Debug)]
pub(crate) struct MapHandle {
    /// Its number in the store.
    pub id: MapId,
    /// Its fixed properties.
    pub spec: Arc<MapSpec>,
    view: Arc<ArcSwap<MapView>>,
    commands: mpsc::Sender<Command>,
    saturated: watch::Receiver<bool>,
    tile_bytes: Arc<AtomicU64>,
    // A lock, because the totals of a generation are counted once; held to copy them, not while counting.
    tile_totals: Mutex<Option<(u64, TileTotals)>>,
}

impl MapHandle {
    /// The handle of a map whose writer publishes to `view`, receives `commands` and sets `saturated` and `tile_bytes`.
    pub(crate) fn new(
        id: MapId,
        spec: Arc<MapSpec>,
        view: Arc<ArcSwap<MapView>>,
        commands: mpsc::Sender<Command>,
        saturated: watch::Receiver<bool>,
        tile_bytes: Arc<AtomicU64>,
    ) -> Self {
        Self { id, spec, view, commands, saturated, tile_bytes, tile_totals: Mutex::new(None) }
    }

    /// Memory of the models and sums of tiles, in bytes, about.
    pub(crate) fn tile_bytes(&self) -> u64 {
        self.tile_bytes.load(Ordering::Relaxed)
    }

    /// What the generation in force has learned of the tiles. Reads tiles that are not in memory once per generation.
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

    /// The current view; never waits.
    pub(crate) fn view(&self) -> Arc<MapView> {
        self.view.load_full()
    }

    /// Sends the writer a command. `false`: the writer has stopped.
    pub(crate) fn send(&self, command: Command) -> bool {
        self.commands.send(command).is_ok()
    }

    /// Whether streams should wait, because updates do not keep up.
    pub(crate) fn saturated(&self) -> watch::Receiver<bool> {
        self.saturated.clone()
    }

    /// Stops the writer, after everything in flight is answered.
    pub(crate) async fn stop(&self, ending: Ending) {
        let (done, stopped) = oneshot::channel();
        if self.send(Command::Stop { ending, done }) {
            // An error means that the writer has already gone.
            let _ = stopped.await;
        }
    }
}
