//! The states of a map, with their kinds, after everything in flight is applied.
//!
//! Invariant: a state in flight keeps its number and its kind: the next stream that names it gets the same. A vector or
//! an angle is in flight as all its axes.

use std::collections::HashMap;

use tidemap_map::{
    event::{Dimensions, NewState, Reporting, RowKind, StateKind, StateShape, StatedReporting},
    ids::{RefusalReason, StateId},
    live_map::{LiveMap, rename::renamed_states},
    name::StateName,
    site::{InvalidEdit, SiteEdit},
};
use tidemap_proto::convert::vectors::{DeclaredState, cannot_report};

use super::{
    super::{
        intake::refuse_value,
        protocol::{AddStateError, NewName},
    },
    Sessions,
};

/// Why an observation is refused, for programs and for people.
pub(super) type Refusal = (RefusalReason, String);

/// The state of a name of a stream's table.
#[derive(Debug)]
pub(super) enum StreamState {
    /// A state of the map, or of a batch in flight; for a vector its first axis.
    State(StateId, StateShape, Reporting),
    /// A label of a categorical state: the first label, how many there are, and the one that is observed.
    Label(StateId, u8, StateId),
    /// A state whose shape differs from the declared one: its shape, and the declared one.
    OtherShape(StateName, StateShape, Option<StateShape>),
    /// A state that is reported otherwise than the stream says.
    OtherReporting(StateName, Reporting, StatedReporting),
    /// A name that no observation has used yet.
    Unused(NewName),
    /// An invalid name; intake refuses its observations.
    Invalid,
}

/// Allocates states, up to a limit.
pub(super) struct StateAllocator<'a> {
    pub(super) map: &'a LiveMap,
    pub(super) in_flight: &'a mut HashMap<StateName, (StateId, StateKind)>,
    pub(super) renames: &'a HashMap<StateName, (StateId, StateKind)>,
    /// Of states in flight that do not report samples.
    pub(super) reportings: &'a mut HashMap<StateId, Reporting>,
    /// Categorical states in flight.
    pub(super) categorical: &'a HashMap<StateName, (StateId, u8)>,
    pub(super) max: usize,
}

impl StreamState {
    /// The state of an observation with this value, or the first axis or label, with its shape, and of a label the one
    /// that holds; it may be new. `has_parts`: it is a position, or shares. `Err(None)`: intake has refused it already.
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
            // Intake passes a position only if a vector was declared, and shares if a categorical state was.
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
            StreamState::OtherShape(name, found, said) => Err(Some(other_shape(name, *found, *said))),
            StreamState::OtherReporting(name, found, said) => Err(Some(other_reporting(name, *found, *said))),
            StreamState::Unused(_) | StreamState::Invalid => Err(None),
        }
    }
}

/// The state of an observation.
pub(super) struct ObservedState {
    /// The state, or its first axis or label.
    pub(super) first: StateId,
    pub(super) shape: StateShape,
    /// Of an observation of a label: the state of the label.
    pub(super) held: Option<StateId>,
}

/// Looks the name of a label up at its first observation.
fn used_label(name: &StateName, state: &str, allocator: &StateAllocator<'_>) -> Result<StreamState, Refusal> {
    let whole = StateName::new(state).map_err(|error| (RefusalReason::StateName, format!("state {error}")))?;
    match allocator.known(&whole) {
        Some((first, StateShape::Categorical(labels))) => match allocator.known(name) {
            Some((held, _)) => Ok(StreamState::Label(first, labels, held)),
            None => {
                let known = allocator.labels(first, labels);
                let (label, known) = (name.as_label().map_or("", |(_, label)| label), known.join(", "));
                Err((RefusalReason::Value, format!("state {state:?} has no label {label:?}: its labels are {known}")))
            }
        },
        Some((_, found)) => Err(other_shape(&whole, found, Some(StateShape::Categorical(0)))),
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
    NewName { name, shape: said, reporting: stated }: &NewName,
    value: f64,
    allocator: &mut StateAllocator<'_>,
    new_states: &mut Vec<NewState>,
) -> Result<StreamState, Refusal> {
    if let Some((state, _)) = name.as_label() {
        return used_label(name, state, allocator);
    }
    let has_events = stated.is_some_and(|stated| stated.kind() == RowKind::Events);
    let usual = if has_events { StateKind::Count.into() } else { StateShape::default() };
    let shape = said.unwrap_or(usual);
    let reporting = stated.map_or(Reporting::Samples, StatedReporting::for_new);
    match allocator.known(name) {
        // A name without a declared shape has single values.
        Some((state, found)) if *said == Some(found) || (said.is_none() && found.is_single()) => {
            let reporting = allocator.reporting(state);
            Ok(match stated {
                Some(stated) if !stated.fits(reporting) => {
                    StreamState::OtherReporting(name.clone(), reporting, *stated)
                }
                _ => StreamState::State(state, found, reporting),
            })
        }
        Some((_, found @ StateShape::Categorical(labels))) if matches!(shape, StateShape::Categorical(_)) => {
            let (name, sent) = (name.as_str().chars().take(60).collect::<String>(), shape.states());
            let text = format!("state {name:?} has {labels} labels, not {sent}: send a share of each");
            debug_assert_ne!(found, shape, "equal shapes are taken above");
            Err((RefusalReason::Value, text))
        }
        Some((_, found)) => Ok(StreamState::OtherShape(name.clone(), found, *said)),
        None if matches!(shape, StateShape::Categorical(_)) => Err(no_labels(name)),
        None if !shape.may_report(reporting) => Err((RefusalReason::StateKind, cannot_report(shape, reporting.kind()))),
        // An invalid value does not create a state. Intake has checked positions.
        None if shape.is_single() && !shape.allows(value) && !(value.is_nan() && reporting.may_end()) => {
            Err(refuse_value(value, shape))
        }
        None => match allocator.add(name, shape, reporting) {
            Some(new) => {
                let state = new.id;
                new_states.push(new);
                Ok(StreamState::State(state, shape, reporting))
            }
            None => Err(allocator.is_full(name)),
        },
    }
}

impl StateAllocator<'_> {
    /// The states of these names and kinds; missing ones are allocated. All of them, or none.
    pub(super) fn states_for(
        &mut self,
        wanted: &[(StateName, StateKind)],
        new_states: &mut Vec<NewState>,
    ) -> Result<Vec<StateId>, Refusal> {
        let mut known = Vec::with_capacity(wanted.len());
        for (name, kind) in wanted {
            known.push(match self.known(name) {
                Some((_, found)) if found != StateShape::Scalar(*kind) => {
                    return Err(other_shape(name, found, Some(StateShape::Scalar(*kind))));
                }
                found => found.map(|(state, _)| state),
            });
        }
        let new = known.iter().filter(|known| known.is_none()).count();
        let room = self.max.saturating_sub(self.map.states() + self.in_flight.len());
        let mut states = Vec::with_capacity(wanted.len());
        for (known, (name, kind)) in known.into_iter().zip(wanted) {
            states.push(match known {
                Some(state) => state,
                None => {
                    let shape = StateShape::Scalar(*kind);
                    let added = if new <= room { self.add(name, shape, Reporting::Samples) } else { None };
                    let added = added.ok_or_else(|| self.is_full(name))?;
                    let state = added.id;
                    new_states.push(added);
                    state
                }
            });
        }
        Ok(states)
    }

    /// A state of the map, or of an event in flight; for a vector or a categorical state its first axis or label.
    fn known(&self, name: &StateName) -> Option<(StateId, StateShape)> {
        known_state(self.map, self.in_flight, (self.renames, self.categorical), name)
    }

    /// The labels of a categorical state.
    fn labels(&self, first: StateId, labels: u8) -> Vec<String> {
        let ids = first.0..first.0.saturating_add(u32::from(labels));
        let of_map = ids.clone().filter_map(|id| Some((StateId(id), self.map.name(StateId(id))?)));
        let in_flight = self.in_flight.iter().map(|(name, (id, _))| (*id, name));
        let in_flight = in_flight.filter(|(id, _)| ids.contains(&id.0));
        let mut named: Vec<(StateId, &StateName)> = of_map.chain(in_flight).collect();
        named.sort_by_key(|(id, _)| *id);
        named.into_iter().filter_map(|(_, name)| Some(name.as_label()?.1.to_owned())).collect()
    }

    /// The refusal of a state beyond the limit.
    fn is_full(&self, name: &StateName) -> Refusal {
        let name = name.as_str().chars().take(60).collect::<String>();
        let text = format!(
            "the state would be new, and the map has {} states, as many as setting max_states_per_map allows: {name:?}",
            self.max
        );
        (RefusalReason::StateLimit, text)
    }

    /// How a state of the map, or in flight, is reported.
    fn reporting(&self, state: StateId) -> Reporting {
        self.reportings.get(&state).copied().unwrap_or_else(|| self.map.reporting(state))
    }

    /// Allocates a state, or all axes of a vector; `None` if the limit allows no more.
    fn add(&mut self, name: &StateName, shape: StateShape, reporting: Reporting) -> Option<NewState> {
        self.add_labelled(name, (shape, Vec::new()), reporting)
    }

    /// As [`StateAllocator::add`], with the states of the labels of a categorical state.
    fn add_labelled(
        &mut self,
        name: &StateName,
        (shape, labels): (StateShape, Vec<StateName>),
        reporting: Reporting,
    ) -> Option<NewState> {
        let next = self.map.states() + self.in_flight.len();
        if next.saturating_add(shape.states()) > self.max {
            return None;
        }
        let new = NewState {
            id: StateId(u32::try_from(next).unwrap_or(u32::MAX)),
            name: name.clone(),
            shape,
            labels,
            sensor: None,
            reporting,
        };
        if reporting.may_end() {
            self.reportings.insert(new.id, reporting);
        }
        self.in_flight.extend(new.states().map(|(id, name, kind)| (name, (id, kind))));
        Some(new)
    }
}

impl Sessions {
    /// The event that adds a state; `None` if the map has it with that shape, sensor and reporting. What is not stated
    /// fits any.
    pub(crate) fn add_state(
        &mut self,
        DeclaredState { name, shape, labels, sensor, reporting: stated }: &DeclaredState,
        map: &LiveMap,
    ) -> Result<Option<NewState>, AddStateError> {
        let (shape, sensor) = (*shape, *sensor);
        let others = (&self.renames_in_flight, &self.categorical_in_flight);
        match known_state(map, &self.states_in_flight, others, name) {
            Some((first, found)) if found == shape && !labels.is_empty() => {
                let is_own = |(label, id): (&StateName, u32)| {
                    let known = map.find(label.as_str());
                    known.or_else(|| self.states_in_flight.get(label).map(|(known, _)| *known)) == Some(StateId(id))
                };
                if labels.iter().zip(first.0..).all(is_own) {
                    Ok(None)
                } else {
                    Err(AddStateError::OtherLabels { name: name.clone() })
                }
            }
            Some((_, StateShape::Categorical(_))) if !labels.is_empty() => {
                Err(AddStateError::OtherLabels { name: name.clone() })
            }
            Some((state, found)) if found == shape => {
                let reporting = self.reportings_in_flight.get(&state).copied();
                let reporting = reporting.unwrap_or_else(|| map.reporting(state));
                if let Some(asked) = stated.filter(|stated| !stated.fits(reporting)) {
                    return Err(AddStateError::OtherReporting { name: name.clone(), found: reporting, asked });
                }
                let found = map.sensor(state).or_else(|| self.sensors_in_flight.get(&state).copied());
                match sensor {
                    Some(asked) if found != Some(asked) => {
                        Err(AddStateError::OtherSensor { name: name.clone(), found, asked })
                    }
                    _ => Ok(None),
                }
            }
            Some((_, found)) => Err(AddStateError::OtherKind { name: name.clone(), found, asked: shape }),
            None => {
                let mut allocator = StateAllocator {
                    map,
                    in_flight: &mut self.states_in_flight,
                    renames: &self.renames_in_flight,
                    reportings: &mut self.reportings_in_flight,
                    categorical: &self.categorical_in_flight,
                    max: self.limits.states,
                };
                let reporting = stated.map_or(Reporting::Samples, StatedReporting::for_new);
                let new = allocator
                    .add_labelled(name, (shape, labels.clone()), reporting)
                    .ok_or(AddStateError::TooMany { max: self.limits.states })?;
                if let StateShape::Categorical(labels) = shape {
                    self.categorical_in_flight.insert(name.clone(), (new.id, labels));
                }
                self.sensors_in_flight.extend(sensor.map(|sensor| (new.id, sensor)));
                Ok(Some(NewState { sensor, ..new }))
            }
        }
    }

    /// Reserves the names that an edit will give to states, until [`Sessions::renamed`], including states in flight.
    ///
    /// # Errors
    /// A name that is invalid, or that another state has; then none is reserved.
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

    /// The edit was applied, or has failed.
    pub(crate) fn renamed(&mut self) {
        self.renames_in_flight.clear();
    }

    /// An added state was applied to the map.
    pub(crate) fn state_added(&mut self, new: &NewState) {
        for (_, name, _) in new.states() {
            self.states_in_flight.remove(&name);
        }
        self.categorical_in_flight.remove(&new.name);
        self.sensors_in_flight.remove(&new.id);
        self.reportings_in_flight.remove(&new.id);
    }
}

/// Names that states will have, and categorical states in flight.
type OtherNames<'a> = (&'a HashMap<StateName, (StateId, StateKind)>, &'a HashMap<StateName, (StateId, u8)>);

/// A state of the map, or of an event in flight; for a vector or a categorical state its first axis or label.
fn known_state(
    map: &LiveMap,
    in_flight: &HashMap<StateName, (StateId, StateKind)>,
    (renames, categorical): OtherNames<'_>,
    name: &StateName,
) -> Option<(StateId, StateShape)> {
    if let Some(known) = map.shape(name.as_str()) {
        return Some(known);
    }
    if let Some(&(state, kind)) = in_flight.get(name).or_else(|| renames.get(name)) {
        return Some((state, kind.into()));
    }
    if let Some(&(first, labels)) = categorical.get(name) {
        return Some((first, StateShape::Categorical(labels)));
    }
    // A vector has a plain name: `edge/A/B/x` is an edge with the action x.
    if name.as_str().contains('/') {
        return None;
    }
    if let Some(&(cos, _)) = in_flight.get(&name.angle_axis(0)) {
        return Some((cos, StateShape::Angle));
    }
    let &(first, _) = in_flight.get(&name.axis(0))?;
    let has_z = in_flight.contains_key(&name.axis(2));
    Some((first, StateShape::Vector(if has_z { Dimensions::Three } else { Dimensions::Two })))
}

/// The refusal of a state whose shape differs from the declared one.
fn other_shape(name: &StateName, found: StateShape, said: Option<StateShape>) -> Refusal {
    let name = name.as_str().chars().take(60).collect::<String>();
    let said = said.map_or("a single value".to_owned(), StateShape::with_article);
    let text = format!("state {name:?} exists and is {}, not {said}", found.with_article());
    (RefusalReason::StateKind, text)
}

/// The refusal of a state that is reported otherwise than the stream says.
fn other_reporting(name: &StateName, found: Reporting, said: StatedReporting) -> Refusal {
    let name = name.as_str().chars().take(60).collect::<String>();
    let text = format!(
        "state {name:?} exists and is reported by {found}, not by {said}: this never changes; send its observations as \
         they are, or erase the state first, and send them as a new producer"
    );
    (RefusalReason::StateKind, text)
}
