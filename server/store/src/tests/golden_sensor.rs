//! The bytes of the sensor that was stated for a state, in the log and in checkpoints, and what of them is refused.

use std::sync::Arc;

use prost::Message as _;
use tidemap_layout::{
    event::NewState as NewStateRecord,
    map::{Sensor, State},
};
use tidemap_map::{
    event::{Event, NewState, Reporting, StateShape},
    ids::StateId,
    name::StateName,
    snapshot::StateSnapshot,
};
use tidemap_model::{StateModel, StateSensor};

use super::golden_states::{alternatives, spec, state};
use crate::record::{
    event,
    snapshot::{SpectrumIn, decode_state, encode_state},
};

fn sensor() -> StateSensor {
    StateSensor::new(0.75, 0.125).expect("a sensor")
}

pub(super) fn known() -> StateSnapshot {
    let plain = state("door", alternatives(None));
    let model = StateModel::clone(&plain.model).with_sensor(sensor());
    StateSnapshot { model: Arc::new(model), ..plain }
}

#[test]
fn sensors_in_checkpoints_are_written_as_they_always_were_and_come_back() {
    let state = known();
    let message = encode_state(0, &state, state.model.accumulator().to_parts());
    let bytes = State { sensor: message.sensor, ..State::default() };
    assert_eq!(crc32c::crc32c(&bytes.encode_to_vec()), 0x7968_592A, "a sensor is written in another way");
    let again = decode_state(0, &message, &spec().periodicities, SpectrumIn::Checkpoint);
    assert_eq!(again, Ok(state));
    let without_belief = State { belief: None, ..message.clone() };
    let found = decode_state(0, &without_belief, &spec().periodicities, SpectrumIn::Checkpoint).expect("readable");
    assert_eq!(found.model.sensor(), Some(sensor()));
    for wrong in [
        State {
            sensor: Some(Sensor { hit_bits: 0.1_f64.to_bits(), false_alarm_bits: 0.1_f64.to_bits() }),
            ..message.clone()
        },
        State { sensor: Some(Sensor { hit_bits: f64::NAN.to_bits(), false_alarm_bits: 0 }), ..message.clone() },
        State { kind: 1, belief: None, alternatives: None, ..message },
    ] {
        assert!(decode_state(0, &wrong, &spec().periodicities, SpectrumIn::Checkpoint).is_err(), "{wrong:?}");
    }
}

#[test]
fn sensors_in_the_log_are_written_as_they_always_were_and_come_back() {
    let name = StateName::new("door").expect("valid");
    let new = NewState {
        id: StateId(3),
        name,
        shape: StateShape::default(),
        labels: Vec::new(),
        sensor: Some(sensor()),
        reporting: Reporting::Samples,
    };
    let added = Event::AddState(new);
    let (kind, payload) = event::encode(&added).expect("valid");
    assert_eq!(crc32c::crc32c(&payload), 0xF2DD_F452, "a sensor is written in another way");
    assert_eq!(event::decode(kind, &payload), Ok(added));
    let message = NewStateRecord::decode(&payload[..]).expect("a message");
    for wrong in [
        NewStateRecord { kind: 1, ..message.clone() },
        NewStateRecord { sensor: Some(Sensor { hit_bits: 0, false_alarm_bits: 0 }), ..message },
    ] {
        assert!(event::decode(kind, &wrong.encode_to_vec()).is_err(), "{wrong:?}");
    }
}
