//! The states of an update, learned local day by local day, with the training that is due after each day.
//!
//! What a map knows must not depend on how many days one update takes: a recording that is imported at once is learned
//! as it would have been night by night. So each day is scored with the models as they were after the day before, and
//! models that are trained on readings are trained after the day on which a nightly update would have trained them,
//! within the limits of a night.
//!
//! Invariant: the result is that of one update a local day.

use std::{
    borrow::Cow,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use rayon::prelude::*;
use tidemap_model::{LocalDay, Sample, StateModel, Surprises, UpdateOutcome};

use super::RoomInUse;
use crate::{
    anomaly::learned,
    ids::StateId,
    spec::MapSpec,
    training::{Pupil, StateReadings, TrainingOutcome, train_due},
};

/// What each state was taught, and what was trained.
type Done = (Vec<(StateId, UpdateOutcome)>, TrainingOutcome);

/// How an update learns its states.
pub(super) struct DailySteps<'a> {
    pub(super) spec: &'a MapSpec,
    /// What earlier updates have learned; `None`: nothing is trained.
    pub(super) readings: Option<&'a dyn StateReadings>,
    pub(super) room: &'a RoomInUse,
    /// Counts the states that are done.
    pub(super) progress: &'a AtomicU64,
}

/// What an update has of a state.
struct Lesson<'a> {
    id: StateId,
    /// In order of time.
    samples: Cow<'a, [Sample]>,
    /// How many of them are learned.
    learned: usize,
    outcome: Option<UpdateOutcome>,
}

/// The lessons of a day, each with the model of its state.
type Class<'a, 'b> = Vec<(&'b mut Lesson<'a>, &'b mut Arc<StateModel>)>;

impl<'a> Lesson<'a> {
    fn new((id, samples): &'a (StateId, Vec<Sample>)) -> Lesson<'a> {
        let mut samples = Cow::Borrowed(samples.as_slice());
        if !samples.is_sorted_by_key(|sample| sample.utc_nanos) {
            samples.to_mut().sort_by_key(|sample| sample.utc_nanos);
        }
        Lesson { id: *id, samples, learned: 0, outcome: None }
    }

    /// The next day that it learns.
    fn day(&self) -> Option<LocalDay> {
        self.samples.get(self.learned).map(Sample::local_day)
    }

    /// Takes the samples of the next day. Clocks set back over midnight return to a date that has already ended: this
    /// is not a new day.
    fn take(&mut self, day: LocalDay) -> Vec<Sample> {
        let rest = self.samples.get(self.learned..).unwrap_or(&[]);
        let length = rest.iter().position(|sample| sample.local_day() > day).unwrap_or(rest.len());
        self.learned += length;
        rest.get(..length).unwrap_or(rest).to_vec()
    }

    fn is_done(&self) -> bool {
        self.learned == self.samples.len()
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
    lessons.iter_mut().filter(|lesson| lesson.day() == Some(day)).filter_map(with_model).collect()
}

impl DailySteps<'_> {
    /// Learns the samples of each state, on the current rayon pool. The states ascend. `models`: of all states.
    ///
    /// # Errors
    /// The state whose sums cannot be read, and why.
    pub(super) fn learn(
        &self,
        states: &[(StateId, Vec<Sample>)],
        models: &mut [Arc<StateModel>],
    ) -> Result<Done, (StateId, String)> {
        let mut lessons: Vec<Lesson<'_>> = states.par_iter().map(Lesson::new).collect();
        let mut training = TrainingOutcome::default();
        let mut runs: usize = models.iter().map(|model| model.surprises().runs().len()).sum();
        while let Some(day) = lessons.iter().filter_map(Lesson::day).min() {
            let mut class = of_day(day, &mut lessons, models);
            let runs_of = |class: &Class<'_, '_>| class.iter().map(|(_, model)| model.surprises().runs().len()).sum();
            let runs_before: usize = runs_of(&class);
            class.par_iter_mut().try_for_each(|(lesson, model)| self.learn_day(day, lesson, model))?;
            let runs_after: usize = runs_of(&class);
            if let Some(readings) = self.readings {
                training.add(self.train_after(day, class, readings));
            }
            runs = runs.saturating_sub(runs_before).saturating_add(runs_after);
            if runs > learned::MAP_RUNS_MAX {
                runs = learned::bound(models, learned::MAP_RUNS_MAX);
            }
        }
        let done = lessons.into_iter().filter_map(|lesson| Some((lesson.id, lesson.outcome?))).collect();
        Ok((done, training))
    }

    fn learn_day(
        &self,
        day: LocalDay,
        lesson: &mut Lesson<'_>,
        model: &mut Arc<StateModel>,
    ) -> Result<(), (StateId, String)> {
        let periodicities = &self.spec.periodicities;
        if lesson.outcome.is_some() {
            self.room.let_go(model);
        }
        // Copied on the first day alone: readers have the model of before.
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
            self.progress.fetch_add(1, Ordering::Relaxed);
        }
        Ok(())
    }

    fn train_after(&self, day: LocalDay, class: Class<'_, '_>, readings: &dyn StateReadings) -> TrainingOutcome {
        let mut pupils: Vec<Pupil<'_>> = Vec::with_capacity(class.len());
        for (lesson, model) in class {
            pupils.push(Pupil { id: lesson.id, own: lesson.samples.get(..lesson.learned).unwrap_or(&[]), model });
        }
        // Also of a day that has not ended: which readings are kept must not depend on the hour of the update.
        let end_nanos = self.spec.zone.midnight_nanos(LocalDay(day.0.saturating_add(1)));
        train_due(self.spec, end_nanos, &mut pupils, readings)
    }
}
