//! Decides which observations are to be erased, and collects the data of a map that this requires.
//!
//! A survey reads the history from its first file to its last, then the log. It refuses erasures that cannot be done
//! exactly.
//!
//! Invariant: a decision names every state with a selected observation.

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
    /// The number of the observation among the observations of its state.
    pub number: u64,
    /// The observation.
    pub sample: Sample,
    /// The producer that sent it.
    pub producer: ProducerId,
    /// Whether it was accepted without waiting.
    pub is_plausible: bool,
}

/// Observations of some states and producers in an interval.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Selection {
    /// The states; `None`: all.
    pub states: Option<BTreeSet<StateId>>,
    /// The producers; `None`: all.
    pub producers: Option<BTreeSet<ProducerId>>,
    /// The first time, nanoseconds UTC.
    pub from_nanos: i64,
    /// The end of the interval, exclusive, nanoseconds UTC; `i64::MAX`: all from the first time on.
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
    /// The history lacks observations of a state, so that the state cannot be learned anew.
    #[error(
        "state {:?} cannot be learned again without them, because {}. Erase the state as a whole, or only observations \
         from {} on, which no update has learned",
        state.as_str(), kept(*kept_from_nanos), format_rfc3339(*pending_from_nanos)
    )]
    HistoryIncomplete {
        /// The state.
        state: StateName,
        /// The earliest observation in the history; `None`: it has none.
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

/// The data of a state that the survey has read.
#[derive(Clone, Debug, Default)]
struct OfState {
    /// Number of observations in the history, and of the selected ones among them.
    learned: (u64, u64),
    /// Number of pending observations in the snapshot, and of the selected ones among them.
    pending: (u64, u64),
    /// Number of observations after the snapshot, and of the selected ones among them.
    later: (u64, u64),
    /// The earliest time in the history.
    kept_from_nanos: Option<i64>,
    /// Numbers of the selected observations in the history, ascending or not.
    numbers: Vec<u64>,
    /// Observations in the log up to the snapshot's position.
    read: u64,
    /// The pending observations, with numbers among the observations read, and whether each is selected.
    waiting: Vec<(Arrival, bool)>,
}

/// Name, number of acknowledged observations, first and last time that the model has learned.
type KnownState = (StateName, u64, Option<(i64, i64)>);

/// The data of a map that has been read so far.
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
    /// Failed traversals and reports of tasks in the snapshot, and the selected ones among them.
    failures: BTreeSet<(StateName, i64)>,
    failed: BTreeSet<(StateName, i64)>,
}

/// The work of an erasure.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Decision {
    /// States without a remaining observation.
    pub emptied: Vec<StateId>,
    /// States that must be learned anew, and states whose last values change; ascending.
    pub relearned: Vec<StateId>,
    /// Number of states with erased observations.
    pub states: u64,
    /// Number of erased observations. A position counts once for each of its axes.
    pub observations: u64,
    /// Numbers of the selected observations that arrived before the snapshot, by state, ascending.
    pub numbers: BTreeMap<StateId, Vec<u64>>,
    /// The remaining pending observations in the snapshot, of the states to learn anew.
    pub(crate) waiting: BTreeMap<StateId, Vec<Arrival>>,
    /// States whose learned observations are selected.
    pub(crate) unlearned: BTreeSet<StateId>,
    /// Selected failed traversals and reports of tasks of the snapshot: the state, and the start.
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

    /// Reads the history of an update; called in ascending order of generations.
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

    /// Reads the event at a position; called from the first event with pending observations on.
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

    /// Decides what is erased.
    ///
    /// # Errors
    /// [`NotErasable`], for the first state with observations that cannot be erased exactly.
    pub fn decide(self) -> Result<Decision, NotErasable> {
        let pending_from_nanos = self.cut_nanos.max(self.newest_nanos.saturating_add(1));
        let mut decision = Decision { failed: self.failed, ..Decision::default() };
        // A state without observations in the history may still have learned selected observations.
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

/// The new number of an observation. For an erased observation it is the new number of the last remaining one before
/// it.
pub(super) fn renumbered(number: u64, erased: &[u64]) -> u64 {
    number.saturating_sub(erased.partition_point(|erased| *erased <= number) as u64)
}
