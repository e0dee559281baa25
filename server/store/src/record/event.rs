//! Events as payloads of the log, and back.
//!
//! Invariant: `decode(encode(event)) == event` to the last bit, or `encode` refuses.

use prost::Message as _;
use tidemap_layout::{cluster, event as layout, log::FrameKind, site as layout_site};
use tidemap_map::{
    event::{
        Digest, Dimensions, Envelope, Epoch, Event, NewState, Observations, OffsetRun, SequenceSpan, StateShape,
        UpdateCause, UpdateDone, UpdateStart,
    },
    ids::{ProducerId, StateId},
    name::StateName,
};

use super::{
    Invalid, columns,
    ids::{decode_kind, decode_new_producer, decode_refused, encode_kind, encode_new_producer, encode_refused},
    rows, scans, sensors,
    tables::{self, failures, tasks},
};

/// Kinds of new vector states. The map stores a vector as states of continuous values, one per axis.
const VECTOR_OF_TWO: u32 = 3;
const VECTOR_OF_THREE: u32 = 4;
/// Kind of a new angle, which the map stores as cosine and sine.
const ANGLE: u32 = 5;
/// Kind of a new categorical state, which the map stores as a probability for each label.
const CATEGORICAL: u32 = 6;

/// Limit of the number of observations in one event. Constant columns take no space, so the length of the payload does
/// not limit this number.
const COUNT_MAX: usize = 1 << 20;

/// The kind and the payload of an event.
pub(crate) fn encode(event: &Event) -> Result<(FrameKind, Vec<u8>), Invalid> {
    match event {
        Event::Observations(envelope, observations) => {
            Ok((FrameKind::Observations, encode_observations(envelope, observations)?.encode_to_vec()))
        }
        Event::Scans(envelope, event) => Ok((FrameKind::Scans, scans::encode(envelope, event)?.encode_to_vec())),
        Event::UpdateStart(start) => Ok((FrameKind::UpdateStart, encode_update_start(start).encode_to_vec())),
        Event::AddState(state) => Ok((FrameKind::AddState, encode_new_state(state).encode_to_vec())),
        Event::EditSite(edit) => Ok((FrameKind::EditSite, tables::encode_edit(edit)?.encode_to_vec())),
        Event::Epoch(epoch) => Ok((FrameKind::Epoch, encode_epoch(epoch).encode_to_vec())),
        Event::UpdateDone(done) => Ok((FrameKind::UpdateDone, encode_update_done(done).encode_to_vec())),
        Event::ForgetProducers(producers) => {
            let message = layout::ForgetProducers { producers: producers.iter().map(|id| id.0).collect() };
            Ok((FrameKind::ForgetProducers, message.encode_to_vec()))
        }
    }
}

/// The event of a payload.
pub(crate) fn decode(kind: FrameKind, payload: &[u8]) -> Result<Event, Invalid> {
    const GARBLED: Invalid = "the payload is not a message";
    match kind {
        FrameKind::Observations => {
            let message = layout::Observations::decode(payload).map_err(|_| GARBLED)?;
            let (envelope, observations) = decode_observations(&message)?;
            Ok(Event::Observations(envelope, observations))
        }
        FrameKind::Scans => {
            let message = layout::Scans::decode(payload).map_err(|_| GARBLED)?;
            let (envelope, scans) = scans::decode(&message)?;
            Ok(Event::Scans(envelope, scans))
        }
        FrameKind::UpdateStart => {
            let message = layout::UpdateStart::decode(payload).map_err(|_| GARBLED)?;
            decode_update_start(&message).map(Event::UpdateStart)
        }
        FrameKind::AddState => {
            let message = layout::NewState::decode(payload).map_err(|_| GARBLED)?;
            decode_new_state(&message).map(Event::AddState)
        }
        FrameKind::EditSite => {
            let message = layout_site::SiteEdit::decode(payload).map_err(|_| GARBLED)?;
            tables::decode_edit(&message).map(Event::EditSite)
        }
        FrameKind::Epoch => {
            let cluster::Epoch { epoch, writer, version, maths } =
                cluster::Epoch::decode(payload).map_err(|_| GARBLED)?;
            Ok(Event::Epoch(Epoch { epoch, writer, version, maths }))
        }
        FrameKind::UpdateDone => {
            let cluster::UpdateDone { generation, digest, maths } =
                cluster::UpdateDone::decode(payload).map_err(|_| GARBLED)?;
            Ok(Event::UpdateDone(UpdateDone { generation, digest: Digest(digest), maths }))
        }
        FrameKind::ForgetProducers => {
            let layout::ForgetProducers { producers } =
                layout::ForgetProducers::decode(payload).map_err(|_| GARBLED)?;
            Ok(Event::ForgetProducers(producers.into_iter().map(ProducerId).collect()))
        }
    }
}

fn encode_epoch(epoch: &Epoch) -> cluster::Epoch {
    let Epoch { epoch, writer, version, maths } = epoch.clone();
    cluster::Epoch { epoch, writer, version, maths }
}

fn encode_update_done(done: &UpdateDone) -> cluster::UpdateDone {
    cluster::UpdateDone { generation: done.generation, digest: done.digest.0, maths: done.maths }
}

fn encode_update_start(start: &UpdateStart) -> layout::UpdateStart {
    let cause = match start.cause {
        UpdateCause::Request => 1,
        UpdateCause::Midnight => 2,
        UpdateCause::DataTime => 3,
        UpdateCause::PendingLimit => 4,
    };
    layout::UpdateStart { generation: start.generation, cut_nanos: start.cut_nanos, cause }
}

fn decode_update_start(message: &layout::UpdateStart) -> Result<UpdateStart, Invalid> {
    let cause = match message.cause {
        1 => UpdateCause::Request,
        2 => UpdateCause::Midnight,
        3 => UpdateCause::DataTime,
        4 => UpdateCause::PendingLimit,
        _ => return Err("the cause of the update is unknown"),
    };
    Ok(UpdateStart { generation: message.generation, cut_nanos: message.cut_nanos, cause })
}

fn check_counts(accepted: usize, columns: [usize; 3], offsets: impl Iterator<Item = u32>) -> Result<(), Invalid> {
    if accepted > COUNT_MAX {
        return Err("there are more observations than one record may hold");
    }
    if columns != [accepted; 3] {
        return Err("states, times and values differ in number");
    }
    if offsets.map(u64::from).sum::<u64>() != accepted as u64 {
        return Err("the UTC offsets are not as many as the observations");
    }
    Ok(())
}

fn encode_observations(envelope: &Envelope, event: &Observations) -> Result<layout::Observations, Invalid> {
    let lengths = [event.states.len(), event.times_nanos.len(), event.values.len()];
    check_counts(event.states.len(), lengths, event.offsets.iter().map(|run| run.count))?;
    if envelope.span.is_empty() {
        return Err("the last sequence number is before the first");
    }
    let (refused_sequences, refused_reasons) = encode_refused(&envelope.refused)?;
    let times = columns::encode_times(&event.times_nanos)?;
    let (value_encoding, values) = columns::encode_values(&event.values)?;
    Ok(layout::Observations {
        producer: envelope.producer.0,
        new_producer: envelope.new_producer.as_ref().map(encode_new_producer),
        incarnation: envelope.incarnation,
        first_sequence: envelope.span.first,
        last_sequence: envelope.span.last,
        content_crc: envelope.span.content_crc,
        received_nanos: envelope.received_nanos,
        new_states: event.new_states.iter().map(encode_new_state).collect(),
        // The number is checked above against a much lower limit.
        count: event.states.len() as u32,
        states: columns::encode_states(&event.states, |state| state.0),
        first_time_nanos: times.first_nanos,
        time_unit_nanos: times.unit_nanos,
        times: times.differences,
        value_encoding,
        values,
        offset_counts: event.offsets.iter().map(|run| run.count).collect(),
        offset_secs: event.offsets.iter().map(|run| run.offset_secs).collect(),
        refused_sequences,
        refused_reasons,
        failures: event.failures.iter().map(failures::encode_failure).collect(),
        runs: event.runs.iter().map(tasks::encode_run).collect(),
    })
}

fn decode_observations(message: &layout::Observations) -> Result<(Envelope, Observations), Invalid> {
    let count = message.count as usize;
    check_counts(count, [count; 3], message.offset_counts.iter().copied())?;
    if message.offset_counts.len() != message.offset_secs.len() {
        return Err("the UTC offsets differ in number from their runs");
    }
    if message.last_sequence < message.first_sequence {
        return Err("the last sequence number is before the first");
    }
    let times = columns::Times {
        first_nanos: message.first_time_nanos,
        unit_nanos: message.time_unit_nanos,
        differences: &message.times,
    };
    let runs = message.offset_counts.iter().zip(&message.offset_secs);
    Ok((
        Envelope {
            producer: ProducerId(message.producer),
            new_producer: message.new_producer.as_ref().map(decode_new_producer).transpose()?,
            incarnation: message.incarnation,
            span: SequenceSpan {
                first: message.first_sequence,
                last: message.last_sequence,
                content_crc: message.content_crc,
            },
            received_nanos: message.received_nanos,
            refused: decode_refused(&message.refused_sequences, &message.refused_reasons)?,
        },
        Observations {
            new_states: message.new_states.iter().map(decode_new_state).collect::<Result<_, _>>()?,
            states: columns::decode_states(&message.states, count, StateId)?,
            times_nanos: columns::decode_times(&times, count)?,
            values: columns::decode_values(message.value_encoding, &message.values, count)?,
            offsets: runs.map(|(&count, &offset_secs)| OffsetRun { count, offset_secs }).collect(),
            failures: message.failures.iter().map(failures::decode_failure).collect::<Result<_, _>>()?,
            runs: message.runs.iter().map(tasks::decode_run).collect::<Result<_, _>>()?,
        },
    ))
}

fn encode_new_state(state: &NewState) -> layout::NewState {
    let kind = match state.shape {
        StateShape::Scalar(kind) => encode_kind(kind),
        StateShape::Vector(Dimensions::Two) => VECTOR_OF_TWO,
        StateShape::Vector(Dimensions::Three) => VECTOR_OF_THREE,
        StateShape::Angle => ANGLE,
        StateShape::Categorical(_) => CATEGORICAL,
    };
    let labels = state.labels.iter().filter_map(StateName::as_label).map(|(_, label)| label.to_owned()).collect();
    let sensor = state.sensor.map(sensors::encode_state_sensor);
    let reporting = rows::encode_reporting(state.reporting);
    layout::NewState { id: state.id.0, name: state.name.as_str().to_owned(), kind, sensor, reporting, labels }
}

fn decode_new_state(state: &layout::NewState) -> Result<NewState, Invalid> {
    const NAME: Invalid = "the name of a state is not valid";
    if state.kind == CATEGORICAL {
        return decode_categorical(state).ok_or("the labels of a categorical state are not valid");
    }
    if !state.labels.is_empty() {
        return Err("a state has labels, and is not categorical");
    }
    let name = StateName::stored(&state.name).map_err(|_| NAME)?;
    let shape = match state.kind {
        VECTOR_OF_TWO => StateShape::Vector(Dimensions::Two),
        VECTOR_OF_THREE => StateShape::Vector(Dimensions::Three),
        ANGLE => StateShape::Angle,
        kind => StateShape::Scalar(decode_kind(kind)?),
    };
    // An axis is only created together with its vector or angle.
    if name.as_axis().or(name.as_angle_axis()).is_some() {
        return Err(NAME);
    }
    if let StateShape::Vector(_) | StateShape::Angle = shape {
        name.check_vector().map_err(|_| NAME)?;
    }
    let sensor = state.sensor.as_ref().map(sensors::decode_state_sensor).transpose()?;
    if sensor.is_some() && !shape.may_have_sensor() {
        return Err("a state has a sensor, and is no probability");
    }
    let reporting = rows::decode_reporting(state.reporting.as_ref(), shape)?;
    Ok(NewState { sensor, reporting, ..NewState::sampled(StateId(state.id), name, shape) })
}

/// A categorical state, which has no sensor and reports samples.
fn decode_categorical(state: &layout::NewState) -> Option<NewState> {
    let name = StateName::new(&state.name).ok()?;
    let labels = state.labels.iter().map(|label| name.label(label).ok()).collect::<Option<Vec<_>>>()?;
    let is_plain = state.sensor.is_none() && state.reporting.is_none();
    NewState::categorical(StateId(state.id), name, labels).filter(|_| is_plain)
}
