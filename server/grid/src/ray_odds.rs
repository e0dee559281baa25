//! The log odds that a scan adds to the evidence about the cells that it observed.
//!
//! Invariant: log odds are whole numbers, so that their sums are exact in any order, and no reading is surer than
//! OctoMap's upper clamping value.

/// The log odds that scans add, in units of 2^-20, so that sums are exact.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct RayOdds {
    /// The log odds of a hit.
    pub(crate) hit: i64,
    /// The log odds of a miss.
    pub(crate) miss: i64,
}

/// Units of [`RayOdds`] for each unit of log odds.
const UNITS: f64 = 1_048_576.0;
/// A single reading is at most this sure, whatever its sensor: the upper clamping value of OctoMap.
const SURE: f64 = 0.97;
/// P(occupied | hit) and P(occupied | miss) where no sensor is stated: the values of OctoMap.
const OCCUPIED_IF_HIT: f64 = 0.7;
const OCCUPIED_IF_MISS: f64 = 0.4;

impl RayOdds {
    /// The log odds of a sensor with these probabilities to read occupied where a cell is occupied, and where it is
    /// free. A sensor that is stated to be always right would contradict itself: it counts as OctoMap's.
    pub(crate) fn new(hit: f64, false_alarm: f64) -> RayOdds {
        if hit >= 1.0 && false_alarm <= 0.0 {
            return RayOdds { hit: odds(OCCUPIED_IF_HIT), miss: odds(OCCUPIED_IF_MISS) };
        }
        RayOdds { hit: odds(hit / (hit + false_alarm)), miss: odds((1.0 - hit) / (2.0 - hit - false_alarm)) }
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
        let certain = RayOdds::new(1.0, 0.1);
        assert_eq!(certain.miss, odds(1.0 - SURE));
        assert!(certain.hit > 0 && RayOdds::new(0.5, 0.0).hit == odds(SURE));
    }
}
