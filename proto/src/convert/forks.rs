//! The contents of a fork of a map's log, for the wire: observations as their producers sent them, and states that it
//! added.
//!
//! Invariant: every sequence number of an event has one observation, so that a client that sends them again sends them
//! under their numbers. An observation that cannot be sent again contains the reason.

use tidemap_map::{
    event::{Envelope, NewState, Observations, StateShape},
    ids::StateId,
    name::StateName,
};

use super::{reporting::reporting_to_wire, state_sensor::state_sensor_to_wire, vectors::shape_to_wire};
use crate::v1::{self, forked_observation::Content};

/// The object that observations name: a state, or all axes of a vector or labels of a categorical state.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ForkedState {
    /// The name that observations have.
    pub name: StateName,
    /// Shape of the observations.
    pub shape: StateShape,
    /// Names of the states of its labels; only of a categorical state.
    pub labels: Vec<StateName>,
}

impl From<&NewState> for ForkedState {
    fn from(new: &NewState) -> Self {
        Self { name: new.name.clone(), shape: new.shape, labels: new.labels.clone() }
    }
}

fn label_of(name: &StateName) -> String {
    name.as_label().map_or_else(String::new, |(_, label)| label.to_owned())
}

/// A state that a fork added, as a request that adds it to a map.
#[must_use]
pub fn added_state_to_wire(map: &str, new: &NewState) -> v1::AddStateRequest {
    let (kind, size) = shape_to_wire(new.shape);
    v1::AddStateRequest {
        map: map.to_owned(),
        state: new.name.as_str().to_owned(),
        kind: kind.into(),
        dimensions: if new.labels.is_empty() { size } else { 0 },
        sensor: new.sensor.map(state_sensor_to_wire),
        reporting: reporting_to_wire(new.reporting),
        labels: new.labels.iter().map(label_of).collect(),
    }
}

/// The content of an observation whose states have these values.
fn content(state: &ForkedState, values: &[f64]) -> Result<Content, &'static str> {
    match (state.shape, values) {
        (StateShape::Scalar(_), &[value]) => Ok(Content::Value(value)),
        (StateShape::Angle, &[cos, sin]) => Ok(Content::Value(sin.atan2(cos))),
        (StateShape::Vector(_), coordinates) => {
            Ok(Content::Position(v1::ForkedPosition { coordinates: coordinates.to_vec() }))
        }
        (StateShape::Categorical(_), shares) => {
            let held = shares.iter().position(|share| *share == 1.0).and_then(|held| state.labels.get(held));
            held.map(|label| Content::Label(label_of(label))).ok_or("shares of labels")
        }
        _ => Err("an incomplete observation"),
    }
}

/// The observations of an event, one for each sequence number. `state` gives what a state is, or of which vector or
/// categorical state it is the first part.
#[must_use]
pub fn forked_observations_to_wire(
    envelope: &Envelope,
    event: &Observations,
    state: impl Fn(StateId) -> Option<ForkedState>,
) -> Vec<v1::ForkedObservation> {
    let span = envelope.span;
    let refused = |sequence| envelope.refused.binary_search_by_key(&sequence, |(refused, _)| *refused).is_ok();
    let left = |sequence: u64, why: &str| v1::ForkedObservation {
        sequence,
        content: Some(Content::Left(why.to_owned())),
        ..v1::ForkedObservation::default()
    };
    // A traversal, a sighting or the report of a task is more than the observations of states that were made of it.
    let is_report = |id: &StateId| state(*id).is_none_or(|state| StateName::observed(state.name.as_str()).is_err());
    if !event.failures.is_empty() || !event.runs.is_empty() || event.states.first().is_some_and(is_report) {
        return left_to_wire(envelope, "a traversal, a sighting or a task");
    }
    let mut rows = 0;
    let mut wire = Vec::new();
    for sequence in span.first..=span.last {
        if refused(sequence) {
            wire.push(v1::ForkedObservation { sequence, ..v1::ForkedObservation::default() });
            continue;
        }
        let Some((&id, &time_nanos)) = event.states.get(rows).zip(event.times_nanos.get(rows)) else {
            wire.push(left(sequence, "an incomplete observation"));
            continue;
        };
        let Some(found) = state(id) else {
            wire.push(left(sequence, "an observation of an unknown state"));
            rows += 1;
            continue;
        };
        let values = event.values.get(rows..rows + found.shape.states()).unwrap_or_default();
        rows += found.shape.states();
        wire.push(match content(&found, values) {
            Ok(content) => v1::ForkedObservation {
                sequence,
                state: found.name.as_str().to_owned(),
                time_nanos,
                content: Some(content),
            },
            Err(why) => left(sequence, why),
        });
    }
    wire
}

/// The observations of an event, at most `at_once` in each part, with the producer that the envelope is of.
pub fn forked_parts_to_wire(
    (producer, label): (String, String),
    envelope: &Envelope,
    observations: Vec<v1::ForkedObservation>,
    at_once: usize,
) -> impl Iterator<Item = v1::ForkedObservations> {
    let incarnation = envelope.incarnation;
    let mut rest = observations.into_iter().peekable();
    std::iter::from_fn(move || {
        rest.peek()?;
        let observations = rest.by_ref().take(at_once).collect();
        Some(v1::ForkedObservations { producer: producer.clone(), label: label.clone(), incarnation, observations })
    })
}

/// The observations of a producer in a fork, compared with what the map has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ForkedProducer {
    /// The first sequence number in the fork.
    pub first_sequence: u64,
    /// The last sequence number in the fork.
    pub last_sequence: u64,
    /// Number of observations in the fork.
    pub observations: u64,
    /// Number of these that the map has as well.
    pub known_observations: u64,
}

/// The observations of a producer in a fork, for the wire.
#[must_use]
pub fn forked_producer_to_wire(producer: String, label: String, held: ForkedProducer) -> v1::ForkedProducer {
    let ForkedProducer { first_sequence, last_sequence, observations, known_observations } = held;
    v1::ForkedProducer { producer, label, first_sequence, last_sequence, observations, known_observations }
}

/// The observations of an event that cannot be sent again, one for each sequence number.
#[must_use]
pub fn left_to_wire(envelope: &Envelope, why: &str) -> Vec<v1::ForkedObservation> {
    let content = Some(Content::Left(why.to_owned()));
    let left = |sequence| v1::ForkedObservation { sequence, content: content.clone(), ..Default::default() };
    (envelope.span.first..=envelope.span.last).map(left).collect()
}

#[cfg(test)]
mod tests {
    use tidemap_map::{
        event::{Dimensions, OffsetRun, SequenceSpan, StateKind},
        ids::{ProducerId, RefusalReason},
    };

    use super::*;

    fn name(text: &str) -> StateName {
        StateName::new(text).expect("valid")
    }

    fn known(id: StateId) -> Option<ForkedState> {
        let state = |text: &str, shape: StateShape| ForkedState { name: name(text), shape, labels: Vec::new() };
        match id.0 {
            0 => Some(state("door", StateKind::Probability.into())),
            1 => Some(state("robot", StateShape::Vector(Dimensions::Two))),
            3 => Some(state("heading", StateShape::Angle)),
            5 => Some(ForkedState {
                labels: ["light/on", "light/off"].map(|label| StateName::labelled(label).expect("valid")).to_vec(),
                ..state("light", StateShape::Categorical(2))
            }),
            _ => None,
        }
    }

    fn envelope(first: u64, last: u64, refused: &[u64]) -> Envelope {
        Envelope {
            producer: ProducerId(0),
            new_producer: None,
            incarnation: 1,
            span: SequenceSpan { first, last, content_crc: 0 },
            received_nanos: 0,
            refused: refused.iter().map(|&sequence| (sequence, RefusalReason::Value)).collect(),
        }
    }

    #[test]
    fn every_number_of_an_event_has_what_its_producer_sent() {
        let rows = [(0, 1.0), (1, 2.5), (2, -3.0), (3, 0.0), (4, 1.0), (5, 0.0), (6, 1.0), (5, 0.25), (6, 0.75)];
        let event = Observations {
            states: rows.iter().map(|(id, _)| StateId(*id)).collect(),
            times_nanos: vec![7; rows.len()],
            values: rows.iter().map(|(_, value)| *value).collect(),
            offsets: vec![OffsetRun { count: 9, offset_secs: 0 }],
            ..Observations::default()
        };
        let wire = forked_observations_to_wire(&envelope(11, 16, &[12]), &event, known);
        assert_eq!(wire.iter().map(|row| row.sequence).collect::<Vec<_>>(), [11, 12, 13, 14, 15, 16]);
        assert_eq!(
            wire.iter().map(|row| row.state.as_str()).collect::<Vec<_>>(),
            ["door", "", "robot", "heading", "light", ""]
        );
        let contents: Vec<Option<Content>> = wire.into_iter().map(|row| row.content).collect();
        assert_eq!(
            contents,
            [
                Some(Content::Value(1.0)),
                None,
                Some(Content::Position(v1::ForkedPosition { coordinates: vec![2.5, -3.0] })),
                Some(Content::Value(std::f64::consts::FRAC_PI_2)),
                Some(Content::Label("off".to_owned())),
                Some(Content::Left("shares of labels".to_owned())),
            ]
        );
    }

    #[test]
    fn what_cannot_be_sent_again_keeps_its_number() {
        let event = Observations {
            states: vec![StateId(9)],
            times_nanos: vec![7],
            values: vec![1.0],
            ..Observations::default()
        };
        let wire = forked_observations_to_wire(&envelope(3, 4, &[]), &event, known);
        assert_eq!(wire.iter().map(|row| row.sequence).collect::<Vec<_>>(), [3, 4]);
        assert!(wire.iter().all(|row| matches!(row.content, Some(Content::Left(_)))));
        assert_eq!(left_to_wire(&envelope(3, 5, &[]), "a scan").len(), 3);
    }

    #[test]
    fn a_state_of_a_fork_is_added_as_it_was() {
        let labels = ["light/on", "light/off"].map(|label| StateName::labelled(label).expect("valid")).to_vec();
        let new = NewState::categorical(StateId(4), name("light"), labels).expect("sound");
        let request = added_state_to_wire("office", &new);
        let declared = super::super::vectors::declared_state_from_wire(&request).expect("valid");
        assert_eq!((declared.name, declared.shape, declared.labels), (new.name, new.shape, new.labels));
        let vector = NewState::sampled(StateId(0), name("robot"), StateShape::Vector(Dimensions::Three));
        let request = added_state_to_wire("office", &vector);
        let declared = super::super::vectors::declared_state_from_wire(&request).expect("valid");
        assert_eq!((declared.name, declared.shape), (vector.name, vector.shape));
    }

    #[test]
    fn observations_of_a_fork_are_sent_in_parts() {
        let parts = |count: u64| -> Vec<Vec<u64>> {
            let envelope = envelope(1, count, &[]);
            let producer = ("robot".to_owned(), "arm".to_owned());
            let observations = (1..=count)
                .map(|sequence| v1::ForkedObservation { sequence, ..v1::ForkedObservation::default() })
                .collect();
            let parts = forked_parts_to_wire(producer, &envelope, observations, 2);
            parts
                .map(|part| {
                    assert_eq!((part.producer.as_str(), part.label.as_str(), part.incarnation), ("robot", "arm", 1));
                    part.observations.iter().map(|row| row.sequence).collect()
                })
                .collect()
        };
        assert!(parts(0).is_empty());
        assert_eq!(parts(2), [vec![1, 2]]);
        assert_eq!(parts(5), [vec![1, 2], vec![3, 4], vec![5]]);
    }
}
