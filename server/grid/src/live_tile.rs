//! A tile according to its newest scans: the last value of each cell, and how long cells keep their values.
//!
//! Persistence (T-RO 2017, eq. 12) needs pairs of successive observations, changes per time between them, and the
//! newest observation. These are kept per tile for the cells of the newest scan, and per cell only for the other cells
//! and for cells that have changed.
//!
//! Values follow the newest evidence (see [`crate::tile_odds`]), so that one ray beside a wall is no change.
//!
//! Where sensors with different levels observe the same cells, a cell can change its value although its reading is the
//! same. Rates of change are in units of the map's own sensor (see [`crate::sensors`]).
//!
//! Invariant: `known` is `current` and the cells of `away`; lists ascend by cell. An observation of a cell counts
//! exactly if it is newer than all earlier observations of that cell.

use tidemap_model::{Persistence, PersistenceParts};

use crate::{
    bins::BIN_NANOS,
    day::ScanTime,
    index::TileIndex,
    mask::{Mask, TileMasks},
    sensors::{SensorId, Sensors},
    tile_odds::{OddsSteps, TileOdds},
};

/// A cell that the newest scan did not observe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Away {
    /// The place of the cell in the tile.
    pub cell: u16,
    /// The sensor that last observed the cell.
    pub sensor: SensorId,
    /// The time of the last observation of the cell, nanoseconds UTC.
    pub last_nanos: i64,
    /// Pairs of successive observations so far.
    pub pairs: u64,
}

/// A tile according to its newest scans.
#[derive(Clone, Debug, PartialEq)]
pub struct LiveTile {
    /// The index of the tile.
    pub index: TileIndex,
    /// The sensor of the newest scan.
    pub sensor: SensorId,
    /// The masks of the last scan of the tile in log order.
    pub arrival: TileMasks,
    /// Cells that were ever observed.
    pub known: Mask,
    /// Cells whose newest reading is occupied.
    pub occupied: Mask,
    /// Cells that the newest scan observed.
    pub current: Mask,
    /// Time of the newest scan, nanoseconds UTC.
    pub newest_nanos: i64,
    /// Number of scans that were each newer than all scans before.
    pub scans: u64,
    /// Known cells that the newest scan did not observe.
    pub away: Vec<Away>,
    /// Current cells whose number of pairs of successive observations is not `scans` - 1, with their offset: the number
    /// of pairs is `scans` - offset.
    pub offsets: Vec<(u16, i64)>,
    /// For each cell that has changed: the sum, over its changes of value, of the size of the change in units of the
    /// map's own sensor, divided by the seconds between the two readings.
    pub change_rates: Vec<(u16, f64)>,
    /// The newest evidence about the cells; empty where readings count as they are.
    pub odds: TileOdds,
    /// If the tile is part of the map's run: the count of the run up to which `scans` and `newest_nanos` are current.
    pub(crate) joined: Option<u64>,
}

/// The rule by which the readings of a scan count.
#[derive(Clone, Copy)]
pub(crate) struct ReadingRule<'a> {
    pub(crate) sensors: &'a Sensors,
    /// The steps that they add to the newest evidence; `None` where readings count as they are.
    pub(crate) steps: Option<OddsSteps>,
}

/// Consecutive scans, each newer than the scan before, that saw the same tiles with the same sensor. They do not touch
/// unchanged tiles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ScanRun {
    pub(crate) count: u64,
    pub(crate) newest_nanos: i64,
    /// The steps that its readings add to the newest evidence; `None` where readings count as they are.
    pub(crate) steps: Option<OddsSteps>,
}

impl LiveTile {
    /// A tile that no scan has seen.
    pub fn new(index: TileIndex) -> LiveTile {
        LiveTile {
            index,
            sensor: SensorId::OWN,
            arrival: TileMasks::default(),
            known: Mask::EMPTY,
            occupied: Mask::EMPTY,
            current: Mask::EMPTY,
            newest_nanos: 0,
            scans: 0,
            away: Vec::new(),
            offsets: Vec::new(),
            change_rates: Vec::new(),
            odds: TileOdds::default(),
            joined: None,
        }
    }

    /// Applies the scans of the run so far.
    pub(crate) fn settle(&mut self, run: ScanRun) {
        if let Some(joined) = self.joined.as_mut().filter(|joined| **joined < run.count) {
            let more = run.count - *joined;
            self.scans += more;
            self.newest_nanos = run.newest_nanos;
            *joined = run.count;
            if let Some(steps) = run.steps {
                // The masks that the evidence shows do not change: the tile is settled.
                self.odds.read(steps, self.arrival, more);
            }
        }
    }

    /// The newest time and the number of scans, with the scans of the run.
    pub(crate) fn settled(&self, run: ScanRun) -> (i64, u64) {
        match self.joined {
            Some(joined) if joined < run.count => (run.newest_nanos, self.scans + (run.count - joined)),
            _ => (self.newest_nanos, self.scans),
        }
    }

    /// Whether a scan of this time counts.
    pub(crate) fn is_newer(&self, utc_nanos: i64) -> bool {
        self.scans == 0 || utc_nanos > self.newest_nanos
    }

    /// Applies a scan that is newer than all scans before. Returns whether more scans like it would change nothing.
    pub(crate) fn observe(&mut self, time: ScanTime, masks: TileMasks, readings: ReadingRule<'_>) -> bool {
        let ReadingRule { sensors, steps } = readings;
        let (masks, is_settled) = match steps {
            None => (masks, true),
            Some(steps) => {
                if time.utc_nanos.saturating_sub(self.newest_nanos) > BIN_NANOS {
                    self.odds.age();
                }
                self.odds.read(steps, masks, 1)
            }
        };
        let (observed, occupied) = (masks.observed(), masks.occupied());
        // With another sensor, the value of every cell may change.
        let same = self.current & observed;
        let may_change = if time.sensor == self.sensor { (self.occupied ^ occupied) & same } else { same };
        let (left, entered) = (self.current.without(observed), observed.without(self.current));
        let returned: Vec<Away> = match entered.is_empty() {
            true => Vec::new(),
            false => self.away.iter().filter(|away| entered.contains(away.cell)).copied().collect(),
        };
        let change = |cell: u16, sensor: SensorId, from_nanos: i64| {
            let size = self.change(cell, sensor, time.sensor, occupied.contains(cell), sensors);
            Some((cell, change_rate(size, from_nanos, time.utc_nanos)?))
        };
        let stayed = may_change.cells().filter_map(|cell| change(cell, self.sensor, self.newest_nanos));
        let back = returned.iter().filter_map(|away| change(away.cell, away.sensor, away.last_nanos));
        let mut rates: Vec<(u16, f64)> = stayed.collect();
        rates.extend(back);
        rates.sort_by_key(|(cell, _)| *cell);
        self.add_rates(&rates);
        if observed != self.current {
            if !(left.is_empty() && returned.is_empty()) {
                self.leave(left, &returned);
            }
            self.enter(entered, &returned, left);
            self.known |= observed;
            self.current = observed;
        }
        self.scans += 1;
        self.occupied = self.occupied.without(observed) | occupied;
        self.newest_nanos = time.utc_nanos;
        self.sensor = time.sensor;
        is_settled
    }

    /// The change in the value of a known cell by a reading, in units of the map's own sensor.
    fn change(&self, cell: u16, from: SensorId, to: SensorId, is_occupied: bool, sensors: &Sensors) -> f64 {
        let before = sensors.weights(from).units(self.occupied.contains(cell));
        (sensors.weights(to).units(is_occupied) - before).abs()
    }

    /// Applies a scan that is not newer than all scans before: it counts for cells whose own observations are older.
    pub(crate) fn observe_late(&mut self, time: ScanTime, masks: TileMasks, readings: ReadingRule<'_>) {
        let ScanTime { utc_nanos, sensor, source, .. } = time;
        let sensors = readings.sensors;
        let masks = readings.steps.map_or(masks, |_| self.odds.beside(source, masks));
        let mut rates = Vec::new();
        for cell in masks.observed().without(self.current).cells() {
            let is_occupied = masks.occupied().contains(cell);
            match self.away.binary_search_by_key(&cell, |away| away.cell) {
                Ok(at) => {
                    let Away { last_nanos, pairs, sensor: before, .. } = self.away[at];
                    if utc_nanos <= last_nanos {
                        continue;
                    }
                    self.away[at] = Away { cell, sensor, last_nanos: utc_nanos, pairs: pairs + 1 };
                    let size = self.change(cell, before, sensor, is_occupied, sensors);
                    rates.extend(change_rate(size, last_nanos, utc_nanos).map(|rate| (cell, rate)));
                    if self.occupied.contains(cell) != is_occupied {
                        self.occupied.flip(cell);
                    }
                }
                Err(at) => {
                    self.away.insert(at, Away { cell, sensor, last_nanos: utc_nanos, pairs: 0 });
                    self.known.insert(cell);
                    if is_occupied {
                        self.occupied.insert(cell);
                    }
                }
            }
        }
        self.add_rates(&rates);
    }

    /// Adds to the change rates of cells, given ascending.
    fn add_rates(&mut self, rates: &[(u16, f64)]) {
        let (known, mut at) = (self.change_rates.len(), 0);
        for &(cell, rate) in rates {
            at += self.change_rates[at..known].iter().take_while(|(known, _)| *known < cell).count();
            match self.change_rates[at..known].first_mut().filter(|(known, _)| *known == cell) {
                Some((_, sum)) => *sum += rate,
                None => self.change_rates.push((cell, rate)),
            }
        }
        if self.change_rates.len() > known {
            self.change_rates.sort_by_key(|(cell, _)| *cell);
        }
    }

    /// Turns current cells into away cells, and removes the away cells that `returned`. Lists are merged, not sorted: a
    /// moving robot changes most of a tile.
    fn leave(&mut self, cells: Mask, returned: &[Away]) {
        let scans = i64::try_from(self.scans).unwrap_or(i64::MAX);
        let mut away = Vec::with_capacity(self.away.len() - returned.len() + cells.count() as usize);
        let mut returned = returned.iter().peekable();
        let is_kept = |known: &&Away| returned.next_if(|away| away.cell == known.cell).is_none();
        let mut kept = self.away.iter().filter(is_kept).peekable();
        let mut offsets = self.offsets.iter().peekable();
        for cell in cells.cells() {
            away.extend(std::iter::from_fn(|| kept.next_if(|known| known.cell < cell)));
            while offsets.next_if(|(other, _)| *other < cell).is_some() {}
            let offset = offsets.next_if(|(other, _)| *other == cell).map_or(1, |(_, offset)| *offset);
            let pairs = u64::try_from(scans - offset).unwrap_or(0);
            away.push(Away { cell, sensor: self.sensor, last_nanos: self.newest_nanos, pairs });
        }
        away.extend(kept);
        self.away = away;
    }

    /// Makes cells current, of which `returned` were away; `left`: the cells that are no longer current.
    fn enter(&mut self, cells: Mask, returned: &[Away], left: Mask) {
        let scans = i64::try_from(self.scans + 1).unwrap_or(i64::MAX);
        let mut offsets = Vec::with_capacity(self.offsets.len() + cells.count() as usize);
        let mut kept = self.offsets.iter().filter(|(cell, _)| !left.contains(*cell)).peekable();
        let mut returned = returned.iter().peekable();
        for cell in cells.cells() {
            offsets.extend(std::iter::from_fn(|| kept.next_if(|(known, _)| *known < cell)));
            let pairs = returned.next_if(|away| away.cell == cell).map_or(0, |away| away.pairs + 1);
            let offset = scans - i64::try_from(pairs).unwrap_or(i64::MAX);
            if offset != 1 {
                offsets.push((cell, offset));
            }
        }
        offsets.extend(kept);
        self.offsets = offsets;
    }

    fn pairs_of_current(&self, cell: u16, scans: u64) -> u64 {
        let found = self.offsets.binary_search_by_key(&cell, |(cell, _)| *cell);
        let offset = found.ok().map_or(1, |at| self.offsets[at].1);
        u64::try_from(i64::try_from(scans).unwrap_or(i64::MAX) - offset).unwrap_or(0)
    }

    /// The sensor that last observed a known cell.
    fn reader(&self, cell: u16, sensors: &Sensors) -> SensorId {
        if sensors.others() == 0 {
            return SensorId::OWN;
        }
        if self.current.contains(cell) {
            return self.sensor;
        }
        let found = self.away.binary_search_by_key(&cell, |away| away.cell);
        found.map_or(SensorId::OWN, |at| self.away[at].sensor)
    }

    /// Whether some cell was last observed by another sensor than the map's own.
    pub(crate) fn has_other_readers(&self, sensors: &Sensors) -> bool {
        let is_other = |sensor: SensorId| sensor != SensorId::OWN;
        sensors.others() > 0 && (is_other(self.sensor) || self.away.iter().any(|away| is_other(away.sensor)))
    }

    /// The value of the newest reading of a known cell.
    pub(crate) fn value(&self, cell: u16, sensors: &Sensors) -> f64 {
        sensors.value(self.reader(cell, sensors), self.occupied.contains(cell))
    }

    /// Persistence of a cell, with the scans of the run. Before the first observation it is the persistence of an
    /// unknown state.
    pub(crate) fn persistence(&self, cell: u16, run: ScanRun, sensors: &Sensors) -> Persistence {
        if !self.known.contains(cell) {
            return Persistence::default();
        }
        let (newest_nanos, scans) = self.settled(run);
        let (last_nanos, pairs) = if self.current.contains(cell) {
            (newest_nanos, self.pairs_of_current(cell, scans))
        } else {
            let found = self.away.binary_search_by_key(&cell, |away| away.cell);
            found.ok().map_or((newest_nanos, 0), |at| (self.away[at].last_nanos, self.away[at].pairs))
        };
        let found = self.change_rates.binary_search_by_key(&cell, |(cell, _)| *cell);
        let (free, occupied) = sensors.levels(SensorId::OWN);
        let change_rate_sum = found.ok().map_or(0.0, |at| self.change_rates[at].1) * (occupied - free);
        let value = self.value(cell, sensors);
        let parts = PersistenceParts { pairs, change_rate_sum, last: Some((last_nanos, value)) };
        // Its parts are in their ranges by construction.
        Persistence::from_parts(parts).unwrap_or_default()
    }

    /// Memory in bytes, about.
    pub fn bytes(&self) -> usize {
        size_of::<Self>()
            + self.away.len() * 24
            + (self.offsets.len() + self.change_rates.len()) * 16
            + self.odds.bytes()
    }
}

/// The amount that a change of this size adds to the change rates of a cell; `None` if it adds nothing.
fn change_rate(size: f64, from_nanos: i64, to_nanos: i64) -> Option<f64> {
    (size != 0.0).then(|| size * 1e9 / to_nanos.abs_diff(from_nanos).max(1) as f64)
}
