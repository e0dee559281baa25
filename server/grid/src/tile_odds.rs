//! The newest evidence about the cells of a tile, for each source of scans.
//!
//! One ray that passes an occupied cell in part reads it as free. So the newest value of a cell follows the clamped log
//! odds of its newest rays (OctoMap, Hornung et al. 2013): it turns after a few rays that agree. Cells that a scan
//! states turn at once.
//!
//! Invariant: log odds lie between [`ODDS_MIN`] and [`ODDS_MAX`], and a cell is occupied if they are above 0. The
//! sources ascend.

use crate::{
    index::TILE_CELLS,
    mask::{Mask, TileMasks},
    ray_odds::{RayOdds, UNITS},
    scan::ScanSource,
};

/// Steps for each unit of log odds.
const STEPS: f64 = 32.0;
/// The lower clamping value of OctoMap: a probability of .12.
pub const ODDS_MIN: i8 = -64;
/// The upper clamping value of OctoMap: a probability of .97.
pub const ODDS_MAX: i8 = 112;

/// The log odds of each cell of a tile, in steps.
pub type CellOdds = Box<[i8; TILE_CELLS]>;

/// The newest evidence about the cells of a tile.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TileOdds {
    of_sources: Vec<OddsOfSource>,
}

/// The newest evidence of one source. Most cells are at a limit already and are read alike, which costs nothing.
#[derive(Clone, Debug, PartialEq)]
struct OddsOfSource {
    source: ScanSource,
    odds: CellOdds,
    /// The cells whose log odds are above 0.
    occupied: Mask,
    /// The cells whose log odds are [`ODDS_MAX`].
    highest: Mask,
    /// The cells whose log odds are [`ODDS_MIN`].
    lowest: Mask,
}

impl OddsOfSource {
    fn new(source: ScanSource, odds: CellOdds) -> OddsOfSource {
        let where_odds = |is_among: fn(i8) -> bool| {
            (0..).zip(odds.iter()).filter(|(_, odds)| is_among(**odds)).fold(Mask::EMPTY, |mut cells, (cell, _)| {
                cells.insert(cell);
                cells
            })
        };
        let occupied = where_odds(|odds| odds > 0);
        let (highest, lowest) = (where_odds(|odds| odds == ODDS_MAX), where_odds(|odds| odds == ODDS_MIN));
        OddsOfSource { source, odds, occupied, highest, lowest }
    }

    /// Adds scans that all read these masks.
    fn read(&mut self, steps: OddsSteps, masks: TileMasks, scans: i32) {
        let (hits, misses) = (masks.occupied(), masks.observed().without(masks.occupied()));
        self.add(hits.without(self.highest), steps.hit, scans);
        self.add(misses.without(self.lowest), steps.miss, scans);
    }

    fn add(&mut self, cells: Mask, step: i8, scans: i32) {
        let more = i32::from(step).saturating_mul(scans);
        for cell in cells.cells() {
            let Some(odds) = self.odds.get_mut(usize::from(cell)) else { continue };
            let sum = more.saturating_add(i32::from(*odds));
            *odds = sum.clamp(i32::from(ODDS_MIN), i32::from(ODDS_MAX)) as i8;
            for (mask, is_among) in [
                (&mut self.occupied, *odds > 0),
                (&mut self.highest, *odds == ODDS_MAX),
                (&mut self.lowest, *odds == ODDS_MIN),
            ] {
                if mask.contains(cell) != is_among {
                    mask.flip(cell);
                }
            }
        }
    }
}

/// The steps that readings of a scan add.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct OddsSteps {
    source: ScanSource,
    hit: i8,
    miss: i8,
}

impl OddsSteps {
    pub(crate) fn new(source: ScanSource, odds: RayOdds) -> OddsSteps {
        if source == ScanSource::Cells {
            return OddsSteps { source, hit: i8::MAX, miss: i8::MIN };
        }
        let steps = |odds: i64| (odds as f64 / UNITS * STEPS).round().clamp(f64::from(i8::MIN), f64::from(i8::MAX));
        OddsSteps { source, hit: (steps(odds.hit) as i8).max(1), miss: (steps(odds.miss) as i8).min(-1) }
    }
}

/// The log odds of a source are out of range, or its place is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the newest evidence of a tile is out of range, or its sources do not ascend")]
pub struct InvalidOdds;

impl TileOdds {
    /// Restores the log odds of each source.
    ///
    /// # Errors
    /// [`InvalidOdds`] where the sources do not ascend, or a number is out of range.
    pub fn from_sources(of_sources: Vec<(ScanSource, CellOdds)>) -> Result<TileOdds, InvalidOdds> {
        let ascends = of_sources.is_sorted_by(|(one, _), (next, _)| one < next);
        let mut all = of_sources.iter().flat_map(|(_, odds)| odds.iter());
        if !ascends || !all.all(|odds| (ODDS_MIN..=ODDS_MAX).contains(odds)) {
            return Err(InvalidOdds);
        }
        let of_sources = of_sources.into_iter().map(|(source, odds)| OddsOfSource::new(source, odds));
        Ok(TileOdds { of_sources: of_sources.collect() })
    }

    /// The log odds of each source, in steps of 1/32.
    pub fn sources(&self) -> impl Iterator<Item = (ScanSource, &[i8; TILE_CELLS])> {
        self.of_sources.iter().map(|of_source| (of_source.source, &*of_source.odds))
    }

    /// Memory in bytes beyond its own size, about.
    pub(crate) fn bytes(&self) -> usize {
        self.of_sources.len() * (size_of::<OddsOfSource>() + TILE_CELLS)
    }

    /// Adds scans of one source that all read these masks. Returns the masks that the newest evidence shows of the
    /// cells that the scans observed, and whether more such scans would show the same.
    pub(crate) fn read(&mut self, steps: OddsSteps, masks: TileMasks, scans: u64) -> (TileMasks, bool) {
        let at = match self.of_sources.binary_search_by_key(&steps.source, |known| known.source) {
            Ok(at) => at,
            Err(at) => {
                self.of_sources.insert(at, OddsOfSource::new(steps.source, Box::new([0; TILE_CELLS])));
                at
            }
        };
        let mut shown = Mask::EMPTY;
        if let Some(of_source) = self.of_sources.get_mut(at) {
            of_source.read(steps, masks, i32::try_from(scans).unwrap_or(i32::MAX));
            shown = of_source.occupied & masks.observed();
        }
        let is_settled = shown == masks.occupied();
        (self.beside(steps.source, TileMasks::clipped(masks.observed(), shown)), is_settled)
    }

    /// The masks that a source reads, without the free cells that other sources read as occupied.
    pub(crate) fn beside(&self, source: ScanSource, masks: TileMasks) -> TileMasks {
        let others = self.of_sources.iter().filter(|other| other.source != source);
        let standing = others.fold(Mask::EMPTY, |all, other| all | other.occupied);
        TileMasks::clipped(masks.observed().without(standing.without(masks.occupied())), masks.occupied())
    }

    /// Keeps only whether each cell is free or occupied: what was observed long ago does not outweigh a new scan.
    pub(crate) fn age(&mut self) {
        for of_source in &mut self.of_sources {
            of_source.odds.iter_mut().for_each(|odds| *odds = odds.signum());
            (of_source.highest, of_source.lowest) = (Mask::EMPTY, Mask::EMPTY);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ray_odds::SourceOdds;

    const LOW: ScanSource = ScanSource::Rays { height: 1 };
    const HIGH: ScanSource = ScanSource::Rays { height: 8 };

    fn steps(source: ScanSource) -> OddsSteps {
        OddsSteps::new(source, SourceOdds::new(1.0, 0.0).by_source(source))
    }

    /// Whether cell 7 is shown as occupied after these scans of a source; `None` if it counts as not observed.
    fn show(tile: &mut TileOdds, source: ScanSource, is_occupied: bool, scans: u64) -> Option<bool> {
        let occupied = if is_occupied { Mask::of(7) } else { Mask::EMPTY };
        let (shown, _) = tile.read(steps(source), TileMasks::clipped(Mask::of(7), occupied), scans);
        shown.observed().contains(7).then(|| shown.occupied().contains(7))
    }

    #[test]
    fn one_ray_that_passes_does_not_free_a_wall() {
        let mut tile = TileOdds::default();
        assert_eq!(show(&mut tile, LOW, true, 1), Some(true));
        assert_eq!(show(&mut tile, LOW, false, 2), Some(true));
        assert_eq!(show(&mut tile, LOW, false, 1), Some(false));
        // However long a wall stood, it is gone after nine rays, and is back after three.
        show(&mut tile, LOW, true, 10_000);
        assert_eq!((show(&mut tile, LOW, false, 8), show(&mut tile, LOW, false, 1)), (Some(true), Some(false)));
        show(&mut tile, LOW, false, 10_000);
        assert_eq!((show(&mut tile, LOW, true, 2), show(&mut tile, LOW, true, 1)), (Some(false), Some(true)));
    }

    #[test]
    fn what_is_long_ago_does_not_outweigh_a_new_scan() {
        let mut tile = TileOdds::default();
        show(&mut tile, LOW, true, 100);
        tile.age();
        assert_eq!(show(&mut tile, LOW, false, 1), Some(false));
    }

    #[test]
    fn cells_that_a_scan_states_turn_at_once() {
        let mut tile = TileOdds::default();
        for is_occupied in [true, false, true] {
            assert_eq!(show(&mut tile, ScanSource::Cells, is_occupied, 1), Some(is_occupied));
        }
    }

    #[test]
    fn a_sensor_does_not_free_another_height() {
        let mut tile = TileOdds::default();
        assert_eq!(show(&mut tile, LOW, true, 20), Some(true));
        assert_eq!(show(&mut tile, HIGH, false, 20), None);
        assert_eq!(show(&mut tile, LOW, false, 20), Some(false));
        assert_eq!(show(&mut tile, HIGH, false, 1), Some(false));
    }

    #[test]
    fn many_equal_scans_count_like_one_after_the_other() {
        let (mut one, mut many) = (TileOdds::default(), TileOdds::default());
        for (is_occupied, scans) in [(true, 2), (false, 7), (true, 1), (false, 40), (true, 300)] {
            let last = (0..scans).map(|_| show(&mut one, LOW, is_occupied, 1)).last();
            assert_eq!(last, Some(show(&mut many, LOW, is_occupied, scans)));
        }
        assert_eq!(one, many);
    }

    #[test]
    fn invalid_numbers_are_refused() {
        let odds = |odds: i8| Box::new([odds; TILE_CELLS]);
        assert!(TileOdds::from_sources(vec![(LOW, odds(ODDS_MAX)), (HIGH, odds(ODDS_MIN))]).is_ok());
        for wrong in [vec![(LOW, odds(ODDS_MAX + 1))], vec![(HIGH, odds(0)), (LOW, odds(0))]] {
            assert_eq!(TileOdds::from_sources(wrong), Err(InvalidOdds));
        }
    }
}
