//! The candidate periods of hypertime: those of a map, a month and a year; and a time as a point on circles.
//!
//! Most candidates divide one cycle (a week, unless the map has another), so that errors can be summed by slot of the
//! cycle before the search. The others, such as a month beside a week, are searched in the readings' own times.
//! Invariant: a period is a whole division of some nanoseconds, never a length in floating point.

use std::f64::consts::TAU;

use crate::InvalidParts;
use crate::civil::NANOS_PER_SEC;
use crate::gaps::Gaps;
use crate::periodicity::Periodicities;

#[cfg(test)]
mod tests;

/// Maximum number of circles of a model.
pub(super) const PERIODS_MAX: usize = 5;
/// The shortest period searched is the cycle divided by this, or a day in a cycle of more days.
const DIVISOR_MIN: i64 = 84;
/// Upper bound of the divisor, for cycles of years.
const DIVISOR_MAX: i64 = 400;
/// Number of slots of the shortest period.
const SLOTS_PER_PERIOD: usize = 24;
/// Maximum number of periods that do not divide the cycle.
const OTHERS_MAX: usize = 64;
const DAY_NANOS: i64 = 86_400 * NANOS_PER_SEC;
/// A month and a year of the Gregorian calendar, on average.
const CALENDAR_NANOS: [i64; 2] = [2_629_746 * NANOS_PER_SEC, 31_556_952 * NANOS_PER_SEC];
const CYCLE_MAX_NANOS: i64 = 36_525 * DAY_NANOS;

/// A period of a hypertime model: a cycle divided by a whole number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HypertimePeriod {
    /// 1 s to 100 years of 365.25 days.
    pub cycle_nanos: i64,
    /// 1 to 400.
    pub divisor: u32,
}

impl HypertimePeriod {
    /// The length of the period in seconds.
    pub fn secs(self) -> f64 {
        self.cycle_nanos as f64 / f64::from(self.divisor) / 1e9
    }

    /// The position of a local civil time in the period, in turns from 0 to 1.
    fn turn(self, civil_nanos: i64) -> f64 {
        let turn = civil_nanos.rem_euclid(self.cycle_nanos) as f64 / self.cycle_nanos as f64;
        (turn * f64::from(self.divisor)).fract()
    }

    /// Checks stored periods: not too many, each in its range, no two equal.
    pub(super) fn check(periods: &[HypertimePeriod]) -> Result<(), InvalidParts> {
        InvalidParts::check("periods", periods.len() as f64, 0.0..=PERIODS_MAX as f64)?;
        for (index, period) in periods.iter().enumerate() {
            let repeated = periods[..index].contains(period);
            let found = if repeated { f64::NAN } else { f64::from(period.divisor) };
            InvalidParts::check("divisor", found, 1.0..=DIVISOR_MAX as f64)?;
            let range = NANOS_PER_SEC as f64..=CYCLE_MAX_NANOS as f64;
            InvalidParts::check("cycle_nanos", period.cycle_nanos as f64, range)?;
        }
        Ok(())
    }
}

/// Projects a local civil time onto the circles (RA-L 2019 eq. 1): cosine and sine for each period, appended.
pub(super) fn project(civil_nanos: i64, periods: &[HypertimePeriod], out: &mut Vec<f64>) {
    for period in periods {
        let (sin, cos) = libm::sincos(TAU * period.turn(civil_nanos));
        out.extend([cos, sin]);
    }
}

/// The periods that a model may choose, from readings of some span.
#[derive(Clone, Debug)]
pub(super) struct Candidates {
    cycle_nanos: i64,
    /// Divisors of the cycle, ascending.
    divisors: Vec<u32>,
    slots: usize,
    /// Periods that do not divide the cycle; only periods that the readings can hold.
    others: Vec<HypertimePeriod>,
    span_nanos: u64,
    gaps: Gaps,
}

impl Candidates {
    /// The candidates of a map, and a month and a year where no candidate is within a hundredth of them. `utc_nanos`
    /// are the times of the readings, ascending.
    pub(super) fn new(periodicities: &Periodicities, utc_nanos: impl Iterator<Item = i64>) -> Candidates {
        let (mut first, mut last, mut gaps) = (None, None, Gaps::default());
        for nanos in utc_nanos {
            if let Some(last) = last {
                gaps.observe(nanos.abs_diff(last));
            }
            first = first.or(Some(nanos));
            last = Some(nanos);
        }
        let span_nanos = last.zip(first).map_or(0, |(last, first)| last.abs_diff(first));
        let periods: Vec<(i64, u32)> = (0..periodicities.len()).filter_map(|k| periodicities.turns_of(k)).collect();
        let cycle_nanos = periods.iter().map(|&(nanos, _)| nanos).max().unwrap_or(DAY_NANOS);
        let days = cycle_nanos.div_euclid(DAY_NANOS) + i64::from(cycle_nanos.rem_euclid(DAY_NANOS) > 0);
        let max_divisor = days.clamp(DIVISOR_MIN, DIVISOR_MAX);
        let (mut divisors, mut others) = (Vec::new(), Vec::new());
        for &(nanos, turns) in &periods {
            let turned = i128::from(cycle_nanos) * i128::from(turns);
            let (divisor, rest) = (turned / i128::from(nanos), turned % i128::from(nanos));
            match u32::try_from(divisor) {
                Ok(divisor) if i64::from(divisor) <= max_divisor && rest == 0 => divisors.push(divisor),
                Ok(divisor) if i64::from(divisor) < max_divisor => {
                    others.push(HypertimePeriod { cycle_nanos: nanos, divisor: turns });
                }
                _ => {}
            }
        }
        divisors.sort_unstable();
        divisors.dedup();
        for nanos in CALENDAR_NANOS {
            let is_near = |&(other, turns): &(i64, u32)| {
                let ratio = other as f64 / f64::from(turns) / nanos as f64;
                (ratio - 1.0).abs() < 0.01
            };
            if !periods.iter().any(is_near) {
                others.push(HypertimePeriod { cycle_nanos: nanos, divisor: 1 });
            }
        }
        let slots = SLOTS_PER_PERIOD * max_divisor as usize;
        let mut candidates = Candidates { cycle_nanos, divisors, slots, others: Vec::new(), span_nanos, gaps };
        others.retain(|&period| candidates.holds(period));
        others.sort_by(|a, b| b.secs().total_cmp(&a.secs()));
        others.truncate(OTHERS_MAX);
        candidates.others = others;
        candidates
    }

    /// Number of slots of the cycle.
    pub(super) fn slots(&self) -> usize {
        self.slots
    }

    /// The slot of the cycle that a local civil time falls into.
    pub(super) fn slot(&self, civil_nanos: i64) -> usize {
        let within = i128::from(civil_nanos.rem_euclid(self.cycle_nanos));
        (within * self.slots as i128 / i128::from(self.cycle_nanos)) as usize
    }

    /// A local civil time in the middle of a slot.
    pub(super) fn middle_nanos(&self, slot: usize) -> i64 {
        let twice = i128::from(self.cycle_nanos) * (2 * slot as i128 + 1);
        (twice / (2 * self.slots as i128)) as i64
    }

    /// Candidates that do not divide the cycle.
    pub(super) fn others(&self) -> &[HypertimePeriod] {
        &self.others
    }

    /// Whether all of these divide the cycle, so that the slot of the cycle determines the point on the circles.
    pub(super) fn all_divide(&self, periods: &[HypertimePeriod]) -> bool {
        periods.iter().all(|period| period.cycle_nanos == self.cycle_nanos)
    }

    /// Candidates that divide the cycle, the longest first.
    pub(super) fn of_cycle(&self) -> impl Iterator<Item = HypertimePeriod> {
        self.divisors.iter().map(|&divisor| HypertimePeriod { cycle_nanos: self.cycle_nanos, divisor })
    }

    /// Whether the readings can resolve a period: their span plus a median gap holds at least 0.99 of it, and the gap
    /// of regular readings is at most half of it.
    pub(super) fn holds(&self, period: HypertimePeriod) -> bool {
        let (cycle, turns) = (period.cycle_nanos.unsigned_abs(), u128::from(period.divisor));
        let span = self.span_nanos.saturating_add(self.gaps.median_nanos());
        let is_long = u128::from(span) * turns * 100 >= u128::from(cycle) * 99;
        let is_dense = |gap: u64| u128::from(cycle) * 100 >= u128::from(gap) * turns * 198;
        is_long && self.gaps.regular_nanos().is_none_or(is_dense)
    }
}
