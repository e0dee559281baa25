//! The sensor of a stream's scans.
//!
//! Invariant: a key keeps the sensor of its first event. Announced sensors that are not durable yet are also counted,
//! so that the map always has a number for the sensor of an event.

use tidemap_grid::sensors::ProducerSensor;
use tidemap_map::live_map::LiveMap;

use super::{
    super::protocol::{Hello, HelloError},
    Sessions,
};

impl Sessions {
    /// The sensor that the key of a hello has or gets; `None`: the map's default.
    pub(super) fn sensor(&self, hello: &Hello, map: &LiveMap) -> Result<Option<ProducerSensor>, HelloError> {
        let fixed = map.producer(&hello.key).map(|(_, mark)| mark.sensor);
        let Some(announced) = hello.sensor else { return Ok(fixed.flatten()) };
        let grid = map.grid().ok_or(HelloError::SensorWithoutGrid)?;
        let Some(fixed) = fixed else {
            // Sensors that other streams have announced, which may become durable before this one.
            let others = self.sessions.values().filter_map(|session| session.sensor);
            return Ok(grid.may_have(announced, others)?);
        };
        if grid.sensors().check(announced)? != fixed {
            let fixed = fixed.unwrap_or_else(|| grid.sensors().own());
            return Err(HelloError::OtherSensor { key: hello.key.clone(), fixed, announced });
        }
        Ok(fixed)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use tidemap_grid::{
        scan::Scans,
        sensors::{InvalidSensor, SENSORS_MAX},
        spec::{GridSpec, Retention, SensorNoise},
    };
    use tidemap_map::{
        event::{Envelope, Event, SequenceSpan},
        ids::{NewProducer, ProducerId},
        name::{MapName, ProducerKey},
        spec::MapSpec,
    };
    use tidemap_model::Zone;
    use tokio::sync::{mpsc, oneshot};

    use super::{super::SessionLimits, *};

    const OWN: SensorNoise = SensorNoise { hit: 0.9, false_alarm: 0.1, prior: 0.5 };

    fn map(has_grid: bool) -> LiveMap {
        let grid = GridSpec { sensor: OWN, ..GridSpec::new(0.1) };
        LiveMap::new(Arc::new(MapSpec {
            zone: Zone::named("Europe/London").expect("known"),
            retention: Retention::None,
            grid: has_grid.then_some(grid),
            ..MapSpec::new(MapName::new("office").expect("valid"))
        }))
    }

    fn sessions() -> Sessions {
        let limits = SessionLimits { states: 10, producers: 1000, producers_of_client: 1000, ahead: 10, tiles: 10 };
        Sessions::new(Zone::named("Europe/London").expect("known").offset_cache(), limits)
    }

    fn sensor(hit: f64) -> Option<ProducerSensor> {
        Some(ProducerSensor { hit, false_alarm: 0.1 })
    }

    fn key(name: &str) -> ProducerKey {
        ProducerKey::new(name, "").expect("valid")
    }

    fn hello(name: &str, sensor: Option<ProducerSensor>) -> Hello {
        let (events, reply) = (mpsc::unbounded_channel().0, oneshot::channel().0);
        Hello {
            key: key(name),
            incarnation: 0,
            client: String::new(),
            probe: None,
            takes_over: None,
            nightly: false,
            sensor,
            events,
            reply,
        }
    }

    /// The first event of a producer.
    fn first(map: &mut LiveMap, name: &str, sensor: Option<ProducerSensor>) {
        let producer = ProducerId(u32::try_from(map.producers()).expect("few"));
        let envelope = Envelope {
            producer,
            new_producer: Some(NewProducer { key: key(name), sensor, introduced_by: String::new() }),
            incarnation: 1,
            span: SequenceSpan { first: 1, last: 1, content_crc: 0 },
            received_nanos: 0,
            refused: Vec::new(),
        };
        map.apply(map.position() + 1, &Event::Scans(envelope, Scans::default())).expect("consistent");
    }

    #[test]
    fn a_key_keeps_the_sensor_that_it_began_with() {
        let (mut map, sessions) = (map(true), sessions());
        first(&mut map, "weak", sensor(0.5));
        first(&mut map, "usual", None);
        let requested = |name: &str, given| sessions.sensor(&hello(name, given), &map);
        assert_eq!((requested("weak", None), requested("weak", sensor(0.5))), (Ok(sensor(0.5)), Ok(sensor(0.5))));
        assert_eq!((requested("usual", None), requested("usual", sensor(0.9))), (Ok(None), Ok(None)));
        assert_eq!((requested("new", sensor(0.9)), requested("new", sensor(0.6))), (Ok(None), Ok(sensor(0.6))));
        for (name, given, fixed) in [("weak", 0.6, 0.5), ("weak", 0.9, 0.5), ("usual", 0.5, 0.9)] {
            let refused = requested(name, sensor(given)).expect_err("refused");
            assert!(matches!(refused, HelloError::OtherSensor { .. }), "{refused}");
            let text = refused.to_string();
            assert!(text.contains(&format!("of hit {fixed},")) && text.contains(&format!("announces hit {given},")));
        }
        let invalid = requested("new", sensor(f64::NAN)).expect_err("refused");
        assert!(matches!(invalid, HelloError::Sensor(InvalidSensor::Range(_))), "{invalid}");
        let without = sessions.sensor(&hello("new", sensor(0.5)), &self::map(false));
        assert_eq!(without, Err(HelloError::SensorWithoutGrid));
    }

    #[test]
    fn sensors_that_are_announced_count_with_those_that_are_durable() {
        let (mut map, mut sessions) = (map(true), sessions());
        let number = |number: usize| sensor(0.2 + number as f64 / 1000.0);
        for known in 0..SENSORS_MAX - 2 {
            first(&mut map, &format!("robot{known}"), number(known));
        }
        for (name, given, has_room) in
            [("one", 400, true), ("two", 401, true), ("three", 400, true), ("four", 402, false)]
        {
            let opened = sessions.open(&hello(name, number(given)), &map);
            let is_full = matches!(opened, Err(HelloError::Sensor(InvalidSensor::TooMany)));
            assert_eq!((opened.is_ok(), is_full), (has_room, !has_room), "{name}");
        }
        assert!(sessions.open(&hello("five", number(0)), &map).is_ok());
        assert!(sessions.open(&hello("six", None), &map).is_ok());
    }
}
