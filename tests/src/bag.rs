//! Writes recordings: bags of ROS 1 with the messages of a simulated robot.
//!
//! Invariant: the bytes follow the published format 2.0, without chunks, written here apart from what reads them.

use std::{fs, path::Path};

const HEADER: &str = "uint32 seq\ntime stamp\nstring frame_id";
const SEPARATOR: &str = "\n================================================================================\nMSG: ";

/// A bag in memory.
#[derive(Debug)]
pub struct Bag {
    bytes: Vec<u8>,
    topics: Vec<String>,
}

impl Default for Bag {
    fn default() -> Self {
        let mut bytes = b"#ROSBAG V2.0\n".to_vec();
        let fields =
            [("op", vec![3]), ("index_pos", vec![0; 8]), ("conn_count", vec![0; 4]), ("chunk_count", vec![0; 4])];
        record(&mut bytes, &fields, &[b' '; 4027]);
        Self { bytes, topics: Vec::new() }
    }
}

fn field(name: &str, value: &[u8]) -> Vec<u8> {
    let mut field = u32::try_from(name.len() + 1 + value.len()).expect("a short field").to_le_bytes().to_vec();
    field.extend(name.as_bytes());
    field.push(b'=');
    field.extend(value);
    field
}

fn record(bytes: &mut Vec<u8>, fields: &[(&str, Vec<u8>)], data: &[u8]) {
    let header: Vec<u8> = fields.iter().flat_map(|(name, value)| field(name, value)).collect();
    bytes.extend(u32::try_from(header.len()).expect("a short header").to_le_bytes());
    bytes.extend(header);
    bytes.extend(u32::try_from(data.len()).expect("a short record").to_le_bytes());
    bytes.extend(data);
}

/// A time as ROS 1 has it, from nanoseconds since 1970.
#[must_use]
pub fn time(nanos: i64) -> [u8; 8] {
    let part = |part: i64| u32::try_from(part).expect("a time that ROS 1 has").to_le_bytes();
    [part(nanos / 1_000_000_000), part(nanos % 1_000_000_000)].concat().try_into().expect("eight bytes")
}

/// A text as ROS 1 has it.
#[must_use]
pub fn text(text: &str) -> Vec<u8> {
    [&u32::try_from(text.len()).expect("a short text").to_le_bytes()[..], text.as_bytes()].concat()
}

/// The header of a message.
#[must_use]
pub fn header(nanos: i64, frame: &str) -> Vec<u8> {
    [&[0; 4][..], &time(nanos), &text(frame)].concat()
}

impl Bag {
    /// Writes a message of any type. All messages of a topic have the same definition.
    pub fn message(&mut self, topic: &str, (type_name, definition): (&str, &str), nanos: i64, data: &[u8]) {
        let index = self.topics.iter().position(|known| known == topic).unwrap_or_else(|| {
            self.topics.push(topic.to_owned());
            let number = u32::try_from(self.topics.len() - 1).expect("few topics").to_le_bytes();
            let connection = [
                ("topic", topic.as_bytes().to_vec()),
                ("type", type_name.as_bytes().to_vec()),
                ("md5sum", b"*".to_vec()),
                ("message_definition", definition.as_bytes().to_vec()),
            ];
            let data: Vec<u8> = connection.iter().flat_map(|(name, value)| field(name, value)).collect();
            let fields = [("op", vec![7]), ("conn", number.to_vec()), ("topic", topic.as_bytes().to_vec())];
            record(&mut self.bytes, &fields, &data);
            self.topics.len() - 1
        });
        let number = u32::try_from(index).expect("few topics").to_le_bytes().to_vec();
        record(&mut self.bytes, &[("op", vec![2]), ("conn", number), ("time", time(nanos).to_vec())], data);
    }

    /// Writes a `std_msgs/Bool`.
    pub fn bool(&mut self, topic: &str, nanos: i64, value: bool) {
        self.message(topic, ("std_msgs/Bool", "bool data"), nanos, &[u8::from(value)]);
    }

    /// Writes a `std_msgs/Float64`.
    pub fn float(&mut self, topic: &str, nanos: i64, value: f64) {
        self.message(topic, ("std_msgs/Float64", "float64 data"), nanos, &value.to_le_bytes());
    }

    /// Writes a `std_msgs/String`.
    pub fn text(&mut self, topic: &str, nanos: i64, value: &str) {
        self.message(topic, ("std_msgs/String", "string data"), nanos, &text(value));
    }

    /// Writes one transform: position in metres and turn about z in radians.
    pub fn transform(&mut self, topic: &str, nanos: i64, (parent, child): (&str, &str), [x, y, yaw]: [f64; 3]) {
        let definition = [
            "geometry_msgs/TransformStamped[] transforms",
            "geometry_msgs/TransformStamped\nHeader header\nstring child_frame_id\nTransform transform",
            &format!("std_msgs/Header\n{HEADER}"),
            "geometry_msgs/Transform\nVector3 translation\nQuaternion rotation",
            "geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z",
            "geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w",
        ];
        let numbers = [x, y, 0.0, 0.0, 0.0, (yaw / 2.0).sin(), (yaw / 2.0).cos()];
        let mut data = 1_u32.to_le_bytes().to_vec();
        data.extend(header(nanos, parent));
        data.extend(text(child));
        data.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
        self.message(topic, ("tf2_msgs/TFMessage", &definition.join(SEPARATOR)), nanos, &data);
    }

    /// Writes a `sensor_msgs/LaserScan` all around, with ranges from 0.1 to 30 m.
    pub fn scan(&mut self, topic: &str, nanos: i64, frame: &str, ranges_m: &[f32]) {
        let definition = "Header header\nfloat32 angle_min\nfloat32 angle_max\nfloat32 angle_increment\n\
                          float32 time_increment\nfloat32 scan_time\nfloat32 range_min\nfloat32 range_max\n\
                          float32[] ranges\nfloat32[] intensities";
        let turn = std::f32::consts::TAU;
        let numbers = [0.0, turn, turn / ranges_m.len() as f32, 0.0, 0.0, 0.1, 30.0];
        let mut data = header(nanos, frame);
        data.extend(numbers.iter().flat_map(|number: &f32| number.to_le_bytes()));
        data.extend(u32::try_from(ranges_m.len()).expect("few rays").to_le_bytes());
        data.extend(ranges_m.iter().flat_map(|range| range.to_le_bytes()));
        data.extend([0; 4]);
        let definition = format!("{definition}{SEPARATOR}std_msgs/Header\n{HEADER}");
        self.message(topic, ("sensor_msgs/LaserScan", &definition), nanos, &data);
    }

    /// Number of bytes so far.
    #[must_use]
    pub fn len(&self) -> usize {
        self.bytes.len()
    }

    /// Whether the bag has no bytes: it always has its first ones.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Writes the first bytes of the bag to a file.
    ///
    /// # Panics
    /// If the file cannot be written.
    pub fn write(&self, path: &Path, bytes: usize) {
        fs::write(path, &self.bytes[..bytes.min(self.bytes.len())]).expect("a bag");
    }
}
