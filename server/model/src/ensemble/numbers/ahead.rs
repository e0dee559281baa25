//! What answers two days ahead, a week, four weeks, a quarter, a year: a stack for each.
//!
//! The readings of the days between are not known, so a stack joins tables, and what the same days of the last
//! fortnight left over. Tables are taken with the means that they had as long before: so the stacks learn how long a
//! table that forgets is of use, and their errors are those of predictions so far ahead. What was said within so many
//! days is one piece of evidence. A stack that was not yet judged takes over what the shorter one says, without what
//! has a window. Invariant: the farther ahead, the wider; a class that was not judged is as wide as the values of the
//! state differ.

use super::super::looks::{DayLooks, SLOTS};
use super::SLOW;
use super::members::{Pool, pooled};
use super::spread::{Spread, Squares, hour_errors, shrunk};
use super::stack::LinearStack;
use super::table::{HALF_LIVES_DAYS, Levels, RECENT, Shapes};
use crate::{LocalDay, hours_seen::HOURS};

/// The shortest time ahead of each class, in days.
const AHEAD_DAYS: [i64; CLASSES] = [2, 7, 28, 91, 364];
pub(super) const CLASSES: usize = 5;
/// Features: weekday table, tables that forget, the model of all history, what the newest same weekday and the newest
/// day of the same fortnight left over.
pub(super) const FEATURES: usize = RECENT + 4;
/// Their weights before any look, two days ahead.
const WEIGHTS: [f64; FEATURES] = [0.0, 0.25, 0.25, 0.0, 0.0, 0.0, 0.0];
/// See [`knows_repeated`].
const REPEATED_CLASSES: usize = 2;
/// Members of a class, and their weights before any look.
pub(super) const MEMBERS: usize = 3;
const PRIORS: [f64; MEMBERS] = [1.0, 0.5, 3.0];
/// A table that forgets speaks for about so many of its half-lives ahead, unjudged.
const WINDOWS: f64 = 4.0;
/// How many hours the variance of all looks counts as, for each day ahead.
const FIRST_HOURS: f64 = 48.0;

/// A class of the time ahead.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FarStack {
    pub(super) stack: LinearStack<FEATURES>,
    pub(super) pool: Pool<MEMBERS>,
    /// Of the means of hours.
    pub(super) errors: Squares,
    /// The two last turns of the class, the newer first.
    pub(super) kept_days: [Option<LocalDay>; 2],
    /// The means of the tables at these.
    pub(super) kept: [Levels; 2],
}

/// The classes.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FarStacks {
    pub(super) classes: [FarStack; CLASSES],
}

/// What the members of a class say of a day by half-hour: the table of all history, the model of all history, the
/// stack.
#[derive(Clone, Debug)]
pub(super) struct AheadMembers {
    pub(super) values: [[f64; SLOTS]; MEMBERS],
    features: [[f64; FEATURES]; SLOTS],
}

/// The class of a time ahead in days; `None` below the first.
pub(super) fn class_of(days: i64) -> Option<usize> {
    AHEAD_DAYS.iter().rposition(|&shortest| days >= shortest)
}

/// Whether a class knows of the last fortnight; before that, looks are forgotten.
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

    /// The weights of a class that was not judged.
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

    /// How much the members of a class count; one that was not judged takes over the weights of the shorter.
    pub(super) fn pool_weights(&self, class: usize) -> [f64; MEMBERS] {
        match class.checked_sub(1).filter(|_| !self.is_judged(class)) {
            Some(shorter) => self.pool_weights(shorter),
            None => self.classes[class].pool.weights(PRIORS, AHEAD_DAYS[class] as f64),
        }
    }

    /// What the members of a class say. `levels`: the means of the tables when it is said; `lasting`: the model of all
    /// history; `repeated`: what the same days before left over, if [`knows_repeated`].
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
        let mut said = AheadMembers { values: [base, *lasting, base], features: [[0.0; FEATURES]; SLOTS] };
        for (slot, x) in said.features.iter_mut().enumerate() {
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
            said.values[MEMBERS - 1][slot] += x.iter().zip(&weights).map(|(x, weight)| x * weight).sum::<f64>();
        }
        said
    }

    /// The means of the tables that a class has kept for long enough on a day, and for how many days.
    pub(super) fn kept(&self, class: usize, day: LocalDay) -> Option<(Levels, i64)> {
        let days = i64::from(day.0) - i64::from(self.classes[class].kept_days[1]?.0);
        (days >= AHEAD_DAYS[class]).then(|| (self.classes[class].kept[1], days))
    }

    /// Judges what the members of a class would have said long before a day by the day's looks, and learns from it.
    pub(super) fn judge(&mut self, class: usize, looks: &DayLooks, said: &AheadMembers, variance: f64) {
        let forecast = pooled(&said.values, self.pool_weights(class));
        let (towards, days) = (self.unjudged(class), AHEAD_DAYS[class] as f64);
        let known = &mut self.classes[class];
        known.errors = known.errors.map(|sum| SLOW * sum);
        for (_, square) in hour_errors(looks, &forecast) {
            known.errors[0] += square;
            known.errors[1] += 1.0;
        }
        known.pool.learn(&said.values, looks);
        let targets = looks.seen().map(|(slot, value)| (&said.features[slot], value - said.values[0][slot]));
        known.stack.learn_towards(targets, variance, towards, days);
    }

    /// Keeps the means of the tables at the end of a day, for the classes of which days since `last` include the turn.
    pub(super) fn keep(&mut self, last: Option<LocalDay>, day: LocalDay, levels: Levels) {
        let turn = |day: LocalDay, days: i64| i64::from(day.0).div_euclid(days);
        for (class, days) in self.classes.iter_mut().zip(AHEAD_DAYS) {
            if last.is_none_or(|last| turn(last, days) != turn(day, days)) {
                (class.kept_days, class.kept) = ([Some(day), class.kept_days[0]], [levels, class.kept[0]]);
            }
        }
    }

    /// How much wider predictions so many days ahead are than those of the next day, at least 1. `of_looks`: the
    /// variance of all looks.
    pub(super) fn growth(&self, days: i64, near: &Spread, of_looks: f64) -> f64 {
        let of_near = near.of_all(of_looks);
        let mut widest = of_near;
        for (class, known) in self.classes.iter().enumerate().take(class_of(days).map_or(0, |class| class + 1)) {
            let days = AHEAD_DAYS[class] as f64;
            let found = shrunk(known.errors, of_looks.max(widest), FIRST_HOURS * days);
            let independent = known.errors[1] / (HOURS as f64 * days);
            widest = widest.max(found * (1.0 + 1.0 / independent.max(1.0)));
        }
        if of_near > 0.0 { widest / of_near } else { 1.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_ahead_have_classes() {
        let found = [0, 1, 2, 6, 7, 27, 28, 91, 364, 9_999].map(class_of);
        let expected = [None, None, Some(0), Some(0), Some(1), Some(1), Some(2), Some(3), Some(4), Some(4)];
        assert_eq!(found, expected);
    }

    #[test]
    fn a_table_that_forgets_does_not_speak_far_ahead_unjudged() {
        let ahead = FarStacks::new();
        let [near, far] = [0, CLASSES - 1].map(|class| ahead.weights(class));
        assert_eq!(near, WEIGHTS);
        assert!(far[1..4].iter().all(|weight| weight.abs() < 0.02), "{far:?}");
    }
}
