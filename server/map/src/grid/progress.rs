//! What an update has done of a grid, tile by tile, noted where the end of the process does not reach it.
//!
//! What a tile becomes depends on its own scans and on nothing that other tiles become. So an update that is run again
//! may take any tiles as an earlier run has left them after any of their days, and goes on from there with the rest.
//!
//! Noting costs the disk what a tile's model and sums take, over and over in an update of many days. So it is done where
//! the work it saves is worth it: not before the update has done a good deal, and a tile only when enough has been done to
//! it since the last time.
//!
//! Invariant: whatever is noted, and whenever the update is cut off, the result is the same to the last bit.

use std::{
    collections::HashMap,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use tidemap_model::{LocalDay, ORDER_MAX, PhasorSum};

use super::{
    day::GridDay,
    index::TileId,
    tile::{TileModel, TileSums},
    update::Working,
};

/// Raised whenever an update comes to compute something else from the same scans.
const VERSION: u64 = 1;
/// Work that a byte of a note has to save. A unit of work, a cell at a scan with all its orders, takes about 4 ns; to
/// write a byte, about 1 ns.
const WORK_PER_BYTE: u64 = 2;
/// A tile is noted again once this part of what was done to it before is done again, so that an update of many days does
/// not write each day anew all that it has.
const NOTED_PART: u64 = 8;

/// An update of a map, so that an earlier run of it can be told from another one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UpdateIdentity {
    /// What it publishes.
    pub generation: u64,
    /// Log position of its start, which fixes all that it learns from.
    pub position: u64,
    /// It takes what is older, nanoseconds UTC.
    pub cut_nanos: i64,
    /// A digest of the scans that it takes and of the way in which it computes.
    pub content: u64,
}

/// What an update did to the cells of one tile, all together.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TileOutcome {
    /// Observations of single cells folded in.
    pub observations: u64,
    /// Observations of cells with a spectrum that were predicted first and scored.
    pub scored: u64,
    /// Sum of squared errors over them, per order 0..=15.
    pub squared_errors: [f64; ORDER_MAX + 1],
    /// Sum of squared errors, each predicted with the order in force for its cell on its day.
    pub squared_error_in_force: f64,
    /// The same with the order that was chosen for its cell on that day.
    pub squared_error_chosen: f64,
}

impl TileOutcome {
    pub(crate) fn add(&mut self, other: &TileOutcome) {
        self.observations += other.observations;
        self.scored += other.scored;
        self.squared_error_in_force += other.squared_error_in_force;
        self.squared_error_chosen += other.squared_error_chosen;
        for (sum, error) in self.squared_errors.iter_mut().zip(&other.squared_errors) {
            *sum += error;
        }
    }
}

/// A tile as the update has left it after one of its days.
#[derive(Clone, Copy, Debug)]
pub struct TileNote<'a> {
    /// The tile.
    pub tile: TileId,
    /// The day; all before it are folded in, too.
    pub through: LocalDay,
    /// Its model.
    pub model: &'a TileModel,
    /// Its sums.
    pub sums: &'a TileSums,
    /// What was done to it since the update began.
    pub outcome: &'a TileOutcome,
}

/// [`TileNote`], come back.
#[derive(Clone, Debug, PartialEq)]
pub struct DoneTile {
    /// The tile.
    pub tile: TileId,
    /// The last day that is folded in.
    pub through: LocalDay,
    /// Its model.
    pub model: TileModel,
    /// Its sums.
    pub sums: TileSums,
    /// What was done to it since the update began.
    pub outcome: TileOutcome,
}

/// Keeps what an update has done, for a later run of the same update.
///
/// Notes are only a help: one that is lost, or cannot be written, costs the work that it would have saved.
pub trait UpdateJournal: Send + Sync {
    /// The newest note of each tile, as earlier runs of the update have left them. Asked once, before the first note.
    fn resume(&self) -> Vec<DoneTile>;

    /// Keeps notes, of which there is one per tile. Called from any of the update's threads, from several at once.
    fn note(&self, tiles: &[TileNote<'_>]);
}

/// What an update has done to a tile.
#[derive(Debug, Default)]
pub(crate) struct Account {
    pub(crate) outcome: TileOutcome,
    /// Work that no note holds.
    unnoted: u64,
    /// Work that the last note holds.
    noted: u64,
}

impl Account {
    /// What an earlier run has noted.
    pub(crate) fn of_earlier_run(outcome: TileOutcome) -> Account {
        Account { outcome, unnoted: 0, noted: 0 }
    }

    /// Whether a note of so many bytes is worth it.
    fn is_due(&self, bytes: usize) -> bool {
        self.unnoted >= (WORK_PER_BYTE * bytes as u64).max(self.noted / NOTED_PART)
    }
}

/// A tile while the update works on it.
#[derive(Debug, Default)]
pub(crate) struct BusyTile {
    pub(crate) working: Working,
    pub(crate) account: Account,
}

/// Notes what an update does, where it is worth it.
pub(crate) struct Notes<'a> {
    journal: Option<&'a dyn UpdateJournal>,
    /// Work done before anything is noted.
    min_work: u64,
    done: AtomicU64,
}

impl<'a> Notes<'a> {
    /// With no work to be done first, everything is noted at once.
    pub(crate) fn new(journal: Option<&'a dyn UpdateJournal>, min_work: u64) -> Notes<'a> {
        Notes { journal, min_work, done: AtomicU64::new(0) }
    }

    /// What earlier runs have noted.
    pub(crate) fn resume(&self) -> Vec<DoneTile> {
        self.journal.map_or_else(Vec::new, UpdateJournal::resume)
    }

    /// So many scans of a day have been folded into each of these tiles.
    pub(crate) fn take(&self, day: LocalDay, scans: usize, tiles: &mut [(TileId, BusyTile)]) {
        let Some(journal) = self.journal else { return };
        let mut of_all = 0;
        for (_, tile) in &mut *tiles {
            let work = (1 + tile.working.model.cells.len() as u64).saturating_mul(scans as u64);
            tile.account.unnoted += work;
            of_all += work;
        }
        if self.done.fetch_add(of_all, Ordering::Relaxed) + of_all < self.min_work {
            return;
        }
        let is_due = |tile: &BusyTile| {
            self.min_work == 0 || tile.account.is_due(tile.working.model.bytes() + tile.working.sums.bytes())
        };
        let mut due: Vec<&mut (TileId, BusyTile)> = tiles.iter_mut().filter(|(_, tile)| is_due(tile)).collect();
        let notes: Vec<TileNote<'_>> = due
            .iter()
            .map(|(id, tile)| TileNote {
                tile: *id,
                through: day,
                model: &tile.working.model,
                sums: &tile.working.sums,
                outcome: &tile.account.outcome,
            })
            .collect();
        if notes.is_empty() {
            return;
        }
        journal.note(&notes);
        for (_, tile) in &mut due {
            tile.account.noted += std::mem::take(&mut tile.account.unnoted);
        }
    }
}

/// Says how far an update is in tiles, of which each counts in equal parts on each of its days.
pub(crate) struct Share<'a> {
    progress: &'a AtomicU64,
    tiles: u64,
    /// Days of all tiles, and those that are done.
    of: u64,
    done: AtomicU64,
}

impl<'a> Share<'a> {
    pub(crate) fn new(progress: &'a AtomicU64, tiles: u64, days: &[GridDay]) -> Share<'a> {
        let of = days.iter().map(|day| day.tiles().len() as u64).sum();
        Share { progress, tiles, of, done: AtomicU64::new(0) }
    }

    /// So many tiles are done for one more of their days.
    pub(crate) fn add(&self, days: usize) {
        let before = self.done.fetch_add(days as u64, Ordering::Relaxed);
        let part = |done: u64| u128::from(done) * u128::from(self.tiles) / u128::from(self.of.max(1));
        // The parts add up, in whatever order they are added.
        let more = part(before + days as u64) - part(before);
        self.progress.fetch_add(u64::try_from(more).unwrap_or(0), Ordering::Relaxed);
    }
}

/// Makes tiles share equal sums of groups, which an earlier run and this one have each made anew, with each other and with
/// tiles that the update has not changed.
pub(crate) fn share_alike<'a>(
    unchanged: impl Iterator<Item = &'a TileSums>,
    changed: impl Iterator<Item = &'a mut TileSums>,
) {
    let mut by_address: HashMap<usize, Arc<PhasorSum>> = HashMap::new();
    let mut by_content: HashMap<u64, Vec<Arc<PhasorSum>>> = HashMap::new();
    let mut alike = |sum: &Arc<PhasorSum>| {
        let known = by_address.entry(Arc::as_ptr(sum) as usize).or_insert_with(|| {
            let numbers = sum.as_slice().iter().map(|number| number.to_bits());
            let alike = by_content.entry(digest(numbers)).or_default();
            if let Some(known) = alike.iter().find(|known| known.as_slice() == sum.as_slice()) {
                return Arc::clone(known);
            }
            alike.push(Arc::clone(sum));
            Arc::clone(sum)
        });
        Arc::clone(known)
    };
    for sum in unchanged.flat_map(TileSums::shared) {
        alike(sum);
    }
    for sum in changed.flat_map(TileSums::shared_mut) {
        *sum = alike(sum);
    }
}

/// A digest of what an update takes.
pub(crate) fn content(days: &[GridDay]) -> u64 {
    let of_day = |day: &'_ GridDay| {
        let counts = [i64::from(day.day.0).cast_unsigned(), day.scans.len() as u64, day.tiles().len() as u64];
        let scans = day.scans.iter().map(|scan| scan.utc_nanos.cast_unsigned());
        let tiles = day.tiles().flat_map(|(id, tile)| [u64::from(id.0), tile.flips.len() as u64]);
        digest(counts.into_iter().chain(scans).chain(tiles))
    };
    digest(std::iter::once(VERSION).chain(days.iter().map(of_day)))
}

/// FNV-1a over the bytes of numbers.
fn digest(numbers: impl Iterator<Item = u64>) -> u64 {
    let bytes = numbers.flat_map(u64::to_le_bytes);
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3))
}

#[cfg(test)]
mod tests;
