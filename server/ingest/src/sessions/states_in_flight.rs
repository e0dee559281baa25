//! The additions of events that are not written yet to the states of a map.
//!
//! Invariant: a state in flight keeps its number, its kind and its reporting: the next stream that names it gets the
//! same ones. A vector, an angle and a categorical state have an entry as a whole and one for each of their states.

use std::collections::{HashMap, HashSet};

use tidemap_map::{
    event::{NewState, Reporting, StateKind, StateSensor, StateShape},
    ids::StateId,
    live_map::LiveMap,
    name::StateName,
};

/// The role of a name in flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum NameRole {
    /// A state of the map.
    State,
    /// A vector, an angle or a categorical state as a whole.
    Whole,
    /// The new name of a state that still has its old one.
    Rename,
}

/// The properties of the state of a name.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct KnownState {
    /// The state; for a vector or a categorical state, its first axis or label.
    pub id: StateId,
    pub shape: StateShape,
    /// The reporting of the state.
    pub reporting: Reporting,
    /// The sensor of the state's readings, if one was stated.
    pub sensor: Option<StateSensor>,
}

/// The names of states in flight.
#[derive(Debug, Default)]
pub(super) struct StatesInFlight {
    names: HashMap<StateName, (KnownState, NameRole)>,
    states: usize,
    /// Maximum number of readings a day of the rows of all these states.
    readings_a_day: u64,
}

impl StatesInFlight {
    /// Number of states.
    pub(super) fn states(&self) -> usize {
        self.states
    }

    /// Maximum number of readings a day of the rows of all these states.
    pub(super) fn readings_a_day(&self) -> u64 {
        self.readings_a_day
    }

    /// The state of a name, from the map or in flight.
    pub(super) fn known(&self, map: &LiveMap, name: &StateName) -> Option<KnownState> {
        let Some((id, shape)) = map.shape(name.as_str()) else { return self.names.get(name).map(|(known, _)| *known) };
        Some(KnownState { id, shape, reporting: map.reporting(id), sensor: map.sensor(id) })
    }

    /// The state of the map with a name in flight; not a vector, angle or categorical state as a whole.
    pub(super) fn state(&self, name: &StateName) -> Option<StateId> {
        self.names.get(name).filter(|(_, role)| *role == NameRole::State).map(|(known, _)| known.id)
    }

    /// The states with their kinds and names.
    pub(super) fn iter(&self) -> impl Iterator<Item = ((StateId, StateKind), &StateName)> {
        let states = self.names.iter().filter(|(_, (_, role))| *role == NameRole::State);
        states.map(|(name, (known, _))| ((known.id, known.shape.kind()), name))
    }

    /// Adds the states that an event adds.
    pub(super) fn add(&mut self, new: &NewState) {
        let NewState { id, shape, reporting, sensor, .. } = *new;
        let known = KnownState { id, shape, reporting, sensor };
        for (id, name, kind) in new.states() {
            self.names.insert(name, (KnownState { id, shape: kind.into(), ..known }, NameRole::State));
        }
        if !matches!(shape, StateShape::Scalar(_)) {
            self.names.insert(new.name.clone(), (known, NameRole::Whole));
        }
        self.states += shape.states();
        self.readings_a_day = self.readings_a_day.saturating_add(reporting.readings_a_day());
    }

    /// Removes the states that an event has added to the map. Returns the number of states.
    pub(super) fn remove(&mut self, new: &NewState) -> usize {
        let mut removed = 0;
        for (_, name, _) in new.states() {
            removed += usize::from(self.names.remove(&name).is_some());
        }
        if removed > 0 {
            self.names.remove(&new.name);
            self.readings_a_day = self.readings_a_day.saturating_sub(new.reporting.readings_a_day());
        }
        self.states = self.states.saturating_sub(removed);
        new.shape.states()
    }

    /// Reserves the new names of states, until [`StatesInFlight::end_renames`].
    pub(super) fn rename(&mut self, renames: HashMap<StateName, (StateId, StateKind)>, map: &LiveMap) {
        let ids: HashSet<StateId> = renames.values().map(|(id, _)| *id).collect();
        let states = self.names.values().filter(|(known, role)| *role == NameRole::State && ids.contains(&known.id));
        let in_flight: HashMap<StateId, KnownState> = states.map(|(known, _)| (known.id, *known)).collect();
        for (name, (id, kind)) in renames {
            let of_map = || KnownState { id, shape: kind.into(), reporting: map.reporting(id), sensor: map.sensor(id) };
            let known = in_flight.get(&id).copied().unwrap_or_else(of_map);
            self.names.entry(name).or_insert((known, NameRole::Rename));
        }
    }

    /// The renames were applied, or have failed.
    pub(super) fn end_renames(&mut self) {
        self.names.retain(|_, (_, role)| *role != NameRole::Rename);
    }

    /// Forgets all states in flight, because none of their events was written.
    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }
}
