//! Erases states, or some of the observations: snapshot, events and history become as if these had never been.
//!
//! The states after an erased one move up, so that ids stay without gaps. Positions of events do not change: an event
//! with nothing left becomes an edit that sets the charger to its current position. The producers' marks do not change
//! either: an erased observation still counts as acknowledged, so that it is ignored when it is sent again.
//!
//! The table of `references.rs` lists what else names states.
//!
//! Invariant: the remaining states keep every bit of their learned data, and of the observations that they have not
//! learned yet.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use tidemap_model::Sample;

use crate::{
    event::{Envelope, Event, NewState, Observations},
    history::HistoryPiece,
    ids::{ProducerId, StateId},
    live_map::rename::renamed_states,
    name::{EdgeState, ProducerKey, StateName},
    site::{Site, SiteEdit},
    snapshot::{MapSnapshot, StateSnapshot},
    task::TaskRun,
    traversal::EdgeFailure,
};

mod references;
mod relearn;
mod request;
mod selection;

use references::REFERENCES;
pub use relearn::Relearning;
pub use request::{ErasureRequest, RequestedPart};
pub use selection::{Decision, NotErasable, Selection, Survey};

/// The erasure of observations of states that remain.
#[derive(Clone, Debug)]
struct Part {
    selection: Selection,
    decision: Decision,
    /// The states of the snapshot that have changed.
    relearned: BTreeMap<StateId, StateSnapshot>,
    /// Names of the selected states. Of edges among them, the failed traversals are selected.
    names: BTreeMap<StateId, StateName>,
}

/// Rewrites the data of a map without some of its states: first the snapshot, then the events in their order.
#[derive(Clone, Debug)]
pub struct StateErasure {
    /// Ascending.
    erased: Vec<StateId>,
    /// Names of the erased states that are known so far.
    names: BTreeMap<StateId, StateName>,
    /// All names that the erased states have had or will have.
    all_names: BTreeSet<StateName>,
    /// Position of the snapshot; 0 without one.
    position: u64,
    /// Position of the charger.
    charger_m: Option<[f64; 2]>,
    /// The locations that exist.
    locations: BTreeSet<StateName>,
    part: Option<Part>,
    /// The new keys of producers.
    keys: BTreeMap<ProducerId, ProducerKey>,
}

impl StateErasure {
    /// Erases these states.
    #[must_use]
    pub fn new(mut erased: Vec<StateId>) -> Self {
        erased.sort_unstable();
        erased.dedup();
        let (names, all_names, keys) = (BTreeMap::new(), BTreeSet::new(), BTreeMap::new());
        Self { erased, names, all_names, position: 0, charger_m: None, locations: BTreeSet::new(), part: None, keys }
    }

    /// Erases these states, and the selected observations of the others. `relearned`: the states of the snapshot as
    /// [`Relearning::learn`] returns them, for all states that the decision names.
    #[must_use]
    pub fn of_part(
        erased: Vec<StateId>,
        selection: Selection,
        decision: Decision,
        relearned: BTreeMap<StateId, StateSnapshot>,
    ) -> Self {
        Self { part: Some(Part { selection, decision, relearned, names: BTreeMap::new() }), ..Self::new(erased) }
    }

    /// Gives producers other keys, so that their old keys are new ones.
    #[must_use]
    pub fn with_keys(self, keys: BTreeMap<ProducerId, ProducerKey>) -> Self {
        Self { keys, ..self }
    }

    /// The id of a state after the erasure; `None`: it is erased.
    #[must_use]
    pub fn id(&self, state: StateId) -> Option<StateId> {
        let before = self.erased.partition_point(|erased| *erased < state);
        let is_erased = self.erased.get(before) == Some(&state);
        let id = state.0.saturating_sub(u32::try_from(before).unwrap_or(u32::MAX));
        (!is_erased).then_some(StateId(id))
    }

    fn ids(&self, states: &[StateId]) -> Vec<StateId> {
        states.iter().filter_map(|&state| self.id(state)).collect()
    }

    /// A snapshot without the states.
    #[must_use]
    pub fn snapshot(&mut self, mut snapshot: MapSnapshot) -> MapSnapshot {
        self.position = snapshot.position;
        self.charger_m = snapshot.site.charger_m();
        let mut states = Vec::with_capacity(snapshot.states.len());
        for (id, state) in (0..).map(StateId).zip(snapshot.states) {
            if let Some(part) = &mut self.part {
                part.note(id, &state.name);
            }
            if self.id(id).is_some() {
                let relearned = self.part.as_mut().and_then(|part| part.relearned.remove(&id));
                states.push(relearned.unwrap_or(state));
            } else {
                self.all_names.insert(state.name.clone());
                self.names.insert(id, state.name);
            }
        }
        snapshot.site = Arc::new(self.site(&snapshot.site));
        self.locations = snapshot.site.locations().keys().cloned().collect();
        if snapshot.grid.is_none() {
            let newest = states.iter().filter_map(|state| state.persistence.last());
            snapshot.newest_nanos = newest.map(|(nanos, _)| nanos).max().unwrap_or(0);
        }
        snapshot.states = states;
        for (id, mark) in (0..).map(ProducerId).zip(&mut snapshot.producers) {
            if let Some(key) = self.keys.get(&id) {
                mark.key = key.clone();
            }
        }
        snapshot.history = snapshot.history.iter().filter_map(|piece| self.piece(piece)).map(Arc::new).collect();
        snapshot
    }

    /// The site without the parts that name the erased states.
    fn site(&self, site: &Site) -> Site {
        REFERENCES.iter().fold(site.clone(), |site, reference| (reference.site)(self, site))
    }

    /// Notes the names that an event gives to the states. Called for all events before any is rewritten: a task may
    /// name a state before the state exists.
    pub fn note(&mut self, event: &Event) {
        let new = match event {
            Event::Observations(_, observations) => &observations.new_states[..],
            Event::AddState(new) => std::slice::from_ref(new),
            _ => &[],
        };
        for new in new.iter().filter(|new| self.id(new.id).is_none()).cloned().collect::<Vec<_>>() {
            self.all_names.extend(new.states().map(|(_, name, _)| name));
            self.all_names.insert(new.name);
        }
    }

    /// The event at a log position without the states.
    #[must_use]
    pub fn event(&mut self, position: u64, event: Event) -> Event {
        match event {
            Event::Observations(mut envelope, observations) => {
                let observations = self.observations(position, envelope.producer, observations);
                self.rename(&mut envelope);
                Event::Observations(envelope, observations)
            }
            Event::AddState(new) => match self.new_state(new) {
                Some(new) => Event::AddState(new),
                None => self.unchanged(),
            },
            Event::EditSite(edit) => self.edit(position, edit),
            Event::Scans(mut envelope, scans) => {
                self.rename(&mut envelope);
                Event::Scans(envelope, scans)
            }
            event @ (Event::UpdateStart(_) | Event::Epoch(_) | Event::UpdateDone(_) | Event::ForgetProducers(_)) => {
                event
            }
        }
    }

    fn rename(&self, envelope: &mut Envelope) {
        if let Some((new, key)) = envelope.new_producer.as_mut().zip(self.keys.get(&envelope.producer)) {
            new.key = key.clone();
        }
    }

    fn unchanged(&self) -> Event {
        Event::EditSite(SiteEdit::Charger(self.charger_m))
    }

    fn new_state(&mut self, new: NewState) -> Option<NewState> {
        if let Some(part) = &mut self.part {
            new.states().for_each(|(id, name, _)| part.note(id, &name));
        }
        match self.id(new.id) {
            Some(id) => Some(NewState { id, ..new }),
            None => {
                self.names.extend(new.states().map(|(id, name, _)| (id, name)));
                self.all_names.extend(self.names.values().cloned());
                self.all_names.insert(new.name);
                None
            }
        }
    }

    fn edit(&mut self, position: u64, edit: SiteEdit) -> Event {
        let edit = match edit {
            SiteEdit::SetLocation(name, location) => match self.location(&location) {
                Some(location) => SiteEdit::SetLocation(name, location),
                // The snapshot does not have the location.
                None if position <= self.position => return self.unchanged(),
                // The location replaced another of its name.
                None => SiteEdit::RemoveLocation(name),
            },
            edit => edit,
        };
        let edit = REFERENCES.iter().fold(edit, |edit, reference| (reference.edit)(self, edit));
        // The snapshot contains the earlier edits, which are not applied again.
        if position > self.position {
            match &edit {
                SiteEdit::Charger(at_m) => self.charger_m = *at_m,
                SiteEdit::SetLocation(name, _) => drop(self.locations.insert(name.clone())),
                SiteEdit::RemoveLocation(name) if !self.locations.remove(name) => return self.unchanged(),
                SiteEdit::RemoveLocation(_) | SiteEdit::Visit { .. } => {}
                SiteEdit::Landmarks(_) | SiteEdit::Task(_) | SiteEdit::NoGo(_) => {}
                SiteEdit::Topology(_) => {
                    let renamed = renamed_states(&edit, self.names.iter().map(|(&id, name)| (id, name)));
                    self.names.extend(renamed.into_iter().filter_map(|(id, name)| Some((id, name.ok()?))));
                    self.all_names.extend(self.names.values().cloned());
                    if let Some(part) = &mut self.part {
                        let renamed = renamed_states(&edit, part.names.iter().map(|(&id, name)| (id, name)));
                        part.names.extend(renamed.into_iter().filter_map(|(id, name)| Some((id, name.ok()?))));
                    }
                }
            }
        }
        Event::EditSite(edit)
    }

    fn observations(&mut self, position: u64, producer: ProducerId, mut event: Observations) -> Observations {
        event.new_states =
            std::mem::take(&mut event.new_states).into_iter().filter_map(|new| self.new_state(new)).collect();
        // The snapshot contains the failures and task reports up to its position: earlier events are read for pending
        // observations only.
        let is_known = position <= self.position;
        let part = self.part.as_ref();
        let is_selected = |failure: &EdgeFailure| part.is_some_and(|part| part.takes(producer, failure));
        event.failures.retain(|failure| !is_known && !self.is_of_erased(failure) && !is_selected(failure));
        let names = &self.names;
        event.runs.retain(|run| {
            let is_erased = names.values().any(|known| *known == run.name.state());
            !is_known && !is_erased && !part.is_some_and(|part| part.takes_run(producer, run))
        });
        let is_left = |state: StateId, sample: &Sample| {
            part.is_none_or(|part| !part.selection.takes(state, producer, sample.utc_nanos))
        };
        let kept = event.samples().filter(|(state, sample)| is_left(*state, sample));
        let kept: Vec<_> = kept.filter_map(|(state, sample)| Some((self.id(state)?, sample))).collect();
        let mut left = Observations {
            new_states: event.new_states,
            failures: event.failures,
            runs: event.runs,
            ..Observations::default()
        };
        kept.into_iter().for_each(|(state, sample)| left.push(state, sample));
        left
    }

    /// The history of an update without the states; `None` where nothing remains.
    #[must_use]
    pub fn piece(&self, piece: &HistoryPiece) -> Option<HistoryPiece> {
        debug_assert_eq!(piece.states.len(), piece.origins.len(), "each state has its origins");
        let mut kept = HistoryPiece { days: piece.days.clone(), ..HistoryPiece::new(piece.generation) };
        for ((state, samples), origins) in piece.states.iter().zip(&piece.origins) {
            let Some(id) = self.id(*state) else { continue };
            let (samples, origins) = match &self.part {
                Some(part) => {
                    let numbers = part.decision.numbers.get(state);
                    relearn::left(&part.selection, numbers, (*state, samples, origins))
                }
                None => (samples.clone(), origins.clone()),
            };
            if !samples.is_empty() {
                kept.states.push((id, samples));
                kept.origins.push(origins);
            }
        }
        kept.bounded()
    }
}

impl Part {
    /// Notes the name of a state that may be selected.
    fn note(&mut self, id: StateId, name: &StateName) {
        if self.selection.states.as_ref().is_some_and(|states| states.contains(&id)) {
            self.names.insert(id, name.clone());
        }
    }

    /// Whether a failed traversal that a producer reported is selected.
    fn takes(&self, producer: ProducerId, failure: &EdgeFailure) -> bool {
        self.takes_at(producer, &failure.edge.state(EdgeState::Success), failure.start_nanos)
    }

    /// Whether a report of a task is selected.
    fn takes_run(&self, producer: ProducerId, run: &TaskRun) -> bool {
        self.takes_at(producer, &run.name.state(), run.start_nanos)
    }

    fn takes_at(&self, producer: ProducerId, name: &StateName, start_nanos: i64) -> bool {
        let is_of_states = self.selection.states.is_none() || self.names.values().any(|known| known == name);
        is_of_states && self.selection.has_time(start_nanos) && self.selection.has_producer(producer)
    }
}

#[cfg(test)]
mod tests;
