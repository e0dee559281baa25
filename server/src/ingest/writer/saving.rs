//! The writer's saves, which follow its updates, and what they let it free.
//!
//! Invariant: a snapshot that is not saved costs nothing but time at the next start; the history that it carries is kept
//! until a save has it, because nothing else gives it once a later snapshot is saved. One save runs at a time.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, atomic::Ordering},
    time::{Duration, Instant},
};

use tidemap_map::{grid::paging::SavedTiles, snapshot::MapSnapshot};
use tracing::{debug, warn};

use super::{
    super::protocol::{Command, SavedGrid},
    SAVE_INTERVAL, Writer,
};

/// A log that has grown by this much since the last checkpoint is not to grow further before the next.
const TAIL_BYTES: u64 = 256 << 20;
/// History that takes this much memory is not to grow further before the next save either.
const HISTORY_BYTES: usize = 64 << 20;
/// While saves fail, streams wait when history takes this much memory.
const HISTORY_MAX_BYTES: usize = 256 << 20;
/// The longest time between saves that fail.
const SAVE_RETRY_MAX: Duration = Duration::from_secs(600);

/// How long after this many failed saves the next is tried.
pub(super) fn retry_pause(failures: u32) -> Duration {
    SAVE_INTERVAL.saturating_mul(1 << failures.saturating_sub(1).min(10)).min(SAVE_RETRY_MAX)
}

impl Writer {
    pub(super) fn is_save_due(&self) -> bool {
        let Some(last) = self.last_save else { return true };
        if self.save_failures > 0 {
            return last.elapsed() >= retry_pause(self.save_failures);
        }
        last.elapsed() >= SAVE_INTERVAL || self.history_bytes >= HISTORY_BYTES || self.log.tail_bytes() >= TAIL_BYTES
    }

    /// Whether history has no room any more, because it cannot be saved.
    pub(super) fn is_history_too_large(&self) -> bool {
        self.save_failures > 0 && self.history_bytes >= HISTORY_MAX_BYTES
    }

    /// Finds out how much memory history takes that is not saved.
    pub(super) fn count_history(&mut self) {
        let pieces = self.unsaved.iter().flat_map(|snapshot| &snapshot.history);
        let pieces = pieces.chain(&self.unsaved_history).chain(&self.saving_history);
        self.history_bytes = pieces.map(|piece| piece.bytes()).sum();
    }

    /// A snapshot is to be saved; history that was not takes its way with it.
    pub(super) fn keep_unsaved(&mut self, mut snapshot: MapSnapshot) {
        self.drop_unsaved();
        snapshot.history.append(&mut self.unsaved_history);
        snapshot.history.sort_by_key(|piece| piece.generation);
        self.unsaved = Some(snapshot);
        self.count_history();
    }

    /// Frees a snapshot that is not saved, but for its history.
    pub(super) fn drop_unsaved(&mut self) {
        if let Some(snapshot) = self.unsaved.take() {
            self.unsaved_history.extend(snapshot.history);
        }
    }

    pub(super) fn save(&mut self) {
        if self.saving {
            return;
        }
        let Some(snapshot) = self.unsaved.take() else { return };
        let history = snapshot.history.clone();
        let (store, id, commands) = (Arc::clone(&self.context.store), self.id, self.commands.clone());
        let spawned = std::thread::Builder::new().name(format!("save-{}", id.0)).spawn(move || {
            let saved = catch_unwind(AssertUnwindSafe(|| store.save(id, &snapshot)));
            let saved = match saved {
                Ok(Ok(source)) => Ok(source.zip(snapshot.grid.as_ref().map(SavedTiles::of))),
                Ok(Err(error)) => Err((error.to_string(), snapshot)),
                Err(_) => Err(("saving panicked; this is a defect of tidemap".to_owned(), snapshot)),
            };
            // Before the answer, which may be what a stop waits for.
            drop(store);
            // At a stop nobody waits: the log gives back what is not saved.
            let _ = commands.send(Command::Saved(saved));
        });
        match spawned {
            Ok(_) => (self.saving, self.saving_history) = (true, history),
            Err(error) => {
                warn!(%error, "no thread to save a checkpoint; the next update tries again");
                self.unsaved_history.extend(history);
            }
        }
    }

    pub(super) fn saved(&mut self, result: Result<SavedGrid, (String, MapSnapshot)>) {
        self.saving = false;
        self.saving_history = Vec::new();
        self.last_save = Some(Instant::now());
        match result {
            Ok(saved) => {
                self.save_failures = 0;
                self.saved_grid = saved;
                self.page_out();
            }
            Err((error, failed)) => {
                self.save_failures = self.save_failures.saturating_add(1);
                warn!(map = %self.map.spec().name, error, "checkpoint not saved; the log keeps everything, tried again");
                match &mut self.unsaved {
                    // A newer one is better, with the history of both.
                    Some(newer) => drop(newer.history.splice(..0, failed.history)),
                    None => self.unsaved = Some(failed),
                }
            }
        }
        self.count_history();
    }

    /// Lets tiles go that the last save has, where those in memory are too large.
    pub(super) fn page_out(&mut self) {
        if self.map.is_updating() {
            return;
        }
        if let Some((source, saved)) = self.saved_grid.take() {
            let gone = self.map.page_out(&source, &saved, self.context.tile_cache_bytes);
            if gone > 0 {
                self.changed = true;
                debug!(map = %self.map.spec().name, tiles = gone, "tiles are read from the checkpoint from now on");
            }
        }
        self.tile_bytes.store(self.map.tile_memory().bytes, Ordering::Relaxed);
    }
}
