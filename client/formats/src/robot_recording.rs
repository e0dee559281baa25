//! A recording of a robot in MCAP, as ROS 2 writes it: scans, transforms and doors.
//!
//! Invariant: messages are written as they come, without compression, each with the definition of its type. A file is
//! complete only after [`RobotRecording::finish`].

use std::{
    collections::{BTreeMap, HashMap},
    io::{Seek, Write},
};

use mcap::{McapError, WriteOptions, Writer, records::MessageHeader};

use crate::{
    cdr::{Cdr, TooLate},
    ros_types,
};

const TRANSFORMS: &str = "tf2_msgs/TFMessage";
const SCAN: &str = "sensor_msgs/LaserScan";
const CLOUD: &str = "sensor_msgs/PointCloud2";
const DOOR: &str = "rmf_door_msgs/DoorState";
/// Number type of the coordinates of a point, and the bytes of a point.
const FLOAT32: u8 = 7;
const POINT_BYTES: usize = 12;
/// Mode of an open door, and of a closed one.
const OPEN: u32 = 2;
const CLOSED: u32 = 0;

/// Why a recording cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum RobotRecordingError {
    /// The file cannot be written.
    #[error("the recording cannot be written: {0}")]
    Mcap(#[from] McapError),
    /// A time is out of range.
    #[error(transparent)]
    TooLate(#[from] TooLate),
    /// A time before 1970, in nanoseconds since then.
    #[error("the time {0} ns is before 1970: a recording begins in 1970 or later")]
    TooEarly(i64),
}

/// A scan all around, the first ray along the x axis of the sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct RingScan<'a> {
    /// Frame of the sensor.
    pub frame: &'a str,
    /// Smallest and largest valid range, metres.
    pub limits_m: [f32; 2],
    /// Ranges, metres, counter-clockwise.
    pub ranges_m: &'a [f32],
}

/// A recording in progress.
pub struct RobotRecording<W: Write + Seek> {
    writer: Writer<W>,
    /// Number of the channel and of its next message, by topic.
    channels: HashMap<String, (u16, u32)>,
}

impl<W: Write + Seek> RobotRecording<W> {
    /// Begins a recording.
    ///
    /// # Errors
    /// [`RobotRecordingError::Mcap`].
    pub fn new(target: W) -> Result<Self, RobotRecordingError> {
        let writer = WriteOptions::new().compression(None).profile("ros2").library("tidemap").create(target)?;
        Ok(Self { writer, channels: HashMap::new() })
    }

    /// Adds a transform: the position of a frame within its parent, metres, and its turn about z, radians.
    ///
    /// # Errors
    /// [`RobotRecordingError`].
    pub fn transform(
        &mut self,
        (topic, time_nanos): (&str, i64),
        (parent, child): (&str, &str),
        [x, y, z]: [f64; 3],
        yaw_rad: f64,
    ) -> Result<(), RobotRecordingError> {
        let mut cdr = Cdr::with_capacity(128);
        cdr.count(1);
        cdr.time(time_nanos)?;
        cdr.text(parent);
        cdr.text(child);
        cdr.doubles(&[x, y, z, 0.0, 0.0, (yaw_rad / 2.0).sin(), (yaw_rad / 2.0).cos()]);
        self.put((topic, time_nanos), TRANSFORMS, &cdr.into_bytes())
    }

    /// Adds a scan.
    ///
    /// # Errors
    /// [`RobotRecordingError`].
    pub fn scan(&mut self, (topic, time_nanos): (&str, i64), scan: &RingScan<'_>) -> Result<(), RobotRecordingError> {
        let RingScan { frame, limits_m: [min, max], ranges_m } = scan;
        let turn = std::f32::consts::TAU;
        let mut cdr = Cdr::with_capacity(ranges_m.len() * 4 + 128);
        cdr.time(time_nanos)?;
        cdr.text(frame);
        cdr.floats(&[0.0, turn, turn / ranges_m.len() as f32, 0.0, 0.0, *min, *max]);
        cdr.count(ranges_m.len());
        cdr.floats(ranges_m);
        cdr.count(0);
        self.put((topic, time_nanos), SCAN, &cdr.into_bytes())
    }

    /// Adds a point cloud: points in the frame of the sensor, metres.
    ///
    /// # Errors
    /// [`RobotRecordingError`].
    pub fn cloud(
        &mut self,
        (topic, time_nanos): (&str, i64),
        frame: &str,
        points_m: &[[f32; 3]],
    ) -> Result<(), RobotRecordingError> {
        let size = |bytes: usize| u32::try_from(bytes).unwrap_or(u32::MAX).to_le_bytes();
        let mut cdr = Cdr::with_capacity(points_m.len() * POINT_BYTES + 256);
        cdr.time(time_nanos)?;
        cdr.text(frame);
        cdr.number(1_u32.to_le_bytes());
        cdr.number(size(points_m.len()));
        cdr.count(3);
        for (name, offset) in [("x", 0_u32), ("y", 4), ("z", 8)] {
            cdr.text(name);
            cdr.number(offset.to_le_bytes());
            cdr.number([FLOAT32]);
            cdr.number(1_u32.to_le_bytes());
        }
        cdr.number([0]);
        cdr.number(size(POINT_BYTES));
        cdr.number(size(points_m.len() * POINT_BYTES));
        cdr.count(points_m.len() * POINT_BYTES);
        cdr.bytes(points_m.iter().flatten().flat_map(|along| along.to_le_bytes()));
        cdr.number([1]);
        self.put((topic, time_nanos), CLOUD, &cdr.into_bytes())
    }

    /// Adds the state of a door.
    ///
    /// # Errors
    /// [`RobotRecordingError`].
    pub fn door(
        &mut self,
        (topic, time_nanos): (&str, i64),
        name: &str,
        is_open: bool,
    ) -> Result<(), RobotRecordingError> {
        let mut cdr = Cdr::with_capacity(64);
        cdr.time(time_nanos)?;
        cdr.text(name);
        cdr.number(if is_open { OPEN } else { CLOSED }.to_le_bytes());
        self.put((topic, time_nanos), DOOR, &cdr.into_bytes())
    }

    /// Ends the recording.
    ///
    /// # Errors
    /// [`RobotRecordingError::Mcap`].
    pub fn finish(mut self) -> Result<(), RobotRecordingError> {
        self.writer.finish()?;
        Ok(())
    }

    fn put(
        &mut self,
        (topic, time_nanos): (&str, i64),
        type_name: &str,
        bytes: &[u8],
    ) -> Result<(), RobotRecordingError> {
        let time = u64::try_from(time_nanos).map_err(|_| RobotRecordingError::TooEarly(time_nanos))?;
        if !self.channels.contains_key(topic) {
            let definition = ros_types::definition(type_name);
            let full_name = type_name.replace('/', "/msg/");
            let schema = self.writer.add_schema(&full_name, "ros2msg", definition.as_bytes())?;
            let channel = self.writer.add_channel(schema, topic, "cdr", &BTreeMap::new())?;
            self.channels.insert(topic.to_owned(), (channel, 0));
        }
        let Some((channel_id, sequence)) = self.channels.get_mut(topic) else { return Ok(()) };
        let header = MessageHeader { channel_id: *channel_id, sequence: *sequence, log_time: time, publish_time: time };
        self.writer.write_to_known_channel(&header, bytes)?;
        *sequence = sequence.wrapping_add(1);
        Ok(())
    }
}
