//! Which observations are to be erased, and what has to be known of a map before they can be.
//!
//! A survey reads the history from its first file to its last, then the log. It refuses what cannot be done exactly.
//!
//! Invariant: a decision names every state of which an observation is selected.

use std::collections::{BTreeMap, BTreeSet};

use tidemap_model::{Sample, time::format_rfc3339};

use crate::{
    event::{Envelope, Event},
    history::HistoryPiece,
    ids::{ProducerId, StateId},
    name::{EdgeState, StateName},
    snapshot::MapSnapshot,
};

/// An observation in the order of arrival.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Arrival {
    /// Its number among those of its state.
    pub number: u64,
    /// The observation.
    pub sample: Sample,
    /// Who sent it.
    pub producer: ProducerId,
    /// Whether it did not have to wait.
    pub is_plausible: bool,
}

/// Observations of some states and producers in an interval.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Selection {
    /// Of these states; `None`: of all.
    pub states: Option<BTreeSet<StateId>>,
    /// By these producers; `None`: by all.
    pub producers: Option<BTreeSet<ProducerId>>,
    /// The first time, nanoseconds UTC.
    pub from_nanos: i64,
    /// The time before which they lie, nanoseconds UTC; `i64::MAX`: all from the first on.
    pub to_nanos: i64,
}

impl Selection {
    /// Whether a time is in the interval.
    #[must_use]
    pub fn has_time(&self, nanos: i64) -> bool {
        self.from_nanos <= nanos && (nanos < self.to_nanos || self.to_nanos == i64::MAX)
    }

    /// Whether observations of a state may be selected.
    #[must_use]
    pub fn has_state(&self, state: StateId) -> bool {
        self.states.as_ref().is_none_or(|states| states.contains(&state))
    }

    /// Whether observations of a producer may be selected.
    #[must_use]
    pub fn has_producer(&self, producer: ProducerId) -> bool {
        self.producers.as_ref().is_none_or(|producers| producers.contains(&producer))
    }

    /// Whether an observation is selected.
    #[must_use]
    pub fn takes(&self, state: StateId, producer: ProducerId, nanos: i64) -> bool {
        self.has_state(state) && self.has_time(nanos) && self.has_producer(producer)
    }
}

/// Why observations cannot be erased. Times are nanoseconds UTC.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotErasable {
    /// Nothing is selected.
    #[error("the map has no such observation")]
    Nothing,
    /// The history does not have all observations of a state, so that it cannot be learned anew.
    #[error(
        "state {:?} cannot be learned anew without them, because {}. Erase the state as a whole, or only observations \
         from {} on, which no update has learned",
        state.as_str(), kept(*kept_from_nanos), format_rfc3339(*pending_from_nanos)
    )]
    HistoryIncomplete {
        /// The state.
        state: StateName,
        /// The earliest observation that the history has; `None`: it has none.
        kept_from_nanos: Option<i64>,
        /// Observations from this time on were not learned, and can be erased.
        pending_from_nanos: i64,
    },
}

fn kept(from_nanos: Option<i64>) -> String {
    match from_nanos {
        Some(from) => {
            format!("the history has not kept all that it has learned: the earliest is of {}", format_rfc3339(from))
        }
        None => "the history has not kept what it has learned".to_owned(),
    }
}

/// What is known of a state.
#[derive(Clone, Debug, Default)]
struct OfState {
    /// Observations in the history, and those of them that are selected.
    learned: (u64, u64),
    /// Observations that the snapshot has as pending, and those of them that are selected.
    pending: (u64, u64),
    /// Observations after the snapshot, and those of them that are selected.
    later: (u64, u64),
    /// The earliest time in the history.
    kept_from_nanos: Option<i64>,
    /// Numbers of the selected observations that the history has, ascending or not.
    numbers: Vec<u64>,
    /// Observations in the log up to the snapshot's position.
    read: u64,
    /// The pending ones, with numbers among those read.
    waiting: Vec<(Arrival, bool)>,
}

/// Name, acknowledged observations, first and last time that the model has learned.
type KnownState = (StateName, u64, Option<(i64, i64)>);

/// What has been read of a map so far.
#[derive(Clone, Debug)]
pub struct Survey {
    selection: Selection,
    position: u64,
    generation: u64,
    cut_nanos: i64,
    newest_nanos: i64,
    /// The states of the snapshot.
    known: Vec<KnownState>,
    states: BTreeMap<StateId, OfState>,
    /// Failed traversals and reports of tasks that the snapshot has, and those of them that are selected.
    failures: BTreeSet<(StateName, i64)>,
    failed: BTreeSet<(StateName, i64)>,
}

/// What an erasure has to do.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Decision {
    /// States of which no observation is left.
    pub emptied: Vec<StateId>,
    /// States that have to be learned anew, and those with other last values; ascending.
    pub relearned: Vec<StateId>,
    /// Number of states of which observations are erased.
    pub states: u64,
    /// Observations that are erased. A position counts for each of its axes.
    pub observations: u64,
    /// Numbers of the selected observations that arrived before the snapshot, by state, ascending.
    pub numbers: BTreeMap<StateId, Vec<u64>>,
    /// What the snapshot has as pending of the states to learn anew, without what is selected.
    pub(crate) waiting: BTreeMap<StateId, Vec<Arrival>>,
    /// States whose learned observations are selected.
    pub(crate) unlearned: BTreeSet<StateId>,
    /// Failed traversals and reports of tasks of the snapshot that are selected: the state, and the start.
    pub(crate) failed: BTreeSet<(StateName, i64)>,
}

impl Survey {
    /// A survey of a map with this snapshot, or with none yet.
    #[must_use]
    pub fn new(selection: Selection, snapshot: Option<&MapSnapshot>) -> Self {
        let states = snapshot.into_iter().flat_map(|snapshot| &snapshot.states);
        let failures = snapshot.into_iter().flat_map(|snapshot| snapshot.site.failures().oldest_first());
        let failures = failures.map(|failure| (failure.edge.state(EdgeState::Success), failure.start_nanos));
        let runs = snapshot.into_iter().flat_map(|snapshot| snapshot.site.tasks().runs().oldest_first());
        let runs = runs.map(|run| (run.name.state(), run.start_nanos));
        Self {
            selection,
            position: snapshot.map_or(0, |snapshot| snapshot.position),
            generation: snapshot.map_or(0, |snapshot| snapshot.generation),
            cut_nanos: snapshot.map_or(0, |snapshot| snapshot.cut_nanos),
            newest_nanos: snapshot.map_or(0, |snapshot| snapshot.newest_nanos),
            known: states
                .map(|state| {
                    let sums = state.model.accumulator();
                    (state.name.clone(), state.observations, sums.first_nanos().zip(sums.last_nanos()))
                })
                .collect(),
            states: BTreeMap::new(),
            failures: failures.chain(runs).collect(),
            failed: BTreeSet::new(),
        }
    }

    /// Reads the history of an update; they come ascending by generation.
    pub fn history(&mut self, piece: &HistoryPiece) {
        if piece.generation > self.generation {
            return;
        }
        for ((state, samples), origins) in piece.states.iter().zip(&piece.origins) {
            if !self.selection.has_state(*state) {
                continue;
            }
            let of_state = self.states.entry(*state).or_default();
            for (sample, (producer, number)) in samples.iter().zip(origins.each()) {
                let nanos = sample.utc_nanos;
                of_state.kept_from_nanos = Some(of_state.kept_from_nanos.map_or(nanos, |from| from.min(nanos)));
                of_state.learned.0 += 1;
                if self.selection.takes(*state, producer, nanos) {
                    of_state.learned.1 += 1;
                    of_state.numbers.push(number);
                    if let Some((name, ..)) = self.known.get(state.0 as usize)
                        && self.failures.contains(&(name.clone(), nanos))
                    {
                        self.failed.insert((name.clone(), nanos));
                    }
                }
            }
        }
    }

    /// Reads the event at a position, from the first that has pending observations.
    pub fn event(&mut self, position: u64, event: &Event) {
        let Event::Observations(envelope, event) = event else { return };
        for new in event.new_states.iter().flat_map(|new| new.states()).filter(|_| position > self.position) {
            let (id, name, _) = new;
            if id.0 as usize == self.known.len() {
                self.known.push((name, 0, None));
            }
        }
        for (state, sample) in event.samples() {
            if self.selection.has_state(state) {
                self.observation(position, envelope, state, sample);
            }
        }
    }

    fn observation(&mut self, position: u64, envelope: &Envelope, state: StateId, sample: Sample) {
        let is_taken = self.selection.takes(state, envelope.producer, sample.utc_nanos);
        let of_state = self.states.entry(state).or_default();
        if position > self.position {
            of_state.later.0 += 1;
            of_state.later.1 += u64::from(is_taken);
            return;
        }
        of_state.read += 1;
        if sample.utc_nanos < self.cut_nanos {
            return;
        }
        of_state.pending.0 += 1;
        of_state.pending.1 += u64::from(is_taken);
        let is_plausible = sample.utc_nanos <= envelope.plausible_nanos();
        of_state
            .waiting
            .push((Arrival { number: of_state.read, sample, producer: envelope.producer, is_plausible }, is_taken));
        if is_taken
            && let Some((name, ..)) = self.known.get(state.0 as usize)
            && self.failures.contains(&(name.clone(), sample.utc_nanos))
        {
            self.failed.insert((name.clone(), sample.utc_nanos));
        }
    }

    /// What is to be done.
    ///
    /// # Errors
    /// [`NotErasable`], for the first state of which observations cannot be erased exactly.
    pub fn decide(self) -> Result<Decision, NotErasable> {
        let pending_from_nanos = self.cut_nanos.max(self.newest_nanos.saturating_add(1));
        let mut decision = Decision { failed: self.failed, ..Decision::default() };
        // A state of which the history has nothing may still have learned what is selected.
        let known = (0..self.known.len()).filter_map(|at| u32::try_from(at).ok()).map(StateId);
        for state in known.filter(|state| self.selection.has_state(*state)) {
            let none = OfState::default();
            let of_state = self.states.get(&state).unwrap_or(&none);
            let Some((name, observations, learned)) = self.known.get(state.0 as usize) else { continue };
            let is_complete = *observations == of_state.learned.0 + of_state.pending.0;
            let hits = of_state.learned.1 + of_state.pending.1;
            let may_miss = learned
                .is_some_and(|(first, last)| self.selection.from_nanos <= last && (first < self.selection.to_nanos));
            if !is_complete && (hits > 0 || may_miss) {
                return Err(NotErasable::HistoryIncomplete {
                    state: name.clone(),
                    kept_from_nanos: of_state.kept_from_nanos,
                    pending_from_nanos,
                });
            }
            if hits + of_state.later.1 == 0 {
                continue;
            }
            decision.states += 1;
            decision.observations += hits + of_state.later.1;
            if observations + of_state.later.0 == hits + of_state.later.1 {
                decision.emptied.push(state);
            }
            if hits == 0 {
                continue;
            }
            let before = observations.saturating_sub(of_state.read);
            let arrival = |arrival: &Arrival| Arrival { number: before + arrival.number, ..*arrival };
            let mut numbers = of_state.numbers.clone();
            let selected = of_state.waiting.iter().filter(|(_, is_taken)| *is_taken);
            numbers.extend(selected.map(|(waiting, _)| before + waiting.number));
            numbers.sort_unstable();
            let left = of_state.waiting.iter().filter(|(_, is_taken)| !is_taken);
            let left = left.map(|(waiting, _)| without(arrival(waiting), &numbers)).collect();
            decision.waiting.insert(state, left);
            decision.numbers.insert(state, numbers);
            decision.relearned.push(state);
            if of_state.learned.1 > 0 {
                decision.unlearned.insert(state);
            }
        }
        if decision.observations == 0 { Err(NotErasable::Nothing) } else { Ok(decision) }
    }
}

fn without(arrival: Arrival, erased: &[u64]) -> Arrival {
    Arrival { number: renumbered(arrival.number, erased), ..arrival }
}

/// The new number of an observation. If it was erased: the new number of the last observation before it that is left.
pub(super) fn renumbered(number: u64, erased: &[u64]) -> u64 {
    number.saturating_sub(erased.partition_point(|erased| *erased <= number) as u64)
}
