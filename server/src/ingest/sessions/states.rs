//! Which states a map will have once all that is in flight is applied, and of what kind.
//!
//! Invariant: a state in flight has its number and its kind for good: whoever names it next gets the same.

use std::collections::HashMap;

use tidemap_map::{
    event::{NewState, RefusalReason, StateId, StateKind},
    live_map::LiveMap,
    name::StateName,
};

use super::{super::protocol::AddStateError, Sessions};

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
pub(super) fn known_state(
    map: &LiveMap,
    in_flight: &HashMap<StateName, (StateId, StateKind)>,
    name: &StateName,
) -> Option<(StateId, StateKind)> {
    let of_map = map.find(name.as_str()).and_then(|id| Some((id, map.kind(id)?)));
    of_map.or_else(|| in_flight.get(name).copied())
}

/// That a stream has said of a state that it is of another kind than it is.
pub(super) fn other_kind(name: &StateName, found: StateKind, said: StateKind) -> (RefusalReason, String) {
    let name = name.as_str().chars().take(60).collect::<String>();
    let text = format!("state {name:?} exists and is a {}, not a {}", found.name(), said.name());
    (RefusalReason::StateKind, text)
}
