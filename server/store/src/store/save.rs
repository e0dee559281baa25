//! Saving a map: its history, a checkpoint, what it publishes in the index; then everything that these replace is
//! deleted.
//!
//! Invariant: at every moment the kept checkpoints, the log after the oldest of them and the history files restore the
//! map with all observations that its retention keeps. The newest segment of a log is never deleted.

use std::{
    path::Path,
    sync::{Arc, PoisonError},
};

use tidemap_grid::tile::TileSource;
use tidemap_map::snapshot::MapSnapshot;

use super::{MapEntry, OpenStore, Store};
use crate::{
    MapId,
    error::StoreError,
    folders,
    log::{Log, segment_path, segment_position, writer::LogWriter},
};

impl Store {
    /// Writes the history of the observations that the snapshot's updates have learned, then a checkpoint, and what it
    /// publishes to the index. Durable when this returns. Appends continue meanwhile. Files that are no longer
    /// needed are deleted: old checkpoints, history beyond the map's retention, and the log's segments that every kept
    /// checkpoint covers.
    ///
    /// For a map with a grid, returns the tiles of the checkpoint, so that they need not stay in memory.
    ///
    /// # Errors
    /// [`StoreError`]; earlier saves are still valid. A failing index is not an error: it is logged
    /// and rebuilt at the next start. A file that cannot be deleted is not an error either; the next save tries again.
    pub fn save(&self, map: MapId, snapshot: &MapSnapshot) -> Result<Option<Arc<dyn TileSource>>, StoreError> {
        let saved = self.save_now(map, snapshot);
        let failure = saved.as_ref().err().map(ToString::to_string);
        self.inner.committer.watch.saved(map, failure);
        saved
    }

    fn save_now(&self, map: MapId, snapshot: &MapSnapshot) -> Result<Option<Arc<dyn TileSource>>, StoreError> {
        let inner = &*self.inner;
        if let Some(error) = inner.committer.check_lock() {
            return Err(StoreError::Io { file: inner.directory.clone(), source: std::io::Error::other(error) });
        }
        let entry = inner.maps().entries.get(&map).cloned().ok_or(StoreError::UnknownMap(map))?;
        let _busy = entry.busy.lock().unwrap_or_else(PoisonError::into_inner);
        if !inner.maps().entries.contains_key(&map) {
            return Err(StoreError::UnknownMap(map));
        }
        inner.history(map).save(&entry.spec, &snapshot.history)?;
        let (places, tiles) = inner.checkpoints(map).save(&entry.spec, snapshot, inner.options.checkpoints_kept)?;
        places.follow(&snapshot.states, inner.options.spectrum_cache_bytes);
        if let Some(log) = &entry.log {
            log.cover(snapshot.position);
        }
        let mut index = inner.index();
        index.save(map.0, snapshot);
        inner.committer.watch.indexed(index.failure());
        drop(index);
        inner.forget(map, &entry, snapshot);
        inner.forget_missing(map);
        Ok(tiles.map(|tiles| tiles as Arc<dyn TileSource>))
    }
}

impl OpenStore {
    /// Deletes files that are no longer needed.
    fn forget(&self, map: MapId, entry: &MapEntry, snapshot: &MapSnapshot) {
        // An import may be far later than the learned observations, and models of those days need the days before them.
        let learned_nanos = snapshot.newest_nanos.min(snapshot.cut_nanos);
        if let Err(error) = self.history(map).forget(&entry.spec, learned_nanos) {
            tracing::warn!(map = map.0, %error, "old history is not deleted; tried again at the next save");
        }
        if let Some(log) = &entry.log
            && let Err(error) = self.delete_segments(map, log)
        {
            tracing::warn!(map = map.0, %error, "old segments are not deleted; tried again at the next save");
        }
    }

    /// Deletes the segments that no kept checkpoint needs. While there are fewer checkpoints than
    /// are kept, no segment is deleted.
    fn delete_segments(&self, map: MapId, log: &Log) -> std::io::Result<()> {
        let Some(replay_from) = self.checkpoints(map).replay_from(self.options.checkpoints_kept.max(1))? else {
            return Ok(());
        };
        let folder = folders::log_folder(&self.directory, map);
        // A newer segment may already have a name and still be lost in a power cut.
        let newest = log.writer.lock().unwrap_or_else(PoisonError::into_inner).as_ref().map_or(0, LogWriter::segment);
        let deletable = self.deletable(&folder, replay_from.min(newest))?;
        // This also runs where nothing is deleted: a segment may have been missing that is needed no longer.
        let segments = self.disk.list(&folder)?;
        let mut segments = segments.iter().filter_map(|name| segment_position(name));
        if let Some(first) = segments.find(|first| !deletable.contains(first)) {
            self.checkpoints(map).begin_log(first).map_err(std::io::Error::other)?;
        }
        // The oldest first, so that the remaining segments never have a gap.
        for &first in &deletable {
            self.disk.remove(&segment_path(&folder, first))?;
        }
        if deletable.is_empty() { Ok(()) } else { self.disk.sync_folder(&folder) }
    }

    /// Withdraws the reports of missing checkpoints and segments that need not exist any more.
    fn forget_missing(&self, map: MapId) {
        let checkpoints = self.checkpoints(map);
        let Ok(list) = checkpoints.listed() else { return };
        let within = |folder: &Path| folder.strip_prefix(&self.directory).unwrap_or(folder).to_owned();
        let [folder, log] = [&checkpoints.folder, &folders::log_folder(&self.directory, map)].map(|path| within(path));
        let kept: Vec<_> = list.checkpoints.iter().map(|&position| within(&checkpoints.path(position))).collect();
        self.committer.watch.forget(|file| {
            let segment = file.file_name().and_then(|name| segment_position(name.to_str()?));
            file.starts_with(&folder) && !kept.iter().any(|kept| kept == file)
                || file.starts_with(&log) && segment.is_some_and(|first| first < list.first_record)
        });
    }

    /// Segments that end before a position.
    fn deletable(&self, folder: &Path, before: u64) -> std::io::Result<Vec<u64>> {
        let segments: Vec<u64> = self.disk.list(folder)?.iter().filter_map(|name| segment_position(name)).collect();
        let ends = segments.iter().skip(1);
        Ok(segments.iter().zip(ends).filter(|&(_, &next)| next <= before).map(|(&first, _)| first).collect())
    }
}

/// Access for tests.
#[cfg(test)]
mod tests_only {
    use tidemap_map::{snapshot::MapSnapshot, spec::MapSpec};

    use crate::{MapId, Store, checkpoint::Memory};

    impl Store {
        /// The newest good checkpoint, and how many damaged ones are newer.
        pub(crate) fn newest_checkpoint(
            &self,
            map: MapId,
            spec: &MapSpec,
            tile_bytes: u64,
        ) -> (Option<MapSnapshot>, usize) {
            let (found, damaged) =
                self.inner.checkpoints(map).load(spec, Memory { tile_bytes, spectrum_bytes: 0 }).expect("listed");
            (found, damaged.len())
        }
    }
}
