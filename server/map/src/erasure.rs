//! Erasing states: snapshot, events and history as they would be if the states had never been observed.
//!
//! The states after an erased one move up, so that ids stay without gaps. Positions of events do not change: an event
//! of which nothing remains becomes the edit that sets the charger to where it already is. Nor do the producers' marks:
//! an erased observation still counts as acknowledged, so that it is ignored when it is sent again.
//!
//! Invariant: the remaining states keep every bit of what they have learned, and of what they still have to learn.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use crate::{
    event::{Event, NewState, Observations, OffsetRun},
    history::HistoryPiece,
    ids::StateId,
    live_map::rename::renamed_states,
    name::{EdgeState, StateName},
    site::{Location, Site, SiteEdit},
    snapshot::MapSnapshot,
    traversal::{EdgeFailure, Failures},
};

/// Rewrites what a map is made of without some of its states: first the snapshot, then the events in their order.
#[derive(Clone, Debug)]
pub struct StateErasure {
    /// Ascending.
    erased: Vec<StateId>,
    /// Names of the erased states, as far as they are known.
    names: BTreeMap<StateId, StateName>,
    /// Position of the snapshot; 0 without one.
    position: u64,
    /// Where the charger is.
    charger_m: Option<[f64; 2]>,
    /// The locations that there are.
    locations: BTreeSet<StateName>,
}

impl StateErasure {
    /// The erasure of these states.
    #[must_use]
    pub fn new(mut erased: Vec<StateId>) -> Self {
        erased.sort_unstable();
        erased.dedup();
        Self { erased, names: BTreeMap::new(), position: 0, charger_m: None, locations: BTreeSet::new() }
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
            if self.id(id).is_some() {
                states.push(state);
            } else {
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
        snapshot.history = snapshot.history.iter().filter_map(|piece| self.piece(piece)).map(Arc::new).collect();
        snapshot
    }

    fn site(&self, site: &Site) -> Site {
        let mut failures = Failures::default();
        let kept = site.failures().oldest_first().filter(|failure| !self.is_of_erased(failure));
        kept.for_each(|failure| failures.add(failure.clone()));
        let locations = site.locations().iter();
        let locations = locations.filter_map(|(name, location)| Some((name.clone(), self.location(location)?)));
        site.clone().with_failures(failures).with_locations(locations.collect())
    }

    /// A location without the states; `None` where nothing else is observed there.
    fn location(&self, location: &Location) -> Option<Location> {
        let states = self.ids(&location.states);
        let is_left = !states.is_empty() || !location.cells.is_empty();
        is_left.then(|| Location { states, ..location.clone() })
    }

    fn is_of_erased(&self, failure: &EdgeFailure) -> bool {
        let of_edge = [EdgeState::Success, EdgeState::Speed, EdgeState::Pace].map(|what| failure.edge.state(what));
        self.names.values().any(|name| of_edge.contains(name))
    }

    /// The event at a log position without the states.
    #[must_use]
    pub fn event(&mut self, position: u64, event: Event) -> Event {
        match event {
            Event::Observations(observations) => Event::Observations(self.observations(position, observations)),
            Event::AddState(new) => match self.new_state(new) {
                Some(new) => Event::AddState(new),
                None => self.unchanged(),
            },
            Event::EditSite(edit) => self.edit(position, edit),
            event @ (Event::Scans(_) | Event::UpdateStart(_)) => event,
        }
    }

    fn unchanged(&self) -> Event {
        Event::EditSite(SiteEdit::Charger(self.charger_m))
    }

    fn new_state(&mut self, new: NewState) -> Option<NewState> {
        match self.id(new.id) {
            Some(id) => Some(NewState { id, ..new }),
            None => {
                self.names.extend(new.states().map(|(id, name, _)| (id, name)));
                None
            }
        }
    }

    fn edit(&mut self, position: u64, edit: SiteEdit) -> Event {
        let edit = match edit {
            SiteEdit::SetLocation(name, location) => match self.location(&location) {
                Some(location) => SiteEdit::SetLocation(name, location),
                // It replaced what had its name.
                None => SiteEdit::RemoveLocation(name),
            },
            edit => edit,
        };
        // The snapshot has the earlier edits, which are not applied again.
        if position > self.position {
            match &edit {
                SiteEdit::Charger(at_m) => self.charger_m = *at_m,
                SiteEdit::SetLocation(name, _) => drop(self.locations.insert(name.clone())),
                SiteEdit::RemoveLocation(name) if !self.locations.remove(name) => return self.unchanged(),
                SiteEdit::RemoveLocation(_) | SiteEdit::Visit { .. } => {}
                SiteEdit::Topology(_) => {
                    let renamed = renamed_states(&edit, self.names.iter().map(|(&id, name)| (id, name)));
                    self.names.extend(renamed.into_iter().filter_map(|(id, name)| Some((id, name.ok()?))));
                }
            }
        }
        Event::EditSite(edit)
    }

    fn observations(&mut self, position: u64, mut event: Observations) -> Observations {
        event.new_states =
            std::mem::take(&mut event.new_states).into_iter().filter_map(|new| self.new_state(new)).collect();
        // The snapshot has those up to its position: here they are read for pending observations only.
        let is_known = position <= self.position;
        event.failures.retain(|failure| !is_known && !self.is_of_erased(failure));
        let kept: Vec<_> = event.samples().filter_map(|(state, sample)| Some((self.id(state)?, sample))).collect();
        event.states = kept.iter().map(|(state, _)| *state).collect();
        event.times_nanos = kept.iter().map(|(_, sample)| sample.utc_nanos).collect();
        event.values = kept.iter().map(|(_, sample)| sample.value).collect();
        event.offsets = Vec::new();
        for (_, sample) in &kept {
            match event.offsets.last_mut().filter(|run| run.offset_secs == sample.offset_secs) {
                Some(run) => run.count += 1,
                None => event.offsets.push(OffsetRun { count: 1, offset_secs: sample.offset_secs }),
            }
        }
        event
    }

    /// The history of an update without the states; `None` where nothing remains.
    #[must_use]
    pub fn piece(&self, piece: &HistoryPiece) -> Option<HistoryPiece> {
        let states = piece.states.iter().filter_map(|(id, samples)| Some((self.id(*id)?, samples.clone())));
        HistoryPiece { states: states.collect(), days: piece.days.clone(), ..*piece }.bounded()
    }
}

#[cfg(test)]
mod tests;
