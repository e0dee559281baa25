//! Half-hour bins: the mean of the readings of a state in each half-hour of a local day.
//!
//! All readings of one half-hour are one bin, however many they are: the mean of their values. So a robot that reads a
//! door once a second gains no more certainty than one that reads it once a minute. Invariant: the bins of a day depend
//! on its readings and their times alone, and on their order by less than 1e-9.

use crate::{Sample, time::NANOS_PER_SEC};

/// Number of half-hours of a local day.
pub(crate) const SLOTS: usize = 48;
/// Length of a half-hour in nanoseconds.
pub(super) const SLOT_NANOS: i64 = 1800 * NANOS_PER_SEC;
const DAY_NANOS: i64 = SLOTS as i64 * SLOT_NANOS;

/// The half-hour of the local day, 0..[`SLOTS`], at a local civil time in nanoseconds since 1970.
pub(crate) fn slot_at(civil_nanos: i64) -> usize {
    // Between 0 and 47.
    (civil_nanos.rem_euclid(DAY_NANOS) / SLOT_NANOS) as usize
}

/// The bins of one local day.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct DayBins {
    sums: [f64; SLOTS],
    readings: [u32; SLOTS],
}

impl Default for DayBins {
    fn default() -> DayBins {
        DayBins { sums: [0.0; SLOTS], readings: [0; SLOTS] }
    }
}

impl DayBins {
    /// The bins of the readings of one local day. Half-hours that occur twice when clocks are set back are one bin.
    pub(crate) fn of_samples(samples: &[Sample]) -> DayBins {
        let mut bins = DayBins::default();
        for sample in samples {
            let slot = slot_at(sample.civil_nanos());
            bins.sums[slot] += sample.value;
            bins.readings[slot] = bins.readings[slot].saturating_add(1);
        }
        bins
    }

    /// The mean of the readings in a half-hour; `None` where there is none.
    pub(super) fn value(&self, slot: usize) -> Option<f64> {
        let readings = self.readings[slot];
        (readings > 0).then(|| self.sums[slot] / f64::from(readings))
    }

    /// The half-hours that have readings, with the mean of these.
    pub(super) fn seen(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        (0..SLOTS).filter_map(|slot| Some((slot, self.value(slot)?)))
    }

    /// Whether the day has no reading.
    pub(super) fn is_empty(&self) -> bool {
        self.readings.iter().all(|&readings| readings == 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thousand_readings_in_a_half_hour_are_one_bin() {
        let sample = |secs: i64, value| Sample { utc_nanos: secs * NANOS_PER_SEC, offset_secs: 0, value };
        let once = [sample(8 * 3600 + 60, 1.0), sample(20 * 3600, 0.0)];
        let often: Vec<Sample> =
            (0..1_000).map(|i| sample(8 * 3600 + i, 1.0)).chain([sample(20 * 3600, 0.0)]).collect();
        let bins = DayBins::of_samples(&often);
        assert_eq!(bins.seen().collect::<Vec<_>>(), [(16, 1.0), (40, 0.0)]);
        assert_eq!(bins.seen().collect::<Vec<_>>(), DayBins::of_samples(&once).seen().collect::<Vec<_>>());
        assert!(DayBins::of_samples(&[]).is_empty() && !bins.is_empty());
    }

    #[test]
    fn half_hours_are_of_the_local_day_before_1970_too() {
        assert_eq!([slot_at(0), slot_at(SLOT_NANOS - 1), slot_at(SLOT_NANOS), slot_at(-1)], [0, 0, 1, 47]);
    }
}
