//! The sensors of a grid: the map's own sensor, and the sensors that producers have announced.
//!
//! A reading counts as the posterior P(occupied | reading) of the sensor that made it, under the map's prior. All sums
//! are kept in units of the map's own sensor, in which its free reading counts as 0 and its occupied reading as 1: with
//! levels f0 and o0 of the map's own sensor and f and o of another sensor, a reading of the other sensor counts as α +
//! β·occupied, with α = (f - f0)/(o0 - f0) and β = (o - f)/(o0 - f0).
//!
//! Invariant: sensor 0 is the map's own, with α = 0 and β = 1; the others are numbered in the order in which their
//! first producers appear in the log, each once. Every α and β is finite.

use tidemap_model::StateSensor;

use crate::{
    ray_odds::{RayOdds, SourceOdds},
    scan::ScanSource,
    spec::SensorNoise,
};

/// Maximum number of sensors of a grid besides the map's own.
pub const SENSORS_MAX: usize = u8::MAX as usize;
/// Minimum distance between the levels of the map's own sensor, so that others can be expressed in its units.
const DISTINGUISHED: f64 = 1e-9;

/// Number of a sensor of a grid; 0 is the map's own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct SensorId(pub u8);

impl SensorId {
    /// The map's own sensor.
    pub const OWN: SensorId = SensorId(0);
}

/// The sensor that a producer announces; the prior is the map's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProducerSensor {
    /// P(reads occupied | is occupied), in (0, 1].
    pub hit: f64,
    /// P(reads occupied | is free), in [0, 1), below `hit`.
    pub false_alarm: f64,
}

impl std::fmt::Display for ProducerSensor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "hit {}, false alarm {}", self.hit, self.false_alarm)
    }
}

/// Why a sensor is invalid.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum InvalidSensor {
    /// The probabilities are inconsistent, or are so small that no posterior follows from them.
    #[error("sensor of {0}: it must satisfy 0 <= false alarm < hit <= 1")]
    Range(ProducerSensor),
    /// The map's own sensor is not informative enough.
    #[error(
        "the map's own sensor hardly distinguishes free from occupied (its readings count as {free} and {occupied}), \
         and other sensors are kept in its units: no producer may have one of its own"
    )]
    Own {
        /// The value that a free reading counts as.
        free: f64,
        /// The value that an occupied reading counts as.
        occupied: f64,
    },
    /// The map has the maximum number of sensors.
    #[error("the map has {SENSORS_MAX} sensors beside its own, as many as it may")]
    TooMany,
}

/// The weight of one or more readings in units of the map's own sensor: α + β·occupied.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Weights {
    /// The part that counts whether the reading is free or occupied.
    pub alpha: f64,
    /// The additional part of an occupied reading.
    pub beta: f64,
}

impl Weights {
    /// The weight of `count` readings of the map's own sensor.
    pub fn own(readings: u64) -> Weights {
        Weights { alpha: 0.0, beta: readings as f64 }
    }

    /// The sum of the readings if all, or none, are occupied.
    pub fn units(self, is_occupied: bool) -> f64 {
        if is_occupied { self.alpha + self.beta } else { self.alpha }
    }
}

impl std::ops::AddAssign for Weights {
    fn add_assign(&mut self, other: Weights) {
        self.alpha += other.alpha;
        self.beta += other.beta;
    }
}

impl std::ops::MulAssign<f64> for Weights {
    fn mul_assign(&mut self, factor: f64) {
        self.alpha *= factor;
        self.beta *= factor;
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Sensor {
    levels: (f64, f64),
    weights: Weights,
    odds: SourceOdds,
}

/// The sensors of a grid.
#[derive(Clone, Debug, PartialEq)]
pub struct Sensors {
    noise: SensorNoise,
    own: Sensor,
    others: Vec<(ProducerSensor, Sensor)>,
}

impl Sensors {
    /// The sensors of a grid that has only the map's own sensor.
    pub fn new(noise: SensorNoise) -> Sensors {
        let own = Sensor {
            levels: noise.levels(),
            weights: Weights::own(1),
            odds: SourceOdds::new(noise.hit, noise.false_alarm),
        };
        Sensors { noise, own, others: Vec::new() }
    }

    /// The sensor of a producer that announces this sensor: `None` if it equals the map's own.
    ///
    /// # Errors
    /// [`InvalidSensor`] where the producer cannot have it.
    pub fn check(&self, announced: ProducerSensor) -> Result<Option<ProducerSensor>, InvalidSensor> {
        if (announced.hit, announced.false_alarm) == (self.noise.hit, self.noise.false_alarm) {
            return Ok(None);
        }
        self.describe(announced).map(|_| Some(announced))
    }

    fn describe(&self, announced: ProducerSensor) -> Result<Sensor, InvalidSensor> {
        let ProducerSensor { hit, false_alarm } = announced;
        let is_sensor = StateSensor::new(hit, false_alarm).is_ok();
        let (free, occupied) = SensorNoise { hit, false_alarm, prior: self.noise.prior }.levels();
        // A product of probabilities may underflow.
        if !(is_sensor && (0.0..=1.0).contains(&free) && (0.0..=1.0).contains(&occupied)) {
            return Err(InvalidSensor::Range(announced));
        }
        let (own_free, own_occupied) = self.own.levels;
        let unit = own_occupied - own_free;
        // This is also false if the distance is NaN.
        if unit.is_nan() || unit < DISTINGUISHED {
            return Err(InvalidSensor::Own { free: own_free, occupied: own_occupied });
        }
        let weights = Weights { alpha: (free - own_free) / unit, beta: (occupied - free) / unit };
        Ok(Sensor { levels: (free, occupied), weights, odds: SourceOdds::new(hit, false_alarm) })
    }

    /// The number of a sensor that some producer has; `None` is the map's own.
    pub fn find(&self, sensor: Option<ProducerSensor>) -> Option<SensorId> {
        let Some(sensor) = sensor else { return Some(SensorId::OWN) };
        let at = self.others.iter().position(|(known, _)| *known == sensor)?;
        u8::try_from(at + 1).ok().map(SensorId)
    }

    /// Numbers a sensor that may be new.
    ///
    /// # Errors
    /// [`InvalidSensor`] where the grid cannot have it.
    pub fn add(&mut self, sensor: Option<ProducerSensor>) -> Result<SensorId, InvalidSensor> {
        if let Some(known) = self.find(sensor) {
            return Ok(known);
        }
        let Some(sensor) = sensor.map(|sensor| self.check(sensor)).transpose()?.flatten() else {
            return Ok(SensorId::OWN);
        };
        let id = u8::try_from(self.others.len() + 1).map_err(|_| InvalidSensor::TooMany)?;
        self.others.push((sensor, self.describe(sensor)?));
        Ok(SensorId(id))
    }

    /// The map's own sensor, in the form in which a producer would announce it.
    pub fn own(&self) -> ProducerSensor {
        ProducerSensor { hit: self.noise.hit, false_alarm: self.noise.false_alarm }
    }

    /// Number of sensors beside the map's own.
    pub fn others(&self) -> usize {
        self.others.len()
    }

    fn get(&self, id: SensorId) -> &Sensor {
        let other = usize::from(id.0).checked_sub(1).and_then(|at| self.others.get(at));
        other.map_or(&self.own, |(_, sensor)| sensor)
    }

    /// The values of a free and an occupied reading of a sensor. An unknown sensor counts as the map's own.
    pub fn levels(&self, id: SensorId) -> (f64, f64) {
        self.get(id).levels
    }

    /// The value of a reading of a sensor.
    pub fn value(&self, id: SensorId, is_occupied: bool) -> f64 {
        let (free, occupied) = self.levels(id);
        if is_occupied { occupied } else { free }
    }

    /// The weight of a reading of a sensor in units of the map's own.
    pub fn weights(&self, id: SensorId) -> Weights {
        self.get(id).weights
    }

    /// The log odds that a scan of a sensor adds to the evidence of a bin.
    pub(crate) fn odds(&self, id: SensorId, source: ScanSource) -> RayOdds {
        self.get(id).odds.by_source(source)
    }

    /// A value in [0, 1] from units of the map's own sensor.
    pub(crate) fn value_of_units(&self, units: f64) -> f64 {
        let (free, occupied) = self.own.levels;
        (free + (occupied - free) * units).clamp(0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOISE: SensorNoise = SensorNoise { hit: 0.83, false_alarm: 0.07, prior: 0.37 };

    fn sensor(hit: f64, false_alarm: f64) -> ProducerSensor {
        ProducerSensor { hit, false_alarm }
    }

    #[test]
    fn readings_in_units_of_the_own_sensor_have_their_levels() {
        let mut sensors = Sensors::new(NOISE);
        let (one, other) = (sensor(0.6, 0.3), sensor(1.0, 0.0));
        assert_eq!(sensors.add(Some(one)), Ok(SensorId(1)));
        assert_eq!(sensors.add(Some(other)), Ok(SensorId(2)));
        assert_eq!(sensors.add(Some(one)), Ok(SensorId(1)));
        assert_eq!(sensors.add(Some(sensor(0.83, 0.07))), Ok(SensorId::OWN));
        assert_eq!((sensors.add(None), sensors.others()), (Ok(SensorId::OWN), 2));
        assert_eq!((sensors.find(Some(other)), sensors.find(Some(sensor(0.5, 0.1)))), (Some(SensorId(2)), None));
        assert_eq!(sensors.weights(SensorId::OWN), Weights { alpha: 0.0, beta: 1.0 });
        assert_eq!(sensors.levels(SensorId(2)), (0.0, 1.0));
        let expected = SensorNoise { hit: 0.6, false_alarm: 0.3, ..NOISE }.levels();
        assert_eq!(sensors.levels(SensorId(1)), expected);
        for id in (0..4).map(SensorId) {
            for is_occupied in [false, true] {
                let value = sensors.value_of_units(sensors.weights(id).units(is_occupied));
                assert!((value - sensors.value(id, is_occupied)).abs() < 1e-14, "{id:?}");
            }
        }
    }

    #[test]
    fn what_is_no_sensor_is_refused() {
        let sensors = Sensors::new(NOISE);
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
            (f64::from_bits(1), 0.0),
        ] {
            let found = sensors.check(sensor(hit, false_alarm));
            assert!(matches!(found, Err(InvalidSensor::Range(_))), "{hit}, {false_alarm}: {found:?}");
        }
        let dull = Sensors::new(SensorNoise { hit: 0.5 + 1e-12, false_alarm: 0.5, prior: 0.5 });
        assert!(matches!(dull.check(sensor(0.9, 0.1)), Err(InvalidSensor::Own { .. })));
    }

    #[test]
    fn scans_and_cells_take_no_more_memory_for_it() {
        use crate::{day::ScanTime, live_tile::Away};
        assert_eq!(size_of::<ScanTime>(), size_of::<(i64, i32)>());
        assert_eq!(size_of::<Away>(), size_of::<(u16, i64, u64)>());
    }

    #[test]
    fn there_are_no_more_sensors_than_numbers() {
        let mut sensors = Sensors::new(NOISE);
        for number in 1..=SENSORS_MAX {
            let id = sensors.add(Some(sensor(0.9, number as f64 / 1000.0))).expect("room");
            assert_eq!(usize::from(id.0), number);
        }
        assert_eq!(sensors.add(Some(sensor(0.9, 0.5))), Err(InvalidSensor::TooMany));
        assert_eq!(sensors.add(Some(sensor(0.9, 0.001))), Ok(SensorId(1)));
    }
}
