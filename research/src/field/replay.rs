//! A recording that a map learns night by night, with questions at each lead time.
//!
//! Invariant: a forecast uses readings up to the end of its lead time's knowledge and no later ones: views and tables
//! are those of that time.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use tidemap_map::{
    event::Observations,
    ids::StateId,
    name::{MapName, ProducerKey, StateName},
    spec::MapSpec,
    view::MapView,
};
use tidemap_model::{LocalDay, Sample, models::Interval, selector::ModelSelector};

use super::{
    FieldError,
    baselines::{BASELINES, Baselines},
    lead::{KnownUntil, Lead},
    recording::ReadRecording,
};
use crate::nightly_map::NightlyMap;

/// The number of ways to ask the map.
pub(super) const ASKED_MODELS: usize = 2;
/// Level of the intervals.
pub(super) const LEVEL: f64 = 0.8;
/// Number of midnights whose views are kept: the oldest is that of the longest lead time.
const VIEWS_MAX: usize = 28;

/// A prediction of the map.
#[derive(Clone, Copy, Debug)]
pub(super) struct MapAnswer {
    /// The predicted value of the reading.
    pub(super) value: f64,
    /// The interval of the mean over the hour around the reading; none if the map gives none.
    pub(super) interval: Option<Interval>,
}

/// The predictions of one reading at one lead time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Forecast {
    /// Index of the state.
    pub(super) state: usize,
    /// The reading that is predicted.
    pub(super) truth: Sample,
    /// The lead time.
    pub(super) lead: Lead,
    /// The answers of `auto`; then, at short lead times, of `ensemble`, which does not use the newest readings.
    pub(super) answers: [Option<MapAnswer>; ASKED_MODELS],
    /// The predictions of the baselines.
    pub(super) baselines: [f64; BASELINES.len()],
}

/// The time that a replay took.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Spent {
    /// Learning, with observing.
    pub(super) learning: Duration,
    /// Asking, with scoring.
    pub(super) asking: Duration,
}

/// A question about readings of one time.
#[derive(Debug)]
struct Question {
    known_until: i64,
    lead: Lead,
    /// The states with the readings that are predicted.
    truths: Vec<(usize, Sample)>,
}

/// Replays a recording of which the map gets `learned`, the readings of each state; `take` receives each forecast. The
/// test days of a lead time's forecasts ascend.
pub(super) fn replay(
    recording: &ReadRecording,
    learned: &[Vec<Sample>],
    take: &mut impl FnMut(&Forecast),
) -> Result<Spent, FieldError> {
    let mut spent = Spent::default();
    let (Some(first), Some(last)) = (
        learned.iter().filter_map(|samples| samples.first()).map(Sample::local_day).min(),
        recording.asked.keys().next_back().copied(),
    ) else {
        return Ok(spent);
    };
    let mut learner = FieldLearner::new(recording, learned, first)?;
    let mut views: VecDeque<(MapView, Vec<Baselines>)> = VecDeque::with_capacity(VIEWS_MAX);
    let midnight = |day: i32| recording.zone.midnight_nanos(LocalDay(day));
    let mut short = short_questions(recording).into_iter().peekable();
    while short.next_if(|question| question.known_until < midnight(first.0)).is_some() {}
    for day in first.0..=last.0 {
        if views.len() == VIEWS_MAX {
            views.pop_front();
        }
        views.push_back((learner.map.view(), learner.baselines.clone()));
        let begin = Instant::now();
        let mut observing = Duration::ZERO;
        for lead in Lead::ALL {
            let Some(truths) = recording.asked.get(&LocalDay(day)) else { break };
            let KnownUntil::Midnight(before) = lead.known_until() else { continue };
            if let Some((view, tables)) = views.len().checked_sub(before + 1).and_then(|newest| views.get(newest)) {
                ask(view, tables, learned, (lead, truths), take);
            }
        }
        while let Some(question) = short.next_if(|question| question.known_until < midnight(day + 1)) {
            let begin = Instant::now();
            learner.observe(question.known_until + 1)?;
            let view = learner.map.view();
            observing += begin.elapsed();
            ask(&view, &learner.baselines, learned, (question.lead, &question.truths), take);
        }
        spent.asking += begin.elapsed() - observing;
        spent.learning += observing;
        // After the last day nothing is predicted.
        if day < last.0 {
            let begin = Instant::now();
            learner.observe(midnight(day + 1))?;
            learner.update(midnight(day + 1))?;
            spent.learning += begin.elapsed();
        }
    }
    Ok(spent)
}

/// The questions of the short lead times, in the order of what is known.
fn short_questions(recording: &ReadRecording) -> Vec<Question> {
    let mut truths: Vec<(usize, Sample)> = recording.asked.values().flatten().copied().collect();
    // Stable: states stay in their order.
    truths.sort_by_key(|(_, sample)| sample.utc_nanos);
    let mut questions: Vec<Question> = Vec::new();
    for lead in Lead::ALL {
        let KnownUntil::Nanos(before) = lead.known_until() else { continue };
        questions.extend(
            truths.chunk_by(|(_, one), (_, next)| one.utc_nanos == next.utc_nanos).map(|truths| Question {
                known_until: truths[0].1.utc_nanos - before,
                lead,
                truths: truths.to_vec(),
            }),
        );
    }
    questions.sort_by_key(|question| question.known_until);
    questions
}

/// Asks a view about readings, state by state, unless it has learned nothing of the state.
fn ask(
    view: &MapView,
    tables: &[Baselines],
    learned: &[Vec<Sample>],
    (lead, truths): (Lead, &[(usize, Sample)]),
    take: &mut impl FnMut(&Forecast),
) {
    for truths in truths.chunk_by(|(one, _), (next, _)| one == next) {
        let state = truths[0].0;
        if view.generation() == 0 || tables[state].is_empty() {
            continue;
        }
        let times: Vec<i64> = truths.iter().map(|(_, truth)| truth.utc_nanos).collect();
        let id = StateId(state as u32);
        let times = view.prepare(&times);
        let answers = |selector: ModelSelector| {
            let mut values = vec![0.0; times.len()];
            view.predict_into(id, &times, selector, &mut values);
            let held = view.intervals(id, (times.moments(), &values), selector, Some(LEVEL));
            let answer =
                |(at, value): (usize, f64)| MapAnswer { value, interval: held.get(at).map(|held| held.interval) };
            values.into_iter().enumerate().map(answer).collect::<Vec<_>>()
        };
        let auto = answers(ModelSelector::default());
        let long_term = if lead.is_short() { answers(ModelSelector::default().long_term()) } else { Vec::new() };
        for (at, &(_, truth)) in truths.iter().enumerate() {
            let baselines = tables[state].predict(&learned[state], truth, lead);
            let answers = [auto.get(at).copied(), long_term.get(at).copied()];
            take(&Forecast { state, truth, lead, answers, baselines });
        }
    }
}

/// A map and the baselines of its states, which learn the same readings.
struct FieldLearner {
    map: NightlyMap,
    baselines: Vec<Baselines>,
    /// All readings, ascending by time, from the next one that is observed on.
    ahead: std::iter::Peekable<std::vec::IntoIter<(usize, Sample)>>,
    has_new: bool,
}

impl FieldLearner {
    /// An untrained map with default properties.
    fn new(recording: &ReadRecording, learned: &[Vec<Sample>], first: LocalDay) -> Result<Self, FieldError> {
        let name = MapName::new("field").map_err(FieldError::setting)?;
        let producer = ProducerKey::new("robot", "").map_err(FieldError::setting)?;
        let zone = recording.zone.clone();
        let created_nanos = zone.midnight_nanos(first);
        let mut map = NightlyMap::new(MapSpec { zone, created_nanos, ..MapSpec::new(name) }, producer);
        for state in &recording.states {
            map.add_state(StateName::new(&state.name).map_err(FieldError::setting)?, state.kind)?;
        }
        let baselines = recording.states.iter().map(|state| Baselines::new(state.kind)).collect();
        let of_state =
            |(state, samples): (usize, &Vec<Sample>)| samples.iter().map(|sample| (state, *sample)).collect::<Vec<_>>();
        let mut all: Vec<(usize, Sample)> = learned.iter().enumerate().flat_map(of_state).collect();
        all.sort_by_key(|(_, sample)| sample.utc_nanos);
        Ok(Self { map, baselines, ahead: all.into_iter().peekable(), has_new: false })
    }

    /// Observes the readings before a time.
    fn observe(&mut self, until_nanos: i64) -> Result<(), FieldError> {
        let (mut observed, mut count) = (Observations::default(), 0);
        while let Some((state, sample)) = self.ahead.next_if(|(_, sample)| sample.utc_nanos < until_nanos) {
            observed.push(StateId(state as u32), sample);
            self.baselines[state].learn(sample);
            count += 1;
        }
        if count > 0 {
            self.map.observe(observed, count, until_nanos)?;
            self.has_new = true;
        }
        Ok(())
    }

    /// Learns what was observed before midnight.
    fn update(&mut self, midnight_nanos: i64) -> Result<(), FieldError> {
        self.baselines.iter_mut().for_each(Baselines::fade);
        if std::mem::take(&mut self.has_new) { self.map.update(midnight_nanos) } else { Ok(()) }
    }
}
