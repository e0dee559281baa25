//! The forecasts of the members of an ensemble of numbers for the next day, and the weights of the members.
//!
//! A member has its prior weight times exp(-L/2v), where L is its faded sum of squared errors over half-hour bins and v
//! the least mean squared error of the members, and one bin in ten is independent of the others. Invariant: weights sum
//! to 1.

use super::super::bins::{DayBins, SLOT_NANOS, SLOTS};
use super::super::forecast::civil_moment;
use super::super::pool::normalised;
use super::table::RECENT;
use super::{NumberEnsemble, SeenDay};
use crate::special::square;
use crate::{
    LocalDay,
    models::{Moment, TemporalModel},
};

/// The residuals of the days this many days back are features.
const DAYS_AGO: [i32; 4] = [1, 2, 7, 14];
/// Number of the last bins of the day before whose mean residual is a feature.
const LAST_BINS: usize = 2;
/// This mean residual falls by so many factors of e in a day.
const FALL: f64 = 2.0;
/// Features of the stacks: weekday table, tables that forget, chosen model, residuals of the days before, and twice the
/// mean residual of the end of the day before: constant over the day, and falling.
pub(super) const FEATURES: usize = 2 + RECENT + DAYS_AGO.len() + 2;
/// The weights of the features before the first bin. The rest of the weight is that of the table of weekdays and the
/// weekend.
pub(super) const WEIGHTS: [f64; FEATURES] = [0.0, 0.2, 0.2, 0.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];

/// Members: mean, hour, kind, weekday, tables that forget, yesterday, chosen model, two stacks.
pub(super) const MEMBERS: usize = 8 + RECENT;
pub(super) const PRIORS: [f64; MEMBERS] = [1.0, 0.5, 5.0, 1.0, 1.0, 1.0, 1.0, 1.0, 2.0, 1.5, 1.5];
/// The share of the losses that remains after each further observed day.
const KEPT: f64 = 0.97;
/// The weight of the loss of a bin, relative to the least loss.
const RATE: f64 = 0.05;

/// The forecasts of the members for a day by half-hour.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct DayMembers {
    pub(super) values: [[f64; SLOTS]; MEMBERS],
    pub(super) features: [[f64; FEATURES]; SLOTS],
    /// The values that the features are relative to: the table of weekdays and the weekend.
    pub(super) base: [f64; SLOTS],
}

/// The losses of `N` members.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Pool<const N: usize> {
    pub(super) losses: [f64; N],
    pub(super) bins: f64,
}

/// A value at the middle of each half-hour of a day.
pub(super) fn at_slots(day: LocalDay, value: impl Fn(Moment) -> f64) -> [f64; SLOTS] {
    let mut values = [0.0; SLOTS];
    for (slot, found) in values.iter_mut().enumerate() {
        *found = value(civil_moment(day, slot as i64 * SLOT_NANOS + SLOT_NANOS / 2));
    }
    values
}

impl SeenDay {
    fn value(&self, slot: usize) -> Option<f64> {
        (self.seen >> slot & 1 == 1).then(|| self.values[slot])
    }

    /// The value of a half-hour, or else of the one before, or else of the one after.
    fn value_near(&self, slot: usize) -> Option<f64> {
        let before = || self.value(slot.checked_sub(1)?);
        self.value(slot).or_else(before).or_else(|| self.value((slot + 1).min(SLOTS - 1)))
    }
}

fn residual(before: &Option<(&SeenDay, [f64; SLOTS])>, slot: usize) -> f64 {
    let Some((seen, base)) = before else { return 0.0 };
    seen.value_near(slot).map_or(0.0, |value| value - base[slot])
}

impl NumberEnsemble {
    /// The table of weekdays and the weekend on a day.
    fn base(&self, day: LocalDay) -> [f64; SLOTS] {
        let level = self.tables.levels()[0];
        self.tables.shapes(day.weekday()).kind.map(|value| level + value)
    }

    /// The bins of the day that is `back` days before a day, and the table of that day; `None` if it is forgotten.
    fn before(&self, day: LocalDay, back: i32) -> Option<(&SeenDay, [f64; SLOTS])> {
        let day = LocalDay(day.0.saturating_sub(back));
        self.seen(day).map(|seen| (seen, self.base(day)))
    }

    /// The residuals of the newest learned day that is whole weeks before a day with a lead time of `ahead` days, and
    /// of the newest one that is whole fortnights before it; 0 if that day is forgotten.
    pub(super) fn repeated(&self, day: LocalDay, ahead: i64) -> [[f64; SLOTS]; 2] {
        [7, 14].map(|days: i64| {
            // Lead times here are below four weeks.
            let back = days * (ahead.clamp(1, 28) + days - 1).div_euclid(days);
            let before = self.before(day, back as i32);
            let mut left = [0.0; SLOTS];
            left.iter_mut().enumerate().for_each(|(slot, value)| *value = residual(&before, slot));
            left
        })
    }

    /// The forecasts of the members for the day after a learned one.
    pub(super) fn members(&self, day: LocalDay, chosen: &dyn TemporalModel) -> DayMembers {
        let (shapes, levels) = (self.tables.shapes(day.weekday()), self.tables.levels());
        let base = shapes.kind.map(|value| levels[0] + value);
        let chosen = at_slots(day, |at| chosen.predict(at) - self.origin);
        let before = DAYS_AGO.map(|back| self.before(day, back));
        let [yesterday, ..] = &before;
        let end = yesterday.as_ref().map_or(0.0, |(seen, base)| {
            let residuals = (0..SLOTS).rev().filter_map(|slot| Some(seen.value(slot)? - base[slot]));
            let (sum, bins) = residuals.take(LAST_BINS).fold((0.0, 0.0), |(sum, n), value| (sum + value, n + 1.0));
            sum / f64::max(bins, 1.0)
        });
        let (mut values, mut features) = ([[0.0; SLOTS]; MEMBERS], [[0.0; FEATURES]; SLOTS]);
        for slot in 0..SLOTS {
            let [one, two, week, fortnight] = before.each_ref().map(|known| residual(known, slot));
            let [slow, middle, fast] = [0, 1, 2].map(|table| levels[table + 1] + shapes.recent[table][slot]);
            let (weekday, left) = (levels[0] + shapes.weekday[slot], libm::exp(-FALL * slot as f64 / SLOTS as f64));
            let own = base[slot];
            features[slot] = [
                weekday - own,
                slow - own,
                middle - own,
                fast - own,
                chosen[slot] - own,
                one,
                two,
                week,
                fortnight,
                end,
                end * left,
            ];
            let [by_slow, by_fast] = self.stacks.each_ref().map(|stack| own + stack.predict(&features[slot]));
            let stored = [
                levels[0],
                levels[0] + shapes.hour[slot],
                own,
                weekday,
                slow,
                middle,
                fast,
                own + one,
                chosen[slot],
                by_slow,
                by_fast,
            ];
            values.iter_mut().zip(stored).for_each(|(values, stored)| values[slot] = stored);
        }
        DayMembers { values, features, base }
    }
}

impl<const N: usize> Pool<N> {
    pub(super) const fn new() -> Pool<N> {
        Pool { losses: [0.0; N], bins: 0.0 }
    }

    /// The weights of the members, from those before the first bin. `dependence`: the evidence of a bin is divided by
    /// this; 1 for the next day.
    pub(super) fn weights(&self, priors: [f64; N], dependence: f64) -> [f64; N] {
        let least = self.losses.iter().copied().fold(f64::INFINITY, f64::min);
        let mut logs = priors.map(libm::log);
        for (log, loss) in logs.iter_mut().zip(&self.losses) {
            let more = loss - least;
            // Where one member was always right, it has all the weight.
            *log -= if more > 0.0 { RATE / dependence * self.bins * more / least } else { 0.0 };
        }
        normalised(logs)
    }

    /// Adds the losses of a day that was predicted before.
    pub(super) fn learn(&mut self, values: &[[f64; SLOTS]; N], bins: &DayBins) {
        self.losses.iter_mut().for_each(|sum| *sum *= KEPT);
        self.bins *= KEPT;
        for (slot, value) in bins.seen() {
            self.bins += 1.0;
            for (sum, predicted) in self.losses.iter_mut().zip(values) {
                *sum += square(predicted[slot] - value);
            }
        }
    }
}

/// The weighted sum of the forecasts of members.
pub(super) fn pooled<const N: usize>(values: &[[f64; SLOTS]; N], weights: [f64; N]) -> [f64; SLOTS] {
    let mut sums = [0.0; SLOTS];
    for (values, weight) in values.iter().zip(weights) {
        sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += weight * value);
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Sample;

    #[test]
    fn weights_follow_the_losses() {
        let sample = |slot: i64| Sample { utc_nanos: slot * SLOT_NANOS, offset_secs: 0, value: 5.0 };
        let bins = DayBins::of_samples(&(0..SLOTS as i64).map(sample).collect::<Vec<_>>());
        let learned = |errors: [f64; 3]| {
            let mut pool = Pool::new();
            pool.learn(&errors.map(|error| [5.0 + error; SLOTS]), &bins);
            pool
        };
        let priors = [1.0, 1.0, 2.0];
        assert_eq!(Pool::new().weights(priors, 1.0), [0.25, 0.25, 0.5]);
        let [one, other, best] = learned([2.0, -2.0, 1.0]).weights(priors, 1.0);
        assert!(one == other && best > 0.99, "{best}");
        assert!(learned([2.0, -2.0, 1.0]).weights(priors, 100.0)[2] < 0.6);
        assert_eq!(learned([1.0, 0.0, 1.0]).weights(priors, 1.0), [0.0, 1.0, 0.0]);
    }
}
