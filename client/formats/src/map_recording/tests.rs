//! Recordings, read back by the reader of the crate mcap and by an own reader of CDR.
//!
//! Invariant: the expected bytes of CDR follow from its specification, not from the code.

use std::io::Cursor;

use serde_json::{Value, json};

use super::*;
use crate::picture::samples;

/// 2016-03-21T10:00:00.5Z.
const TIME: i64 = 1_458_554_400_500_000_000;

fn written(fill: impl FnOnce(&mut MapRecording<Cursor<Vec<u8>>>)) -> (Vec<u8>, MessageCounts) {
    let about = [("map".to_owned(), "office".to_owned())].into();
    let head = RecordingHead { is_ros2_only: false, about };
    let mut recording = MapRecording::new(Cursor::new(Vec::new()), &head).expect("a recording");
    fill(&mut recording);
    let (target, counts) = recording.finish().expect("the end");
    (target.into_inner(), counts)
}

fn one(fill: impl FnOnce(&mut MapRecording<Cursor<Vec<u8>>>)) -> (String, String, String, u64, Vec<u8>) {
    let (bytes, _) = written(fill);
    let mut messages = mcap::MessageStream::new(&bytes).expect("MCAP").map(|message| message.expect("a message"));
    let message = messages.next().expect("one message");
    assert!(messages.next().is_none());
    let schema = message.channel.schema.as_ref().expect("a schema");
    let (topic, encoding) = (message.channel.topic.clone(), message.channel.message_encoding.clone());
    (topic, schema.name.clone(), encoding, message.log_time, message.data.to_vec())
}

#[test]
fn a_map_for_ros_has_the_bytes_of_an_occupancy_grid() {
    let (topic, schema, encoding, time, data) =
        one(|recording| recording.map(TIME, "map", &samples::flat()).expect("a map"));
    assert_eq!((topic.as_str(), schema.as_str(), encoding.as_str()), ("/map", "nav_msgs/msg/OccupancyGrid", "cdr"));
    assert_eq!(i64::try_from(time), Ok(TIME));
    let mut expected = vec![0, 1, 0, 0];
    let stamp = [1_458_554_400_u32.to_le_bytes(), 500_000_000_u32.to_le_bytes()].concat();
    expected.extend(&stamp);
    expected.extend([4, 0, 0, 0, b'm', b'a', b'p', 0]);
    expected.extend(&stamp);
    expected.extend(0.05_f32.to_le_bytes());
    expected.extend([3, 0, 0, 0, 2, 0, 0, 0]);
    // 36 bytes behind the header: the next multiple of 8 is 40.
    expected.extend([0; 4]);
    for number in [-1.5, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0_f64] {
        expected.extend(number.to_le_bytes());
    }
    expected.extend([6, 0, 0, 0, 0, 100, 255, 0, 50, 100]);
    assert_eq!(data, expected);
}

#[test]
fn a_map_for_foxglove_has_the_same_cells() -> Result<(), serde_json::Error> {
    let (topic, schema, encoding, _, data) =
        one(|recording| recording.grid(TIME, "map", &samples::flat()).expect("a grid"));
    assert_eq!((topic.as_str(), schema.as_str(), encoding.as_str()), ("/grid", "foxglove.Grid", "json"));
    let message: Value = serde_json::from_slice(&data)?;
    assert_eq!(message["timestamp"], json!({ "sec": 1_458_554_400, "nsec": 500_000_000 }));
    assert_eq!(message["pose"]["position"], json!({ "x": -1.5, "y": 2.0, "z": 0.0 }));
    // The bytes 0, 100, 255, 0, 50, 100.
    assert_eq!((&message["column_count"], &message["data"]), (&3.into(), &"AGT/ADJk".into()));
    Ok(())
}

#[test]
fn states_and_topologies_have_topics_of_their_own() -> Result<(), Box<dyn std::error::Error>> {
    let value = |value| StateValue { value, low: Some(0.25), high: None };
    let (bytes, counts) = written(|recording| {
        for hour in 0..3 {
            let time = TIME + hour * 3_600_000_000_000;
            recording.topology(time, "{}").expect("a topological map");
            recording.state(time, "door", value(0.5)).expect("a state");
            recording.state(time, "edge/A/B", value(1.0)).expect("a state");
        }
    });
    assert_eq!(counts, MessageCounts { maps: 0, grids: 0, topologies: 3, states: 6 });
    let summary = mcap::Summary::read(&bytes)?.ok_or("no summary")?;
    let mut topics: Vec<&str> = summary.channels.values().map(|channel| channel.topic.as_str()).collect();
    topics.sort_unstable();
    assert_eq!(topics, ["/states/door", "/states/edge/A/B", "/topology"]);
    assert_eq!(summary.schemas.len(), 2, "states share one schema");
    assert_eq!(summary.stats.map(|stats| (stats.message_count, stats.metadata_count)), Some((9, 1)));
    for message in mcap::MessageStream::new(&bytes)? {
        let message = message?;
        let json: Value = serde_json::from_slice(&message.data)?;
        match message.channel.topic.as_str() {
            "/topology" => assert_eq!(json, json!({ "geojson": "{}" })),
            "/states/door" => {
                assert_eq!((&json["value"], &json["low"], &json["high"]), (&0.5.into(), &0.25.into(), &Value::Null));
            }
            _ => assert_eq!(json["value"], 1.0),
        }
    }
    Ok(())
}

#[test]
fn schemas_are_json_and_name_every_field_of_their_messages() -> Result<(), serde_json::Error> {
    let state = messages::state(TIME, StateValue { value: 0.5, low: None, high: None });
    let anomaly = messages::AnomalyEntry {
        state: "door".to_owned(),
        first_nanos: TIME,
        last_nanos: TIME,
        value: 1.0,
        probability: 0.01,
        bits: 6.6,
    };
    for (schema, message) in [
        (messages::GRID_SCHEMA, messages::grid(TIME, "map", &samples::flat())),
        (messages::GEOJSON_SCHEMA, messages::topology("{}")),
        (messages::STATE_SCHEMA, state),
        (messages::ANOMALIES_SCHEMA, messages::anomalies(TIME, std::slice::from_ref(&anomaly))),
    ] {
        let schema: Value = serde_json::from_str(schema)?;
        let message: Value = serde_json::from_slice(&message.expect("a message"))?;
        let names = |value: &Value| value.as_object().map(|fields| fields.keys().cloned().collect::<Vec<_>>());
        assert_eq!(names(&message), names(&schema["properties"]));
    }
    Ok(())
}

#[test]
fn what_a_recording_cannot_hold_is_refused() {
    written(|recording| {
        let error = recording.map(-1, "map", &samples::flat()).map_err(|error| error.to_string());
        assert!(error.is_err_and(|text| text.contains("before 1970")));
        let late = 2_200_000_000_000_000_000;
        let error = recording.map(late, "map", &samples::flat()).map_err(|error| error.to_string());
        assert!(error.is_err_and(|text| text.contains("2038")));
        assert!(recording.grid(late, "map", &samples::flat()).is_ok(), "Foxglove's times do not end there");
        let mut layers = samples::flat();
        layers.size_cells = [3, 1, 2];
        assert!(recording.map(TIME, "map", &layers).is_err_and(|error| error.to_string().contains("2 layers")));
    });
}
