//! A state with a habit: its hidden values, and the readings of a robot.
//!
//! The hidden state is a chain of two values that relaxes to the habit's probability, and jumps where the probability
//! jumps.
//!
//! Invariant: equal habits and seeds give equal worlds; readings are in the order of their times.

use std::collections::BTreeSet;

use jiff::civil::Date;
use rand::{Rng as _, SeedableRng as _, rngs::SmallRng, seq::index};
use tidemap_model::{Sample, UnknownZone};

use super::{
    calendar::{Calendar, SEC_NANOS, STEP_SECS},
    habit::{HABITS, Habit, LookPlan},
};

/// Where the probability changes by at least this much, the state does not keep its value.
const JUMP: f64 = 0.3;
/// A half-hourly reading comes this many seconds after a step begins.
const LOOK_SECS: i64 = 37;
/// Steps of a half-hour.
const HALF_HOUR: usize = 3;
/// Readings of a burst, one a second.
const BURST: i64 = 3_600;

/// A reading of the state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Look {
    /// The step in which it was taken.
    pub(super) step: usize,
    /// The value of the reading, and its time.
    pub(super) sample: Sample,
}

/// A state from the first day until the last one that is predicted.
#[derive(Clone, Debug)]
pub(super) struct HabitWorld {
    pub(super) calendar: Calendar,
    /// By step, the probability of 1 by the habit.
    pub(super) truth: Vec<f64>,
    /// By step, the value.
    pub(super) values: Vec<bool>,
    /// By time.
    pub(super) looks: Vec<Look>,
}

impl HabitWorld {
    /// The world of a habit and seed.
    pub(super) fn new(habit: &Habit, seed: u64) -> Result<HabitWorld, UnknownZone> {
        let place = HABITS.iter().position(|known| known.name == habit.name).unwrap_or_default() as u64;
        let mut random = SmallRng::seed_from_u64(seed ^ place.rotate_right(8));
        let calendar = Calendar::until(habit.test.1)?;
        let truth = truth(habit, &calendar, &mut random);
        let values = values(&truth, habit.keeps_minutes, &mut random);
        let looks = places(habit.looks, &calendar, &mut random);
        let looks = looks.into_iter().filter_map(|(from, secs)| {
            let step = from + (secs / STEP_SECS) as usize;
            let (start, seen) = (calendar.steps.get(from)?, calendar.steps.get(step)?);
            let utc_nanos = start.utc_nanos + secs * SEC_NANOS;
            let value = f64::from(u8::from(*values.get(step)?));
            Some(Look { step, sample: Sample { utc_nanos, offset_secs: seen.offset_secs, value } })
        });
        Ok(HabitWorld { looks: looks.collect(), truth, values, calendar })
    }

    /// The numbers of the days that are predicted.
    pub(super) fn first_test_day(&self, habit: &Habit) -> usize {
        self.calendar.number_of(habit.test.0)
    }

    /// The readings in the steps of a day.
    pub(super) fn looks_of(&self, day: usize) -> &[Look] {
        let steps = &self.calendar.days[day].steps;
        let before = |step: usize| self.looks.partition_point(|look| look.step < step);
        &self.looks[before(steps.start)..before(steps.end)]
    }
}

fn truth(habit: &Habit, calendar: &Calendar, random: &mut SmallRng) -> Vec<f64> {
    let mut truth = vec![habit.base; calendar.steps.len()];
    for (number, day) in calendar.days.iter().enumerate() {
        for span in (habit.spans)(day, random) {
            let next = calendar.days.get(number + 1).map_or(0..0, |next| next.steps.clone());
            for step in day.steps.clone() {
                if (span.from..span.until).contains(&calendar.steps[step].hour) {
                    truth[step] = span.probability;
                }
            }
            for step in next.take_while(|&step| calendar.steps[step].hour < span.until - 24.0) {
                truth[step] = span.probability;
            }
        }
    }
    truth
}

fn values(truth: &[f64], keeps_minutes: f64, random: &mut SmallRng) -> Vec<bool> {
    let keeps = (-(STEP_SECS as f64) / 60.0 / keeps_minutes).exp();
    let mut values: Vec<bool> = Vec::with_capacity(truth.len());
    for (step, &p) in truth.iter().enumerate() {
        let (fresh, kept): (f64, f64) = (random.random(), random.random());
        let before = values.last().filter(|_| kept < keeps && (p - truth[step - 1]).abs() < JUMP);
        values.push(before.copied().unwrap_or(fresh < p));
    }
    values
}

/// The places of the readings: each as a step and seconds since the step began.
fn places(looks: LookPlan, calendar: &Calendar, random: &mut SmallRng) -> Vec<(usize, i64)> {
    let half_hourly = |first: usize, is_seen: &dyn Fn(Date) -> bool| {
        let seen = |&step: &usize| is_seen(calendar.days[calendar.steps[step].day].date);
        (first..calendar.steps.len()).step_by(HALF_HOUR).filter(seen).map(|step| (step, LOOK_SECS)).collect()
    };
    match looks {
        LookPlan::HalfHourly => half_hourly(random.random_range(0..HALF_HOUR), &|_| true),
        LookPlan::HalfHourlyExcept(from, until) => {
            half_hourly(random.random_range(0..HALF_HOUR), &|date| date < from || date >= until)
        }
        LookPlan::ThreeAWeek => calendar
            .days
            .chunks(7)
            .flat_map(|week| {
                let days: BTreeSet<usize> = index::sample(random, week.len(), week.len().min(3)).into_iter().collect();
                let looks = days.into_iter().map(|day| any_step(calendar, week[day].number, 7.0..21.0, random));
                looks.map(|step| (step, LOOK_SECS)).collect::<Vec<_>>()
            })
            .collect(),
        LookPlan::Bursts => (0..calendar.days.len())
            .flat_map(|day| {
                let first = any_step(calendar, day, 7.0..20.0, random);
                (0..BURST).map(move |secs| (first, secs))
            })
            .collect(),
    }
}

/// Any step of a day between two hours, at which clocks never change.
fn any_step(calendar: &Calendar, day: usize, hours: std::ops::Range<f64>, random: &mut SmallRng) -> usize {
    let steps = calendar.days[day].steps.clone().filter(|&step| hours.contains(&calendar.steps[step].hour));
    let steps: Vec<usize> = steps.collect();
    steps[random.random_range(0..steps.len())]
}
