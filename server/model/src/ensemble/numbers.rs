//! An ensemble of members that predict the half-hour bins of one state of continuous values or counts.
//!
//! The members are tables by hour of the day, of weekdays or the weekend and of the week, some of which forget within
//! days; the residuals of the last days; the model that the nightly update chose; and two linear stacks of all of these
//! ([`stack`]). They are weighted by how well each predicted days before these were learned. At lead times of more than
//! a day stacks of the tables alone predict ([`ahead`]), because there are no readings of the days between.
//!
//! Invariant: the learned data is a function of the bins and their days, as long as days come in order and are not
//! split. The unit does not matter: values times a factor, plus a constant, give predictions times the factor, plus the
//! constant. So values are kept relative to the first reading, and errors are compared with errors only.

mod ahead;
mod fields;
mod members;
mod spread;
mod stack;
mod table;

use ahead::{AheadMembers, FarStacks};
use members::{DayMembers, MEMBERS, PRIORS, Pool, pooled};
use spread::Spread;
use stack::LinearStack;
use table::{Levels, Shapes, Tables};

use super::bins::{DayBins, SLOTS, slot_at};
use crate::special::square;
use crate::{LocalDay, Sample, models::Moment, models::TemporalModel};

/// The shares of their sums that the stacks keep after each further observed day.
const SLOW: f64 = 0.985;
const FAST: f64 = 0.94;
/// Number of days of which the bins are kept.
const RECALL_DAYS: usize = 14;

/// The models that an ensemble needs beside its own members.
#[derive(Clone, Copy)]
pub struct OtherModels<'a> {
    /// The model that the update chose.
    pub chosen: &'a dyn TemporalModel,
    /// A model of all history, which predicts at long lead times as well as at short ones.
    pub lasting: &'a dyn TemporalModel,
    /// The map names the year as a period.
    pub expects_year: bool,
}

/// The bins of one day.
#[derive(Clone, Copy, Debug, PartialEq)]
struct SeenDay {
    /// One bit for each half-hour: it has a reading.
    seen: u64,
    values: [f64; SLOTS],
}

const UNSEEN: SeenDay = SeenDay { seen: 0, values: [0.0; SLOTS] };

/// Number and mean of all bins, and the sum of their squared deviations.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct BinScatter {
    bins: f64,
    mean: f64,
    squares: f64,
}

impl BinScatter {
    fn add(&mut self, value: f64) {
        self.bins += 1.0;
        let deviation = value - self.mean;
        self.mean += deviation / self.bins;
        self.squares += deviation * (value - self.mean);
    }

    fn variance(&self) -> f64 {
        self.squares / self.bins.max(1.0)
    }
}

/// An ensemble of one state of continuous values or counts.
#[derive(Clone, Debug, PartialEq)]
pub struct NumberEnsemble {
    /// The first reading; all other values are relative to it.
    origin: f64,
    last: Option<LocalDay>,
    scatter: BinScatter,
    tables: Tables,
    /// Indexed by the day's number modulo [`RECALL_DAYS`].
    recall: [SeenDay; RECALL_DAYS],
    stacks: [LinearStack<{ members::FEATURES }>; 2],
    pool: Pool<MEMBERS>,
    spread: Spread,
    ahead: FarStacks,
    /// The day that is about to be learned; between updates there is none.
    prepared: Option<Box<PreparedDay>>,
}

/// The predictions for a day before it is learned.
#[derive(Clone, Debug, PartialEq)]
struct PreparedDay {
    day: LocalDay,
    /// The predictions of the members; `None` unless the day before was learned.
    members: Option<DayMembers>,
    forecast: [f64; SLOTS],
}

/// The forecasts for a day that do not depend on the lead time.
#[derive(Clone, Debug)]
struct KnownAhead {
    day: LocalDay,
    shapes: Shapes,
    /// The predictions of the model of all history.
    lasting: [f64; SLOTS],
}

impl Default for NumberEnsemble {
    fn default() -> NumberEnsemble {
        NumberEnsemble {
            origin: 0.0,
            last: None,
            scatter: BinScatter::default(),
            tables: Tables::new(),
            recall: [UNSEEN; RECALL_DAYS],
            stacks: [SLOW, FAST].map(|kept| LinearStack::new(kept, members::WEIGHTS)),
            pool: Pool::new(),
            spread: Spread::new(),
            ahead: FarStacks::new(),
            prepared: None,
        }
    }
}

impl NumberEnsemble {
    /// The last learned day.
    pub fn last_day(&self) -> Option<LocalDay> {
        self.last
    }

    /// The mean of all bins; 0 without any.
    pub fn mean(&self) -> f64 {
        self.origin + self.scatter.mean
    }

    /// Predicts a day that is about to be learned, once for all callers that score its readings. The first day, and a
    /// day that is not newer than all learned days, is not predicted.
    pub fn prepare(&mut self, day: LocalDay, others: OtherModels<'_>) {
        let Some(last) = self.last.filter(|&last| day > last) else { return };
        if self.prepared.as_ref().is_some_and(|known| known.day == day) {
            return;
        }
        self.tables.pass(f64::from(day.0) - f64::from(last.0) - 1.0);
        let members = (self.days_ahead(day) == 1).then(|| self.members(day, others.chosen));
        let forecast = match &members {
            Some(members) => self.pooled(members),
            None => self.forecast_ahead(day, others),
        };
        self.prepared = Some(Box::new(PreparedDay { day, members, forecast }));
    }

    /// Learns a local day: scores all members on its bins, then adds the bins. A day that is not newer than all learned
    /// days is added without scoring. `samples`: the readings of the day in order of time; `others`: the models as they
    /// were before the day. Returns the sum of the squared errors of the predictions for `newer`, the samples that no
    /// earlier day has; `None` where the day was not predicted.
    pub fn learn_day(
        &mut self,
        day: LocalDay,
        samples: &[Sample],
        newer: &[Sample],
        others: OtherModels<'_>,
    ) -> Option<f64> {
        let first = samples.first()?;
        if self.last.is_none() {
            self.origin = first.value;
        }
        self.prepare(day, others);
        let relative = |sample: &Sample| Sample { value: sample.value - self.origin, ..*sample };
        let bins = DayBins::of_samples(&samples.iter().map(relative).collect::<Vec<_>>());
        let Some(prepared) = self.prepared.take() else {
            self.add(day, &bins);
            return None;
        };
        let error =
            |sample: &Sample| square(self.origin + prepared.forecast[slot_at(sample.civil_nanos())] - sample.value);
        let error = newer.iter().map(error).sum();
        let variance = self.scatter.variance();
        if let Some(members) = &prepared.members {
            for stack in &mut self.stacks {
                let targets = bins.seen().map(|(slot, value)| (&members.features[slot], value - members.base[slot]));
                stack.learn(targets, variance);
            }
            self.pool.learn(&members.values, &bins);
            self.spread.learn(day, &bins, &prepared.forecast);
        }
        let known = self.known_ahead(day, others);
        for class in 0..ahead::CLASSES {
            // The forecasts that the class would have made at its lead time before the day.
            if let Some((levels, days)) = self.ahead.kept(class, day) {
                let stored = self.stored_ahead(class, &known, days, &levels);
                self.ahead.judge(class, &bins, &stored, variance);
            }
        }
        self.add(day, &bins);
        Some(error)
    }

    /// Adds bins without scoring.
    fn add(&mut self, day: LocalDay, bins: &DayBins) {
        let last = self.last;
        let age_days = last.map_or(0.0, |last| (f64::from(last.0) - f64::from(day.0)).max(0.0));
        self.tables.add(day.weekday(), bins, last.is_some_and(|last| day > last), age_days);
        bins.seen().for_each(|(_, value)| self.scatter.add(value));
        let newest = last.is_none_or(|last| day > last);
        if newest {
            // The days between have no bins.
            let passed = last.map_or(RECALL_DAYS as i64, |last| i64::from(day.0) - i64::from(last.0));
            for back in 0..passed.min(RECALL_DAYS as i64) {
                self.recall[place(day, back as i32)] = UNSEEN;
            }
            self.last = Some(day);
        }
        if age_days < RECALL_DAYS as f64 {
            let kept = &mut self.recall[place(day, 0)];
            for (slot, value) in bins.seen() {
                kept.seen |= 1 << slot;
                kept.values[slot] = value;
            }
        }
        if newest {
            self.ahead.keep(last, day, self.tables.levels());
        }
    }

    /// Number of days from the last learned day to a day; for an earlier day, number of days back to it.
    fn days_ahead(&self, day: LocalDay) -> i64 {
        self.last.map_or(0, |last| (i64::from(day.0) - i64::from(last.0)).abs())
    }

    /// The bins of a day; `None` if they are forgotten.
    fn seen(&self, day: LocalDay) -> Option<&SeenDay> {
        let age = i64::from(self.last?.0) - i64::from(day.0);
        (0..RECALL_DAYS as i64).contains(&age).then(|| &self.recall[place(day, 0)])
    }

    fn forecast(&self, day: LocalDay, others: OtherModels<'_>) -> [f64; SLOTS] {
        match &self.prepared {
            Some(prepared) if prepared.day == day => prepared.forecast,
            _ if self.days_ahead(day) <= 1 => self.pooled(&self.members(day, others.chosen)),
            _ => self.forecast_ahead(day, others),
        }
    }

    fn pooled(&self, members: &DayMembers) -> [f64; SLOTS] {
        pooled(&members.values, self.pool.weights(PRIORS, 1.0))
    }

    fn known_ahead(&self, day: LocalDay, others: OtherModels<'_>) -> KnownAhead {
        let lasting = members::at_slots(day, |at| others.lasting.predict(at) - self.origin);
        KnownAhead { day, shapes: self.tables.shapes(day.weekday()), lasting }
    }

    /// The forecasts of the members of a lead-time class at a lead time of `days`. `levels`: the means of the tables
    /// when the forecasts are made.
    fn stored_ahead(&self, class: usize, known: &KnownAhead, days: i64, levels: &Levels) -> AheadMembers {
        let repeated = ahead::knows_repeated(class).then(|| self.repeated(known.day, days));
        self.ahead.members(class, &known.shapes, levels, &known.lasting, repeated.as_ref())
    }

    fn forecast_ahead(&self, day: LocalDay, others: OtherModels<'_>) -> [f64; SLOTS] {
        let days = self.days_ahead(day);
        let class = ahead::class_of(days).unwrap_or(0);
        let stored = self.stored_ahead(class, &self.known_ahead(day, others), days, &self.tables.levels());
        pooled(&stored.values, self.ahead.pool_weights(class))
    }

    /// Predictions at moments; faster if the moments are in order of time, because each day is then forecast once.
    pub fn predict(&self, moments: &[Moment], others: OtherModels<'_>) -> Vec<f64> {
        let mut of_day: Option<(LocalDay, [f64; SLOTS])> = None;
        let predict = |&at: &Moment| {
            let day = LocalDay::of_civil_nanos(at.civil_nanos());
            let forecast = match of_day {
                Some((known, forecast)) if known == day => forecast,
                _ => self.forecast(day, others),
            };
            of_day = Some((day, forecast));
            self.origin + forecast[slot_at(at.civil_nanos())]
        };
        moments.iter().map(predict).collect()
    }

    /// The expected squared distance of the mean of the hour around a moment from its prediction, at least 0.
    pub fn variance(&self, at: Moment) -> f64 {
        let day = LocalDay::of_civil_nanos(at.civil_nanos());
        let of_all = self.scatter.variance();
        let near = self.spread.variance(day, slot_at(at.civil_nanos()), of_all);
        near * self.ahead.growth(self.days_ahead(day), &self.spread, of_all)
    }
}

/// The index of the day that is `back` days before a day.
fn place(day: LocalDay, back: i32) -> usize {
    day.0.saturating_sub(back).rem_euclid(RECALL_DAYS as i32) as usize
}
