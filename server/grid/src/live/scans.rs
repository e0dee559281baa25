//! Applies logged scans to a grid. The work follows the changes of each scan.
//!
//! Consecutive scans, each newer than the one before, that saw the same tiles with the same sensor, form a run. A tile
//! of the run is touched only by scans that flip one of its bits.
//!
//! Invariant: during a run, the masks of each of its tiles have been equal to its `arrival` masks since the scan of the
//! run that last flipped one of their bits.

use std::{collections::HashSet, sync::Arc};

use tidemap_model::LocalDay;

use super::{
    super::{
        bins::BIN_NANOS,
        day::ScanTime,
        index::TileId,
        live_tile::{LiveTile, ReadingRule, ScanRun},
        mask::TileMasks,
        scan::{CellRef, LoggedScan, Scans},
        sensors::{ProducerSensor, SensorId},
        snapshot::FutureScan,
        spec::Evidence,
        tile_odds::OddsSteps,
    },
    LiveGrid, Previous,
};

/// The reason why scans cannot follow the earlier scans in the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InvalidScans {
    /// There would be more tiles than can be numbered.
    #[error("there are too many tiles")]
    TooManyTiles,
    /// A tile that is stated to be new already exists, is named twice, or is outside the limits of indices.
    #[error("a tile is not new")]
    TileNotNew,
    /// The tiles that a scan saw are not ascending.
    #[error("the tiles of a scan do not ascend")]
    TilesNotAscending,
    /// A scan saw a tile that has no number.
    #[error("a tile is unknown")]
    UnknownTile,
    /// The cells that a scan flips are not ascending.
    #[error("the cells of a scan do not ascend")]
    CellsNotAscending,
    /// A scan flips a cell of a tile that it did not see.
    #[error("a cell is of a tile that its scan did not see")]
    TileNotSeen,
}

/// The flips of a scan, tile by tile.
struct ScanFlips<'a> {
    observed: &'a [CellRef],
    occupied: &'a [CellRef],
}

impl ScanFlips<'_> {
    /// The next tile with flips.
    fn next_tile(&self) -> Option<TileId> {
        match (self.observed.first(), self.occupied.first()) {
            (Some(one), Some(other)) => Some(one.tile().min(other.tile())),
            (one, other) => one.or(other).map(|cell| cell.tile()),
        }
    }

    /// The masks of the next tile after its flips, and the change in the number of observed cells.
    fn flip(&mut self, tile: TileId, masks: TileMasks) -> (TileMasks, i64) {
        let (mut observed, mut occupied, mut more) = (masks.observed(), masks.occupied(), 0);
        while let Some((cell, rest)) = self.observed.split_first().filter(|(cell, _)| cell.tile() == tile) {
            observed.flip(cell.cell());
            more += if observed.contains(cell.cell()) { 1 } else { -1 };
            self.observed = rest;
        }
        while let Some((cell, rest)) = self.occupied.split_first().filter(|(cell, _)| cell.tile() == tile) {
            occupied.flip(cell.cell());
            self.occupied = rest;
        }
        (TileMasks::clipped(observed, occupied), more)
    }
}

/// Whether a tile is among ascending tiles. Found in one step if no tile number is left out.
fn is_among(seen: &[TileId], tile: TileId) -> bool {
    let place = seen.first().map_or(0, |first| tile.0.wrapping_sub(first.0) as usize);
    seen.get(place) == Some(&tile) || seen.binary_search(&tile).is_ok()
}

impl LiveGrid {
    /// Checks that scans are consistent with the earlier scans; changes nothing.
    ///
    /// # Errors
    /// [`InvalidScans`], if they cannot follow in the log.
    pub fn check(&self, event: &Scans) -> Result<(), InvalidScans> {
        let tiles = self.tiles.len() + event.new_tiles.len();
        if tiles > CellRef::TILES_MAX as usize {
            return Err(InvalidScans::TooManyTiles);
        }
        let mut new = HashSet::with_capacity(event.new_tiles.len());
        let mut is_new = |index| !self.ids.contains_key(&index) && new.insert(index);
        if event.new_tiles.iter().any(|&index| !index.is_valid() || !is_new(index)) {
            return Err(InvalidScans::TileNotNew);
        }
        let mut seen: &[TileId] = &self.last_seen;
        for scan in &event.scans {
            if let Some(of_scan) = &scan.seen {
                seen = of_scan;
                if !seen.is_sorted_by(|one, next| one < next) {
                    return Err(InvalidScans::TilesNotAscending);
                }
                if seen.last().is_some_and(|tile| tile.0 as usize >= tiles) {
                    return Err(InvalidScans::UnknownTile);
                }
            }
            for flips in [&scan.observed_flips, &scan.occupied_flips] {
                if !flips.is_sorted_by(|one, next| one < next) {
                    return Err(InvalidScans::CellsNotAscending);
                }
                let of_tiles = flips.chunk_by(|one, next| one.tile() == next.tile());
                let mut tiles = of_tiles.filter_map(|cells| cells.first()).map(|cell| cell.tile());
                if tiles.any(|tile| !is_among(seen, tile)) {
                    return Err(InvalidScans::TileNotSeen);
                }
            }
        }
        Ok(())
    }

    /// Applies scans that [`LiveGrid::check`] has accepted, made with this sensor. Scans later than `plausible_nanos`
    /// wait. Returns the latest time of the scans that do not wait.
    pub fn apply(&mut self, event: &Scans, sensor: Option<ProducerSensor>, plausible_nanos: i64) -> Option<i64> {
        let sensor = self.sensors.find(sensor).unwrap_or_default();
        for &index in &event.new_tiles {
            self.add_tile(Arc::new(LiveTile::new(index)));
        }
        self.shown = self.shown.union(&event.shown);
        let mut newest = None;
        for scan in &event.scans {
            if self.take_in_scan(scan, sensor, plausible_nanos) {
                newest = newest.max(Some(scan.utc_nanos));
            }
        }
        newest
    }

    fn take_in_scan(&mut self, scan: &LoggedScan, sensor: SensorId, plausible_nanos: i64) -> bool {
        if let Some(seen) = &scan.seen {
            self.last_seen = Arc::clone(seen);
        }
        let seen = Arc::clone(&self.last_seen);
        self.scans += 1;
        let LoggedScan { utc_nanos, offset_secs, source, .. } = *scan;
        let time = ScanTime { utc_nanos, offset_secs, sensor, source };
        let flips = ScanFlips { observed: &scan.observed_flips, occupied: &scan.occupied_flips };
        if scan.utc_nanos > plausible_nanos {
            self.flip_arrivals(flips);
            let shown = seen.iter().filter_map(|&tile| Some((tile, self.arrival(tile)?)));
            let tiles: Vec<(TileId, TileMasks)> = shown.collect();
            self.cell_observations += tiles.iter().map(|(_, masks)| u64::from(masks.observed().count())).sum::<u64>();
            self.future_tiles += tiles.len() as u64;
            self.future.push(FutureScan { time, tiles });
            // The current masks of the tiles of a scan that waits are in no day and in no last value.
            self.previous = None;
            self.end_run();
            return false;
        }
        let day = LocalDay::of_civil_nanos(time.civil_nanos());
        let same = self.previous.take().filter(|previous| previous.day == day && Arc::ptr_eq(&previous.seen, &seen));
        let is_run = self.run_seen.as_ref().is_some_and(|run| Arc::ptr_eq(run, &seen));
        let newest_nanos = self.run.newest_nanos;
        let follows = scan.utc_nanos > newest_nanos && scan.utc_nanos.saturating_sub(newest_nanos) <= BIN_NANOS;
        let goes_on = is_run && follows && self.run_origin == (sensor, source);
        let observed = match same {
            Some(previous) if goes_on => {
                previous.observed.saturating_add_signed(self.take_in_like(day, time, &seen, flips))
            }
            _ => {
                self.flip_arrivals(flips);
                self.take_in_all(day, time, &seen);
                seen.iter().filter_map(|&t| self.arrival(t)).map(|m| u64::from(m.observed().count())).sum()
            }
        };
        self.cell_observations += observed;
        self.oldest_pending_nanos = Some(self.oldest_pending_nanos.map_or(time.utc_nanos, |t| t.min(time.utc_nanos)));
        self.previous = Some(Previous { day, seen, observed });
        true
    }

    /// Applies the flips to the arrival masks.
    fn flip_arrivals(&mut self, mut flips: ScanFlips<'_>) {
        while let Some(id) = flips.next_tile() {
            let arrival = self.arrival(id).unwrap_or_default();
            let (masks, _) = flips.flip(id, arrival);
            if let Some(tile) = self.tiles.get_mut(id.0 as usize) {
                Arc::make_mut(tile).arrival = masks;
            }
            self.touch(id);
        }
    }

    /// Applies a scan of the same day, newer than the scan before and with the same tiles: tiles without flips have the
    /// same masks as in the scan before. Returns the change in the number of observed cells.
    fn take_in_like(&mut self, day: LocalDay, time: ScanTime, seen: &Arc<[TileId]>, mut flips: ScanFlips<'_>) -> i64 {
        let run = self.run;
        let next = ScanRun { count: run.count + 1, newest_nanos: time.utc_nanos, ..run };
        let readings = ReadingRule { sensors: &self.sensors, steps: run.steps };
        let kept = Self::day_of(&mut self.days, day);
        let (scan, mut changes) = kept.take(time, seen);
        let mut more_observed = 0;
        let unsettled = std::mem::take(&mut self.unsettled);
        let mut unsettled = unsettled.into_iter().peekable();
        while let Some(id) = flips.next_tile().into_iter().chain(unsettled.peek().copied()).min() {
            unsettled.next_if_eq(&id);
            let Some(tile) = self.tiles.get_mut(id.0 as usize) else { break };
            let tile = Arc::make_mut(tile);
            tile.settle(run);
            if flips.next_tile() == Some(id) {
                let (masks, more) = flips.flip(id, tile.arrival);
                tile.arrival = masks;
                more_observed += more;
                changes += kept.show(scan, id, masks);
            }
            if !tile.observe(time, tile.arrival, readings) {
                self.unsettled.push(id);
            }
            tile.joined = Some(next.count);
            Self::note_touch(&mut self.dirty, id);
        }
        self.pending_changes += changes;
        self.run = next;
        more_observed
    }

    /// Applies any scan: the arrival masks of each of its tiles go to the day, to last values and to persistence.
    fn take_in_all(&mut self, day: LocalDay, time: ScanTime, seen: &Arc<[TileId]>) {
        self.end_run();
        let (scan, mut changes) = Self::day_of(&mut self.days, day).take(time, seen);
        let mut all_newer = true;
        for &id in seen.iter() {
            let Some(arrival) = self.arrival(id) else { continue };
            changes += Self::day_of(&mut self.days, day).show(scan, id, arrival);
            all_newer &= self.show_tile(id, time, arrival);
        }
        self.pending_changes += changes;
        if all_newer {
            for &id in seen.iter() {
                if let Some(tile) = self.tiles.get_mut(id.0 as usize) {
                    Arc::make_mut(tile).joined = Some(0);
                }
            }
            self.run = ScanRun { count: 0, newest_nanos: time.utc_nanos, steps: self.steps(time) };
            (self.run_seen, self.run_origin) = (Some(Arc::clone(seen)), (time.sensor, time.source));
        }
    }

    /// Applies the masks of a settled tile in a scan to the tile's last values and persistence. Returns whether the
    /// scan is newer than all earlier scans of the tile.
    pub(super) fn show_tile(&mut self, id: TileId, time: ScanTime, masks: TileMasks) -> bool {
        let readings = ReadingRule { sensors: &self.sensors, steps: self.steps(time) };
        let Some(tile) = self.tiles.get_mut(id.0 as usize) else { return true };
        let is_newer = tile.is_newer(time.utc_nanos);
        if is_newer {
            if !Arc::make_mut(tile).observe(time, masks, readings) {
                self.unsettled.push(id);
            }
            self.touch(id);
        } else if !masks.observed().without(tile.current).is_empty() {
            Arc::make_mut(tile).observe_late(time, masks, readings);
            self.touch(id);
        }
        is_newer
    }

    /// The steps that readings of a scan add to the newest evidence.
    fn steps(&self, time: ScanTime) -> Option<OddsSteps> {
        let odds = || OddsSteps::new(time.source, self.sensors.odds(time.sensor, time.source));
        (self.spec.evidence == Evidence::Bins).then(odds)
    }

    /// Ends the run and brings its tiles up to date.
    pub(super) fn end_run(&mut self) {
        self.unsettled.clear();
        let Some(seen) = self.run_seen.take() else { return };
        for &id in seen.iter() {
            if let Some(tile) = self.tiles.get_mut(id.0 as usize).filter(|tile| tile.joined.is_some()) {
                let tile = Arc::make_mut(tile);
                tile.settle(self.run);
                tile.joined = None;
                self.touch(id);
            }
        }
        self.run = ScanRun::default();
    }
}
