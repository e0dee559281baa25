//! Sensors of producers and states, and the numbers of the sensors of scans, and back.
//!
//! Invariant: nothing is written if all scans are of the sensor of the map. Numbers fit into a byte; other code checks
//! whether a map has such a sensor.

use tidemap_grid::sensors::{ProducerSensor, SensorId};
use tidemap_layout::map as layout;
use tidemap_model::StateSensor;

use super::Invalid;

const NUMBER: Invalid = "the number of a sensor is too large";

pub(super) fn encode(sensor: Option<ProducerSensor>) -> Option<layout::Sensor> {
    sensor
        .map(|sensor| layout::Sensor { hit_bits: sensor.hit.to_bits(), false_alarm_bits: sensor.false_alarm.to_bits() })
}

/// Decodes a sensor; the map checks whether it has such a sensor.
pub(super) fn decode(message: Option<&layout::Sensor>) -> Result<Option<ProducerSensor>, Invalid> {
    let Some(message) = message else { return Ok(None) };
    let (hit, false_alarm) = (f64::from_bits(message.hit_bits), f64::from_bits(message.false_alarm_bits));
    // NaN fails both comparisons.
    let is_sensor = (0.0..1.0).contains(&false_alarm) && hit > false_alarm && hit <= 1.0;
    if is_sensor { Ok(Some(ProducerSensor { hit, false_alarm })) } else { Err("the sensor of a producer is not valid") }
}

pub(super) fn encode_state_sensor(sensor: StateSensor) -> layout::Sensor {
    layout::Sensor { hit_bits: sensor.hit().to_bits(), false_alarm_bits: sensor.false_alarm().to_bits() }
}

pub(super) fn decode_state_sensor(message: &layout::Sensor) -> Result<StateSensor, Invalid> {
    let (hit, false_alarm) = (f64::from_bits(message.hit_bits), f64::from_bits(message.false_alarm_bits));
    StateSensor::new(hit, false_alarm).map_err(|_| "the sensor of a state is not valid")
}

/// The number of a sensor.
pub(super) fn number(number: u32) -> Result<SensorId, Invalid> {
    u8::try_from(number).map(SensorId).map_err(|_| NUMBER)
}

/// Lengths and sensors of the runs of scans of one sensor.
pub(super) fn encode_runs(sensors: impl Iterator<Item = SensorId> + Clone) -> (Vec<u32>, Vec<u32>) {
    let (mut counts, mut numbers): (Vec<u32>, Vec<u32>) = (Vec::new(), Vec::new());
    if sensors.clone().all(|sensor| sensor == SensorId::OWN) {
        return (counts, numbers);
    }
    for sensor in sensors {
        let number = u32::from(sensor.0);
        match (numbers.last(), counts.last_mut()) {
            (Some(&last), Some(count)) if last == number && *count < u32::MAX => *count += 1,
            _ => {
                numbers.push(number);
                counts.push(1);
            }
        }
    }
    (counts, numbers)
}

/// One sensor per scan; `None` if all scans are of the sensor of the map.
pub(super) fn decode_runs(counts: &[u32], numbers: &[u32], count: usize) -> Result<Option<Vec<SensorId>>, Invalid> {
    if counts.is_empty() && numbers.is_empty() {
        return Ok(None);
    }
    let total = counts.iter().map(|&count| u64::from(count)).sum::<u64>();
    if counts.len() != numbers.len() || total != count as u64 {
        return Err("the number of sensors differs from the number of scans");
    }
    let mut sensors = Vec::with_capacity(count);
    for (&count, &of_run) in counts.iter().zip(numbers) {
        sensors.resize(sensors.len() + count as usize, number(of_run)?);
    }
    Ok(Some(sensors))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_come_back_and_those_that_do_not_fit_are_refused() {
        let ids = |numbers: &[u8]| numbers.iter().map(|&number| SensorId(number)).collect::<Vec<_>>();
        let sensors = ids(&[0, 0, 3, 255, 255, 0]);
        let (counts, numbers) = encode_runs(sensors.iter().copied());
        assert_eq!((&counts[..], &numbers[..]), (&[2, 1, 2, 1][..], &[0, 3, 255, 0][..]));
        assert_eq!(decode_runs(&counts, &numbers, 6), Ok(Some(sensors)));
        assert_eq!(encode_runs(ids(&[0; 9]).into_iter()), (Vec::new(), Vec::new()));
        assert_eq!(decode_runs(&[], &[], 9), Ok(None));
        for (counts, numbers, count) in [(&[2][..], &[1][..], 3), (&[3], &[256], 3), (&[1, 2], &[1], 3), (&[], &[1], 0)]
        {
            assert!(decode_runs(counts, numbers, count).is_err(), "{counts:?} {numbers:?}");
        }
    }

    #[test]
    fn sensors_come_back_and_what_is_none_is_refused() {
        let sensor = Some(ProducerSensor { hit: 0.7, false_alarm: 0.1 });
        assert_eq!(decode(encode(sensor).as_ref()), Ok(sensor));
        assert_eq!((encode(None), decode(None)), (None, Ok(None)));
        for (hit, false_alarm) in [(f64::NAN, 0.1), (0.5, f64::NAN), (0.5, 0.5), (1.5, 0.5), (0.5, -0.5)] {
            let message = encode(Some(ProducerSensor { hit, false_alarm }));
            assert!(decode(message.as_ref()).is_err(), "{hit} {false_alarm}");
        }
    }
}
