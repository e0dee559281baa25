//! Which states a map will have once all that is in flight is applied, and of what kind.
//!
//! Invariant: a state in flight has its number and its kind for good: whoever names it next gets the same. A vector is in
//! flight as all its axes.

use std::collections::HashMap;

use tidemap_map::{
    event::{Dimensions, NewState, StateKind, StateShape},
    ids::{RefusalReason, StateId},
    live_map::{LiveMap, rename::renamed_states},
    name::StateName,
    site::{InvalidEdit, SiteEdit},
};

use super::{
    super::{
        intake::refuse_value,
        protocol::{AddStateError, NewName},
    },
    Sessions,
};

/// Why an observation is refused, to act on and to read.
pub(super) type Refusal = (RefusalReason, String);

/// A name of a stream's table.
#[derive(Debug)]
pub(super) enum StreamState {
    /// A state of the map, or of a batch in flight; of a vector its first axis.
    State(StateId, StateShape),
    /// A state that is not what the stream said: what it is, and what was said.
    OtherShape(StateName, StateShape, Option<StateShape>),
    /// A name that no observation has used yet.
    Unused(NewName),
    /// A name that is not valid; intake refuses its observations.
    Invalid,
}

/// The states that there are, and how many there may be.
pub(super) struct StateAllocator<'a> {
    pub(super) map: &'a LiveMap,
    pub(super) in_flight: &'a mut HashMap<StateName, (StateId, StateKind)>,
    pub(super) renames: &'a HashMap<StateName, (StateId, StateKind)>,
    pub(super) max: usize,
}

impl StreamState {
    /// The state of an observation with this value, or the first axis of one with a position; it may be new. `Err(None)`:
    /// it is refused already.
    pub(super) fn state_for(
        &mut self,
        value: f64,
        is_position: bool,
        allocator: &mut StateAllocator<'_>,
        new_states: &mut Vec<NewState>,
    ) -> Result<StateId, Option<Refusal>> {
        if let StreamState::Unused(name) = self {
            *self = used(name, value, allocator, new_states)?;
        }
        match self {
            // Intake gives a position where a vector was said, and then only.
            StreamState::State(state, StateShape::Vector(_)) if is_position => Ok(*state),
            StreamState::State(state, StateShape::Scalar(kind)) if !is_position && kind.allows(value) => Ok(*state),
            StreamState::State(_, shape) => Err(Some(refuse_value(value, shape.kind()))),
            StreamState::OtherShape(name, found, said) => Err(Some(other_shape(name, *found, *said))),
            StreamState::Unused(_) | StreamState::Invalid => Err(None),
        }
    }
}

/// What becomes of a name at its first observation.
fn used(
    NewName { name, shape: said }: &NewName,
    value: f64,
    allocator: &mut StateAllocator<'_>,
    new_states: &mut Vec<NewState>,
) -> Result<StreamState, Refusal> {
    let shape = said.unwrap_or_default();
    match known_state(allocator.map, allocator.in_flight, allocator.renames, name) {
        // Of a name of which nothing is said there are values.
        Some((state, found)) if *said == Some(found) || (said.is_none() && is_scalar(found)) => {
            Ok(StreamState::State(state, found))
        }
        Some((_, found)) => Ok(StreamState::OtherShape(name.clone(), found, *said)),
        // A value that no such state may have does not make one. Positions are those that a vector may have.
        None if is_scalar(shape) && !shape.kind().allows(value) => Err(refuse_value(value, shape.kind())),
        None => match allocator.add(name, shape) {
            Some(new) => {
                let state = new.id;
                new_states.push(new);
                Ok(StreamState::State(state, shape))
            }
            None => Err(allocator.is_full(name)),
        },
    }
}

impl StateAllocator<'_> {
    /// The states of these names and kinds; those that there are not yet are new. All of them, or none.
    pub(super) fn states_for(
        &mut self,
        wanted: &[(StateName, StateKind)],
        new_states: &mut Vec<NewState>,
    ) -> Result<Vec<StateId>, Refusal> {
        let mut known = Vec::with_capacity(wanted.len());
        for (name, kind) in wanted {
            known.push(match known_state(self.map, self.in_flight, self.renames, name) {
                Some((_, found)) if found != StateShape::Scalar(*kind) => {
                    return Err(other_shape(name, found, Some(StateShape::Scalar(*kind))));
                }
                found => found.map(|(state, _)| state),
            });
        }
        let new = known.iter().filter(|known| known.is_none()).count();
        let most = self.max.saturating_sub(self.map.states() + self.in_flight.len());
        let mut states = Vec::with_capacity(wanted.len());
        for (known, (name, kind)) in known.into_iter().zip(wanted) {
            states.push(match known {
                Some(state) => state,
                None => {
                    let added = if new <= most { self.add(name, StateShape::Scalar(*kind)) } else { None };
                    let added = added.ok_or_else(|| self.is_full(name))?;
                    let state = added.id;
                    new_states.push(added);
                    state
                }
            });
        }
        Ok(states)
    }

    /// That there is no allocator for a state.
    fn is_full(&self, name: &StateName) -> Refusal {
        let name = name.as_str().chars().take(60).collect::<String>();
        let text = format!(
            "the state would be new, and the map has {} states, as many as setting max_states_per_map allows: {name:?}",
            self.max
        );
        (RefusalReason::StateLimit, text)
    }

    /// A state, or all axes of a vector, which are in flight from now on; `None` where there is no allocator for them.
    fn add(&mut self, name: &StateName, shape: StateShape) -> Option<NewState> {
        let next = self.map.states() + self.in_flight.len();
        if next.saturating_add(shape.states()) > self.max {
            return None;
        }
        let new = NewState { id: StateId(u32::try_from(next).unwrap_or(u32::MAX)), name: name.clone(), shape };
        self.in_flight.extend(new.states().map(|(id, name, kind)| (name, (id, kind))));
        Some(new)
    }
}

impl Sessions {
    /// The event that adds a state; `None` where the map has it, of that kind.
    pub(crate) fn add_state(
        &mut self,
        name: &StateName,
        shape: StateShape,
        map: &LiveMap,
    ) -> Result<Option<NewState>, AddStateError> {
        match known_state(map, &self.states_in_flight, &self.renames_in_flight, name) {
            Some((_, found)) if found == shape => Ok(None),
            Some((_, found)) => Err(AddStateError::OtherKind { name: name.clone(), found, asked: shape }),
            None => {
                let mut allocator = StateAllocator {
                    map,
                    in_flight: &mut self.states_in_flight,
                    renames: &self.renames_in_flight,
                    max: self.limits.states,
                };
                let new = allocator.add(name, shape);
                new.map(Some).ok_or(AddStateError::TooMany { max: self.limits.states })
            }
        }
    }

    /// Keeps the names that an edit will give to states for these states, until [`Sessions::renamed`]; those in flight count.
    ///
    /// # Errors
    /// A name that cannot be, or that another state has; then none is kept.
    pub(crate) fn keep_names(&mut self, edit: &SiteEdit, map: &LiveMap) -> Result<(), InvalidEdit> {
        let in_flight = self.states_in_flight.iter().map(|(name, known)| (*known, name));
        let known = map.names().map(|(id, name)| ((id, map.kind(id).unwrap_or_default()), name));
        let renamed: Vec<_> = renamed_states(edit, known.chain(in_flight));
        let mut kept = HashMap::new();
        for ((id, kind), name) in renamed {
            let name = name?;
            let of_another = map.shape(name.as_str()).map(|(other, _)| other);
            let of_another = of_another.or(self.states_in_flight.get(&name).map(|&(other, _)| other));
            if of_another.is_some_and(|other| other != id) || kept.contains_key(&name) {
                let state = map.names().find(|(other, _)| *other == id).map_or("", |(_, name)| name.as_str());
                return Err(InvalidEdit::StateExists { state: state.to_owned(), name: name.to_string() });
            }
            kept.insert(name, (id, kind));
        }
        self.renames_in_flight = kept;
        Ok(())
    }

    /// What was renamed has its new name, or keeps its old one.
    pub(crate) fn renamed(&mut self) {
        self.renames_in_flight.clear();
    }

    /// A state that was added is applied to the map.
    pub(crate) fn state_added(&mut self, new: &NewState) {
        for (_, name, _) in new.states() {
            self.states_in_flight.remove(&name);
        }
    }
}

/// A state of the map, or of an event in flight; of a vector its first axis.
fn known_state(
    map: &LiveMap,
    in_flight: &HashMap<StateName, (StateId, StateKind)>,
    renames: &HashMap<StateName, (StateId, StateKind)>,
    name: &StateName,
) -> Option<(StateId, StateShape)> {
    if let Some(known) = map.shape(name.as_str()) {
        return Some(known);
    }
    if let Some(&(state, kind)) = in_flight.get(name).or_else(|| renames.get(name)) {
        return Some((state, kind.into()));
    }
    // A vector has a plain name: `edge/A/B/x` is an edge with the action x.
    if name.as_str().contains('/') {
        return None;
    }
    let &(first, _) = in_flight.get(&name.axis(0))?;
    let has_z = in_flight.contains_key(&name.axis(2));
    Some((first, StateShape::Vector(if has_z { Dimensions::Three } else { Dimensions::Two })))
}

fn is_scalar(shape: StateShape) -> bool {
    matches!(shape, StateShape::Scalar(_))
}

/// That a stream has said of a state that it is something else than it is.
fn other_shape(name: &StateName, found: StateShape, said: Option<StateShape>) -> Refusal {
    let name = name.as_str().chars().take(60).collect::<String>();
    let said = said.map_or("single value", StateShape::name);
    let text = format!("state {name:?} exists and is a {}, not a {said}", found.name());
    (RefusalReason::StateKind, text)
}
