//! Scans and clouds of a robot that was written here, in their places.
//!
//! Invariant: what is expected follows from how the messages were written.

mod markers;
mod order;
mod poses;
mod times;

use nalgebra::Point3;

use super::*;
use crate::{
    built_in,
    plan::{Wishes, plan},
    recording::{Encoding, RecordedMessage, Sink as _},
    survey::Survey,
};

const SECOND: i64 = 1_000_000_000;
const SCAN: &str = "sensor_msgs/LaserScan";
const CLOUD: &str = "sensor_msgs/PointCloud2";
const TF: &str = "tf2_msgs/TFMessage";

/// The bytes of a message in plain CDR, aligned as ROS 2 does.
struct Cdr(Vec<u8>);

impl Cdr {
    fn header(stamp_nanos: i64, frame: &str) -> Self {
        Self(vec![0, 1, 0, 0]).stamp(stamp_nanos).text(frame)
    }

    fn aligned(mut self, size: usize) -> Self {
        while !(self.0.len() - 4).is_multiple_of(size) {
            self.0.push(0);
        }
        self
    }

    fn number<const N: usize>(self, bytes: [u8; N]) -> Self {
        let mut cdr = self.aligned(N);
        cdr.0.extend(bytes);
        cdr
    }

    fn u32(self, number: usize) -> Self {
        self.number(u32::try_from(number).unwrap().to_le_bytes())
    }

    fn floats(self, numbers: impl IntoIterator<Item = f32>) -> Self {
        numbers.into_iter().fold(self, |cdr, number| cdr.number(number.to_le_bytes()))
    }

    fn doubles(self, numbers: impl IntoIterator<Item = f64>) -> Self {
        numbers.into_iter().fold(self, |cdr, number| cdr.number(number.to_le_bytes()))
    }

    fn text(self, text: &str) -> Self {
        let mut cdr = self.u32(text.len() + 1);
        cdr.0.extend(text.bytes().chain([0]));
        cdr
    }

    fn stamp(self, nanos: i64) -> Self {
        let part = |part: i64| usize::try_from(part).unwrap();
        self.u32(part(nanos / SECOND)).u32(part(nanos % SECOND))
    }
}

/// A scan all around: the first beam along x, the others evenly after it.
struct ScanText<'a> {
    stamp: i64,
    frame: &'a str,
    increments: [f32; 2],
    limits: [f32; 2],
    ranges: &'a [f32],
}

impl ScanText<'_> {
    fn bytes(&self) -> Vec<u8> {
        let [angle, time] = self.increments;
        let cdr = Cdr::header(self.stamp, self.frame).floats([0.0, 6.0, angle, time, 0.1]);
        cdr.floats(self.limits).u32(self.ranges.len()).floats(self.ranges.iter().copied()).u32(0).0
    }
}

/// A cloud whose points have x, y, z and other fields; a field is its name, its number type and its size.
fn cloud(stamp: i64, frame: &str, fields: &[(&str, u8, usize)], points: &[(&[f32; 3], Vec<u8>)]) -> Vec<u8> {
    let axes = [("x", 7, 4), ("y", 7, 4), ("z", 7, 4)];
    let mut cdr = Cdr::header(stamp, frame).u32(1).u32(points.len()).u32(3 + fields.len());
    let mut offset = 0;
    for (name, kind, size) in axes.iter().chain(fields) {
        cdr = cdr.text(name).u32(offset).number([*kind]).u32(1);
        offset += size;
    }
    let data: Vec<u8> = points
        .iter()
        .flat_map(|(xyz, rest)| xyz.iter().flat_map(|along| along.to_le_bytes()).chain(rest.iter().copied()))
        .collect();
    let mut cdr = cdr.number([0]).u32(offset).u32(data.len()).u32(data.len());
    cdr.0.extend(data);
    cdr.number([1]).0
}

/// A transform from its parent: x, y and the angle in the plane.
fn transform(stamp: i64, (parent, child): (&str, &str), [x, y, yaw]: [f64; 3]) -> Vec<u8> {
    let cdr = Cdr(vec![0, 1, 0, 0]).u32(1).stamp(stamp).text(parent).text(child);
    cdr.doubles([x, y, 0.0, 0.0, 0.0, (yaw / 2.0).sin(), (yaw / 2.0).cos()]).0
}

/// A recording: topic, type, time of recording, bytes.
type Recorded = Vec<(&'static str, &'static str, i64, Vec<u8>)>;

struct Converted {
    made: Vec<Result<Item, NotMade>>,
    converter: Converter,
}

fn topics(recorded: &Recorded) -> Vec<Topic> {
    let mut topics: Vec<Topic> = Vec::new();
    for (name, type_name, ..) in recorded {
        assert!(built_in::definition(type_name).is_some(), "{type_name} has a definition");
        if !topics.iter().any(|topic| topic.name == *name) {
            topics.push(Topic {
                name: (*name).to_owned(),
                type_name: (*type_name).to_owned(),
                encoding: Encoding::Cdr,
                definition: String::new(),
                is_latched: false,
            });
        }
    }
    topics
}

/// Surveys, plans and converts a recording, as an import does.
fn converted(recorded: &Recorded, wishes: &Wishes, options: ConvertOptions) -> Converted {
    let topics = topics(recorded);
    let index = |name: &str| topics.iter().position(|topic| topic.name == name).unwrap();
    let mut survey = Survey::default();
    if let Some(source) = wishes.pose_source() {
        survey.take_poses(source.clone());
    }
    for topic in &topics {
        survey.topic(topic);
    }
    for (position, (name, _, recorded_nanos, data)) in (0..).zip(recorded) {
        let message = RecordedMessage { topic: index(name), recorded_nanos: *recorded_nanos, data };
        survey.message(message, position).unwrap();
    }
    let surveyed = Arc::new(survey.finish());
    let plan = plan(&surveyed, wishes).unwrap_or_else(|error| panic!("{error}"));
    let mut converter = Converter::new(surveyed, Arc::new(plan), options);
    let wanted: Vec<bool> = topics.iter().map(|topic| converter.topic(topic)).collect();
    let mut made = Vec::new();
    for (name, _, recorded_nanos, data) in recorded {
        if wanted[index(name)] {
            made.extend(converter.convert(index(name), *recorded_nanos, data));
        }
    }
    Converted { made, converter }
}

fn usual(recorded: &Recorded) -> Converted {
    converted(recorded, &Wishes::default(), ConvertOptions::default())
}

/// Where the beams of a scan or cloud have ended, in the frame of the plan.
fn ends(item: &Result<Item, NotMade>) -> Vec<Point3<f64>> {
    match &item.as_ref().unwrap().made {
        Made::Scan(scan) => (0..)
            .zip(&scan.ranges_m)
            .filter(|(_, range)| range.is_finite())
            .map(|(ray, range)| {
                let angle = scan.angle_min_rad + f64::from(ray) * scan.angle_increment_rad;
                scan.pose * (Point3::new(angle.cos(), angle.sin(), 0.0) * f64::from(*range))
            })
            .collect(),
        Made::Cloud(cloud) => {
            cloud.points_m.iter().map(|point| cloud.pose * Point3::from(point.map(f64::from))).collect()
        }
        made => panic!("{made:?}"),
    }
}
