//! Logged scans into a grid: what each one changes, and only that.
//!
//! Scans that follow each other, each newer than the one before, and that saw the same tiles are like scans: of them a
//! tile is touched only by those that flip a bit of it.
//!
//! Invariant: while a run of like scans goes on, each of its tiles has shown its `arrival` masks since the run's scan
//! that last flipped them.

use std::{collections::HashSet, sync::Arc};

use tidemap_model::LocalDay;

use super::{
    super::{
        day::ScanTime,
        index::TileId,
        live_tile::{LikeScans, LiveTile},
        mask::TileMasks,
        scan::{CellRef, LoggedScan, Scans},
    },
    AheadScan, LiveGrid, Previous,
};

/// The tiles that a scan flips, and by how many the observed cells of all become more.
#[derive(Default)]
struct Flipped {
    /// Ascending.
    tiles: Vec<TileId>,
    observed: i64,
}

impl LiveGrid {
    /// Checks that an event follows from those before; nothing is changed.
    pub(crate) fn check(&self, event: &Scans) -> Result<(), String> {
        let tiles = self.tiles.len() + event.new_tiles.len();
        if tiles > CellRef::TILES_MAX as usize {
            return Err("there are too many tiles".to_owned());
        }
        let mut new = HashSet::with_capacity(event.new_tiles.len());
        let mut is_new = |index| !self.ids.contains_key(&index) && new.insert(index);
        if event.new_tiles.iter().any(|&index| !index.is_valid() || !is_new(index)) {
            return Err("a tile is not new".to_owned());
        }
        let mut seen: &[TileId] = &self.last_seen;
        for scan in &event.scans {
            if let Some(of_scan) = &scan.seen {
                seen = of_scan;
                if !seen.is_sorted_by(|one, next| one < next) {
                    return Err("the tiles of a scan do not ascend".to_owned());
                }
                if seen.last().is_some_and(|tile| tile.0 as usize >= tiles) {
                    return Err("a tile is unknown".to_owned());
                }
            }
            for flips in [&scan.observed_flips, &scan.occupied_flips] {
                if !flips.is_sorted_by(|one, next| one < next) {
                    return Err("the cells of a scan do not ascend".to_owned());
                }
                let of_tiles = flips.chunk_by(|one, next| one.tile() == next.tile());
                let mut tiles = of_tiles.filter_map(|cells| cells.first()).map(|cell| cell.tile());
                if tiles.any(|tile| seen.binary_search(&tile).is_err()) {
                    return Err("a cell is of a tile that its scan did not see".to_owned());
                }
            }
        }
        Ok(())
    }

    /// Takes in scans that [`LiveGrid::check`] has let pass. Gives the greatest time that did not have to wait.
    pub(crate) fn take_in(&mut self, event: &Scans) -> Option<i64> {
        for &index in &event.new_tiles {
            self.add_tile(Arc::new(LiveTile::new(index)));
        }
        let plausible = event.plausible_nanos();
        let mut newest = None;
        for scan in &event.scans {
            if self.take_in_scan(scan, plausible) {
                newest = newest.max(Some(scan.utc_nanos));
            }
        }
        newest
    }

    fn take_in_scan(&mut self, scan: &LoggedScan, plausible: i64) -> bool {
        if let Some(seen) = &scan.seen {
            self.last_seen = Arc::clone(seen);
        }
        let seen = Arc::clone(&self.last_seen);
        self.scans += 1;
        let flipped = self.flip_arrivals(&scan.observed_flips, &scan.occupied_flips);
        let time = ScanTime { utc_nanos: scan.utc_nanos, offset_secs: scan.offset_secs };
        if scan.utc_nanos > plausible {
            let shown = seen.iter().filter_map(|&tile| Some((tile, self.arrival(tile)?)));
            let tiles: Vec<(TileId, TileMasks)> = shown.collect();
            self.cell_observations += tiles.iter().map(|(_, masks)| u64::from(masks.observed().count())).sum::<u64>();
            self.ahead.push(AheadScan { time, tiles });
            // What its tiles show now has gone into no day, and into no last value.
            self.previous = None;
            self.end_run();
            return false;
        }
        let day = LocalDay::of_civil_nanos(time.civil_nanos());
        let same = self.previous.take().filter(|previous| previous.day == day && Arc::ptr_eq(&previous.seen, &seen));
        let observed = match &same {
            Some(previous) => previous.observed.saturating_add_signed(flipped.observed),
            None => seen.iter().filter_map(|&t| self.arrival(t)).map(|m| u64::from(m.observed().count())).sum(),
        };
        self.cell_observations += observed;
        self.keep(day, time, &seen, same.is_some(), &flipped.tiles);
        self.see(scan.utc_nanos, &seen, &flipped.tiles);
        self.previous = Some(Previous { day, seen, observed });
        true
    }

    /// Brings the arrival masks of flipped tiles up to date.
    fn flip_arrivals(&mut self, observed: &[CellRef], occupied: &[CellRef]) -> Flipped {
        let mut flipped = Flipped::default();
        let (mut observed, mut occupied) = (observed, occupied);
        while let Some(id) = observed.first().into_iter().chain(occupied.first()).map(|cell| cell.tile()).min() {
            let of_tile = |cells: &[CellRef]| cells.iter().take_while(|cell| cell.tile() == id).count();
            let (observed_cells, occupied_cells);
            (observed_cells, observed) = observed.split_at(of_tile(observed));
            (occupied_cells, occupied) = occupied.split_at(of_tile(occupied));
            if let Some(tile) = self.tiles.get_mut(id.0 as usize) {
                let tile = Arc::make_mut(tile);
                let before = tile.arrival;
                let observed = before.observed().flipped(observed_cells.iter().map(|cell| cell.cell()));
                let occupied = before.occupied().flipped(occupied_cells.iter().map(|cell| cell.cell()));
                tile.arrival = TileMasks::clipped(observed, occupied);
                flipped.observed += i64::from(observed.count()) - i64::from(before.observed().count());
            }
            self.touch(id);
            flipped.tiles.push(id);
        }
        flipped
    }

    /// Keeps a scan for the update of its day.
    fn keep(
        &mut self,
        day: LocalDay,
        time: ScanTime,
        seen: &Arc<[TileId]>,
        is_like_previous: bool,
        flipped: &[TileId],
    ) {
        let kept = Self::day_of(&mut self.days, day);
        let (scan, mut changes) = kept.take(time, seen);
        // The other tiles show what they showed in the scan before, which went into this day too.
        for &id in if is_like_previous { flipped } else { seen } {
            if let Some(tile) = self.tiles.get(id.0 as usize) {
                changes += kept.show(scan, id, tile.arrival);
            }
        }
        self.pending_changes += changes;
        self.oldest_pending_nanos = Some(self.oldest_pending_nanos.map_or(time.utc_nanos, |t| t.min(time.utc_nanos)));
    }

    /// Shows a scan to the tiles' last values and persistence.
    fn see(&mut self, utc_nanos: i64, seen: &Arc<[TileId]>, flipped: &[TileId]) {
        let goes_on = self.run_seen.as_ref().is_some_and(|run| Arc::ptr_eq(run, seen));
        if goes_on && utc_nanos > self.run.newest_nanos {
            let run = self.run;
            let next = LikeScans { count: run.count + 1, newest_nanos: utc_nanos };
            for &id in flipped {
                let Some(tile) = self.tiles.get_mut(id.0 as usize) else { continue };
                let tile = Arc::make_mut(tile);
                tile.settle(run);
                tile.observe(utc_nanos, tile.arrival);
                tile.joined = Some(next.count);
            }
            self.run = next;
            return;
        }
        self.end_run();
        let mut all_newer = true;
        for &id in seen.iter() {
            let Some(arrival) = self.arrival(id) else { continue };
            all_newer &= self.show_tile(id, utc_nanos, arrival);
        }
        if all_newer {
            for &id in seen.iter() {
                if let Some(tile) = self.tiles.get_mut(id.0 as usize) {
                    Arc::make_mut(tile).joined = Some(0);
                }
            }
            self.run = LikeScans { count: 0, newest_nanos: utc_nanos };
            self.run_seen = Some(Arc::clone(seen));
        }
    }

    /// Shows what a scan saw of a settled tile to its last values and persistence. Gives whether the scan is newer than
    /// all before that saw the tile.
    pub(super) fn show_tile(&mut self, id: TileId, utc_nanos: i64, masks: TileMasks) -> bool {
        let Some(tile) = self.tiles.get_mut(id.0 as usize) else { return true };
        let is_newer = tile.is_newer(utc_nanos);
        if is_newer {
            Arc::make_mut(tile).observe(utc_nanos, masks);
            self.touch(id);
        } else if !masks.observed().without(tile.current).is_empty() {
            Arc::make_mut(tile).observe_late(utc_nanos, masks);
            self.touch(id);
        }
        is_newer
    }

    /// Ends the run of like scans: its tiles are brought up to date.
    pub(super) fn end_run(&mut self) {
        let Some(seen) = self.run_seen.take() else { return };
        for &id in seen.iter() {
            if let Some(tile) = self.tiles.get_mut(id.0 as usize).filter(|tile| tile.joined.is_some()) {
                let tile = Arc::make_mut(tile);
                tile.settle(self.run);
                tile.joined = None;
                self.touch(id);
            }
        }
        self.run = LikeScans::default();
    }
}
