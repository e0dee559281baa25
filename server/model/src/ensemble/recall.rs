//! The half-hour bins of the last eighteen weeks: the value of a state a day, a week, two weeks ago.
//!
//! A day takes 32 bytes: for each half-hour, one bit is set if it has a reading, and four bits hold the value in steps
//! of 1/14; 0 and 1 are exact. Invariant: a day that is older than the last one by [`DAYS`] or more is forgotten, and
//! days between without bins are empty.

use super::bins::{DayBins, SLOTS};
use crate::LocalDay;

/// Number of days that are kept: eighteen weeks, so that four occurrences of the same weekday of the month are among
/// them.
pub(super) const DAYS: usize = 126;
/// Number of steps between 0 and 1.
const STEPS: f64 = 14.0;

/// The bins of one day.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct SeenDay {
    /// One bit for each half-hour: it has a reading.
    pub(super) seen: u64,
    /// Two half-hours a byte, the earlier in the lower four bits.
    pub(super) values: [u8; SLOTS / 2],
}

impl SeenDay {
    const NONE: SeenDay = SeenDay { seen: 0, values: [0; SLOTS / 2] };

    fn of_bins(bins: &DayBins) -> SeenDay {
        let mut day = SeenDay::NONE;
        for (slot, value) in bins.seen() {
            // Between 0 and 14, for values in [0, 1].
            let step = (value.clamp(0.0, 1.0) * STEPS).round() as u8;
            day.seen |= 1 << slot;
            day.values[slot / 2] |= step << (4 * (slot % 2));
        }
        day
    }

    /// The value of a half-hour; `None`: it has no reading.
    pub(super) fn value(&self, slot: usize) -> Option<f64> {
        let step = self.values[slot / 2] >> (4 * (slot % 2)) & 0xf;
        (self.seen >> slot & 1 == 1).then(|| f64::from(step.min(STEPS as u8)) / STEPS)
    }

    /// The value of a half-hour, or else of the one before, or else of the one after.
    pub(super) fn value_near(&self, slot: usize) -> Option<f64> {
        let before = || self.value((slot + SLOTS - 1) % SLOTS);
        self.value(slot).or_else(before).or_else(|| self.value((slot + 1) % SLOTS))
    }
}

/// The bins of the last days.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Recall {
    /// Indexed by the day's number modulo [`DAYS`]; empty before the first learned day.
    pub(super) days: Vec<SeenDay>,
    pub(super) last: Option<LocalDay>,
}

impl Recall {
    pub(super) const fn new() -> Recall {
        Recall { days: Vec::new(), last: None }
    }

    fn place(day: LocalDay) -> usize {
        day.0.rem_euclid(DAYS as i32) as usize
    }

    /// The bins of a day; `None` if it has none, or is forgotten.
    pub(super) fn day(&self, day: LocalDay) -> Option<&SeenDay> {
        let age = i64::from(self.last?.0) - i64::from(day.0);
        let known = (0..DAYS as i64).contains(&age);
        self.days.get(Self::place(day)).filter(|kept| known && kept.seen != 0)
    }

    /// The last learned day.
    pub(super) fn last(&self) -> Option<LocalDay> {
        self.last
    }

    /// Stores a day. The bins of a day that is not the newest are added to its stored bins.
    pub(super) fn learn(&mut self, day: LocalDay, bins: &DayBins) {
        if self.days.is_empty() {
            self.days = vec![SeenDay::NONE; DAYS];
        }
        let of_day = SeenDay::of_bins(bins);
        match self.last {
            Some(last) if day <= last => {
                if i64::from(last.0) - i64::from(day.0) < DAYS as i64 {
                    self.add(day, of_day);
                }
            }
            last => {
                let passed = last.map_or(DAYS as i64, |last| i64::from(day.0) - i64::from(last.0)).min(DAYS as i64);
                for back in 0..passed {
                    // `saturating_sub` keeps the day number in its range.
                    self.days[Self::place(LocalDay(day.0.saturating_sub(back as i32)))] = SeenDay::NONE;
                }
                self.days[Self::place(day)] = of_day;
                self.last = Some(day);
            }
        }
    }

    fn add(&mut self, day: LocalDay, of_day: SeenDay) {
        let kept = &mut self.days[Self::place(day)];
        let new = of_day.seen & !kept.seen;
        for slot in (0..SLOTS).filter(|slot| new >> slot & 1 == 1) {
            kept.values[slot / 2] |= of_day.values[slot / 2] & (0xf << (4 * (slot % 2)));
        }
        kept.seen |= new;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Sample;

    fn bins(values: &[(i64, f64)]) -> DayBins {
        let sample =
            |&(slot, value): &(i64, f64)| Sample { utc_nanos: slot * 1_800_000_000_000, offset_secs: 0, value };
        DayBins::of_samples(&values.iter().map(sample).collect::<Vec<_>>())
    }

    #[test]
    fn what_was_seen_is_recalled_and_old_days_are_forgotten() {
        let mut recall = Recall::new();
        assert_eq!((recall.day(LocalDay(0)), recall.last()), (None, None));
        recall.learn(LocalDay(-3), &bins(&[(0, 1.0), (47, 0.0), (20, 0.5)]));
        let seen = |recall: &Recall, day, slot| recall.day(LocalDay(day)).and_then(|day| day.value(slot));
        assert_eq!([0, 47, 20, 1].map(|slot| seen(&recall, -3, slot)), [Some(1.0), Some(0.0), Some(0.5), None]);
        recall.learn(LocalDay(4), &bins(&[(3, 1.0)]));
        assert_eq!((seen(&recall, -3, 0), seen(&recall, 0, 0), seen(&recall, 4, 3)), (Some(1.0), None, Some(1.0)));
        recall.learn(LocalDay(-3 + DAYS as i32), &bins(&[(3, 0.0)]));
        assert_eq!((seen(&recall, -3, 0), seen(&recall, 4, 3)), (None, Some(1.0)));
        recall.learn(LocalDay(1_000_000), &bins(&[(3, 0.0)]));
        assert_eq!((seen(&recall, 4, 3), seen(&recall, 1_000_000, 3)), (None, Some(0.0)));
    }

    #[test]
    fn late_readings_join_the_day_that_they_are_of() {
        let mut recall = Recall::new();
        recall.learn(LocalDay(9), &bins(&[(5, 1.0)]));
        recall.learn(LocalDay(7), &bins(&[(5, 1.0), (6, 0.0)]));
        recall.learn(LocalDay(7), &bins(&[(5, 0.0), (8, 1.0)]));
        let day = recall.day(LocalDay(7)).unwrap();
        assert_eq!([5, 6, 8, 9].map(|slot| day.value(slot)), [Some(1.0), Some(0.0), Some(1.0), None]);
        assert_eq!((day.value_near(7), day.value_near(4), day.value_near(20)), (Some(0.0), Some(1.0), None));
        assert_eq!(recall.last(), Some(LocalDay(9)));
        recall.learn(LocalDay(9 - DAYS as i32), &bins(&[(5, 1.0)]));
        assert_eq!(recall.day(LocalDay(9 - DAYS as i32)), None);
    }
}
