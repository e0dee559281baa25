//! The sensor that is stated for a state.
//!
//! Invariant: what is no sensor is refused.

use tidemap_model::StateSensor;

use super::InvalidField;
use crate::v1;

/// The sensor of a state; absent numbers are those of a sensor that is always right.
///
/// # Errors
/// The invalid field.
pub fn state_sensor_from_wire(wire: &v1::StateSensor) -> Result<StateSensor, InvalidField> {
    let v1::StateSensor { hit, false_alarm } = *wire;
    let sensor = StateSensor::new(hit.unwrap_or(1.0), false_alarm.unwrap_or(0.0));
    sensor.map_err(|error| InvalidField::new("sensor", error))
}

/// The sensor of a state for the wire.
#[must_use]
pub fn state_sensor_to_wire(sensor: StateSensor) -> v1::StateSensor {
    v1::StateSensor { hit: Some(sensor.hit()), false_alarm: Some(sensor.false_alarm()) }
}

#[cfg(test)]
mod tests {
    use prost::Message as _;

    use super::*;
    use crate::convert::vectors::declared_state_from_wire;

    #[test]
    fn the_sensor_of_a_state_survives_the_wire() {
        let declared = |kind: v1::StateKind, hit, false_alarm| {
            let sensor = Some(v1::StateSensor { hit, false_alarm });
            let request = v1::AddStateRequest {
                state: "door".to_owned(),
                kind: kind.into(),
                sensor,
                ..v1::AddStateRequest::default()
            };
            let read = v1::AddStateRequest::decode(&request.encode_to_vec()[..]).expect("a message");
            declared_state_from_wire(&read).map(|declared| declared.sensor)
        };
        let probability = v1::StateKind::Probability;
        for (hit, false_alarm, expected) in
            [(Some(0.9), Some(0.05), (0.9, 0.05)), (None, Some(0.05), (1.0, 0.05)), (Some(0.9), None, (0.9, 0.0))]
        {
            let sensor = StateSensor::new(expected.0, expected.1).expect("a sensor");
            assert_eq!(declared(probability, hit, false_alarm), Ok(Some(sensor)));
            assert_eq!(state_sensor_from_wire(&state_sensor_to_wire(sensor)), Ok(sensor));
        }
        for (kind, hit, false_alarm) in [
            (probability, Some(0.3), Some(0.3)),
            (probability, Some(f64::NAN), None),
            (probability, Some(1.5), None),
            (probability, None, Some(-0.1)),
            (v1::StateKind::Continuous, Some(0.9), Some(0.05)),
            (v1::StateKind::Angle, Some(0.9), Some(0.05)),
        ] {
            assert_eq!(declared(kind, hit, false_alarm).expect_err("wrong").field, "sensor");
        }
    }
}
