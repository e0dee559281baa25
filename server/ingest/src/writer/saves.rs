//! Saves of the map, which follow its updates, and the history that no save has kept yet.
//!
//! Invariant: a snapshot that is not saved costs only time at the next start, because the log has all its data. The
//! history of the snapshot is kept until a save has stored it: after a later snapshot is saved, nothing else has this
//! history. One save runs at a time.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use tidemap_base::telemetry::traces::Span;
use tidemap_grid::paging::SavedTiles;
use tidemap_map::{history::HistoryPiece, live_map::LiveMap, name::MapName, snapshot::MapSnapshot};
use tracing::{debug, warn};

use super::Writer;
use crate::protocol::{Command, HistoryTail, PendingExtract, ReadHistory, ReadPending, SavedGrid};

#[cfg(test)]
mod tests;

/// Least time between two saves of updates in the time of imported data. These updates follow each other fast; they are
/// not saved each time, because the log has them.
const SAVE_INTERVAL: Duration = Duration::from_secs(20);
/// Growth of the log since the last checkpoint at which a save is due.
const TAIL_BYTES: u64 = 256 << 20;
/// Memory of unsaved history at which a save is due.
const HISTORY_BYTES: usize = 64 << 20;
/// Memory of unsaved history at which streams wait while saves fail.
const HISTORY_BYTES_MAX: usize = 256 << 20;
/// The longest pause between saves that fail.
const SAVE_RETRY_MAX: Duration = Duration::from_secs(600);

/// The pause before the next save after this many failed saves.
fn retry_pause(failures: u32) -> Duration {
    SAVE_INTERVAL.saturating_mul(1 << failures.saturating_sub(1).min(10)).min(SAVE_RETRY_MAX)
}

/// The saved and unsaved data, and the time at which the next save is due.
pub(super) struct Saves {
    /// The newest unsaved snapshot, with the unsaved history of all earlier ones.
    unsaved: Option<MapSnapshot>,
    /// History of snapshots that were dropped before they were saved; the next snapshot carries it.
    unsaved_history: Vec<Arc<HistoryPiece>>,
    /// History that the running save stores.
    saving_history: Vec<Arc<HistoryPiece>>,
    /// The last save, if an update had the tiles when the save ended.
    saved_grid: SavedGrid,
    /// Memory of the history that no save has stored, approximately.
    history_bytes: usize,
    is_saving: bool,
    last_save: Option<Instant>,
    /// Saves that have failed since the last successful one.
    failures: u32,
    /// Memory of the models and sums of tiles, published to readers.
    tile_bytes: Arc<AtomicU64>,
}

impl Saves {
    /// `unsaved`: the unsaved result of an update that was run during the start.
    pub(super) fn new(unsaved: Option<MapSnapshot>, tile_bytes: Arc<AtomicU64>) -> Self {
        let mut saves = Self {
            unsaved,
            unsaved_history: Vec::new(),
            saving_history: Vec::new(),
            saved_grid: None,
            history_bytes: 0,
            is_saving: false,
            last_save: None,
            failures: 0,
            tile_bytes,
        };
        saves.count_history();
        saves
    }

    /// Whether a snapshot should be saved at `now`, with `tail_bytes` of log since the last checkpoint.
    pub(super) fn is_due(&self, now: Instant, tail_bytes: u64) -> bool {
        let Some(last) = self.last_save else { return true };
        let elapsed = now.saturating_duration_since(last);
        if self.failures > 0 {
            return elapsed >= retry_pause(self.failures);
        }
        elapsed >= SAVE_INTERVAL || self.history_bytes >= HISTORY_BYTES || tail_bytes >= TAIL_BYTES
    }

    pub(super) fn is_saving(&self) -> bool {
        self.is_saving
    }

    pub(super) fn has_unsaved(&self) -> bool {
        self.unsaved.is_some()
    }

    pub(super) fn has_failed(&self) -> bool {
        self.failures > 0
    }

    /// Whether there is no room for more history, because it cannot be saved.
    pub(super) fn is_history_too_large(&self) -> bool {
        self.failures > 0 && self.history_bytes >= HISTORY_BYTES_MAX
    }

    /// All history that no save has stored.
    pub(super) fn history(&self) -> impl Iterator<Item = &Arc<HistoryPiece>> {
        let pieces = self.unsaved.iter().flat_map(|snapshot| &snapshot.history);
        pieces.chain(&self.unsaved_history).chain(&self.saving_history)
    }

    fn count_history(&mut self) {
        self.history_bytes = self.history().map(|piece| piece.bytes()).sum();
    }

    /// Takes a new snapshot, which replaces an unsaved one and carries its history.
    pub(super) fn push(&mut self, mut snapshot: MapSnapshot) {
        self.drop_unsaved();
        snapshot.history.append(&mut self.unsaved_history);
        snapshot.history.sort_by_key(|piece| piece.generation);
        self.unsaved = Some(snapshot);
        self.count_history();
    }

    /// Frees the unsaved snapshot, but not its history.
    pub(super) fn drop_unsaved(&mut self) {
        if let Some(snapshot) = self.unsaved.take() {
            self.unsaved_history.extend(snapshot.history);
        }
    }

    /// The unsaved snapshot, for the last save.
    pub(super) fn take_unsaved(&mut self) -> Option<MapSnapshot> {
        self.unsaved.take()
    }

    /// Begins a save, unless one is running; returns the snapshot to save.
    fn begin(&mut self) -> Option<MapSnapshot> {
        if self.is_saving {
            return None;
        }
        let snapshot = self.unsaved.take()?;
        self.is_saving = true;
        self.saving_history = snapshot.history.clone();
        Some(snapshot)
    }

    /// The save could not begin, and its snapshot is gone.
    fn cancel(&mut self) {
        self.is_saving = false;
        self.unsaved_history.append(&mut self.saving_history);
    }

    /// The save has ended at `now`; `Err`: it failed, and returns the snapshot.
    fn end(&mut self, now: Instant, result: Result<SavedGrid, MapSnapshot>) {
        self.is_saving = false;
        self.saving_history = Vec::new();
        self.last_save = Some(now);
        match result {
            Ok(saved) => {
                self.failures = 0;
                self.saved_grid = saved;
            }
            Err(failed) => {
                self.failures = self.failures.saturating_add(1);
                match &mut self.unsaved {
                    // The newer snapshot is better, with the history of both.
                    Some(newer) => drop(newer.history.splice(..0, failed.history)),
                    None => self.unsaved = Some(failed),
                }
            }
        }
        self.count_history();
    }

    /// Frees tiles that the last save has stored, if the tiles in memory exceed `bytes_max`; returns how many. While an
    /// update has the tiles, nothing is freed: the save is remembered.
    fn page_out(&mut self, map: &mut LiveMap, bytes_max: u64) -> usize {
        if map.is_updating() {
            return 0;
        }
        let freed = self.saved_grid.take().map_or(0, |(source, saved)| map.page_out(&source, &saved, bytes_max));
        self.tile_bytes.store(map.tile_memory().bytes, Ordering::Relaxed);
        freed
    }
}

/// The span of a save, which begins now.
pub(super) fn checkpoint_span(map: &MapName, snapshot: &MapSnapshot) -> Span {
    let span = Span::root("checkpoint");
    span.text("tidemap.map", map);
    span.number("tidemap.generation", snapshot.generation);
    span
}

impl Writer {
    /// Whether the newest snapshot should be saved.
    pub(super) fn is_save_due(&self) -> bool {
        self.saves.is_due(Instant::now(), self.log.tail_bytes())
    }

    /// Starts a save in a thread of its own, unless one is running or there is nothing to save.
    pub(super) fn save(&mut self) {
        let Some(snapshot) = self.saves.begin() else { return };
        let (store, id, commands) = (Arc::clone(&self.context.store), self.id, self.commands.clone());
        let span = checkpoint_span(&self.map.spec().name, &snapshot);
        let spawned = std::thread::Builder::new().name(format!("save-{}", id.0)).spawn(move || {
            let saved = catch_unwind(AssertUnwindSafe(|| store.save(id, &snapshot)));
            let saved = match saved {
                Ok(Ok(source)) => Ok(source.zip(snapshot.grid.as_ref().map(SavedTiles::of))),
                Ok(Err(error)) => Err((error.to_string(), snapshot)),
                Err(_) => Err(("saving panicked; this is a defect of tidemap".to_owned(), snapshot)),
            };
            if saved.is_err() {
                span.fail("not saved: the log has the reason");
            }
            span.end();
            // The store is released before the message, because a stop may be waiting for it.
            drop(store);
            // During a stop nobody waits: the log has the unsaved data.
            let _ = commands.send(Command::Saved(saved));
        });
        if let Err(error) = spawned {
            warn!(%error, "no thread to save a checkpoint; the next update tries again");
            self.saves.cancel();
        }
    }

    pub(super) fn saved(&mut self, result: Result<SavedGrid, (String, MapSnapshot)>) {
        let result = result.map_err(|(error, snapshot)| {
            metrics::counter!("tidemap_save_failures_total").increment(1);
            warn!(map = %self.map.spec().name, error, "checkpoint not saved: the log has everything, and the save is retried");
            snapshot
        });
        let is_saved = result.is_ok();
        self.saves.end(Instant::now(), result);
        if is_saved {
            self.page_out();
        }
    }

    pub(super) fn page_out(&mut self) {
        let tiles = self.saves.page_out(&mut self.map, self.context.tile_cache_bytes);
        if tiles > 0 {
            self.changed = true;
            debug!(map = %self.map.spec().name, tiles, "tiles are read from the checkpoint from now on");
        }
    }

    /// Replies with all acknowledged observations that are not in the generations of the store before `stored_before`,
    /// each once. A request for observations that a running update has waits for its end.
    pub(super) fn read_history(&mut self, read: ReadHistory) {
        if read.reply.is_closed() {
            return;
        }
        if self.updates.has_times(read.from_nanos, read.to_nanos) {
            return self.backlog.wait_history_read(read);
        }
        let unsaved: Vec<Arc<HistoryPiece>> = self.saves.history().map(Arc::clone).collect();
        // Later generations are in the pending observations.
        let next = self.map.generation() + 1;
        let tail = HistoryTail {
            pending: self.map.pending_readings(read.subject, read.from_nanos, read.to_nanos, read.at_most),
            stored_before: unsaved.iter().map(|piece| piece.generation).fold(next, u64::min),
            unsaved,
            newest_nanos: self.map.newest_nanos(),
        };
        // The client may have gone away.
        let _ = read.reply.send(tail);
    }
    /// Replies with an extract of the data that the next update could learn. If the client has gone, no work is done.
    pub(super) fn read_pending(&self, read: ReadPending) {
        if read.reply.is_closed() {
            return;
        }
        let states = self.map.pending_extract(read.states_max, read.readings_max);
        let _ = read.reply.send(PendingExtract { generation: self.map.generation(), states });
    }
}
