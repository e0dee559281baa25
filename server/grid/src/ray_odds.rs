//! The log odds that a scan adds to the evidence about the cells that it observed.
//!
//! Invariant: log odds are whole numbers, so that their sums are exact in any order, and no reading is surer than
//! OctoMap's upper clamping value.

use crate::scan::ScanSource;

/// The log odds that scans add, in units of 2^-20, so that sums are exact.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct RayOdds {
    /// The log odds of a hit.
    pub(crate) hit: i64,
    /// The log odds of a miss.
    pub(crate) miss: i64,
}

/// Units of [`RayOdds`] for each unit of log odds.
pub(crate) const UNITS: f64 = 1_048_576.0;
/// A single reading is at most this sure, whatever its sensor: the upper clamping value of OctoMap.
const SURE: f64 = 0.97;
/// P(occupied | hit) and P(occupied | miss) where no sensor is stated: the values of OctoMap.
const OCCUPIED_IF_HIT: f64 = 0.7;
const OCCUPIED_IF_MISS: f64 = 0.4;

/// The log odds that scans of one sensor add, by their source.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SourceOdds {
    rays: RayOdds,
    cells: RayOdds,
}

impl SourceOdds {
    /// The log odds of a sensor with these probabilities to read occupied where a cell is occupied, and where it is
    /// free. A sensor that is stated to be always right would contradict itself: its rays count as OctoMap's, because
    /// they pass cells beside their ends, and the cells that it states count alike, free or occupied.
    pub(crate) fn new(hit: f64, false_alarm: f64) -> SourceOdds {
        if hit >= 1.0 && false_alarm <= 0.0 {
            let hit = odds(OCCUPIED_IF_HIT);
            let rays = RayOdds { hit, miss: odds(OCCUPIED_IF_MISS) };
            return SourceOdds { rays, cells: RayOdds { hit, miss: -hit } };
        }
        let stated =
            RayOdds { hit: odds(hit / (hit + false_alarm)), miss: odds((1.0 - hit) / (2.0 - hit - false_alarm)) };
        SourceOdds { rays: stated, cells: stated }
    }

    /// The log odds of a scan of this source.
    pub(crate) fn by_source(&self, source: ScanSource) -> RayOdds {
        match source {
            ScanSource::Cells => self.cells,
            ScanSource::Rays { .. } => self.rays,
        }
    }
}

/// The log odds of a probability, within what a reading may state.
fn odds(probability: f64) -> i64 {
    let probability = probability.clamp(1.0 - SURE, SURE);
    (libm::log(probability / (1.0 - probability)) * UNITS).round() as i64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_reading_is_surer_than_a_limit() {
        let certain = SourceOdds::new(1.0, 0.1).rays;
        assert_eq!(certain.miss, odds(1.0 - SURE));
        assert!(certain.hit > 0 && SourceOdds::new(0.5, 0.0).cells.hit == odds(SURE));
    }
}
