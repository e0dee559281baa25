//! Learns states anew from their history, update by update, without the erased observations.
//!
//! Each history file is one update. The states go through the same code as in that update, with the readings of the
//! updates before it, so that they become what they would be without the erased observations. The nightly limits of
//! models to train count only the states that are learned anew: with more models due in one night than an update
//! trains, a model may be trained earlier than it would have been. Rows of changes and events count as complete up to
//! the newest observation of all these states, not of their own producer. So a row of a producer that lags behind may
//! be late here and not have been late in the update, or the reverse.
//!
//! Invariant: the result depends only on the history and on the remaining pending observations.

use std::{
    collections::BTreeMap,
    sync::{Arc, atomic::AtomicU64},
};

use tidemap_model::{Sample, StateModel};

use super::selection::{Decision, Selection, renumbered};
use crate::{
    directory::{Directory, StateInfo},
    event::{UpdateCause, UpdateStart},
    history::{HistoryPiece, origins::Origins},
    ids::{ProducerId, StateId},
    live_state::Delivery,
    prior_models::PriorModels,
    site::Site,
    snapshot::StateSnapshot,
    spec::MapSpec,
    training::{ReadingsRequest, StateReadings},
    update::{MapAtUpdate, SumsUnavailable, UpdateWork},
    view::LiveState,
};

/// The remaining observations of a state in one update, with their origins; both are empty if none remains.
pub(super) fn left(
    selection: &Selection,
    erased: Option<&Vec<u64>>,
    (state, samples, origins): (StateId, &[Sample], &Origins),
) -> (Vec<Sample>, Origins) {
    let erased = erased.map_or(&[][..], Vec::as_slice);
    let first_ahead = samples.len().saturating_sub(origins.ahead as usize);
    let (runs, arrived) = (Vec::new(), renumbered(origins.arrived, erased));
    let mut kept = (Vec::new(), Origins { runs, ahead: 0, arrived, ..*origins });
    for (at, (sample, (producer, number))) in samples.iter().zip(origins.each()).enumerate() {
        if selection.takes(state, producer, sample.utc_nanos) {
            continue;
        }
        kept.0.push(*sample);
        kept.1.push(producer, renumbered(number, erased));
        kept.1.ahead += u32::from(at >= first_ahead);
    }
    if kept.1.ahead == 0 {
        kept.1.arrived = 0;
    }
    kept
}

/// The data that earlier updates of the new history have learned.
#[derive(Debug, Default)]
struct Earlier(BTreeMap<StateId, Vec<Sample>>);

impl StateReadings for Earlier {
    fn readings(&self, wanted: &[ReadingsRequest]) -> Result<Vec<Vec<Sample>>, String> {
        let samples_for = |wanted: &ReadingsRequest| {
            let all = self.0.get(&wanted.state).into_iter().flatten();
            let mut found: Vec<Sample> = all.filter(|sample| sample.utc_nanos >= wanted.from_nanos).copied().collect();
            found.sort_by_key(|sample| sample.utc_nanos);
            found
        };
        Ok(wanted.iter().map(samples_for).collect())
    }
}

/// One update of the history, with its remaining observations of the states that are learned anew.
#[derive(Debug)]
struct Lesson {
    generation: u64,
    /// The latest time that all states have learned, up to this update.
    newest_nanos: i64,
    samples: Vec<(StateId, Vec<Sample>)>,
    origins: Vec<Origins>,
}

/// Some states that are learned anew.
#[derive(Debug)]
pub struct Relearning<'a> {
    spec: &'a MapSpec,
    selection: &'a Selection,
    decision: &'a Decision,
    /// The states as the snapshot has them.
    states: Vec<(StateId, StateSnapshot)>,
    lessons: Vec<Lesson>,
    newest_nanos: i64,
}

impl<'a> Relearning<'a> {
    /// Begins with these states of the snapshot, ascending.
    #[must_use]
    pub fn new(
        spec: &'a MapSpec,
        selection: &'a Selection,
        decision: &'a Decision,
        states: Vec<(StateId, StateSnapshot)>,
    ) -> Self {
        Self { spec, selection, decision, states, lessons: Vec::new(), newest_nanos: 0 }
    }

    /// Reads the history of an update; called in ascending order of generations. `to_nanos`: the latest time of the
    /// whole update. States that are not learned anew are ignored.
    pub fn history(&mut self, piece: &HistoryPiece, to_nanos: i64) {
        self.newest_nanos = self.newest_nanos.max(to_nanos);
        let (generation, newest_nanos) = (piece.generation, self.newest_nanos);
        let mut lesson = Lesson { generation, newest_nanos, samples: Vec::new(), origins: Vec::new() };
        for ((state, samples), origins) in piece.states.iter().zip(&piece.origins) {
            let Ok(index) = self.states.binary_search_by_key(state, |(state, _)| *state) else { continue };
            let of_state = (*state, samples.as_slice(), origins);
            let (samples, origins) = left(self.selection, self.decision.numbers.get(state), of_state);
            if !samples.is_empty() {
                lesson.samples.push((StateId(u32::try_from(index).unwrap_or(u32::MAX)), samples));
                lesson.origins.push(origins);
            }
        }
        if !lesson.samples.is_empty() {
            self.lessons.push(lesson);
        }
    }

    /// Learns the states, on the current rayon pool.
    ///
    /// # Errors
    /// [`SumsUnavailable`] does not happen: the sums are in memory.
    pub fn learn(mut self) -> Result<Vec<(StateId, StateSnapshot)>, SumsUnavailable> {
        let spec = Arc::new(MapSpec { grid: None, ..self.spec.clone() });
        let mut directory = Directory::new();
        let prior_models = PriorModels::new(&spec);
        for (_, state) in &self.states {
            let (sensor, reporting) = (state.model.sensor(), state.model.reporting());
            directory.push(StateInfo { name: state.name.clone(), kind: state.kind, sensor, reporting });
        }
        let models: Vec<_> = directory.iter().map(|info| prior_models.beginning(info)).collect();
        let with_rows: Vec<StateId> = (0..)
            .map(StateId)
            .zip(directory.iter())
            .filter_map(|(id, info)| info.reporting.may_end().then_some(id))
            .collect();
        let mut models = Arc::new(models);
        let mut arrivals = self.waiting();
        let mut earlier = Earlier::default();
        for lesson in std::mem::take(&mut self.lessons) {
            lesson.arrive(&mut arrivals);
            let source = Arc::new(earlier);
            let work = UpdateWork {
                basis: lesson.basis(&directory),
                spec: Arc::clone(&spec),
                models,
                prior_models: prior_models.clone(),
                samples: lesson.samples.clone(),
                origins: Vec::new(),
                horizons: with_rows.iter().map(|&id| (id, lesson.newest_nanos)).collect(),
                grid: None,
                readings: Some(Arc::<Earlier>::clone(&source)),
                room: None,
                // An erasure learns all remaining observations at once: no update follows it.
                readings_max: u64::MAX,
            };
            models = work.run(&AtomicU64::new(0))?.models;
            earlier = Arc::try_unwrap(source).unwrap_or_default();
            for (index, samples) in lesson.samples {
                earlier.0.entry(index).or_default().extend(samples);
            }
        }
        Ok(self.learned(&models, arrivals))
    }

    /// For each state, the remaining observations that wait.
    fn waiting(&self) -> Vec<Vec<Step>> {
        let of_state = |id: &StateId| {
            let waiting = self.decision.waiting.get(id).into_iter().flatten().filter(|waiting| waiting.is_plausible);
            waiting.map(|waiting| Step::arrived(waiting.number, waiting.sample, waiting.producer)).collect()
        };
        self.states.iter().map(|(id, _)| of_state(id)).collect()
    }

    /// The states with these models, and with the last values after these observations.
    fn learned(self, models: &[Arc<StateModel>], arrivals: Vec<Vec<Step>>) -> Vec<(StateId, StateSnapshot)> {
        let Self { decision, mut states, .. } = self;
        for ((at, (id, state)), mut arrivals) in states.iter_mut().enumerate().zip(arrivals) {
            arrivals.sort_by_key(|step| step.place);
            let mut live = LiveState::default();
            let reporting = state.model.reporting();
            for Step { sample, producer, .. } in &arrivals {
                // The history does not keep whether the row was live, so the row counts as part of a recording.
                live.observe_row(reporting, sample, Delivery { producer: *producer, received_nanos: i64::MAX });
            }
            (state.persistence, state.recent, state.newest_row) = (live.persistence, live.recent, live.newest_row);
            let erased = decision.numbers.get(id).map_or(0, |numbers| numbers.len() as u64);
            state.observations = state.observations.saturating_sub(erased);
            if decision.unlearned.contains(id)
                && let Some(model) = models.get(at)
            {
                state.model = Arc::clone(model);
            }
        }
        states
    }
}

impl Lesson {
    /// Adds the observations of this update to the observations of each state.
    fn arrive(&self, arrivals: &mut [Vec<Step>]) {
        for ((index, samples), origins) in self.samples.iter().zip(&self.origins) {
            let Some(arrivals) = arrivals.get_mut(index.0 as usize) else { continue };
            let first_ahead = samples.len().saturating_sub(origins.ahead as usize);
            for (at, (sample, (producer, number))) in samples.iter().zip(origins.each()).enumerate() {
                arrivals.push(match at < first_ahead {
                    true => Step::arrived(number, *sample, producer),
                    false => Step::waited(origins.arrived, self.generation, *sample, producer),
                });
            }
        }
    }

    /// The map when its update began, as far as the states need it.
    fn basis(&self, directory: &Directory) -> MapAtUpdate {
        let is_early = self.origins.last().is_some_and(|origins| origins.is_early);
        let cause = if is_early { UpdateCause::PendingLimit } else { UpdateCause::Midnight };
        MapAtUpdate {
            start: UpdateStart { generation: self.generation, cut_nanos: i64::MAX, cause },
            position: 0,
            replay_from: 0,
            newest_nanos: self.newest_nanos,
            producers: Vec::new(),
            directory: directory.clone(),
            live: Vec::new(),
            site: Arc::new(Site::default()),
            grid: None,
        }
    }
}

/// A step in which an observation becomes the last value of its state.
#[derive(Clone, Copy, Debug)]
struct Step {
    /// The number of the last observation that had arrived, the generation that took this observation after waiting,
    /// and its time in that case.
    place: (u64, u64, i64),
    sample: Sample,
    producer: ProducerId,
}

impl Step {
    fn arrived(number: u64, sample: Sample, producer: ProducerId) -> Self {
        Self { place: (number, 0, 0), sample, producer }
    }

    fn waited(arrived: u64, generation: u64, sample: Sample, producer: ProducerId) -> Self {
        Self { place: (arrived, generation, sample.utc_nanos), sample, producer }
    }
}
