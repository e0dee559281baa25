//! The states of a map, with their kinds, after all events in flight are applied.
//!
//! Invariant: a state in flight keeps its number and its kind: the next stream that names it gets the same number and
//! kind. A vector or an angle is in flight with all its axes.

use std::collections::HashMap;

use tidemap_map::{
    event::{NewState, Reporting, RowKind, StateKind, StateShape, StatedReporting},
    ids::{RefusalReason, StateId},
    live_map::{LiveMap, ROW_READINGS_A_DAY_MAX, rename::renamed_states},
    name::StateName,
    site::{InvalidEdit, SiteEdit},
};
use tidemap_proto::convert::vectors::{DeclaredState, cannot_report};

use super::{
    super::{
        intake::refuse_value,
        protocol::{AddStateError, NewName, NoRoom},
    },
    Sessions,
    places::Room,
    states_in_flight::{KnownState, StatesInFlight},
};

/// The reason why an observation is refused, for programs and for people.
pub(super) type Refusal = (RefusalReason, String);

/// The state for a name in a stream's table.
#[derive(Debug)]
pub(super) enum StreamState {
    /// A state of the map, or of a batch in flight; for a vector, its first axis.
    State(StateId, StateShape, Reporting),
    /// A label of a categorical state: the first label, the number of labels, and the observed label.
    Label(StateId, u8, StateId),
    /// A state whose shape differs from the declared one: its shape, and the declared one.
    OtherShape(StateName, StateShape, Option<StateShape>),
    /// A state whose reporting differs from the one that the stream has stated.
    OtherReporting(StateName, Reporting, StatedReporting),
    /// A name that no observation has used yet.
    Unused(NewName),
    /// An invalid name; intake refuses its observations.
    Invalid,
}

/// Allocates states, up to a limit.
pub(super) struct StateAllocator<'a> {
    pub(super) map: &'a LiveMap,
    pub(super) in_flight: &'a mut StatesInFlight,
    /// The room that the client has.
    pub(super) room: &'a mut Room,
}

impl StreamState {
    /// The state of an observation with this value, or its first axis or label, with its shape. For a label, also the
    /// state of the label that holds; it may be new. `has_parts`: the observation is a position, or shares.
    /// `Err(None)`: intake has refused it already.
    pub(super) fn state_for(
        &mut self,
        value: f64,
        has_parts: bool,
        allocator: &mut StateAllocator<'_>,
        new_states: &mut Vec<NewState>,
    ) -> Result<ObservedState, Option<Refusal>> {
        if let StreamState::Unused(name) = self {
            *self = used(name, value, allocator, new_states)?;
        }
        match self {
            // Intake passes a position only if a vector was declared, and shares only if a categorical state was
            // declared.
            StreamState::State(state, shape @ (StateShape::Vector(_) | StateShape::Categorical(_)), _) if has_parts => {
                Ok(ObservedState { first: *state, shape: *shape, held: None })
            }
            StreamState::Label(first, labels, held) => {
                let shape = StateShape::Categorical(*labels);
                Ok(ObservedState { first: *first, shape, held: Some(*held) })
            }
            StreamState::State(state, shape, reporting)
                if !has_parts && (shape.allows(value) || (value.is_nan() && reporting.may_end())) =>
            {
                Ok(ObservedState { first: *state, shape: *shape, held: None })
            }
            StreamState::State(_, shape, _) => Err(Some(refuse_value(value, *shape))),
            StreamState::OtherShape(name, found, given) => Err(Some(other_shape(name, *found, *given))),
            StreamState::OtherReporting(name, found, given) => Err(Some(other_reporting(name, *found, *given))),
            StreamState::Unused(_) | StreamState::Invalid => Err(None),
        }
    }
}

/// The state of an observation.
pub(super) struct ObservedState {
    /// The state, or its first axis or label.
    pub(super) first: StateId,
    pub(super) shape: StateShape,
    /// For an observation of a label: the state of the label.
    pub(super) held: Option<StateId>,
}

/// Looks the name of a label up at its first observation.
fn used_label(name: &StateName, state: &str, allocator: &StateAllocator<'_>) -> Result<StreamState, Refusal> {
    let whole = StateName::new(state).map_err(|error| (RefusalReason::StateName, format!("state {error}")))?;
    match allocator.known(&whole) {
        Some(KnownState { id: first, shape: StateShape::Categorical(labels), .. }) => match allocator.known(name) {
            Some(held) => Ok(StreamState::Label(first, labels, held.id)),
            None => {
                let known = allocator.labels(first, labels);
                let (label, known) = (name.as_label().map_or("", |(_, label)| label), known.join(", "));
                Err((RefusalReason::Value, format!("state {state:?} has no label {label:?}: its labels are {known}")))
            }
        },
        Some(found) => Err(other_shape(&whole, found.shape, Some(StateShape::Categorical(0)))),
        None => Err(no_labels(&whole)),
    }
}

/// The refusal of an observation of a categorical state that was not added.
fn no_labels(name: &StateName) -> Refusal {
    let name = name.as_str().chars().take(60).collect::<String>();
    let text = format!("state {name:?} does not exist: a categorical state is added with its labels first");
    (RefusalReason::StateKind, text)
}

/// Looks the name up at its first observation.
fn used(
    NewName { name, shape: given, reporting: stated }: &NewName,
    value: f64,
    allocator: &mut StateAllocator<'_>,
    new_states: &mut Vec<NewState>,
) -> Result<StreamState, Refusal> {
    if let Some((state, _)) = name.as_label() {
        return used_label(name, state, allocator);
    }
    let has_events = stated.is_some_and(|stated| stated.kind() == RowKind::Events);
    let usual = if has_events { StateKind::Count.into() } else { StateShape::default() };
    let shape = given.unwrap_or(usual);
    let reporting = stated.map_or(Reporting::Samples, StatedReporting::for_new);
    match allocator.known(name) {
        // A name without a declared shape has observations of single values.
        Some(KnownState { id, shape: found, reporting, .. })
            if *given == Some(found) || (given.is_none() && found.is_single()) =>
        {
            Ok(match stated {
                Some(stated) if !stated.fits(reporting) => {
                    StreamState::OtherReporting(name.clone(), reporting, *stated)
                }
                _ => StreamState::State(id, found, reporting),
            })
        }
        Some(KnownState { shape: StateShape::Categorical(labels), .. })
            if matches!(shape, StateShape::Categorical(_)) =>
        {
            let (name, sent) = (name.as_str().chars().take(60).collect::<String>(), shape.states());
            let text = format!("state {name:?} has {labels} labels, not {sent}: send a share of each");
            debug_assert_ne!(usize::from(labels), sent, "equal shapes are accepted above");
            Err((RefusalReason::Value, text))
        }
        Some(found) => Ok(StreamState::OtherShape(name.clone(), found.shape, *given)),
        None if matches!(shape, StateShape::Categorical(_)) => Err(no_labels(name)),
        None if !shape.may_report(reporting) => Err((RefusalReason::StateKind, cannot_report(shape, reporting.kind()))),
        // An invalid value does not create a state. Intake has checked positions.
        None if shape.is_single() && !shape.allows(value) && !(value.is_nan() && reporting.may_end()) => {
            Err(refuse_value(value, shape))
        }
        None => match allocator.add(name, shape, reporting) {
            Ok(new) => {
                let state = new.id;
                new_states.push(new);
                Ok(StreamState::State(state, shape, reporting))
            }
            Err(no_room) => Err(is_full(name, &no_room)),
        },
    }
}

impl StateAllocator<'_> {
    /// The states of these names and kinds. Missing states are allocated, all of them or none.
    pub(super) fn states_for(
        &mut self,
        wanted: &[(StateName, StateKind)],
        new_states: &mut Vec<NewState>,
    ) -> Result<Vec<StateId>, Refusal> {
        let mut known = Vec::with_capacity(wanted.len());
        for (name, kind) in wanted {
            known.push(match self.known(name) {
                Some(found) if found.shape != StateShape::Scalar(*kind) => {
                    return Err(other_shape(name, found.shape, Some(StateShape::Scalar(*kind))));
                }
                found => found.map(|found| found.id),
            });
        }
        let new = known.iter().filter(|known| known.is_none()).count();
        let room = self.room.left();
        let mut states = Vec::with_capacity(wanted.len());
        for (known, (name, kind)) in known.into_iter().zip(wanted) {
            states.push(match known {
                Some(state) => state,
                None => {
                    let shape = StateShape::Scalar(*kind);
                    let full = Err(self.room.full());
                    let added = if new <= room { self.add(name, shape, Reporting::Samples) } else { full };
                    let added = added.map_err(|no_room| is_full(name, &no_room))?;
                    let state = added.id;
                    new_states.push(added);
                    state
                }
            });
        }
        Ok(states)
    }

    /// A state of the map, or of an event in flight; for a vector or a categorical state, its first axis or label.
    fn known(&self, name: &StateName) -> Option<KnownState> {
        self.in_flight.known(self.map, name)
    }

    /// The labels of a categorical state.
    fn labels(&self, first: StateId, labels: u8) -> Vec<String> {
        let ids = first.0..first.0.saturating_add(u32::from(labels));
        let of_map = ids.clone().filter_map(|id| Some((StateId(id), self.map.name(StateId(id))?)));
        let in_flight = self.in_flight.iter().map(|((id, _), name)| (id, name));
        let in_flight = in_flight.filter(|(id, _)| ids.contains(&id.0));
        let mut named: Vec<(StateId, &StateName)> = of_map.chain(in_flight).collect();
        named.sort_by_key(|(id, _)| *id);
        named.into_iter().filter_map(|(_, name)| Some(name.as_label()?.1.to_owned())).collect()
    }

    /// Allocates a state, or all axes of a vector, if there is room.
    fn add(&mut self, name: &StateName, shape: StateShape, reporting: Reporting) -> Result<NewState, NoRoom> {
        let (name, labels) = (name.clone(), Vec::new());
        self.allocate(NewState { id: StateId(0), name, shape, labels, sensor: None, reporting })
    }

    /// Gives a new state its number, if there is room for it.
    fn allocate(&mut self, new: NewState) -> Result<NewState, NoRoom> {
        let next = self.map.states() + self.in_flight.states();
        let known = self.map.row_readings_a_day().saturating_add(self.in_flight.readings_a_day());
        let readings = known.saturating_add(new.reporting.readings_a_day());
        if new.reporting.may_end() && readings > ROW_READINGS_A_DAY_MAX {
            return Err(NoRoom::Readings { max: ROW_READINGS_A_DAY_MAX });
        }
        self.room.take(new.shape.states())?;
        let new = NewState { id: StateId(u32::try_from(next).unwrap_or(u32::MAX)), ..new };
        self.in_flight.add(&new);
        Ok(new)
    }
}

/// The refusal of a state for which there is no room.
fn is_full(name: &StateName, no_room: &NoRoom) -> Refusal {
    let name = name.as_str().chars().take(60).collect::<String>();
    (RefusalReason::StateLimit, format!("the state would be new: {name:?}; {no_room}"))
}

impl Sessions {
    /// The event that adds a state; `None` if the map has it with that shape, sensor and reporting. A property that is
    /// not stated matches any value.
    pub(crate) fn add_state(
        &mut self,
        DeclaredState { name, shape, labels, sensor, reporting: stated }: &DeclaredState,
        client: &str,
        map: &LiveMap,
    ) -> Result<Option<NewState>, AddStateError> {
        let (shape, sensor) = (*shape, *sensor);
        match self.states_in_flight.known(map, name) {
            Some(found) if found.shape == shape && !labels.is_empty() => {
                let is_own = |(label, id): (&StateName, u32)| {
                    let known = map.find(label.as_str()).or_else(|| self.states_in_flight.state(label));
                    known == Some(StateId(id))
                };
                if labels.iter().zip(found.id.0..).all(is_own) {
                    Ok(None)
                } else {
                    Err(AddStateError::OtherLabels { name: name.clone() })
                }
            }
            Some(KnownState { shape: StateShape::Categorical(_), .. }) if !labels.is_empty() => {
                Err(AddStateError::OtherLabels { name: name.clone() })
            }
            Some(found) if found.shape == shape => {
                if let Some(requested) = stated.filter(|stated| !stated.fits(found.reporting)) {
                    return Err(AddStateError::OtherReporting {
                        name: name.clone(),
                        found: found.reporting,
                        requested,
                    });
                }
                match sensor {
                    Some(requested) if found.sensor != Some(requested) => {
                        Err(AddStateError::OtherSensor { name: name.clone(), found: found.sensor, requested })
                    }
                    _ => Ok(None),
                }
            }
            Some(found) => Err(AddStateError::OtherKind { name: name.clone(), found: found.shape, requested: shape }),
            None => {
                let mut room = self.state_places.room(client, map.states() + self.states_in_flight.states());
                let in_flight = &mut self.states_in_flight;
                let mut allocator = StateAllocator { map, in_flight, room: &mut room };
                let reporting = stated.map_or(Reporting::Samples, StatedReporting::for_new);
                let (name, labels) = (name.clone(), labels.clone());
                let new = NewState { id: StateId(0), name, shape, labels, sensor, reporting };
                let new = allocator.allocate(new)?;
                self.state_places.take(client, room.taken());
                Ok(Some(new))
            }
        }
    }

    /// Reserves the names that an edit will give to states, until [`Sessions::renamed`]. The states include those in
    /// flight.
    ///
    /// # Errors
    /// A name that is invalid, or that another state has; then none is reserved.
    pub(crate) fn keep_names(&mut self, edit: &SiteEdit, map: &LiveMap) -> Result<(), InvalidEdit> {
        let in_flight = self.states_in_flight.iter();
        let known = map.names().map(|(id, name)| ((id, map.kind(id).unwrap_or_default()), name));
        let renamed: Vec<_> = renamed_states(edit, known.chain(in_flight));
        let mut kept = HashMap::new();
        for ((id, kind), name) in renamed {
            let name = name?;
            let of_another = map.shape(name.as_str()).map(|(other, _)| other);
            let of_another = of_another.or(self.states_in_flight.state(&name));
            if of_another.is_some_and(|other| other != id) || kept.contains_key(&name) {
                let state = map.names().find(|(other, _)| *other == id).map_or("", |(_, name)| name.as_str());
                return Err(InvalidEdit::StateExists { state: state.to_owned(), name: name.to_string() });
            }
            kept.insert(name, (id, kind));
        }
        self.states_in_flight.end_renames();
        self.states_in_flight.rename(kept, map);
        Ok(())
    }

    /// The edit was applied, or has failed.
    pub(crate) fn renamed(&mut self) {
        self.states_in_flight.end_renames();
    }

    /// An added state was applied to the map.
    pub(crate) fn state_added(&mut self, new: &NewState, client: &str) {
        let count = self.states_in_flight.remove(new);
        self.state_places.applied(client, count);
    }
}

/// The refusal of a state whose shape differs from the declared one.
fn other_shape(name: &StateName, found: StateShape, given: Option<StateShape>) -> Refusal {
    let name = name.as_str().chars().take(60).collect::<String>();
    let given = given.map_or("a single value".to_owned(), StateShape::with_article);
    let text = format!("state {name:?} exists and is {}, not {given}", found.with_article());
    (RefusalReason::StateKind, text)
}

/// The refusal of a state whose reporting differs from the one that the stream has stated.
fn other_reporting(name: &StateName, found: Reporting, given: StatedReporting) -> Refusal {
    let name = name.as_str().chars().take(60).collect::<String>();
    let text = format!(
        "state {name:?} exists and is reported by {found}, not by {given}: this never changes; send its observations \
         as they are, or erase the state first, and send them as a new producer"
    );
    (RefusalReason::StateKind, text)
}
