//! The writer's saves, which follow its updates, and what they let it free.
//!
//! Invariant: a snapshot that is not saved costs nothing but time at the next start; the history that it carries is kept
//! until a save has it, because nothing else gives it once a later snapshot is saved. One save runs at a time.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, atomic::Ordering},
    time::Instant,
};

use tidemap_map::{grid::paging::SavedTiles, snapshot::MapSnapshot};
use tracing::{debug, warn};

use super::{
    super::protocol::{Command, SavedGrid},
    SAVE_INTERVAL, TAIL_BYTES, Writer,
};

impl Writer {
    pub(super) fn is_save_due(&self) -> bool {
        self.log.tail_bytes() >= TAIL_BYTES || self.last_save.is_none_or(|last| last.elapsed() >= SAVE_INTERVAL)
    }

    /// A snapshot is to be saved; history that was not takes its way with it.
    pub(super) fn keep_unsaved(&mut self, mut snapshot: MapSnapshot) {
        self.drop_unsaved();
        snapshot.history.append(&mut self.unsaved_history);
        snapshot.history.sort_by_key(|piece| piece.generation);
        self.unsaved = Some(snapshot);
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
                self.saved_grid = saved;
                self.page_out();
            }
            Err((error, failed)) => {
                warn!(map = %self.map.spec().name, error, "checkpoint not saved; the log keeps everything, tried again");
                match &mut self.unsaved {
                    // A newer one is better, with the history of both.
                    Some(newer) => drop(newer.history.splice(..0, failed.history)),
                    None => self.unsaved = Some(failed),
                }
            }
        }
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
