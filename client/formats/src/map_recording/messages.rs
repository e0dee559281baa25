//! Messages of a recording as JSON, and the schemas that describe them.
//!
//! Invariant: every message is valid by its schema.

use base64::{Engine as _, engine::general_purpose::STANDARD};
use serde_json::{Value, json};

use super::MapRecordingError;
use crate::{MapPicture, PictureError};

const SEC_NANOS: i64 = 1_000_000_000;
/// The number of the type of signed bytes in the fields of `foxglove.Grid`.
const INT8: u8 = 2;

/// The schema of [`grid`].
pub const GRID_SCHEMA: &str = r#"{
  "title": "foxglove.Grid",
  "description": "A grid of cells: the probability in percent that each is occupied, -1 where it is unknown",
  "type": "object",
  "properties": {
    "timestamp": {"type": "object", "title": "time", "properties": {"sec": {"type": "integer", "minimum": 0}, "nsec": {"type": "integer", "minimum": 0, "maximum": 999999999}}},
    "frame_id": {"type": "string"},
    "pose": {"type": "object", "title": "foxglove.Pose", "properties": {
      "position": {"type": "object", "title": "foxglove.Vector3", "properties": {"x": {"type": "number"}, "y": {"type": "number"}, "z": {"type": "number"}}},
      "orientation": {"type": "object", "title": "foxglove.Quaternion", "properties": {"x": {"type": "number"}, "y": {"type": "number"}, "z": {"type": "number"}, "w": {"type": "number"}}}
    }},
    "column_count": {"type": "integer", "minimum": 0},
    "cell_size": {"type": "object", "title": "foxglove.Vector2", "properties": {"x": {"type": "number"}, "y": {"type": "number"}}},
    "row_stride": {"type": "integer", "minimum": 0},
    "cell_stride": {"type": "integer", "minimum": 0},
    "fields": {"type": "array", "items": {"type": "object", "title": "foxglove.PackedElementField", "properties": {"name": {"type": "string"}, "offset": {"type": "integer", "minimum": 0}, "type": {"type": "integer"}}}},
    "data": {"type": "string", "contentEncoding": "base64"}
  }
}"#;

/// The schema of [`topology`].
pub const GEOJSON_SCHEMA: &str = r#"{
  "title": "foxglove.GeoJSON",
  "description": "The topological map; coordinates are metres",
  "type": "object",
  "properties": {"geojson": {"type": "string"}}
}"#;

/// The schema of [`state`].
pub const STATE_SCHEMA: &str = r#"{
  "title": "tidemap.State",
  "description": "The predicted value of a state at a time, and the interval of the mean of the hour around it",
  "type": "object",
  "properties": {
    "timestamp": {"type": "object", "title": "time", "properties": {"sec": {"type": "integer", "minimum": 0}, "nsec": {"type": "integer", "minimum": 0, "maximum": 999999999}}},
    "value": {"type": "number"},
    "low": {"type": ["number", "null"]},
    "high": {"type": ["number", "null"]}
  },
  "required": ["timestamp", "value"]
}"#;

/// The schema of [`anomalies`].
pub const ANOMALIES_SCHEMA: &str = r#"{
  "title": "tidemap.Anomalies",
  "description": "Observations in the hour before a time that the map did not expect, the most surprising first",
  "type": "object",
  "properties": {
    "timestamp": {"type": "object", "title": "time", "properties": {"sec": {"type": "integer", "minimum": 0}, "nsec": {"type": "integer", "minimum": 0, "maximum": 999999999}}},
    "anomalies": {"type": "array", "items": {"type": "object", "properties": {
      "state": {"type": "string"},
      "first": {"type": "object", "title": "time", "properties": {"sec": {"type": "integer", "minimum": 0}, "nsec": {"type": "integer", "minimum": 0, "maximum": 999999999}}},
      "last": {"type": "object", "title": "time", "properties": {"sec": {"type": "integer", "minimum": 0}, "nsec": {"type": "integer", "minimum": 0, "maximum": 999999999}}},
      "value": {"type": "number"},
      "probability": {"type": "number"},
      "bits": {"type": "number"}
    }}}
  }
}"#;

/// Unusual observations of a state in a row.
#[derive(Clone, Debug, PartialEq)]
pub struct AnomalyEntry {
    /// Name of the state.
    pub state: String,
    /// Time of the first observation, nanoseconds UTC.
    pub first_nanos: i64,
    /// Time of the last observation, nanoseconds UTC.
    pub last_nanos: i64,
    /// The value of the most surprising one.
    pub value: f64,
    /// The prediction for this value: the probability of the value 1, or of a value at least as far from the
    /// prediction.
    pub probability: f64,
    /// The surprise of all observations, in bits.
    pub bits: f64,
}

/// The predicted value of a state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StateValue {
    /// Probability that the state is 1, or the expected value of other kinds.
    pub value: f64,
    /// Lower end of its interval, if there is one.
    pub low: Option<f64>,
    /// Upper end of its interval, if there is one.
    pub high: Option<f64>,
}

/// The cells of a flat map: the probability in percent that each is occupied, -1 where it is unknown.
///
/// # Errors
/// The map is invalid or has several layers.
#[allow(clippy::cast_possible_truncation, reason = "a probability was checked to be within 0 and 1")]
pub(super) fn percents(picture: &MapPicture) -> Result<Vec<i8>, PictureError> {
    picture.check_flat()?;
    let percent = |cell| picture.value_of(cell).map_or(-1, |value| (f64::from(value) * 100.0).round() as i8);
    Ok(picture.cells.iter().copied().map(percent).collect())
}

/// A time as Foxglove's messages have it.
fn time(nanos: i64) -> Value {
    json!({ "sec": nanos.div_euclid(SEC_NANOS), "nsec": nanos.rem_euclid(SEC_NANOS) })
}

/// A map as a `foxglove.Grid`. `frame`: the frame of its origin.
///
/// # Errors
/// The map is invalid or not flat.
pub fn grid(time_nanos: i64, frame: &str, picture: &MapPicture) -> Result<Vec<u8>, MapRecordingError> {
    let cells: Vec<u8> = percents(picture)?.into_iter().map(|percent| percent.to_le_bytes()[0]).collect();
    let [x, y, _] = picture.origin_m;
    let [width, ..] = picture.size_cells;
    let side = picture.resolution_m;
    Ok(serde_json::to_vec(&json!({
        "timestamp": time(time_nanos),
        "frame_id": frame,
        "pose": {
            "position": { "x": x, "y": y, "z": 0.0 },
            "orientation": { "x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0 },
        },
        "column_count": width,
        "cell_size": { "x": side, "y": side },
        "row_stride": width,
        "cell_stride": 1,
        "fields": [{ "name": "occupied_percent", "offset": 0, "type": INT8 }],
        "data": STANDARD.encode(&cells),
    }))?)
}

/// A topological map as a `foxglove.GeoJSON`; `geojson` is the text of GeoJSON.
///
/// # Errors
/// [`MapRecordingError::Json`].
pub fn topology(geojson: &str) -> Result<Vec<u8>, MapRecordingError> {
    Ok(serde_json::to_vec(&json!({ "geojson": geojson }))?)
}

/// The value of a state as a `tidemap.State`.
///
/// # Errors
/// [`MapRecordingError::Json`].
pub fn state(time_nanos: i64, state: StateValue) -> Result<Vec<u8>, MapRecordingError> {
    let StateValue { value, low, high } = state;
    Ok(serde_json::to_vec(&json!({ "timestamp": time(time_nanos), "value": value, "low": low, "high": high }))?)
}

/// The unusual observations at a time as a `tidemap.Anomalies`; possibly none.
///
/// # Errors
/// [`MapRecordingError::Json`].
pub fn anomalies(time_nanos: i64, entries: &[AnomalyEntry]) -> Result<Vec<u8>, MapRecordingError> {
    let entry = |entry: &AnomalyEntry| {
        json!({
            "state": entry.state,
            "first": time(entry.first_nanos),
            "last": time(entry.last_nanos),
            "value": entry.value,
            "probability": entry.probability,
            "bits": entry.bits,
        })
    };
    let entries: Vec<Value> = entries.iter().map(entry).collect();
    Ok(serde_json::to_vec(&json!({ "timestamp": time(time_nanos), "anomalies": entries }))?)
}
