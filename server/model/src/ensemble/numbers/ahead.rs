//! Forecasts at lead times of two days, a week, four weeks, a quarter and a year: a stack for each of these classes.
//!
//! The readings of the days between are not known, so a stack combines tables, and the residuals of the same days of
//! the last fortnight. Tables are used with the means that they had at the lead time before: so the stacks learn how
//! long a table that forgets is of use, and their errors are those of predictions at this lead time. Forecasts made
//! within one lead time of each other are one piece of evidence. A stack that was not yet scored takes over the weights
//! of the shorter class, with less weight for tables that forget. Invariant: the longer the lead time, the wider the
//! prediction; a class that was not scored is as wide as the values of the state differ.

use super::super::bins::{DayBins, SLOTS};
use super::SLOW;
use super::members::{Pool, pooled};
use super::spread::{Spread, Squares, hour_errors, shrunk};
use super::stack::LinearStack;
use super::table::{HALF_LIVES_DAYS, Levels, RECENT, Shapes};
use crate::{LocalDay, hours_seen::HOURS};

/// The shortest lead time of each class, in days.
const AHEAD_DAYS: [i64; CLASSES] = [2, 7, 28, 91, 364];
pub(super) const CLASSES: usize = 5;
/// Features: weekday table, tables that forget, the model of all history, the residuals of the newest day whole weeks
/// before and of the newest day whole fortnights before.
pub(super) const FEATURES: usize = RECENT + 4;
/// The weights of the features before the first bin, for a lead time of two days.
const WEIGHTS: [f64; FEATURES] = [0.0, 0.25, 0.25, 0.0, 0.0, 0.0, 0.0];
/// Number of classes for which [`knows_repeated`] is true.
const REPEATED_CLASSES: usize = 2;
/// Members of a class, and their weights before the first bin.
pub(super) const MEMBERS: usize = 3;
const PRIORS: [f64; MEMBERS] = [1.0, 0.5, 3.0];
/// In a class that is not scored, a table that forgets has about half the weight at a lead time of this many of its
/// half-lives.
const WINDOWS: f64 = 4.0;
/// The variance of all bins counts as this many hours for each day of lead time.
const FIRST_HOURS: f64 = 48.0;

/// A lead-time class.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FarStack {
    pub(super) stack: LinearStack<FEATURES>,
    pub(super) pool: Pool<MEMBERS>,
    /// Squared errors of the means of hours.
    pub(super) errors: Squares,
    /// The two last turns of the class, the newer first.
    pub(super) kept_days: [Option<LocalDay>; 2],
    /// The means of the tables at these turns.
    pub(super) kept: [Levels; 2],
}

/// All lead-time classes.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FarStacks {
    pub(super) classes: [FarStack; CLASSES],
}

/// The forecasts of the members of a class for a day by half-hour: the table of all history, the model of all history,
/// the stack.
#[derive(Clone, Debug)]
pub(super) struct AheadMembers {
    pub(super) values: [[f64; SLOTS]; MEMBERS],
    features: [[f64; FEATURES]; SLOTS],
}

/// The class of a lead time in days; `None` if it is shorter than the first class.
pub(super) fn class_of(days: i64) -> Option<usize> {
    AHEAD_DAYS.iter().rposition(|&shortest| days >= shortest)
}

/// Whether a class can use the residuals of the last fortnight; older bins are forgotten.
pub(super) fn knows_repeated(class: usize) -> bool {
    class < REPEATED_CLASSES
}

impl FarStacks {
    pub(super) const fn new() -> FarStacks {
        const CLASS: FarStack = FarStack {
            stack: LinearStack::new(SLOW, WEIGHTS),
            pool: Pool::new(),
            errors: [0.0; 2],
            kept_days: [None; 2],
            kept: [[0.0; RECENT + 1]; 2],
        };
        FarStacks { classes: [CLASS; CLASSES] }
    }

    /// The weights of a class that was not scored.
    fn unjudged(&self, class: usize) -> [f64; FEATURES] {
        let Some(shorter) = class.checked_sub(1) else { return WEIGHTS };
        let mut weights = self.weights(shorter);
        for (weight, half_life_days) in weights[1..].iter_mut().zip(HALF_LIVES_DAYS) {
            *weight *= libm::exp2(-(AHEAD_DAYS[class] as f64) / (WINDOWS * half_life_days));
        }
        weights
    }

    fn is_judged(&self, class: usize) -> bool {
        self.classes[class].errors[1] > 0.0
    }

    fn weights(&self, class: usize) -> [f64; FEATURES] {
        if self.is_judged(class) { self.classes[class].stack.weights } else { self.unjudged(class) }
    }

    /// The weights of the members of a class; a class that was not scored takes over the weights of the next shorter
    /// one.
    pub(super) fn pool_weights(&self, class: usize) -> [f64; MEMBERS] {
        match class.checked_sub(1).filter(|_| !self.is_judged(class)) {
            Some(shorter) => self.pool_weights(shorter),
            None => self.classes[class].pool.weights(PRIORS, AHEAD_DAYS[class] as f64),
        }
    }

    /// The forecasts of the members of a class. `levels`: the means of the tables when the forecasts are made;
    /// `lasting`: the predictions of the model of all history; `repeated`: the residuals of the same days before, if
    /// [`knows_repeated`].
    pub(super) fn members(
        &self,
        class: usize,
        shapes: &Shapes,
        levels: &Levels,
        lasting: &[f64; SLOTS],
        repeated: Option<&[[f64; SLOTS]; 2]>,
    ) -> AheadMembers {
        let weights = self.weights(class);
        let base = shapes.kind.map(|value| levels[0] + value);
        let mut stored = AheadMembers { values: [base, *lasting, base], features: [[0.0; FEATURES]; SLOTS] };
        for (slot, x) in stored.features.iter_mut().enumerate() {
            let recent = |table: usize| levels[table + 1] + shapes.recent[table][slot] - base[slot];
            let repeated = |days: usize| repeated.map_or(0.0, |left| left[days][slot]);
            *x = [
                shapes.weekday[slot] - shapes.kind[slot],
                recent(0),
                recent(1),
                recent(2),
                lasting[slot] - base[slot],
                repeated(0),
                repeated(1),
            ];
            stored.values[MEMBERS - 1][slot] += x.iter().zip(&weights).map(|(x, weight)| x * weight).sum::<f64>();
        }
        stored
    }

    /// The means of the tables that a class stored at least one lead time before a day, and how many days before.
    pub(super) fn kept(&self, class: usize, day: LocalDay) -> Option<(Levels, i64)> {
        let days = i64::from(day.0) - i64::from(self.classes[class].kept_days[1]?.0);
        (days >= AHEAD_DAYS[class]).then(|| (self.classes[class].kept[1], days))
    }

    /// Scores the forecasts that the members of a class would have made at its lead time on the bins of a day, and
    /// learns from them.
    pub(super) fn judge(&mut self, class: usize, bins: &DayBins, stored: &AheadMembers, variance: f64) {
        let forecast = pooled(&stored.values, self.pool_weights(class));
        let (towards, days) = (self.unjudged(class), AHEAD_DAYS[class] as f64);
        let known = &mut self.classes[class];
        known.errors = known.errors.map(|sum| SLOW * sum);
        for (_, square) in hour_errors(bins, &forecast) {
            known.errors[0] += square;
            known.errors[1] += 1.0;
        }
        known.pool.learn(&stored.values, bins);
        let targets = bins.seen().map(|(slot, value)| (&stored.features[slot], value - stored.values[0][slot]));
        known.stack.learn_towards(targets, variance, towards, days);
    }

    /// Stores the means of the tables at the end of a day, for the classes whose turn lies in the days after `last`.
    pub(super) fn keep(&mut self, last: Option<LocalDay>, day: LocalDay, levels: Levels) {
        let turn = |day: LocalDay, days: i64| i64::from(day.0).div_euclid(days);
        for (class, days) in self.classes.iter_mut().zip(AHEAD_DAYS) {
            if last.is_none_or(|last| turn(last, days) != turn(day, days)) {
                (class.kept_days, class.kept) = ([Some(day), class.kept_days[0]], [levels, class.kept[0]]);
            }
        }
    }

    /// The factor by which the variance of predictions at a lead time of `days` is larger than that of the next day, at
    /// least 1. `of_bins`: the variance of all bins.
    pub(super) fn growth(&self, days: i64, near: &Spread, of_bins: f64) -> f64 {
        let of_near = near.of_all(of_bins);
        let (mut widest, mut uncertain) = (of_near, 1.0);
        for (class, known) in self.classes.iter().enumerate().take(class_of(days).map_or(0, |class| class + 1)) {
            let days = AHEAD_DAYS[class] as f64;
            let [_, hours] = known.errors;
            let first_hours = FIRST_HOURS * days;
            widest = widest.max(shrunk(known.errors, of_bins.max(widest), first_hours));
            // An estimate from few errors is uncertain.
            let independent = hours / (HOURS as f64 * days);
            uncertain = 1.0 + hours / (hours + first_hours) / independent.max(1.0);
        }
        if of_near > 0.0 { widest * uncertain / of_near } else { 1.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lead_times_have_classes() {
        let found = [0, 1, 2, 6, 7, 27, 28, 91, 364, 9_999].map(class_of);
        let expected = [None, None, Some(0), Some(0), Some(1), Some(1), Some(2), Some(3), Some(4), Some(4)];
        assert_eq!(found, expected);
    }

    #[test]
    fn a_table_that_forgets_is_not_used_at_long_lead_times_before_it_is_scored() {
        let ahead = FarStacks::new();
        let [near, far] = [0, CLASSES - 1].map(|class| ahead.weights(class));
        assert_eq!(near, WEIGHTS);
        assert!(far[1..4].iter().all(|weight| weight.abs() < 0.02), "{far:?}");
    }
}
