//! A recording of predicted maps over time in MCAP, which viewers such as Foxglove and the tools of ROS 2 read.
//!
//! | topic | schema | encoding |
//! | --- | --- | --- |
//! | `/map` | `nav_msgs/msg/OccupancyGrid`, with the definitions of all types inside | CDR of ROS 2 |
//! | `/grid` | `foxglove.Grid` | JSON |
//! | `/topology` | `foxglove.GeoJSON` | JSON |
//! | `/states/NAME` | `tidemap.State` | JSON |
//!
//! The time of a message is the time that was predicted for, past or future. `/map` and `/grid` have the same values:
//! the probability in percent that a cell is occupied, and -1 where it is unknown.
//!
//! Invariant: messages are written as they come, without compression; at most one message and one chunk of about 1 MiB
//! are in memory. A file is complete only after [`MapRecording::finish`].

mod grid_message;
pub mod messages;
#[cfg(test)]
mod tests;

use std::{
    collections::{BTreeMap, HashMap},
    io::{Seek, Write},
};

use mcap::{McapError, WriteOptions, Writer, records::MessageHeader};

use crate::{MapPicture, PictureError, ros_types};
use messages::StateValue;

/// Topic of the maps for ROS 2.
pub const MAP_TOPIC: &str = "/map";
/// Topic of the maps for Foxglove.
pub const GRID_TOPIC: &str = "/grid";
/// Topic of the topological map.
pub const TOPOLOGY_TOPIC: &str = "/topology";
/// Topic of unusual observations, which only a server has.
pub const ANOMALIES_TOPIC: &str = "/anomalies";
/// Before the names of states in topics.
pub const STATES_PREFIX: &str = "/states/";
/// Maximum number of states of a recording: MCAP has at most 65,535 topics.
pub const STATES_MAX: usize = 60_000;

/// Why a recording cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum MapRecordingError {
    /// The file cannot be written.
    #[error("the recording cannot be written: {0}")]
    Mcap(#[from] McapError),
    /// A map is invalid.
    #[error(transparent)]
    Picture(#[from] PictureError),
    /// A message cannot be encoded.
    #[error("a message cannot be encoded as JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// A time before 1970, in nanoseconds since then.
    #[error("the time {0} ns is before 1970: a recording begins in 1970 or later")]
    TooEarly(i64),
    /// A time that ROS 2 cannot express, in nanoseconds since 1970.
    #[error(
        "the time {0} ns is after 2038-01-19, where the times of ROS 2 end: choose earlier times, or leave out the content map"
    )]
    TooLate(i64),
    /// A recording has too many topics.
    #[error("more than {STATES_MAX} states: a recording has a topic for each; choose some with --state")]
    TooManyStates,
}

/// The data of a recording about itself.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RecordingHead {
    /// Whether the recording has messages of ROS 2 only; it then has the profile `ros2`.
    pub is_ros2_only: bool,
    /// Further data about the recording: names and values.
    pub about: BTreeMap<String, String>,
}

/// The number of messages of a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MessageCounts {
    /// Maps for ROS 2.
    pub maps: u64,
    /// Maps for Foxglove.
    pub grids: u64,
    /// Topological maps.
    pub topologies: u64,
    /// Values of states.
    pub states: u64,
}

/// A recording in progress.
pub struct MapRecording<W: Write + Seek> {
    writer: Writer<W>,
    /// Number of the channel and of its next message, by topic.
    channels: HashMap<String, (u16, u32)>,
    states: usize,
    counts: MessageCounts,
}

/// The description of the messages of a topic.
struct Description {
    schema: &'static str,
    schema_encoding: &'static str,
    /// Absent: the definition of the type of ROS 2.
    text: Option<&'static str>,
    message_encoding: &'static str,
}

const MAP: Description = Description {
    schema: "nav_msgs/msg/OccupancyGrid",
    schema_encoding: "ros2msg",
    text: None,
    message_encoding: "cdr",
};
const GRID: Description = json_description("foxglove.Grid", messages::GRID_SCHEMA);
const TOPOLOGY: Description = json_description("foxglove.GeoJSON", messages::GEOJSON_SCHEMA);
const STATE: Description = json_description("tidemap.State", messages::STATE_SCHEMA);

const fn json_description(schema: &'static str, text: &'static str) -> Description {
    Description { schema, schema_encoding: "jsonschema", text: Some(text), message_encoding: "json" }
}

impl<W: Write + Seek> MapRecording<W> {
    /// Begins a recording.
    ///
    /// # Errors
    /// [`MapRecordingError::Mcap`].
    pub fn new(target: W, head: &RecordingHead) -> Result<Self, MapRecordingError> {
        let profile = if head.is_ros2_only { "ros2" } else { "" };
        let mut writer = WriteOptions::new().compression(None).profile(profile).library("tidemap").create(target)?;
        let about = mcap::records::Metadata { name: "tidemap".to_owned(), metadata: head.about.clone() };
        writer.write_metadata(&about)?;
        Ok(Self { writer, channels: HashMap::new(), states: 0, counts: MessageCounts::default() })
    }

    /// Adds a map for ROS 2. `frame`: the frame of its origin.
    ///
    /// # Errors
    /// [`MapRecordingError`]; a map has to be flat.
    pub fn map(&mut self, time_nanos: i64, frame: &str, picture: &MapPicture) -> Result<(), MapRecordingError> {
        let message = grid_message::occupancy_grid(time_nanos, frame, picture)?;
        self.put(time_nanos, MAP_TOPIC, &MAP, &message)?;
        self.counts.maps += 1;
        Ok(())
    }

    /// Adds a map for Foxglove. `frame`: the frame of its origin.
    ///
    /// # Errors
    /// [`MapRecordingError`]; a map has to be flat.
    pub fn grid(&mut self, time_nanos: i64, frame: &str, picture: &MapPicture) -> Result<(), MapRecordingError> {
        let message = messages::grid(time_nanos, frame, picture)?;
        self.put(time_nanos, GRID_TOPIC, &GRID, &message)?;
        self.counts.grids += 1;
        Ok(())
    }

    /// Adds a topological map, as the text of GeoJSON.
    ///
    /// # Errors
    /// [`MapRecordingError`].
    pub fn topology(&mut self, time_nanos: i64, geojson: &str) -> Result<(), MapRecordingError> {
        let message = messages::topology(geojson)?;
        self.put(time_nanos, TOPOLOGY_TOPIC, &TOPOLOGY, &message)?;
        self.counts.topologies += 1;
        Ok(())
    }

    /// Adds the value of a state.
    ///
    /// # Errors
    /// [`MapRecordingError`].
    pub fn state(&mut self, time_nanos: i64, name: &str, value: StateValue) -> Result<(), MapRecordingError> {
        let topic = format!("{STATES_PREFIX}{name}");
        if !self.channels.contains_key(&topic) {
            if self.states >= STATES_MAX {
                return Err(MapRecordingError::TooManyStates);
            }
            self.states += 1;
        }
        let message = messages::state(time_nanos, value)?;
        self.put(time_nanos, &topic, &STATE, &message)?;
        self.counts.states += 1;
        Ok(())
    }

    /// Writes the end of the recording, with its index. Returns the writer of the recording, and the message counts.
    ///
    /// # Errors
    /// [`MapRecordingError::Mcap`].
    pub fn finish(mut self) -> Result<(W, MessageCounts), MapRecordingError> {
        self.writer.finish()?;
        Ok((self.writer.into_inner(), self.counts))
    }

    fn put(
        &mut self,
        time_nanos: i64,
        topic: &str,
        description: &Description,
        message: &[u8],
    ) -> Result<(), MapRecordingError> {
        let log_time = u64::try_from(time_nanos).map_err(|_| MapRecordingError::TooEarly(time_nanos))?;
        if !self.channels.contains_key(topic) {
            let Description { schema, schema_encoding, text, message_encoding } = description;
            let definition = match text {
                Some(text) => (*text).to_owned(),
                None => ros_types::definition(&schema.replace("/msg/", "/")),
            };
            // A schema that is known already keeps its number.
            let schema = self.writer.add_schema(schema, schema_encoding, definition.as_bytes())?;
            let channel = self.writer.add_channel(schema, topic, message_encoding, &BTreeMap::new())?;
            self.channels.insert(topic.to_owned(), (channel, 0));
        }
        let Some((channel, sequence)) = self.channels.get_mut(topic) else { return Ok(()) };
        let header = MessageHeader { channel_id: *channel, sequence: *sequence, log_time, publish_time: log_time };
        *sequence = sequence.wrapping_add(1);
        Ok(self.writer.write_to_known_channel(&header, message)?)
    }
}
