//! A stream of observations: its messages, and requests that send what a stream would.
//!
//! Invariant: what is decoded here keeps the order and the numbers of what was sent. Sizes that depend on the stream
//! are checked by who takes the messages, before anything is unpacked.

use std::ops::RangeInclusive;

use tidemap_grid::sensors::ProducerSensor;
use tidemap_map::{
    event::{StateShape, StatedReporting},
    name::ProducerKey,
};

use super::{
    InvalidField,
    columns::PackedColumns,
    reporting::reporting_from_wire,
    reports::{ReportMessage, reports_from_wire},
    scans::{ScanMessage, scans_from_wire},
    sequences::sequences_from_wire,
    vectors::new_shapes,
};
use crate::v1::{self, observe_request::Message};

mod readings;

pub use readings::{learned_readings, readings_from_wire};

/// The beginning of a stream.
#[derive(Clone, Debug, PartialEq)]
pub struct StreamStart {
    /// The producer.
    pub key: ProducerKey,
    /// 0: a new incarnation is requested.
    pub incarnation: u64,
    /// Whether the client replies to probes.
    pub answers_probes: bool,
    /// Whether the stream announces data time.
    pub is_nightly: bool,
    /// The announced sensor, which the map's writer checks.
    pub sensor: Option<ProducerSensor>,
    /// The stated reporting of the stream's states.
    pub reporting: Option<StatedReporting>,
}

/// The hello in the first message of a stream.
///
/// # Errors
/// It is another message.
pub fn hello_of(first: v1::ObserveRequest) -> Result<v1::Hello, InvalidField> {
    match first.message {
        Some(Message::Hello(hello)) => Ok(hello),
        _ => Err(InvalidField::new("hello", "the first message of a stream must be a Hello")),
    }
}

/// Reads the beginning of a stream.
///
/// # Errors
/// An invalid name of the producer, or label; or states that cannot be reported like that.
pub fn hello_from_wire(hello: &v1::Hello) -> Result<StreamStart, InvalidField> {
    let sensor = |wire: &v1::ProducerSensor| ProducerSensor {
        hit: wire.hit.unwrap_or(1.0),
        false_alarm: wire.false_alarm.unwrap_or(0.0),
    };
    Ok(StreamStart {
        incarnation: hello.incarnation,
        answers_probes: hello.answers_probes,
        is_nightly: hello.nightly,
        sensor: hello.sensor.as_ref().map(sensor),
        reporting: hello.reporting.as_ref().map(|wire| reporting_from_wire("hello.reporting", wire)).transpose()?,
        ..StreamStart::of(("hello.producer", &hello.producer), ("hello.label", &hello.label))?
    })
}

/// Reads the producer of the readings of a request.
///
/// # Errors
/// The errors of [`hello_from_wire`].
pub fn start_of_request(request: &v1::ReportRequest) -> Result<StreamStart, InvalidField> {
    let start = StreamStart::of(("producer", &request.producer), ("label", &request.label))?;
    let reporting = request.reporting.as_ref().map(|wire| reporting_from_wire("reporting", wire)).transpose()?;
    Ok(StreamStart { reporting, ..start })
}

/// Reads the producer that reports a run of a task.
///
/// # Errors
/// An invalid name of the producer, or label.
pub fn start_of_run(request: &v1::ReportTaskRequest) -> Result<StreamStart, InvalidField> {
    StreamStart::of(("producer", &request.producer), ("label", &request.label))
}

/// Returns the producer of what is learned of a classification.
///
/// # Errors
/// An invalid name of the producer, or label.
pub fn start_of_classification(request: &v1::ClassifyActivityRequest) -> Result<StreamStart, InvalidField> {
    StreamStart::of(("producer", &request.producer), ("producer_label", &request.producer_label))
}

impl StreamStart {
    /// A new incarnation of a producer. Each name comes with its field.
    fn of(
        (producer_field, producer): (&str, &str),
        (label_field, label): (&str, &str),
    ) -> Result<StreamStart, InvalidField> {
        // One after the other, to name the invalid field.
        ProducerKey::new(producer, "").map_err(|error| InvalidField::new(producer_field, error))?;
        let key = ProducerKey::new(producer, label).map_err(|error| InvalidField::new(label_field, error))?;
        Ok(Self { key, incarnation: 0, answers_probes: false, is_nightly: false, sensor: None, reporting: None })
    }
}

/// A message of a stream after its hello.
#[derive(Clone, Debug)]
pub enum StreamMessage {
    /// Observations.
    Observations(ObservationMessage),
    /// Scans.
    Scans(ScanMessage),
    /// Reports of robots.
    Reports(ReportMessage),
    /// The reply to a probe.
    Alive,
}

/// A message of a stream after its hello.
///
/// # Errors
/// It has none of these, or the invalid field of what it has.
pub fn message_from_wire(request: v1::ObserveRequest) -> Result<StreamMessage, InvalidField> {
    Ok(match request.message {
        Some(Message::Batch(batch)) => StreamMessage::Observations(observations_from_wire(batch)?),
        Some(Message::Scans(scans)) => StreamMessage::Scans(scans_from_wire(scans)?),
        Some(Message::Reports(batch)) => StreamMessage::Reports(reports_from_wire(&batch)?),
        Some(Message::Alive(v1::Alive {})) => StreamMessage::Alive,
        Some(Message::Hello(_)) | None => {
            let text = "after the Hello a message must be a batch of observations, scans or reports";
            return Err(InvalidField::new("message", text));
        }
    })
}

/// The error of a message that could not be decoded.
#[must_use]
pub fn undecodable(problem: &str) -> InvalidField {
    InvalidField::new("message", problem)
}

/// Observations of one message, still packed.
#[derive(Clone, Debug)]
pub struct ObservationMessage {
    /// Sequence numbers of the observations.
    pub sequences: RangeInclusive<u64>,
    /// The shapes that the message declares for its new names, one each; `None`: not declared.
    pub shapes: Vec<Option<StateShape>>,
    /// The observations and the new names.
    pub columns: PackedColumns,
}

/// Observations of one message.
///
/// # Errors
/// There are none, a shape that no name can have, or a first sequence number of 0.
pub fn observations_from_wire(batch: v1::ObservationBatch) -> Result<ObservationMessage, InvalidField> {
    let missing = || InvalidField::new("observations", "missing: send at least 1");
    UnnumberedObservations(batch.observations.ok_or_else(missing)?).numbered(batch.first_sequence)
}

/// Observations that are not numbered yet.
#[derive(Clone, Debug)]
pub struct UnnumberedObservations(v1::ObservationColumns);

impl UnnumberedObservations {
    /// The observations from this sequence number on.
    ///
    /// # Errors
    /// There are none, a shape that no name can have, or a first sequence number of 0.
    pub fn numbered(self, first_sequence: u64) -> Result<ObservationMessage, InvalidField> {
        let Self(columns) = self;
        let sequences = sequences_from_wire(first_sequence, columns.time_deltas.len())?;
        Ok(ObservationMessage { sequences, shapes: new_shapes(&columns)?, columns: columns.into() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hello_comes_first_and_only_once() {
        let hello = v1::Hello { producer: "robot".to_owned(), ..v1::Hello::default() };
        let request = |message| v1::ObserveRequest { message };
        let first = hello_of(request(Some(Message::Hello(hello.clone())))).expect("a hello");
        assert_eq!(hello_from_wire(&first).expect("right").key.producer(), "robot");
        assert_eq!(hello_of(request(None)).expect_err("nothing").field, "hello");
        let again = message_from_wire(request(Some(Message::Hello(hello))));
        assert_eq!(again.expect_err("a second hello").field, "message");
        assert!(matches!(message_from_wire(request(Some(Message::Alive(v1::Alive {})))), Ok(StreamMessage::Alive)));
    }

    #[test]
    fn the_invalid_part_of_a_key_is_named() {
        let field = |producer: &str, label: &str| {
            let hello = v1::Hello { producer: producer.to_owned(), label: label.to_owned(), ..v1::Hello::default() };
            hello_from_wire(&hello).expect_err("wrong").field
        };
        assert_eq!(field("", "a"), "hello.producer");
        assert_eq!(field("robot", "a\nb"), "hello.label");
    }
}
