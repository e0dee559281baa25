//! Which states a map will have once all that is in flight is applied, and of what kind.
//!
//! Invariant: a state in flight has its number and its kind for good: whoever names it next gets the same.

use std::collections::HashMap;

use tidemap_map::{
    event::{NewState, RefusalReason, StateId, StateKind},
    live_map::LiveMap,
    name::StateName,
};

use super::{
    super::{
        intake::refuse_value,
        protocol::{AddStateError, NewName},
    },
    Sessions,
};

/// Why an observation is refused, to act on and to read.
type Refusal = (RefusalReason, String);

/// A name of a stream's table.
#[derive(Debug)]
pub(super) enum Slot {
    /// A state of the map, or of a batch in flight.
    State(StateId, StateKind),
    /// A state that is not of the kind that the stream said: its kind, and what was said.
    OtherKind(StateName, StateKind, StateKind),
    /// A name that no observation has used yet.
    Unused(NewName),
    /// A name that is not valid; intake refuses its observations.
    Invalid,
}

/// The states that there are, and how many there may be.
pub(super) struct Room<'a> {
    pub(super) map: &'a LiveMap,
    pub(super) in_flight: &'a mut HashMap<StateName, (StateId, StateKind)>,
    pub(super) max: usize,
}

impl Slot {
    /// The state of an observation with this value, which may be new. `Err(None)`: it is refused already.
    pub(super) fn state_for(
        &mut self,
        value: f64,
        room: &mut Room<'_>,
        new_states: &mut Vec<NewState>,
    ) -> Result<StateId, Option<Refusal>> {
        if let Slot::Unused(name) = self {
            *self = used(name, value, room, new_states)?;
        }
        match self {
            Slot::State(state, kind) if kind.allows(value) => Ok(*state),
            Slot::State(_, kind) => Err(Some(refuse_value(value, *kind))),
            Slot::OtherKind(name, found, said) => Err(Some(other_kind(name, *found, *said))),
            Slot::Unused(_) | Slot::Invalid => Err(None),
        }
    }
}

/// What becomes of a name at its first observation.
fn used(
    NewName { name, kind: said }: &NewName,
    value: f64,
    room: &mut Room<'_>,
    new_states: &mut Vec<NewState>,
) -> Result<Slot, Refusal> {
    let next = room.map.states() + room.in_flight.len();
    match known_state(room.map, room.in_flight, name) {
        Some((state, kind)) if said.is_none_or(|said| said == kind) => Ok(Slot::State(state, kind)),
        Some((_, found)) => Ok(Slot::OtherKind(name.clone(), found, said.unwrap_or_default())),
        // A value that no such state may have does not make one.
        None if !said.unwrap_or_default().allows(value) => Err(refuse_value(value, said.unwrap_or_default())),
        None if next < room.max => {
            let state = StateId(u32::try_from(next).unwrap_or(u32::MAX));
            let (name, kind) = (name.clone(), said.unwrap_or_default());
            room.in_flight.insert(name.clone(), (state, kind));
            new_states.push(NewState { id: state, name, kind });
            Ok(Slot::State(state, kind))
        }
        None => {
            let text = format!(
                "the state would be new, and the map has {} states, as many as setting max_states_per_map allows: {:?}",
                room.max,
                name.as_str().chars().take(60).collect::<String>()
            );
            Err((RefusalReason::StateLimit, text))
        }
    }
}

impl Sessions {
    /// The event that adds a state; `None` where the map has it, of that kind.
    pub fn add_state(
        &mut self,
        name: &StateName,
        kind: StateKind,
        map: &LiveMap,
    ) -> Result<Option<NewState>, AddStateError> {
        let next = map.states() + self.states_in_flight.len();
        match known_state(map, &self.states_in_flight, name) {
            Some((_, found)) if found == kind => Ok(None),
            Some((_, found)) => Err(AddStateError::OtherKind { name: name.clone(), found, asked: kind }),
            None if next < self.limits.states => {
                let id = StateId(u32::try_from(next).unwrap_or(u32::MAX));
                self.states_in_flight.insert(name.clone(), (id, kind));
                Ok(Some(NewState { id, name: name.clone(), kind }))
            }
            None => Err(AddStateError::TooMany { max: self.limits.states }),
        }
    }

    /// A state that was added is applied to the map.
    pub fn state_added(&mut self, name: &StateName) {
        self.states_in_flight.remove(name);
    }
}

/// A state of the map, or of an event in flight.
fn known_state(
    map: &LiveMap,
    in_flight: &HashMap<StateName, (StateId, StateKind)>,
    name: &StateName,
) -> Option<(StateId, StateKind)> {
    let of_map = map.find(name.as_str()).and_then(|id| Some((id, map.kind(id)?)));
    of_map.or_else(|| in_flight.get(name).copied())
}

/// That a stream has said of a state that it is of another kind than it is.
fn other_kind(name: &StateName, found: StateKind, said: StateKind) -> Refusal {
    let name = name.as_str().chars().take(60).collect::<String>();
    let text = format!("state {name:?} exists and is a {}, not a {}", found.name(), said.name());
    (RefusalReason::StateKind, text)
}
