//! A tile as the newest scans show it: last value of each cell, and how long cells keep theirs.
//!
//! What persistence needs per cell (T-RO 2017, eq. 12: pairs of successive observations, changes per time between them,
//! the newest observation) is kept per tile for the cells of the newest scan, and per cell only for the others and for
//! those that have changed.
//!
//! Invariant: `known` = `current` and the cells of `away`; lists ascend by cell. An observation of a cell counts exactly
//! if it is newer than all of that cell before it.

use tidemap_model::{Persistence, PersistenceParts};

use super::{
    index::TileIndex,
    mask::{Mask, TileMasks},
};

/// A cell that the newest scan did not observe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Away {
    /// Its place in the tile.
    pub cell: u16,
    /// When it was last observed, nanoseconds UTC.
    pub last_nanos: i64,
    /// Pairs of successive observations so far.
    pub pairs: u64,
}

/// A tile as the newest scans show it.
#[derive(Clone, Debug, PartialEq)]
pub struct LiveTile {
    /// Where it is.
    pub index: TileIndex,
    /// What the last scan in the order of the log showed.
    pub arrival: TileMasks,
    /// Cells that were ever observed.
    pub known: Mask,
    /// Cells whose newest reading is occupied.
    pub occupied: Mask,
    /// Cells that the newest scan observed.
    pub current: Mask,
    /// Time of the newest scan, nanoseconds UTC.
    pub newest_nanos: i64,
    /// Number of scans that were each newer than all before.
    pub scans: u64,
    /// Known cells that the newest scan did not observe.
    pub away: Vec<Away>,
    /// Current cells whose pairs of successive observations are not `scans` - 1 but `scans` - this.
    pub offsets: Vec<(u16, i64)>,
    /// Sum over changes of 1 / seconds between the two readings, of cells that have changed.
    pub change_rates: Vec<(u16, f64)>,
    /// Where the tile takes part in the map's run of like scans: the run's count up to which `scans` and
    /// `newest_nanos` have been brought.
    pub(crate) joined: Option<u64>,
}

/// Scans that follow each other, each newer than the one before, that saw the same tiles: unchanged tiles need not be
/// touched for them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LikeScans {
    pub(crate) count: u64,
    pub(crate) newest_nanos: i64,
}

impl LiveTile {
    /// A tile that no scan has seen.
    #[must_use]
    pub fn new(index: TileIndex) -> LiveTile {
        LiveTile {
            index,
            arrival: TileMasks::default(),
            known: Mask::EMPTY,
            occupied: Mask::EMPTY,
            current: Mask::EMPTY,
            newest_nanos: 0,
            scans: 0,
            away: Vec::new(),
            offsets: Vec::new(),
            change_rates: Vec::new(),
            joined: None,
        }
    }

    /// Brings the tile up to the run's present.
    pub(crate) fn settle(&mut self, run: LikeScans) {
        if let Some(joined) = self.joined.as_mut().filter(|joined| **joined < run.count) {
            self.scans += run.count - *joined;
            self.newest_nanos = run.newest_nanos;
            *joined = run.count;
        }
    }

    /// The tile as it stands with the run's scans counted in.
    #[must_use]
    pub(crate) fn settled(&self, run: LikeScans) -> (i64, u64) {
        match self.joined {
            Some(joined) if joined < run.count => (run.newest_nanos, self.scans + (run.count - joined)),
            _ => (self.newest_nanos, self.scans),
        }
    }

    /// Whether a scan of this time counts.
    #[must_use]
    pub(crate) fn is_newer(&self, utc_nanos: i64) -> bool {
        self.scans == 0 || utc_nanos > self.newest_nanos
    }

    /// Takes in a scan that is newer than all before; the tile is settled.
    pub(crate) fn observe(&mut self, utc_nanos: i64, masks: TileMasks) {
        let (observed, occupied) = (masks.observed(), masks.occupied());
        let changed = (self.occupied ^ occupied) & observed & self.known;
        for cell in (changed & self.current).cells() {
            self.note_change(cell, self.newest_nanos, utc_nanos);
        }
        if observed != self.current {
            self.leave(self.current.without(observed));
            self.enter(observed.without(self.current), changed, utc_nanos);
            self.known |= observed;
            self.current = observed;
        }
        self.scans += 1;
        self.occupied = self.occupied.without(observed) | occupied;
        self.newest_nanos = utc_nanos;
    }

    /// Takes in a scan that is not newer than all before: it counts for the cells whose own observations are older.
    pub(crate) fn observe_late(&mut self, utc_nanos: i64, masks: TileMasks) {
        for cell in masks.observed().without(self.current).cells() {
            let is_occupied = masks.occupied().contains(cell);
            match self.away.binary_search_by_key(&cell, |away| away.cell) {
                Ok(at) => {
                    let Away { last_nanos, pairs, .. } = self.away[at];
                    if utc_nanos <= last_nanos {
                        continue;
                    }
                    self.away[at] = Away { cell, last_nanos: utc_nanos, pairs: pairs + 1 };
                    if self.occupied.contains(cell) != is_occupied {
                        self.note_change(cell, last_nanos, utc_nanos);
                        self.occupied.flip(cell);
                    }
                }
                Err(at) => {
                    self.away.insert(at, Away { cell, last_nanos: utc_nanos, pairs: 0 });
                    self.known.insert(cell);
                    if is_occupied {
                        self.occupied.insert(cell);
                    }
                }
            }
        }
    }

    fn note_change(&mut self, cell: u16, from_nanos: i64, to_nanos: i64) {
        let rate = 1e9 / to_nanos.abs_diff(from_nanos).max(1) as f64;
        match self.change_rates.binary_search_by_key(&cell, |(cell, _)| *cell) {
            Ok(at) => self.change_rates[at].1 += rate,
            Err(at) => self.change_rates.insert(at, (cell, rate)),
        }
    }

    fn leave(&mut self, cells: Mask) {
        for cell in cells.cells() {
            let pairs = self.pairs_of_current(cell, self.scans);
            if let Ok(at) = self.offsets.binary_search_by_key(&cell, |(cell, _)| *cell) {
                self.offsets.remove(at);
            }
            if let Err(at) = self.away.binary_search_by_key(&cell, |away| away.cell) {
                self.away.insert(at, Away { cell, last_nanos: self.newest_nanos, pairs });
            }
        }
    }

    fn enter(&mut self, cells: Mask, changed: Mask, utc_nanos: i64) {
        let scans = i64::try_from(self.scans + 1).unwrap_or(i64::MAX);
        for cell in cells.cells() {
            let mut pairs = 0;
            if let Ok(at) = self.away.binary_search_by_key(&cell, |away| away.cell) {
                let away = self.away.remove(at);
                pairs = away.pairs + 1;
                if changed.contains(cell) {
                    self.note_change(cell, away.last_nanos, utc_nanos);
                }
            }
            let offset = scans - i64::try_from(pairs).unwrap_or(i64::MAX);
            if offset != 1
                && let Err(at) = self.offsets.binary_search_by_key(&cell, |(cell, _)| *cell)
            {
                self.offsets.insert(at, (cell, offset));
            }
        }
    }

    fn pairs_of_current(&self, cell: u16, scans: u64) -> u64 {
        let found = self.offsets.binary_search_by_key(&cell, |(cell, _)| *cell);
        let offset = found.ok().map_or(1, |at| self.offsets[at].1);
        u64::try_from(i64::try_from(scans).unwrap_or(i64::MAX) - offset).unwrap_or(0)
    }

    /// Persistence of a cell with the run's scans counted in; `levels` are the values of a free and an occupied reading.
    /// Before the first observation it is that of an unknown state.
    #[must_use]
    pub(crate) fn persistence(&self, cell: u16, run: LikeScans, levels: (f64, f64)) -> Persistence {
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
        let change_rate_sum = found.ok().map_or(0.0, |at| self.change_rates[at].1) * (levels.1 - levels.0);
        let value = if self.occupied.contains(cell) { levels.1 } else { levels.0 };
        let parts = PersistenceParts { pairs, change_rate_sum, last: Some((last_nanos, value)) };
        // Its parts are in their ranges by construction.
        Persistence::from_parts(parts).unwrap_or_default()
    }

    /// Memory in bytes, about.
    #[must_use]
    pub fn bytes(&self) -> usize {
        size_of::<Self>() + self.away.len() * 24 + (self.offsets.len() + self.change_rates.len()) * 16
    }
}
