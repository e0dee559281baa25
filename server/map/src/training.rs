//! Trains models again after each local day of an update, on the readings that updates have learned.
//!
//! The calibrated model, the rate of counts, the periodic mixture and warped hypertime are due after seven observed
//! days, seven days after they were last trained, and when the change alarm has been raised since. Each is trained on
//! the last twelve weeks. Starting one week after an alarm, models are trained only on data from three days before the
//! alarm onwards. For each kind, the models that have waited longest go first, and a limited number is trained after a
//! day ([`trainings_max`]), so that a costly kind does not delay another. In maps without history of named states, no
//! model is trained.
//!
//! Invariant: the training depends only on the readings, the models and the map's properties: an update that is
//! repeated from the same history trains the same models. If readings cannot be read, their models stay unchanged, and
//! the rest of the update goes on.

use std::{collections::BTreeMap, fmt, sync::Arc};

use rayon::prelude::*;
use tidemap_grid::{pace::Pace, spec::Retention};
use tidemap_model::{
    Hold, LocalDay, OffsetCache, Reporting, Sample, StateModel, TrainedModel,
    catalogue::{ModelKind, NIGHTLY_WINDOW_NANOS, TrainingCost},
    models::{CannotTrain, Readings},
};

use crate::{event::StateKind, ids::StateId, row_samples::samples_of, spec::MapSpec};

#[cfg(test)]
mod tests;

/// Maximum number of models of a kind that are trained after a day: as many as take a few minutes, so that a night with
/// very many states ends. The models that have waited longest go first; the others wait for the next day with data of
/// their states.
#[must_use]
pub(crate) fn trainings_max(kind: ModelKind) -> usize {
    match kind.cost() {
        Some(TrainingCost::Low) => 2_000,
        Some(TrainingCost::Medium) => 1_000,
        Some(TrainingCost::High) => 100,
        None => 0,
    }
}

const SEC_NANOS: i64 = 1_000_000_000;
const DAY_NANOS: i64 = 86_400 * SEC_NANOS;

/// Approximate maximum number of readings on which a model is trained: a state with more frequent readings is trained
/// on fewer days. The states whose readings add up to this are in memory at once, with those of the next batch: 200 MB.
pub const TRAINING_READINGS: u64 = 4_000_000;

/// The readings to fetch for a state: the readings at this instant and later.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReadingsRequest {
    /// The state.
    pub state: StateId,
    /// The first instant, nanoseconds UTC.
    pub from_nanos: i64,
}

/// A source of the readings that updates have learned.
pub trait StateReadings: fmt::Debug + Send + Sync {
    /// The readings that earlier updates have learned of each of these states: one list per entry of `wanted`,
    /// ascending by time; readings with equal times are in the order of the updates, then of arrival.
    ///
    /// # Errors
    /// The reason why they cannot be read.
    fn readings(&self, wanted: &[ReadingsRequest]) -> Result<Vec<Vec<Sample>>, String>;
}

/// The outcome of the training of models that were due.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TrainingOutcome {
    /// Models that were trained.
    pub trained: u64,
    /// Models that wait after the last day, because at most [`trainings_max`] of their kind are trained.
    pub waiting: u64,
    /// States that keep their models, because their readings could not be read.
    pub failed: u64,
    /// The reason why the readings of the first of these states could not be read.
    pub failure: Option<String>,
}

impl TrainingOutcome {
    /// Adds the outcome of the training after a later day.
    pub(crate) fn add(&mut self, later: TrainingOutcome) {
        self.trained += later.trained;
        self.waiting = later.waiting;
        self.failed += later.failed;
        self.failure = self.failure.take().or(later.failure);
    }
}

/// A state that has learned a day.
pub(crate) struct Pupil<'a> {
    pub(crate) id: StateId,
    /// The data of the state that this update has learned up to the day.
    pub(crate) own: Taught<'a>,
    /// The model of the state, learned from all days.
    pub(crate) model: &'a mut Arc<StateModel>,
}

/// The data of a state that an update has learned.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Taught<'a> {
    /// The samples in order of time; they are rows if the state reports changes or events.
    pub(crate) samples: &'a [Sample],
    /// Whether earlier updates have learned nothing else of the state.
    pub(crate) is_all: bool,
    pub(crate) reporting: Reporting,
    /// Rows are learned up to this time.
    pub(crate) horizon_nanos: i64,
    /// Rows from this time on wait for a later day or update.
    pub(crate) end_nanos: i64,
}

impl<'a> Taught<'a> {
    /// The data of a state that reports samples.
    pub(crate) fn samples(samples: &'a [Sample]) -> Taught<'a> {
        Taught { samples, is_all: false, reporting: Reporting::Samples, horizon_nanos: i64::MIN, end_nanos: i64::MAX }
    }
}

/// Limits of a round of training.
#[derive(Clone, Copy, Debug)]
struct Limits {
    /// Maximum number of models of a kind.
    models: fn(ModelKind) -> usize,
    /// Maximum number of readings of one state, and of all states whose models are trained at once.
    readings: u64,
}

const LIMITS: Limits = Limits { models: trainings_max, readings: TRAINING_READINGS };

/// A state with models that are due to be trained.
struct Due<'a> {
    /// The index of the state among the pupils.
    place: usize,
    wanted: ReadingsRequest,
    state_kind: StateKind,
    /// The models to train.
    kinds: Vec<ModelKind>,
    /// The data that this update has learned.
    own: Taught<'a>,
    /// The first instant to train on.
    from_nanos: i64,
    /// The last learned day.
    day: LocalDay,
    /// Expected number of readings, at least one.
    expected: u64,
}

/// Trains the due models of the states that have learned a day, on the current rayon pool. `end_nanos`: the end of the
/// day, which determines the age of readings.
pub(crate) fn train_due(
    spec: &MapSpec,
    end_nanos: i64,
    pupils: &mut [Pupil<'_>],
    source: &dyn StateReadings,
    pace: &dyn Pace,
) -> TrainingOutcome {
    train_within(LIMITS, spec, end_nanos, pupils, (source, pace))
}

fn train_within(
    limits: Limits,
    spec: &MapSpec,
    end_nanos: i64,
    pupils: &mut [Pupil<'_>],
    (source, pace): (&dyn StateReadings, &dyn Pace),
) -> TrainingOutcome {
    // History may have been deleted up to this time, or not yet: a model must not depend on that.
    let kept_from = match spec.retention {
        Retention::None => return TrainingOutcome::default(),
        Retention::Duration(nanos) => end_nanos.saturating_sub(nanos),
        Retention::Forever => i64::MIN,
    };
    let (mut kinds, mut waiting) = (BTreeMap::<StateId, Vec<ModelKind>>::new(), 0);
    for kind in spec.models.trained() {
        let mut of_kind: Vec<(Option<LocalDay>, StateId)> =
            pupils.iter().filter_map(|pupil| Some((trained_on(pupil.model, kind)?, pupil.id))).collect();
        // Models that were never trained go first.
        of_kind.sort_by_key(|(trained, _)| *trained);
        waiting += of_kind.len().saturating_sub((limits.models)(kind)) as u64;
        of_kind.truncate((limits.models)(kind));
        of_kind.into_iter().for_each(|(_, id)| kinds.entry(id).or_default().push(kind));
    }
    let mut offsets = spec.zone.offset_cache();
    let mut due: Vec<Due<'_>> = pupils
        .iter()
        .enumerate()
        .filter_map(|(place, pupil)| {
            let kinds = kinds.remove(&pupil.id)?;
            due((place, pupil), kinds, kept_from, &mut offsets, limits.readings)
        })
        .collect();
    // States are in the order of history; states for which no readings are read come last.
    due.sort_by_key(|due| (due.own.is_all, due.wanted.state));
    let mut batches = Batches { rest: &due, readings_max: limits.readings, source };
    let mut outcome = TrainingOutcome { waiting, ..TrainingOutcome::default() };
    let mut next = batches.next();
    while let Some((batch, found)) = next {
        // The next batch is read at the same time.
        let train_one = |(due, earlier)| {
            pace.await_turn();
            train(spec, due, earlier)
        };
        let train_batch = || found.map(|found| batch.par_iter().zip(found).map(train_one).collect());
        let trained: Result<Vec<_>, String>;
        (trained, next) = rayon::join(train_batch, || batches.next());
        match trained {
            Ok(trained) => {
                for (due, trained) in batch.iter().zip(trained) {
                    let Some(pupil) = pupils.get_mut(due.place) else { continue };
                    let mut retrained = StateModel::clone(pupil.model);
                    // Without readings the state keeps its model.
                    for trained in trained.into_iter().flatten() {
                        retrained = retrained.with_trained(trained, due.day);
                        outcome.trained += 1;
                    }
                    *pupil.model = Arc::new(retrained);
                }
            }
            Err(reason) => {
                outcome.failed += batch.len() as u64;
                outcome.failure.get_or_insert(reason);
            }
        }
    }
    outcome
}

/// Batches of due states with the readings of earlier updates, as many as may be in memory.
struct Batches<'a> {
    rest: &'a [Due<'a>],
    readings_max: u64,
    source: &'a dyn StateReadings,
}

impl<'a> Iterator for Batches<'a> {
    type Item = (&'a [Due<'a>], Result<Vec<Vec<Sample>>, String>);

    fn next(&mut self) -> Option<Self::Item> {
        let (batch, rest) = self.rest.split_at(batch_len(self.rest, self.readings_max));
        self.rest = rest;
        if batch.is_empty() {
            return None;
        }
        if batch.iter().all(|due| due.own.is_all) {
            return Some((batch, Ok(vec![Vec::new(); batch.len()])));
        }
        let wanted: Vec<ReadingsRequest> = batch.iter().map(|due| due.wanted).collect();
        let found = self.source.readings(&wanted).and_then(|found| match found.len() == wanted.len() {
            true => Ok(found),
            false => Err(format!("of {} states readings of {} were found", wanted.len(), found.len())),
        });
        Some((batch, found))
    }
}

/// The time for which a model of a state has waited: the day on which it was last trained, if any. `None` if it is not
/// due.
fn trained_on(model: &StateModel, kind: ModelKind) -> Option<Option<LocalDay>> {
    let known = model.alternatives().filter(|_| model.is_training_due(kind))?;
    Some(known.trained(kind).map(|(_, day)| day))
}

/// The training data of models of these kinds. `kept_from`: the map keeps readings from this time on.
fn due<'a>(
    (place, pupil): (usize, &Pupil<'a>),
    kinds: Vec<ModelKind>,
    kept_from: i64,
    offsets: &mut OffsetCache,
    readings_max: u64,
) -> Option<Due<'a>> {
    let (model, own) = (&*pupil.model, pupil.own);
    let (known, folded) = (model.alternatives()?, model.accumulator());
    let (newest, day) = (folded.last_nanos()?, known.learned_day()?);
    let span_nanos = newest.abs_diff(folded.first_nanos()?).max(1) as f64;
    let window_nanos = span_nanos.min(NIGHTLY_WINDOW_NANOS as f64);
    // Assumes a constant rate of readings.
    let expected = folded.observations() as f64 * (window_nanos / span_nanos);
    let share = (readings_max as f64 / expected.max(1.0)).min(1.0);
    let mut from_nanos = newest.saturating_sub((window_nanos * share) as i64).max(kept_from);
    if let Some(since) = known.training_since() {
        let civil_nanos = i64::from(since.0).saturating_mul(DAY_NANOS);
        // This is off by an hour if clocks changed between midnight UTC and local midnight, which does not matter over
        // weeks.
        from_nanos =
            from_nanos.max(civil_nanos.saturating_sub(i64::from(offsets.offset_secs(civil_nanos)) * SEC_NANOS));
    }
    let expected = ((expected * share) as u64).max(1);
    // A row may hold for up to this long.
    let hold_nanos = own.reporting.hold().map_or(0, Hold::max_nanos);
    let wanted = ReadingsRequest { state: pupil.id, from_nanos: from_nanos.saturating_sub(hold_nanos).max(kept_from) };
    Some(Due { place, wanted, from_nanos, state_kind: model.kind(), kinds, own, day, expected })
}

/// Number of due states to process together: at least one, if there are any. Earlier readings are read for all of them
/// or for none.
fn batch_len(due: &[Due<'_>], readings_max: u64) -> usize {
    let mut readings = 0_u64;
    let is_all = due.first().is_some_and(|due| due.own.is_all);
    let within = due.iter().take_while(|due| {
        readings = readings.saturating_add(due.expected);
        readings <= readings_max && due.own.is_all == is_all
    });
    within.count().max(1).min(due.len())
}

/// Trains each due model of a state.
fn train(spec: &MapSpec, due: &Due<'_>, earlier: Vec<Sample>) -> Vec<Result<TrainedModel, CannotTrain>> {
    let mut samples = earlier;
    let own = due.own.samples;
    let first = own.partition_point(|sample| sample.utc_nanos < due.wanted.from_nanos);
    samples.extend_from_slice(own.get(first..).unwrap_or(&[]));
    // The sort is stable: among equal times, readings of earlier updates come first.
    samples.sort_by_key(|sample| sample.utc_nanos);
    if due.own.reporting.may_end() {
        samples.truncate(samples.partition_point(|sample| sample.utc_nanos < due.own.end_nanos));
        samples = samples_of(due.own.reporting, &samples, due.own.horizon_nanos, &mut spec.zone.offset_cache());
        samples.drain(..samples.partition_point(|sample| sample.utc_nanos < due.from_nanos));
    }
    let half_life_secs = spec.half_life_nanos.map(|nanos| nanos as f64 / 1e9);
    let readings = Readings { half_life_secs, ..Readings::new(&samples) };
    due.kinds.par_iter().map(|&kind| kind.train(readings, due.state_kind, &spec.periodicities)).collect()
}
