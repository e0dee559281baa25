//! Baselines: predictions that anybody can make with a table, and that tidemap has to beat.
//!
//! Invariant: a prediction uses readings of earlier days only. Each reading counts once.

use super::{calendar::Calendar, world::Look};
use crate::tally::{Tally, WEEK_HOURS, bounded};

/// The names of the baselines, in the order of [`Baselines::predict`].
pub const BASELINES: [&str; 5] =
    ["hour of week", "hour of weekday or weekend", "hour of week, fading", "last week", "yesterday"];
/// Steps of a day and of a week.
const DAY_STEPS: usize = 144;
const WEEK_STEPS: usize = 7 * DAY_STEPS;
/// If a step has no reading, these steps around it are tried in turn.
const AROUND: [isize; 7] = [0, -1, 1, -2, 2, -3, 3];

/// The baselines of one state.
#[derive(Clone, Debug)]
pub(super) struct Baselines {
    all: Tally,
    hours: Vec<Tally>,
    kinds: Vec<Tally>,
    fading: Vec<Tally>,
    /// The last reading of each step; steps that were not learned have none.
    values: Vec<Option<f64>>,
}

impl Baselines {
    /// Baselines without readings, for the steps of a calendar.
    pub(super) fn new(calendar: &Calendar) -> Self {
        let week = vec![Tally::default(); WEEK_HOURS];
        Self {
            all: Tally::default(),
            hours: week.clone(),
            kinds: vec![Tally::default(); 48],
            fading: week,
            values: vec![None; calendar.steps.len()],
        }
    }

    /// The probability of 1 at a step, by each of [`BASELINES`]. `ahead_days`: the lead time, at least 1.
    pub(super) fn predict(&self, calendar: &Calendar, step: usize, ahead_days: u32) -> [f64; BASELINES.len()] {
        let weeks = ahead_days.div_ceil(7).max(1) as usize;
        let hour = calendar.hour_of_week(step);
        [
            self.hours[hour].laplace(),
            self.kinds[kind_of(hour)].laplace(),
            self.fading[hour].shrunk(self.all.laplace()),
            self.before(step, weeks * WEEK_STEPS),
            self.before(step, DAY_STEPS),
        ]
    }

    /// The reading this many steps before.
    fn before(&self, step: usize, steps: usize) -> f64 {
        let Some(then) = step.checked_sub(steps) else { return bounded(self.all.laplace()) };
        let seen = |around: isize| self.values.get(then.checked_add_signed(around)?).copied().flatten();
        bounded(AROUND.into_iter().find_map(seen).unwrap_or_else(|| self.all.laplace()))
    }

    /// Learns the readings of a day.
    pub(super) fn learn(&mut self, calendar: &Calendar, looks: &[Look]) {
        for tally in &mut self.fading {
            *tally = tally.a_day_later();
        }
        for look in looks {
            let (hour, value) = (calendar.hour_of_week(look.step), look.sample.value);
            for tally in [&mut self.all, &mut self.hours[hour], &mut self.kinds[kind_of(hour)], &mut self.fading[hour]]
            {
                tally.add(value);
            }
            self.values[look.step] = Some(value);
        }
    }
}

/// The hour of the day, from 24 on of a weekend.
fn kind_of(hour_of_week: usize) -> usize {
    hour_of_week % 24 + if hour_of_week >= 5 * 24 { 24 } else { 0 }
}
