//! Messages of the usual types of ROS: scans, clouds, grids, transforms, poses.
//!
//! Invariant: lengths within a message are checked against each other; the returned data can be read without a check.

mod cloud;
mod grid;

use nalgebra::Isometry3;

pub use self::{
    cloud::{Cloud, PointTimes},
    grid::{Grid, GridUpdate},
};

use crate::{
    frames::{self, FRAME_BYTES_MAX, Transform, frame_name},
    message::{Numbers, Value},
};

/// Why a message of a usual type is not used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum KnownError {
    /// A field is missing, or of another type.
    #[error("{type_name} has no field {field:?} of the usual type")]
    Field {
        /// Name of the type.
        type_name: &'static str,
        /// Path of the field.
        field: String,
    },
    /// Values that do not fit together, or that cannot be used.
    #[error("{0}")]
    Values(String),
}

/// Reads fields of a message of one type.
struct Fields<'m, 'a> {
    type_name: &'static str,
    message: &'m Value<'a>,
}

impl<'m, 'a> Fields<'m, 'a> {
    fn value(&self, path: &[&str]) -> Result<&'m Value<'a>, KnownError> {
        self.message.at(path).ok_or_else(|| self.missing(path))
    }

    fn missing(&self, path: &[&str]) -> KnownError {
        KnownError::Field { type_name: self.type_name, field: path.join(".") }
    }

    fn number(&self, path: &[&str]) -> Result<f64, KnownError> {
        self.value(path)?.number().ok_or_else(|| self.missing(path))
    }

    fn size(&self, path: &[&str]) -> Result<usize, KnownError> {
        let integer = self.value(path)?.integer().ok_or_else(|| self.missing(path))?;
        usize::try_from(integer).map_err(|_| KnownError::Values(format!("{} is {integer}", path.join("."))))
    }

    fn text(&self, path: &[&str]) -> Result<String, KnownError> {
        self.value(path)?.text().ok_or_else(|| self.missing(path))
    }

    fn numbers(&self, path: &[&str]) -> Result<Numbers<'a>, KnownError> {
        self.value(path)?.numbers().ok_or_else(|| self.missing(path))
    }

    fn pose(&self, path: &[&str], position: &str, orientation: &str) -> Result<Isometry3<f64>, KnownError> {
        let part = |name: &str, axis: &str| {
            let full: Vec<&str> = path.iter().copied().chain([name, axis]).collect();
            self.number(&full)
        };
        let xyz = [part(position, "x")?, part(position, "y")?, part(position, "z")?];
        let quaternion =
            [part(orientation, "x")?, part(orientation, "y")?, part(orientation, "z")?, part(orientation, "w")?];
        frames::pose(xyz, quaternion).ok_or_else(|| {
            let name = if path.is_empty() { "the pose".to_owned() } else { path.join(".") };
            KnownError::Values(format!("{name} is no pose: position {xyz:?}, quaternion {quaternion:?}"))
        })
    }
}

/// The time for which a message holds: the time of its header, or another first field that is a time. Nanoseconds since
/// 1970; `None` if it has none.
pub fn stamp(message: &Value<'_>) -> Option<i64> {
    ["header", "door_time", "stamp", "timestamp"].iter().find_map(|name| {
        let field = message.field(name)?;
        field.field("stamp").unwrap_or(field).time_nanos()
    })
}

/// The frame in which a message was measured, without a leading slash; empty if the message names no frame, or a name
/// that is too long.
pub fn frame(message: &Value<'_>) -> String {
    // The types of Foxglove have no header.
    match message.at(&["header", "frame_id"]).or_else(|| message.field("frame_id")) {
        Some(Value::Text(bytes)) if bytes.len() <= FRAME_BYTES_MAX => {
            frame_name(&String::from_utf8_lossy(bytes)).to_owned()
        }
        _ => String::new(),
    }
}

/// The name of a type of Foxglove, such as `LaserScan`, however a recording writes it.
pub fn foxglove_type(type_name: &str) -> Option<&str> {
    type_name.strip_prefix("foxglove.").or_else(|| type_name.strip_prefix("foxglove_msgs/"))
}

/// Whether the messages of a type are scans.
pub fn is_scan(type_name: &str) -> bool {
    type_name == "sensor_msgs/LaserScan" || foxglove_type(type_name) == Some("LaserScan")
}

/// Whether the messages of a type are point clouds.
pub fn is_cloud(type_name: &str) -> bool {
    type_name == "sensor_msgs/PointCloud2" || foxglove_type(type_name) == Some("PointCloud")
}

/// The pose of a sensor within the frame of its message; types of Foxglove have one.
fn own_pose(fields: &Fields<'_, '_>) -> Result<Isometry3<f64>, KnownError> {
    match fields.message.field("pose") {
        None => Ok(Isometry3::identity()),
        Some(pose) => foxglove_pose(fields, pose, ["position", "orientation"]),
    }
}

/// A pose of Foxglove. Protobuf leaves out numbers that are 0, and with them a rotation that nobody has set.
fn foxglove_pose(
    fields: &Fields<'_, '_>,
    message: &Value<'_>,
    [position, orientation]: [&str; 2],
) -> Result<Isometry3<f64>, KnownError> {
    let part = |name: &str, axis: &str| message.at(&[name, axis]).and_then(Value::number).filter(|part| !part.is_nan());
    let xyz = ["x", "y", "z"].map(|axis| part(position, axis).unwrap_or(0.0));
    let mut quaternion = ["x", "y", "z", "w"].map(|axis| part(orientation, axis).unwrap_or(0.0));
    if quaternion == [0.0; 4] {
        quaternion = [0.0, 0.0, 0.0, 1.0];
    }
    frames::pose(xyz, quaternion).ok_or_else(|| {
        let type_name = fields.type_name;
        KnownError::Values(format!("{type_name} has no pose: position {xyz:?}, quaternion {quaternion:?}"))
    })
}

/// A scan of a planar range finder, `sensor_msgs/LaserScan`, or that of Foxglove.
#[derive(Clone, Debug, PartialEq)]
pub struct LaserScan<'a> {
    /// Angle of the first ray from the x axis of the sensor, radians.
    pub angle_min_rad: f64,
    /// Angle between rays, radians.
    pub angle_increment_rad: f64,
    /// Time between rays, seconds; 0 if the driver gives none. The first ray has the time of the header.
    pub time_increment_secs: f64,
    /// Smallest valid range, metres.
    pub range_min_m: f64,
    /// Largest valid range, metres.
    pub range_max_m: f64,
    /// Pose of the sensor within the frame of the message.
    pub pose: Isometry3<f64>,
    ranges: Numbers<'a>,
}

impl<'a> LaserScan<'a> {
    /// Reads a message.
    ///
    /// # Errors
    /// A field is missing, or an angle or a limit is not finite.
    pub fn read(message: &Value<'a>) -> Result<Self, KnownError> {
        if message.field("start_angle").is_some() {
            return Self::read_foxglove(message);
        }
        let fields = Fields { type_name: "sensor_msgs/LaserScan", message };
        let scan = Self {
            pose: Isometry3::identity(),
            angle_min_rad: fields.number(&["angle_min"])?,
            angle_increment_rad: fields.number(&["angle_increment"])?,
            time_increment_secs: fields.number(&["time_increment"]).unwrap_or(0.0),
            range_min_m: fields.number(&["range_min"])?,
            range_max_m: fields.number(&["range_max"])?,
            ranges: fields.numbers(&["ranges"])?,
        };
        let Self { angle_min_rad, angle_increment_rad, range_min_m, range_max_m, .. } = scan;
        if ![angle_min_rad, angle_increment_rad, range_min_m].iter().all(|number| number.is_finite())
            || range_max_m.is_nan()
            || range_max_m <= 0.0
        {
            return Err(KnownError::Values(format!(
                "a scan from {angle_min_rad} rad in steps of {angle_increment_rad} rad, with ranges from {range_min_m} m \
                 to {range_max_m} m"
            )));
        }
        Ok(scan)
    }

    /// Reads a scan of Foxglove, which states the angles of its first and last ray and no limits of its ranges.
    fn read_foxglove(message: &Value<'a>) -> Result<Self, KnownError> {
        let fields = Fields { type_name: "foxglove.LaserScan", message };
        let ranges = fields.numbers(&["ranges"])?;
        let (first, last) = (fields.number(&["start_angle"])?, fields.number(&["end_angle"])?);
        if !first.is_finite() || !last.is_finite() {
            return Err(KnownError::Values(format!("a scan from {first} rad to {last} rad")));
        }
        Ok(Self {
            angle_min_rad: first,
            angle_increment_rad: (last - first) / ranges.len().saturating_sub(1).max(1) as f64,
            time_increment_secs: 0.0,
            range_min_m: 0.0,
            range_max_m: f64::INFINITY,
            pose: own_pose(&fields)?,
            ranges,
        })
    }

    /// The ranges as they are, metres.
    pub fn ranges_m(&self) -> impl Iterator<Item = f64> + 'a {
        self.ranges.floats()
    }

    /// The number of rays.
    pub fn rays(&self) -> usize {
        self.ranges.len()
    }

    /// The measurement of a beam with this range. Drivers mark a beam without a return by infinity, by the largest
    /// valid range or more, by NaN, by 0 or less, or by a range below the smallest valid one.
    pub fn beam(&self, range_m: f64) -> Beam {
        if range_m.is_nan() || range_m <= 0.0 || range_m < self.range_min_m {
            Beam::NoReading
        } else if range_m >= self.range_max_m || range_m == f64::INFINITY {
            Beam::NoReturn
        } else {
            Beam::Hit
        }
    }
}

/// The measurement of a beam of a range finder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Beam {
    /// Something at its range.
    Hit,
    /// Nothing came back from within the sensor's range.
    NoReturn,
    /// Nothing that means anything: the sensor gives no range, or one too near.
    NoReading,
}

/// A transform that a message holds, or why it is not used.
pub type TransformRead = Result<Transform, KnownError>;

/// The transforms of `tf2_msgs/TFMessage`, or `tf/tfMessage` of ROS 1.
///
/// # Errors
/// There is no list of transforms.
pub fn transforms(message: &Value<'_>) -> Result<Vec<TransformRead>, KnownError> {
    if message.field("parent_frame_id").is_some() {
        return Ok(vec![foxglove_transform(message)]);
    }
    let fields = Fields { type_name: "tf2_msgs/TFMessage", message };
    let list = fields.value(&["transforms"])?.list().ok_or_else(|| fields.missing(&["transforms"]))?;
    let read = |message| {
        if Value::field(message, "parent_frame_id").is_some() {
            foxglove_transform(message)
        } else {
            transform(message)
        }
    };
    Ok(list.iter().map(read).collect())
}

fn foxglove_transform(message: &Value<'_>) -> TransformRead {
    let fields = Fields { type_name: "foxglove.FrameTransform", message };
    let time_nanos = stamp(message).ok_or_else(|| fields.missing(&["timestamp"]))?;
    let name = |field: &str| fields.text(&[field]).map(|name| frame_name(&name).to_owned());
    let (parent, child) = (name("parent_frame_id")?, name("child_frame_id")?);
    checked_names(&parent, &child)?;
    let pose = foxglove_pose(&fields, message, ["translation", "rotation"])?;
    Ok(Transform { parent, child, time_nanos, pose })
}

fn checked_names(parent: &str, child: &str) -> Result<(), KnownError> {
    if child.is_empty() || parent.is_empty() || child == parent || child.len().max(parent.len()) > FRAME_BYTES_MAX {
        return Err(KnownError::Values("a transform without the names of two frames".to_owned()));
    }
    Ok(())
}

fn transform(message: &Value<'_>) -> TransformRead {
    let fields = Fields { type_name: "geometry_msgs/TransformStamped", message };
    let time_nanos = stamp(message).ok_or_else(|| fields.missing(&["header", "stamp"]))?;
    let child = frame_name(&fields.text(&["child_frame_id"])?).to_owned();
    let parent = frame(message);
    checked_names(&parent, &child)?;
    let pose = fields.pose(&["transform"], "translation", "rotation")?;
    Ok(Transform { parent, child, time_nanos, pose })
}

/// Types whose messages are poses of a robot at a time within a frame.
pub const POSE_TYPES: [&str; 5] = [
    "nav_msgs/Odometry",
    "geometry_msgs/PoseStamped",
    "geometry_msgs/PoseWithCovarianceStamped",
    "foxglove.PoseInFrame",
    "foxglove_msgs/PoseInFrame",
];

/// The transform that a pose of a robot is, if it is of one of [`POSE_TYPES`]. Its child is empty if the message names
/// none, its time 0 if the message has none.
///
/// # Errors
/// The message names no frame, or the pose is not finite.
pub fn pose_transform(message: &Value<'_>, type_name: &'static str) -> TransformRead {
    let fields = Fields { type_name, message };
    let parent = frame(message);
    if parent.is_empty() {
        return Err(KnownError::Values("the pose names no frame in its header".to_owned()));
    }
    let child = message.field("child_frame_id").and_then(Value::text).unwrap_or_default();
    let child = frame_name(&child).to_owned();
    if child == parent || child.len() > FRAME_BYTES_MAX {
        return Err(KnownError::Values(format!("the pose of {parent:?} is given in {parent:?} itself")));
    }
    let pose = match foxglove_type(type_name) {
        Some(_) => own_pose(&fields)?,
        None => fields.pose(pose_path(type_name).unwrap_or_default(), "position", "orientation")?,
    };
    Ok(Transform { parent, child, time_nanos: stamp(message).unwrap_or(0), pose })
}

/// The path to the pose in a message of one of the usual types with one pose.
pub fn pose_path(type_name: &str) -> Option<&'static [&'static str]> {
    Some(match type_name {
        "geometry_msgs/Pose" => &[],
        "geometry_msgs/PoseStamped" | "foxglove.PoseInFrame" | "foxglove_msgs/PoseInFrame" => &["pose"],
        "geometry_msgs/PoseWithCovariance" => &["pose"],
        "geometry_msgs/PoseWithCovarianceStamped" | "nav_msgs/Odometry" => &["pose", "pose"],
        _ => return None,
    })
}

/// The position of a pose, metres.
///
/// # Errors
/// A field is missing, or a number is not finite.
pub fn position(message: &Value<'_>, path: &[&str]) -> Result<[f64; 3], KnownError> {
    let fields = Fields { type_name: "geometry_msgs/Point", message };
    let part = |axis: &'static str| {
        let full: Vec<&str> = path.iter().copied().chain([axis]).collect();
        fields.number(&full)
    };
    let xyz = [part("x")?, part("y")?, part("z")?];
    if xyz.iter().all(|number| number.is_finite()) {
        Ok(xyz)
    } else {
        Err(KnownError::Values(format!("position {xyz:?} is not finite")))
    }
}
