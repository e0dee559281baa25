//! Learns the states of an update local day by local day, with the training that is due after each day.
//!
//! The learned data of a map must not depend on how many days one update takes: a recording that is imported at once is
//! learned as it would have been night by night. So each day is scored with the models from after the day before, and
//! models that are trained on readings are trained after the day on which a nightly update would have trained them,
//! within the limits of a night.
//!
//! A row may represent a million readings. So rows are learned up to a local midnight before which they represent no
//! more readings than one update may learn, but at least for one local day. The other rows wait in the model of their
//! state for the next update, which follows at once.
//!
//! Invariant: the result equals that of one update per local day.

use std::{borrow::Cow, collections::BTreeMap, sync::Arc};

use rayon::prelude::*;
use tidemap_grid::pace::Pace;
use tidemap_model::{
    LearnedRows, LocalDay, OffsetCache, Reporting, RowReadings, Sample, StateModel, Surprises, UpdateOutcome,
    choose_together, selector::ModelKind,
};

use super::{RoomInUse, late_rows::AllRows};
use crate::{
    anomaly::learned,
    ids::StateId,
    row_samples::{rows_of, sample_at},
    spec::MapSpec,
    training::{Pupil, StateReadings, Taught, TrainingOutcome, train_due},
};

/// The result of the steps of an update.
pub(super) struct Done {
    /// The outcome of each state; ascending.
    pub(super) outcomes: Vec<(StateId, UpdateOutcome)>,
    /// The outcome of the training.
    pub(super) training: TrainingOutcome,
    /// The local midnight up to which rows are learned, nanoseconds UTC; later rows wait for the next update. `None`:
    /// all are learned.
    pub(super) stop_nanos: Option<i64>,
}

/// How an update learns its states.
pub(super) struct DailySteps<'a> {
    pub(super) spec: &'a MapSpec,
    /// The readings that earlier updates have learned; `None`: no model is trained.
    pub(super) readings: Option<&'a dyn StateReadings>,
    /// For each state that reports changes or events: the time up to which its rows are known to be complete.
    pub(super) horizons: &'a BTreeMap<StateId, i64>,
    /// All rows of the states that are learned anew.
    pub(super) anew: AllRows,
    pub(super) room: &'a RoomInUse,
    /// The states that share one choice of model: the first of each group, and how many there are; ascending.
    pub(super) together: Vec<(StateId, usize)>,
    /// Maximum number of readings that rows represent, except the readings of the first local day, which are all
    /// learned.
    pub(super) readings_max: u64,
    /// Counts the states that are done.
    pub(super) pace: &'a dyn Pace,
}

/// The data of a state in an update.
struct Lesson<'a> {
    id: StateId,
    /// The samples in order of time.
    samples: Cow<'a, [Sample]>,
    /// Number of samples that are learned.
    learned: usize,
    /// Number of samples that this update brings; the others were learned before.
    new: usize,
    /// The readings of the samples, if they are rows of changes or events.
    rows: Option<Rows>,
    outcome: Option<UpdateOutcome>,
}

/// The readings of rows that are still to be learned.
struct Rows {
    reporting: Reporting,
    readings: RowReadings,
    /// The state of learning when all these rows are learned.
    after: LearnedRows,
    offsets: OffsetCache,
    horizon_nanos: i64,
    /// The time up to which rows were learned before, exclusive.
    learned_nanos: i64,
}

/// The lessons of a day, each with the model of its state.
type Class<'a, 'b> = Vec<(&'b mut Lesson<'a>, &'b mut Arc<StateModel>)>;

impl<'a> Lesson<'a> {
    fn new(id: StateId, samples: &'a [Sample]) -> Lesson<'a> {
        let mut samples = Cow::Borrowed(samples);
        if !samples.is_sorted_by_key(|sample| sample.utc_nanos) {
            samples.to_mut().sort_by_key(|sample| sample.utc_nanos);
        }
        let new = samples.len();
        Lesson { id, samples, learned: 0, new, rows: None, outcome: None }
    }

    /// A lesson of all rows of a state, including the new rows.
    fn anew(id: StateId, rows: &'a [Sample], new: usize) -> Lesson<'a> {
        Lesson { new, ..Lesson::new(id, rows) }
    }

    /// Treats the samples as rows that represent readings, where the state reports changes or events. Rows from
    /// `stop_nanos` on wait.
    fn with_rows(self, model: &StateModel, horizon_nanos: i64, stop_nanos: i64, spec: &MapSpec) -> Lesson<'a> {
        let Some(learned) = model.learned_rows() else { return self };
        let (reporting, learned_nanos) = (model.reporting(), learned.next_nanos);
        let rows = rows_of(&self.samples);
        let (readings, after) = learned.clone().learn_before(reporting, rows, horizon_nanos, stop_nanos);
        let (offsets, horizon_nanos) = (spec.zone.offset_cache(), horizon_nanos.min(stop_nanos));
        Lesson { rows: Some(Rows { reporting, readings, after, offsets, horizon_nanos, learned_nanos }), ..self }
    }

    /// The next day that the lesson learns.
    fn day(&mut self) -> Option<LocalDay> {
        match &mut self.rows {
            None => self.samples.get(self.learned).map(Sample::local_day),
            Some(rows) => rows.next_day(),
        }
    }

    /// Takes the samples of the next day. If clocks are set back over midnight, a date that has already ended returns:
    /// this is not a new day.
    fn take(&mut self, day: LocalDay) -> Vec<Sample> {
        if let Some(rows) = &mut self.rows {
            return rows.take(day);
        }
        let rest = self.samples.get(self.learned..).unwrap_or(&[]);
        let length = rest.iter().position(|sample| sample.local_day() > day).unwrap_or(rest.len());
        self.learned += length;
        rest.get(..length).unwrap_or(rest).to_vec()
    }

    fn is_done(&self) -> bool {
        match &self.rows {
            None => self.learned == self.samples.len(),
            Some(rows) => rows.readings.next_nanos().is_none(),
        }
    }

    /// The data that the lesson has taught up to a day that ends at this instant.
    fn taught(&self, end_nanos: i64) -> Taught<'_> {
        match &self.rows {
            None => Taught::samples(self.samples.get(..self.learned).unwrap_or(&[])),
            Some(rows) => {
                let count = self.samples.partition_point(|sample| sample.utc_nanos < end_nanos);
                let horizon_nanos = rows.horizon_nanos.min(end_nanos);
                let is_all = self.new < self.samples.len();
                let samples = self.samples.get(..count).unwrap_or(&[]);
                let end_nanos = end_nanos.max(rows.learned_nanos);
                Taught { samples, is_all, reporting: rows.reporting, horizon_nanos, end_nanos }
            }
        }
    }
}

impl Rows {
    fn next_day(&mut self) -> Option<LocalDay> {
        let nanos = self.readings.next_nanos()?;
        Some(sample_at(&mut self.offsets, (nanos, 0.0)).local_day())
    }

    fn take(&mut self, day: LocalDay) -> Vec<Sample> {
        let mut of_day = Vec::new();
        while self.next_day().is_some_and(|next| next <= day) {
            let reading = self.readings.next();
            of_day.extend(reading.map(|reading| sample_at(&mut self.offsets, reading)));
        }
        of_day
    }
}

/// The lessons of a day with the models of their states; both ascend.
fn of_day<'a, 'b>(day: LocalDay, lessons: &'b mut [Lesson<'a>], models: &'b mut [Arc<StateModel>]) -> Class<'a, 'b> {
    let (mut models, mut passed) = (models.iter_mut(), 0);
    let with_model = |lesson: &'b mut Lesson<'a>| {
        let index = lesson.id.0 as usize;
        let model = models.nth(index.checked_sub(passed)?)?;
        passed = index + 1;
        Some((lesson, model))
    };
    lessons
        .iter_mut()
        .filter_map(|lesson| (lesson.day() == Some(day)).then_some(lesson))
        .filter_map(with_model)
        .collect()
}

/// Chooses one model for states that share a choice; each is given with its choice before the day.
fn choose(before: &[(StateId, usize, ModelKind)], class: &mut Class<'_, '_>) {
    for &(first, count, before) in before {
        let start = class.partition_point(|(lesson, _)| lesson.id < first);
        let parts = class.iter_mut().skip(start).take(count).filter(|(lesson, _)| lesson.id.0 < first.0 + count as u32);
        let mut parts: Vec<&mut StateModel> = parts.map(|(_, model)| Arc::make_mut(*model)).collect();
        choose_together(&mut parts, before);
    }
}

impl DailySteps<'_> {
    /// For the states that share a choice and learn on a day: the choice before the day.
    fn choices(&self, class: &Class<'_, '_>) -> Vec<(StateId, usize, ModelKind)> {
        let chosen = |&(first, count): &(StateId, usize)| {
            let at = class.binary_search_by_key(&first, |(lesson, _)| lesson.id).ok()?;
            Some((first, count, class.get(at)?.1.choice()))
        };
        self.together.iter().filter_map(chosen).collect()
    }

    /// Learns the samples of each state, on the current rayon pool. The states ascend. `models`: of all states.
    ///
    /// # Errors
    /// The state whose sums cannot be read, and why.
    pub(super) fn learn(
        &self,
        states: &[(StateId, Vec<Sample>)],
        models: &mut [Arc<StateModel>],
    ) -> Result<Done, (StateId, String)> {
        let mut lessons = self.lessons(states, models);
        let stop_nanos = self.stop_nanos(&mut lessons, models);
        if let Some(stop_nanos) = stop_nanos {
            lessons.par_iter_mut().for_each(|lesson| self.stop(lesson, models, stop_nanos));
        }
        let mut training = TrainingOutcome::default();
        let mut runs: usize = models.iter().map(|model| model.surprises().runs().len()).sum();
        while let Some(day) = lessons.iter_mut().filter_map(Lesson::day).min() {
            let mut class = of_day(day, &mut lessons, models);
            let runs_of = |class: &Class<'_, '_>| class.iter().map(|(_, model)| model.surprises().runs().len()).sum();
            let runs_before: usize = runs_of(&class);
            let before = self.choices(&class);
            class.par_iter_mut().try_for_each(|(lesson, model)| self.learn_day(day, lesson, model))?;
            choose(&before, &mut class);
            let runs_after: usize = runs_of(&class);
            if let Some(readings) = self.readings {
                training.add(self.train_after(day, class, readings));
            }
            runs = runs.saturating_sub(runs_before).saturating_add(runs_after);
            if runs > learned::MAP_RUNS_MAX {
                runs = learned::bound(models, learned::MAP_RUNS_MAX);
            }
        }
        self.rows_are_learned(&mut lessons, models);
        let outcomes = lessons.into_iter().filter_map(|lesson| Some((lesson.id, lesson.outcome?))).collect();
        Ok(Done { outcomes, training, stop_nanos })
    }

    /// A lesson for each state with observations, and for each state with rows that hold; ascending.
    fn lessons<'b>(&'b self, states: &'b [(StateId, Vec<Sample>)], models: &[Arc<StateModel>]) -> Vec<Lesson<'b>> {
        let with_rows = |lesson: Lesson<'b>| match self.horizons.get(&lesson.id).zip(models.get(lesson.id.0 as usize)) {
            Some((&horizon_nanos, model)) => lesson.with_rows(model, horizon_nanos, i64::MAX, self.spec),
            None => lesson,
        };
        let observed = states.par_iter().map(|(id, samples)| match self.anew.get(id) {
            Some(rows) => with_rows(Lesson::anew(*id, rows, samples.len())),
            None => with_rows(Lesson::new(*id, samples)),
        });
        let mut lessons: Vec<Lesson<'b>> = observed.collect();
        let has_observations = |id: &StateId| states.binary_search_by_key(id, |(state, _)| *state).is_ok();
        let silent = self.horizons.keys().filter(|id| !has_observations(id));
        lessons.extend(silent.map(|&id| with_rows(Lesson::new(id, &[]))));
        lessons.sort_by_key(|lesson| lesson.id);
        lessons
    }

    /// The time up to which rows are learned, if all their readings are too many for one update: a local midnight, at
    /// the earliest the one after the first reading.
    fn stop_nanos(&self, lessons: &mut [Lesson<'_>], models: &[Arc<StateModel>]) -> Option<i64> {
        let readings_before = |stop_nanos: i64| -> u64 {
            let of_lesson = |lesson: &Lesson<'_>| {
                let (rows, model) = (lesson.rows.as_ref()?, models.get(lesson.id.0 as usize)?);
                let new = rows_of(&lesson.samples);
                let (learned, horizon_nanos) = (model.learned_rows()?, rows.horizon_nanos);
                Some(learned.readings_before(rows.reporting, &new, horizon_nanos, stop_nanos))
            };
            lessons.par_iter().filter_map(of_lesson).sum()
        };
        if readings_before(i64::MAX) <= self.readings_max {
            return None;
        }
        let midnight = |day: i32| self.spec.zone.midnight_nanos(LocalDay(day));
        let ends = |lesson: &Lesson<'_>| {
            let rows = lesson.rows.as_ref()?;
            let newest = lesson.samples.last().map_or(i64::MIN, |sample| sample.utc_nanos);
            Some((rows.readings.next_nanos()?, rows.horizon_nanos.max(newest)))
        };
        let (first, last) = lessons.iter().filter_map(ends).reduce(|all, one| (all.0.min(one.0), all.1.max(one.1)))?;
        // The end of the day that is learned in any case, and the first day with nothing left to learn.
        let (mut within, mut end) = (self.spec.zone.day_of(first).0 + 1, self.spec.zone.day_of(last).0 + 1);
        while end - within > 1 {
            let middle = within + (end - within) / 2;
            if readings_before(midnight(middle)) <= self.readings_max {
                within = middle;
            } else {
                end = middle;
            }
        }
        (midnight(within) <= last).then(|| midnight(within))
    }

    /// Makes the rows of a state from a time on wait.
    fn stop(&self, lesson: &mut Lesson<'_>, models: &[Arc<StateModel>], stop_nanos: i64) {
        let Some((rows, model)) = lesson.rows.as_ref().zip(models.get(lesson.id.0 as usize)) else { return };
        let horizon_nanos = rows.horizon_nanos;
        let before = std::mem::replace(lesson, Lesson::new(lesson.id, &[]));
        *lesson = before.with_rows(model, horizon_nanos, stop_nanos, self.spec);
    }

    /// Stores the time up to which the rows of each state are learned. Rows count as observations; the readings that
    /// they represent do not.
    fn rows_are_learned(&self, lessons: &mut [Lesson<'_>], models: &mut [Arc<StateModel>]) {
        for lesson in lessons {
            let (Some(rows), Some(model)) = (&lesson.rows, models.get_mut(lesson.id.0 as usize)) else { continue };
            if model.learned_rows() != Some(&rows.after) {
                *model = Arc::new(StateModel::clone(model).with_reporting(rows.reporting, rows.after.clone()));
            }
            if lesson.outcome.is_none() {
                // So far the rows represent no reading that could be learned.
                self.pace.add_done(1);
            }
            if lesson.new > 0 {
                let order = model.order();
                let before = UpdateOutcome { order_before: order, order, ..UpdateOutcome::default() };
                lesson.outcome.get_or_insert(before).observations = lesson.new as u64;
            }
        }
    }

    fn learn_day(
        &self,
        day: LocalDay,
        lesson: &mut Lesson<'_>,
        model: &mut Arc<StateModel>,
    ) -> Result<(), (StateId, String)> {
        self.pace.await_turn();
        let periodicities = &self.spec.periodicities;
        if lesson.outcome.is_some() {
            self.room.let_go(model);
        }
        // The model is copied on the first day only: readers hold the model from before the update.
        let model = Arc::make_mut(model);
        model.load(periodicities).map_err(|reason| (lesson.id, reason))?;
        let mut judge = |before: &StateModel, of_day: &[Sample], surprises: &mut Surprises| {
            learned::judge(surprises, before, periodicities, of_day);
        };
        let outcome = model.update_judged(periodicities, self.spec.update_rules(), lesson.take(day), &mut judge);
        match &mut lesson.outcome {
            Some(all) => all.add(&outcome),
            None => lesson.outcome = Some(outcome),
        }
        self.room.take_in(model);
        if lesson.is_done() {
            self.pace.add_done(1);
        }
        Ok(())
    }

    fn train_after(&self, day: LocalDay, class: Class<'_, '_>, readings: &dyn StateReadings) -> TrainingOutcome {
        // This also applies to a day that has not ended: the choice of readings must not depend on the hour of the
        // update.
        let end_nanos = self.spec.zone.midnight_nanos(LocalDay(day.0.saturating_add(1)));
        let mut pupils: Vec<Pupil<'_>> = Vec::with_capacity(class.len());
        for (lesson, model) in class {
            pupils.push(Pupil { id: lesson.id, own: lesson.taught(end_nanos), model });
        }
        train_due(self.spec, end_nanos, &mut pupils, readings, self.pace)
    }
}
