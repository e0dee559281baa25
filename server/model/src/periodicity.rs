//! Candidate periodicities Ω: the candidate periods of a model, and the phase of a time in each.
//!
//! A time is reduced modulo a period in integer nanoseconds before it becomes f64: at today's dates f64 seconds have a
//! resolution of 2e-7 s, and harmonics would multiply this error. Invariant: 1..=2048 periods of 1 s to 100 years, no
//! two equal.

use std::sync::Arc;

use crate::civil::NANOS_PER_SEC;

#[cfg(test)]
mod tests;

const COUNT_MAX: usize = 2048;
const PERIOD_MIN_NANOS: i64 = NANOS_PER_SEC;
/// A hundred years of 365.25 days.
const PERIOD_MAX_NANOS: i64 = 36_525 * 86_400 * NANOS_PER_SEC;
const WEEK_NANOS: i64 = 7 * 86_400 * NANOS_PER_SEC;
const WEEK_HARMONICS: u32 = 168;
/// The periods that count as a year.
const YEAR_NANOS: std::ops::RangeInclusive<u64> = 365 * DAY_NANOS..=366 * DAY_NANOS;
const DAY_NANOS: u64 = 86_400 * NANOS_PER_SEC as u64;
/// Readings are in phase with a period if the mean of their phasors is at least this long. This is the length for
/// readings at the same time of each day, within up to two and a half hours.
const IN_PHASE: f64 = 0.98;

/// The definition of candidate periodicities.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PeriodicityDefinition {
    /// The periods are base/1, base/2, … base/count; T-RO section III.C.
    Harmonics {
        /// The longest period, in nanoseconds.
        base_nanos: i64,
        /// Number of periods.
        count: u32,
    },
    /// The periods are given one by one.
    List {
        /// Periods in nanoseconds, in the order of their indices.
        period_nanos: Vec<i64>,
    },
}

/// The reason why periodicities are invalid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum InvalidPeriodicities {
    /// There are too few or too many periodicities.
    #[error("{found} periodicities, expected 1 to {COUNT_MAX}")]
    Count { found: usize },
    /// A period, or for harmonics the shortest one, is too short or too long.
    #[error("periodicity {index} has a period of {} s, expected 1 s to {} s (100 years)",
        *period_nanos as f64 / 1e9, PERIOD_MAX_NANOS / NANOS_PER_SEC)]
    Period { index: usize, period_nanos: i64 },
    /// Two periods are equal.
    #[error("periodicities {first} and {second} both have a period of {} s, expected no two equal",
        *period_nanos as f64 / 1e9)]
    Repeated { first: usize, second: usize, period_nanos: i64 },
}

/// Candidate periodicities Ω. Cheap to clone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Periodicities {
    inner: Arc<PeriodicityTable>,
}

#[derive(Debug, PartialEq, Eq)]
struct PeriodicityTable {
    definition: PeriodicityDefinition,
    cycles: Cycles,
}

/// The representation that the kernels use.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Cycles {
    /// Periodicity k turns k + 1 times as fast as the base.
    Harmonics { base: Cycle, count: usize },
    /// Periodicity k is `list[k]`.
    List(Vec<Cycle>),
}

impl Periodicities {
    /// Creates periodicities with the periods base, base/2, … base/count.
    ///
    /// # Errors
    /// [`InvalidPeriodicities`] unless 1 ≤ count ≤ 2048 and all periods are within 1 s and 100 years.
    pub fn harmonics(base_nanos: i64, count: u32) -> Result<Periodicities, InvalidPeriodicities> {
        let harmonics = check_count(count as usize)?;
        check_period(0, base_nanos)?;
        check_period(harmonics - 1, base_nanos / i64::from(count))?;
        Ok(Periodicities::from_inner(PeriodicityTable {
            definition: PeriodicityDefinition::Harmonics { base_nanos, count },
            cycles: Cycles::Harmonics { base: Cycle::new(base_nanos), count: harmonics },
        }))
    }

    /// Creates periodicities with these periods, in nanoseconds, in the order given.
    ///
    /// # Errors
    /// [`InvalidPeriodicities`] unless there are 1 to 2048, each within 1 s and 100 years, no two equal.
    pub fn list(period_nanos: Vec<i64>) -> Result<Periodicities, InvalidPeriodicities> {
        check_count(period_nanos.len())?;
        for (index, &period) in period_nanos.iter().enumerate() {
            check_period(index, period)?;
        }
        let mut by_period: Vec<(i64, usize)> =
            period_nanos.iter().enumerate().map(|(index, &period)| (period, index)).collect();
        by_period.sort_unstable();
        if let Some(equal) = by_period.windows(2).find(|pair| pair[0].0 == pair[1].0) {
            let (period_nanos, first, second) = (equal[0].0, equal[0].1, equal[1].1);
            return Err(InvalidPeriodicities::Repeated { first, second, period_nanos });
        }
        let cycles = Cycles::List(period_nanos.iter().map(|&period| Cycle::new(period)).collect());
        Ok(Periodicities::from_inner(PeriodicityTable {
            definition: PeriodicityDefinition::List { period_nanos },
            cycles,
        }))
    }

    fn from_inner(inner: PeriodicityTable) -> Periodicities {
        Periodicities { inner: Arc::new(inner) }
    }

    /// The definition, from which the periodicities can be created again.
    pub fn definition(&self) -> &PeriodicityDefinition {
        &self.inner.definition
    }

    /// Number of periodicities, 1..=2048.
    pub fn len(&self) -> usize {
        match &self.inner.cycles {
            Cycles::Harmonics { count, .. } => *count,
            Cycles::List(list) => list.len(),
        }
    }

    /// Always false, because there is at least one periodicity.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The period of periodicity `k`, counted from 0, in seconds; infinite where `k` is too large.
    pub fn period_secs(&self, k: usize) -> f64 {
        match &self.inner.cycles {
            Cycles::Harmonics { base, count } if k < *count => base.period as f64 / (k as f64 + 1.0) / 1e9,
            Cycles::List(list) => list.get(k).map_or(f64::INFINITY, |cycle| cycle.period as f64 / 1e9),
            Cycles::Harmonics { .. } => f64::INFINITY,
        }
    }

    /// A 60th of the shortest period, in nanoseconds, at least 1. Readings that are no further apart count as one
    /// observation, since no periodicity separates them.
    pub fn look_nanos(&self) -> i64 {
        let shortest = match &self.inner.cycles {
            Cycles::Harmonics { base, count } => base.period / *count as u64,
            Cycles::List(list) => list.iter().map(|cycle| cycle.period).min().unwrap_or(u64::MAX),
        };
        i64::try_from(shortest / 60).unwrap_or(i64::MAX).max(1)
    }

    /// Whether a list of periods contains the year.
    pub(crate) fn names_year(&self) -> bool {
        let is_year = |cycle: &Cycle| YEAR_NANOS.contains(&cycle.period);
        matches!(&self.inner.cycles, Cycles::List(list) if list.iter().any(is_year))
    }

    /// Whether a span of observation holds at least 0.99 of periodicity `k`, in exact integers.
    pub(crate) fn is_eligible(&self, k: usize, span_nanos: u64) -> bool {
        let Some((period, turns)) = self.period_of_turns(k) else { return false };
        u128::from(span_nanos) * 100 * turns >= u128::from(period) * 99
    }

    /// Whether readings with this gap resolve periodicity `k` from slower ones: its period is at least twice the gap
    /// (H. Nyquist), with a hundredth for rounding.
    pub(crate) fn is_resolved(&self, k: usize, gap_nanos: u64) -> bool {
        let Some((period, turns)) = self.period_of_turns(k) else { return false };
        u128::from(period) * 100 >= u128::from(gap_nanos) * 198 * turns
    }

    /// The longest of the harmonics with which nearly all readings are in phase, in nanoseconds. Such readings resolve
    /// only periods of at least twice as much, as if they were that far apart (H. Nyquist). The result is 0 if there is
    /// no such harmonic. It is also 0 for a list of periods, because the difference of two such periods need not be in
    /// the list. `phasors`: Σ e^(-jω_k t) over the readings, each as its squared magnitude; `weight`: number of the
    /// readings.
    pub(crate) fn in_phase_nanos(&self, phasors: impl Iterator<Item = f64>, weight: f64) -> u64 {
        let Cycles::Harmonics { base, .. } = &self.inner.cycles else { return 0 };
        let least = IN_PHASE * weight;
        let first = (1..).zip(phasors).find(|(_, square)| *square >= least * least);
        first.map_or(0, |(turns, _)| base.period / turns)
    }

    /// Periodicity `k` as a time in nanoseconds and its number of turns in that time; `None` where `k` is too large.
    fn period_of_turns(&self, k: usize) -> Option<(u64, u128)> {
        match &self.inner.cycles {
            Cycles::Harmonics { base, count } if k < *count => Some((base.period, k as u128 + 1)),
            Cycles::List(list) => list.get(k).map(|cycle| (cycle.period, 1)),
            Cycles::Harmonics { .. } => None,
        }
    }

    /// Periodicity `k` as a time in nanoseconds and its number of turns in that time; `None` where `k` is too large.
    pub(crate) fn turns_of(&self, k: usize) -> Option<(i64, u32)> {
        let (period, turns) = self.period_of_turns(k)?;
        Some((i64::try_from(period).ok()?, u32::try_from(turns).ok()?))
    }

    /// The phase of a local civil time in periodicity `k`, in turns from -0.5 to 0.5; `None` where
    /// `k` is too large.
    pub(crate) fn turns(&self, k: usize, civil_nanos: i64) -> Option<f64> {
        match &self.inner.cycles {
            Cycles::Harmonics { base, count } if k < *count => {
                let turns = base.turns(civil_nanos) * (k as f64 + 1.0);
                Some(turns - turns.round())
            }
            Cycles::List(list) => list.get(k).map(|cycle| cycle.turns(civil_nanos)),
            Cycles::Harmonics { .. } => None,
        }
    }

    pub(crate) fn cycles(&self) -> &Cycles {
        &self.inner.cycles
    }
}

impl Default for Periodicities {
    /// The 168 harmonics of a week, one week to one hour (T-RO section III.C, indoor).
    fn default() -> Periodicities {
        let (base_nanos, count) = (WEEK_NANOS, WEEK_HARMONICS);
        Periodicities::from_inner(PeriodicityTable {
            definition: PeriodicityDefinition::Harmonics { base_nanos, count },
            cycles: Cycles::Harmonics { base: Cycle::new(base_nanos), count: count as usize },
        })
    }
}

fn check_count(found: usize) -> Result<usize, InvalidPeriodicities> {
    if (1..=COUNT_MAX).contains(&found) { Ok(found) } else { Err(InvalidPeriodicities::Count { found }) }
}

fn check_period(index: usize, period_nanos: i64) -> Result<(), InvalidPeriodicities> {
    if (PERIOD_MIN_NANOS..=PERIOD_MAX_NANOS).contains(&period_nanos) {
        Ok(())
    } else {
        Err(InvalidPeriodicities::Period { index, period_nanos })
    }
}

/// Reduction modulo one period without a division.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Cycle {
    /// Nanoseconds, at least 2.
    period: u64,
    /// floor(2^64 / period).
    reciprocal: u64,
    turns_per_nano: f64,
}

impl Eq for Cycle {}

impl Cycle {
    fn new(period_nanos: i64) -> Cycle {
        let period = period_nanos.unsigned_abs().max(2);
        // The quotient fits, since the period is at least 2.
        let reciprocal = ((1_u128 << 64) / u128::from(period)) as u64;
        Cycle { period, reciprocal, turns_per_nano: 1.0 / period as f64 }
    }

    /// The phase of a local civil time, in turns from -0.5 to 0.5. Exact before its one rounding.
    #[inline(always)]
    pub(crate) fn turns(&self, civil_nanos: i64) -> f64 {
        let magnitude = civil_nanos.unsigned_abs();
        // Barrett reduction: the estimated quotient is the true one or one less.
        let quotient = ((u128::from(magnitude) * u128::from(self.reciprocal)) >> 64) as u64;
        let estimate = magnitude - quotient * self.period;
        let remainder = if estimate >= self.period { estimate - self.period } else { estimate };
        // Reduced to the nearest turn, so that times just before a full turn keep their precision.
        let centred =
            if remainder > self.period / 2 { remainder as i64 - self.period as i64 } else { remainder as i64 };
        let turns = centred as f64 * self.turns_per_nano;
        if civil_nanos < 0 { -turns } else { turns }
    }
}
