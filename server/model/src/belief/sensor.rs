//! The sensor of a state of two values, as stated by a person who knows it.
//!
//! Invariant: 0 <= false alarm < hit <= 1, so that a reading of 1 always makes 1 more likely.

use super::{Belief, SensorNoise};

/// The reliability of the readings of a state of two values. As evidence, a probability below 0.001 counts as 0.001.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StateSensor {
    hit: f64,
    false_alarm: f64,
}

// Neither number is ever NaN.
impl Eq for StateSensor {}

/// The error for probabilities that no sensor can have.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("a sensor with hit {hit} and false alarm {false_alarm}: it must satisfy 0 <= false alarm < hit <= 1")]
pub struct InvalidStateSensor {
    hit: f64,
    false_alarm: f64,
}

impl StateSensor {
    /// A sensor. `hit`: P(reads 1 | is 1), in (0, 1]. `false_alarm`: P(reads 1 | is 0), in [0, 1), less than `hit`.
    ///
    /// # Errors
    /// [`InvalidStateSensor`] where one of them is outside its range.
    pub fn new(hit: f64, false_alarm: f64) -> Result<StateSensor, InvalidStateSensor> {
        let is_sensor = (0.0..1.0).contains(&false_alarm) && hit > false_alarm && hit <= 1.0;
        if is_sensor { Ok(StateSensor { hit, false_alarm }) } else { Err(InvalidStateSensor { hit, false_alarm }) }
    }

    /// P(reads 1 | is 1), in (0, 1].
    pub fn hit(self) -> f64 {
        self.hit
    }

    /// P(reads 1 | is 0), in [0, 1), less than the hit.
    pub fn false_alarm(self) -> f64 {
        self.false_alarm
    }

    pub(super) fn noise(self) -> SensorNoise {
        SensorNoise { miss: 1.0 - self.hit, false_alarm: self.false_alarm }
    }
}

impl std::fmt::Display for StateSensor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "hit {} and false alarm {}", self.hit, self.false_alarm)
    }
}

impl Belief {
    /// A belief of a state without readings whose sensor is known.
    pub fn of_sensor(sensor: StateSensor) -> Belief {
        Belief::new(true).with_sensor(sensor)
    }

    /// This belief with a sensor that is known: its errors are not learned. To be called before it learns.
    #[must_use]
    pub fn with_sensor(self, sensor: StateSensor) -> Belief {
        Belief { sensor: Some(sensor), ..self }
    }

    /// The sensor that was stated.
    pub fn sensor(&self) -> Option<StateSensor> {
        self.sensor
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_sensor_is_refused() {
        for (hit, false_alarm) in [
            (f64::NAN, 0.1),
            (0.9, f64::NAN),
            (0.3, 0.3),
            (0.2, 0.3),
            (1.1, 0.3),
            (f64::INFINITY, 0.3),
            (0.5, -0.1),
            (1.0, 1.0),
            (0.0, 0.0),
        ] {
            assert!(StateSensor::new(hit, false_alarm).is_err(), "{hit}, {false_alarm}");
        }
        for (hit, false_alarm) in [(1.0, 0.0), (0.9, 0.05), (0.3, 0.2)] {
            let sensor = StateSensor::new(hit, false_alarm).expect("a sensor");
            assert_eq!((sensor.hit(), sensor.false_alarm()), (hit, false_alarm));
        }
    }
}
