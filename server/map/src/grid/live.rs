//! The grid of a map as its single writer holds it: logged scans go in.
//!
//! Invariant: the state is a function of the scans applied and their order. What a scan costs follows what it changes,
//! and the tiles where what is seen changes.

use std::{collections::HashMap, sync::Arc};

use tidemap_model::{LocalDay, OrderCriterion, Periodicities};

use super::{
    day::{GridDay, ScanTime},
    generation::Generation,
    index::{TileId, TileIndex},
    live_tile::{LikeScans, LiveTile},
    mask::TileMasks,
    scan::{CellRef, LoggedScan, Scans},
    snapshot::GridSnapshot,
    spec::GridSpec,
    tile::SumsSlot,
    update::{GridWork, Rules},
};

#[cfg(test)]
mod tests;

/// Tiles are copied on publication in pieces of this many.
pub(crate) const TILE_CHUNK: usize = 64;

/// A chunk of tiles, shared with readers.
pub(crate) type TileChunk = Arc<Vec<Arc<LiveTile>>>;

/// A scan that waits because its time is too far ahead.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AheadScan {
    /// When it was made.
    pub time: ScanTime,
    /// What it showed.
    pub tiles: Vec<(TileId, TileMasks)>,
}

/// The scan before, and what unchanged tiles need not be asked again.
#[derive(Clone, Debug)]
struct Previous {
    day: LocalDay,
    seen: Arc<[TileId]>,
    /// Cells that it observed.
    observed: u64,
}

/// The grid at an update's log position, but for what the update learns.
#[derive(Debug)]
pub(crate) struct GridBasis {
    tiles: Vec<Arc<LiveTile>>,
    last_seen: Arc<[TileId]>,
    days: Vec<GridDay>,
    ahead: Vec<AheadScan>,
    scans: u64,
    cell_observations: u64,
}

/// The grid as its writer holds it.
#[derive(Debug)]
pub struct LiveGrid {
    pub(crate) spec: Arc<GridSpec>,
    pub(crate) tiles: Vec<Arc<LiveTile>>,
    pub(crate) ids: Arc<HashMap<TileIndex, TileId>>,
    /// The tiles of the last scan in the log.
    pub(crate) last_seen: Arc<[TileId]>,
    previous: Option<Previous>,
    pub(crate) run: LikeScans,
    run_seen: Option<Arc<[TileId]>>,
    /// Scans that no update has folded in, by local day.
    pub(crate) days: Vec<GridDay>,
    pub(crate) ahead: Vec<AheadScan>,
    pub(crate) pending_changes: u64,
    pub(crate) oldest_pending_nanos: Option<i64>,
    pub(crate) generation: Arc<Generation>,
    /// The sums of each tile; taken out while an update runs.
    pub(crate) sums: Vec<SumsSlot>,
    published: Vec<TileChunk>,
    dirty: Vec<bool>,
    pub(crate) scans: u64,
    pub(crate) cell_observations: u64,
}

impl LiveGrid {
    /// An empty grid.
    #[must_use]
    pub(crate) fn new(spec: Arc<GridSpec>) -> LiveGrid {
        LiveGrid {
            spec,
            tiles: Vec::new(),
            ids: Arc::default(),
            last_seen: Arc::from([]),
            previous: None,
            run: LikeScans::default(),
            run_seen: None,
            days: Vec::new(),
            ahead: Vec::new(),
            pending_changes: 0,
            oldest_pending_nanos: None,
            generation: Arc::default(),
            sums: Vec::new(),
            published: Vec::new(),
            dirty: Vec::new(),
            scans: 0,
            cell_observations: 0,
        }
    }

    /// The grid as it was when the snapshot was taken.
    pub(crate) fn restore(spec: Arc<GridSpec>, snapshot: GridSnapshot) -> LiveGrid {
        let mut grid = LiveGrid::new(spec);
        for tile in snapshot.tiles {
            grid.add_tile(LiveTile::clone(&tile));
        }
        grid.generation = Arc::new(Generation { models: snapshot.models });
        grid.sums = snapshot.sums;
        grid.last_seen = snapshot.last_seen;
        grid.days = snapshot.days;
        grid.ahead = snapshot.ahead;
        grid.scans = snapshot.scans;
        grid.cell_observations = snapshot.cell_observations;
        grid.count_pending();
        grid
    }

    /// Takes the scans before an instant out, for an update. Gives with them the grid as it stands without what the
    /// update will learn, and the greatest time of the scans that had waited for theirs.
    pub(crate) fn start_update(
        &mut self,
        cut_nanos: i64,
        periodicities: &Periodicities,
        criterion: OrderCriterion,
    ) -> (GridWork, GridBasis, Option<i64>) {
        let (days, newest_ahead) = self.take_before(cut_nanos);
        // Settled, so that the snapshot does not depend on the run.
        self.end_run();
        let work = GridWork {
            rules: Rules::new(periodicities, criterion, self.spec.sensor),
            generation: Arc::clone(&self.generation),
            sums: std::mem::take(&mut self.sums),
            days,
            tiles: self.tiles.len(),
        };
        let basis = GridBasis {
            tiles: self.tiles.clone(),
            last_seen: Arc::clone(&self.last_seen),
            days: self.days.clone(),
            ahead: self.ahead.clone(),
            scans: self.scans,
            cell_observations: self.cell_observations,
        };
        (work, basis, newest_ahead)
    }

    /// Publishes what an update learned.
    pub(crate) fn finish_update(
        &mut self,
        basis: GridBasis,
        generation: Generation,
        sums: Vec<SumsSlot>,
    ) -> GridSnapshot {
        self.generation = Arc::new(generation);
        self.sums = sums;
        let GridBasis { tiles, last_seen, days, ahead, scans, cell_observations } = basis;
        GridSnapshot {
            tiles,
            models: self.generation.models.clone(),
            sums: self.sums.clone(),
            last_seen,
            days,
            ahead,
            scans,
            cell_observations,
        }
    }

    pub(crate) fn add_tile(&mut self, tile: LiveTile) {
        let id = TileId(u32::try_from(self.tiles.len()).unwrap_or(u32::MAX));
        Arc::make_mut(&mut self.ids).insert(tile.index, id);
        self.tiles.push(Arc::new(tile));
        self.touch(id);
    }

    fn touch(&mut self, tile: TileId) {
        let chunk = tile.0 as usize / TILE_CHUNK;
        if chunk >= self.dirty.len() {
            self.dirty.resize(chunk + 1, true);
        }
        self.dirty[chunk] = true;
    }

    /// Number of tiles.
    #[must_use]
    pub fn tiles(&self) -> usize {
        self.tiles.len()
    }

    /// The tile of this index.
    #[must_use]
    pub fn find(&self, index: TileIndex) -> Option<TileId> {
        self.ids.get(&index).copied()
    }

    /// What the last scan of a tile in the order of the log showed.
    #[must_use]
    pub fn arrival(&self, tile: TileId) -> Option<TileMasks> {
        Some(self.tiles.get(tile.0 as usize)?.arrival)
    }

    /// The tiles of the last scan in the log.
    #[must_use]
    pub fn last_seen(&self) -> &Arc<[TileId]> {
        &self.last_seen
    }

    /// Scans that wait because their time is too far ahead.
    #[must_use]
    pub fn ahead(&self) -> u64 {
        self.ahead.len() as u64
    }

    /// The greatest time before `limit_nanos` of the scans that wait.
    pub(crate) fn newest_ahead_before(&self, limit_nanos: i64) -> Option<i64> {
        self.ahead.iter().map(|scan| scan.time.utc_nanos).filter(|&nanos| nanos < limit_nanos).max()
    }

    /// Scans that no update has folded in; those that wait because of their time are not counted.
    #[must_use]
    pub fn pending_scans(&self) -> u64 {
        self.days.iter().map(|day| day.scans.len() as u64).sum()
    }

    /// Checks that an event follows from those before; nothing is changed.
    pub(crate) fn check(&self, event: &Scans) -> Result<(), String> {
        let tiles = self.tiles.len() + event.new_tiles.len();
        if event.new_tiles.iter().any(|index| self.ids.contains_key(index) || !index.is_valid()) {
            return Err("a tile is not new".to_owned());
        }
        for scan in &event.scans {
            if scan.seen.as_ref().is_some_and(|seen| seen.iter().any(|tile| tile.0 as usize >= tiles)) {
                return Err("a tile is unknown".to_owned());
            }
            let mut flips = scan.observed_flips.iter().chain(&scan.occupied_flips);
            if flips.any(|flip| flip.tile().0 as usize >= tiles) {
                return Err("a cell is of an unknown tile".to_owned());
            }
        }
        Ok(())
    }

    /// Takes in scans that [`LiveGrid::check`] has let pass. Gives the greatest time that did not have to wait.
    pub(crate) fn take_in(&mut self, event: &Scans) -> Option<i64> {
        for &index in &event.new_tiles {
            self.add_tile(LiveTile::new(index));
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
            // What its tiles show now has gone into no day.
            self.previous = None;
            return false;
        }
        let day = LocalDay::of_civil_nanos(time.civil_nanos());
        let same = self.previous.take().filter(|previous| previous.day == day && Arc::ptr_eq(&previous.seen, &seen));
        let observed = match &same {
            Some(previous) if scan.observed_flips.is_empty() => previous.observed,
            _ => seen.iter().filter_map(|&t| self.arrival(t)).map(|m| u64::from(m.observed().count())).sum(),
        };
        self.cell_observations += observed;
        self.keep(day, time, &seen, same.is_some(), &flipped);
        self.see(scan.utc_nanos, &seen, &flipped);
        self.previous = Some(Previous { day, seen, observed });
        true
    }

    /// Brings the arrival masks of flipped tiles up to date; gives those tiles, ascending.
    fn flip_arrivals(&mut self, observed: &[CellRef], occupied: &[CellRef]) -> Vec<TileId> {
        let mut tiles: Vec<TileId> = Vec::with_capacity(observed.len().min(8) + occupied.len());
        let (mut observed, mut occupied) = (observed.iter().peekable(), occupied.iter().peekable());
        while let Some(id) = [observed.peek(), occupied.peek()].into_iter().flatten().map(|cell| cell.tile()).min() {
            let of_tile = |cell: &&CellRef| cell.tile() == id;
            let observed_cells = std::iter::from_fn(|| observed.next_if(of_tile)).map(|cell| cell.cell());
            let occupied_cells = std::iter::from_fn(|| occupied.next_if(of_tile)).map(|cell| cell.cell());
            if let Some(tile) = self.tiles.get_mut(id.0 as usize) {
                let tile = Arc::make_mut(tile);
                let observed = tile.arrival.observed().flipped(observed_cells);
                tile.arrival = TileMasks::clipped(observed, tile.arrival.occupied().flipped(occupied_cells));
            }
            self.touch(id);
            tiles.push(id);
        }
        tiles
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
        let at = self.days.partition_point(|known| known.day < day);
        if self.days.get(at).is_none_or(|known| known.day != day) {
            self.days.insert(at, GridDay::new(day));
        }
        let kept = &mut self.days[at];
        let scan = kept.push(time, seen);
        let mut show = |id: TileId| {
            let Some(tile) = self.tiles.get(id.0 as usize) else { return };
            let before = kept.tile(id).map_or(0, |tile| tile.flips.len());
            kept.show(scan, id, tile.arrival);
            self.pending_changes += (kept.tile(id).map_or(0, |tile| tile.flips.len()) - before) as u64 + 1;
        };
        // The other tiles show what they showed in the scan before, which went into this day too.
        for &id in if is_like_previous { flipped } else { seen } {
            show(id);
        }
        self.pending_changes += 1;
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
            let Some(tile) = self.tiles.get_mut(id.0 as usize) else { continue };
            if tile.is_newer(utc_nanos) {
                let tile = Arc::make_mut(tile);
                tile.observe(utc_nanos, tile.arrival);
                tile.joined = Some(0);
            } else {
                all_newer = false;
            }
            self.touch(id);
        }
        self.run = LikeScans { count: 0, newest_nanos: utc_nanos };
        self.run_seen = Some(Arc::clone(seen));
        if !all_newer {
            self.end_run();
        }
    }

    /// Ends the run of like scans: its tiles are brought up to date.
    fn end_run(&mut self) {
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

    /// Takes the pending scans before an instant, by day, ascending; the others stay. Scans that waited for their time
    /// join if it has come; the greatest time of those is given too.
    pub(crate) fn take_before(&mut self, cut_nanos: i64) -> (Vec<GridDay>, Option<i64>) {
        let (due, ahead): (Vec<AheadScan>, Vec<AheadScan>) =
            std::mem::take(&mut self.ahead).into_iter().partition(|scan| scan.time.utc_nanos < cut_nanos);
        self.ahead = ahead;
        let newest = due.iter().map(|scan| scan.time.utc_nanos).max();
        self.join(due);
        let mut taken = Vec::new();
        let mut kept = Vec::new();
        for day in std::mem::take(&mut self.days) {
            let (before, after) = day.split(cut_nanos);
            taken.extend(before);
            kept.extend(after);
        }
        self.days = kept;
        // The scan numbers of a split day begin anew.
        self.previous = None;
        self.count_pending();
        (taken, newest)
    }

    /// Scans whose time has come: from here on they are scans like all others.
    fn join(&mut self, mut due: Vec<AheadScan>) {
        due.sort_by_key(|scan| scan.time.utc_nanos);
        self.end_run();
        for scan in due {
            let day = LocalDay::of_civil_nanos(scan.time.civil_nanos());
            let at = self.days.partition_point(|known| known.day < day);
            if self.days.get(at).is_none_or(|known| known.day != day) {
                self.days.insert(at, GridDay::new(day));
            }
            let seen: Arc<[TileId]> = scan.tiles.iter().map(|(tile, _)| *tile).collect();
            let number = self.days[at].push(scan.time, &seen);
            for (id, masks) in scan.tiles {
                self.days[at].show(number, id, masks);
                let Some(tile) = self.tiles.get_mut(id.0 as usize) else { continue };
                if tile.is_newer(scan.time.utc_nanos) {
                    Arc::make_mut(tile).observe(scan.time.utc_nanos, masks);
                    self.touch(id);
                }
            }
        }
    }

    pub(crate) fn count_pending(&mut self) {
        let changes = |day: &GridDay| {
            let tiles = day.tiles.iter().flatten().map(|tile| 1 + tile.flips.len() as u64);
            day.scans.len() as u64 + tiles.sum::<u64>()
        };
        self.pending_changes = self.days.iter().map(changes).sum();
        self.oldest_pending_nanos = self.days.iter().flat_map(|day| &day.scans).map(|scan| scan.utc_nanos).min();
    }

    /// The tiles as readers are to see them from now on.
    pub(crate) fn publish(&mut self) -> Vec<TileChunk> {
        for (index, dirty) in self.dirty.iter_mut().enumerate() {
            if !std::mem::take(dirty) {
                continue;
            }
            let from = index * TILE_CHUNK;
            let chunk = Arc::new(self.tiles[from..self.tiles.len().min(from + TILE_CHUNK)].to_vec());
            match self.published.get_mut(index) {
                Some(published) => *published = chunk,
                None => self.published.push(chunk),
            }
        }
        self.published.clone()
    }
}
