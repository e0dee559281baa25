//! Definitions of the usual types, for recordings that hold none, such as recordings of rosbag2 before 2023.
//!
//! Invariant: the fields are the fields of the published types, in order. A type that changed between versions of ROS
//! is not here: its bytes could not be read with certainty.

use crate::definition::{self, Definition};

/// Type and fields, one line each; fields are separated by commas.
const TYPES: &[(&str, &str)] = &[
    ("builtin_interfaces/Time", "int32 sec, uint32 nanosec"),
    ("builtin_interfaces/Duration", "int32 sec, uint32 nanosec"),
    ("std_msgs/Header", "builtin_interfaces/Time stamp, string frame_id"),
    ("std_msgs/Empty", ""),
    ("std_msgs/Bool", "bool data"),
    ("std_msgs/Byte", "byte data"),
    ("std_msgs/Char", "char data"),
    ("std_msgs/Float32", "float32 data"),
    ("std_msgs/Float64", "float64 data"),
    ("std_msgs/Int8", "int8 data"),
    ("std_msgs/Int16", "int16 data"),
    ("std_msgs/Int32", "int32 data"),
    ("std_msgs/Int64", "int64 data"),
    ("std_msgs/UInt8", "uint8 data"),
    ("std_msgs/UInt16", "uint16 data"),
    ("std_msgs/UInt32", "uint32 data"),
    ("std_msgs/UInt64", "uint64 data"),
    ("std_msgs/String", "string data"),
    ("std_msgs/ColorRGBA", "float32 r, float32 g, float32 b, float32 a"),
    ("geometry_msgs/Point", "float64 x, float64 y, float64 z"),
    ("geometry_msgs/Point32", "float32 x, float32 y, float32 z"),
    ("geometry_msgs/PointStamped", "std_msgs/Header header, Point point"),
    ("geometry_msgs/Vector3", "float64 x, float64 y, float64 z"),
    ("geometry_msgs/Quaternion", "float64 x, float64 y, float64 z, float64 w"),
    ("geometry_msgs/Pose", "Point position, Quaternion orientation"),
    ("geometry_msgs/Pose2D", "float64 x, float64 y, float64 theta"),
    ("geometry_msgs/PoseArray", "std_msgs/Header header, Pose[] poses"),
    ("geometry_msgs/PoseStamped", "std_msgs/Header header, Pose pose"),
    ("geometry_msgs/PoseWithCovariance", "Pose pose, float64[36] covariance"),
    ("geometry_msgs/PoseWithCovarianceStamped", "std_msgs/Header header, PoseWithCovariance pose"),
    ("geometry_msgs/Transform", "Vector3 translation, Quaternion rotation"),
    ("geometry_msgs/TransformStamped", "std_msgs/Header header, string child_frame_id, Transform transform"),
    ("geometry_msgs/Twist", "Vector3 linear, Vector3 angular"),
    ("geometry_msgs/TwistStamped", "std_msgs/Header header, Twist twist"),
    ("geometry_msgs/TwistWithCovariance", "Twist twist, float64[36] covariance"),
    ("tf2_msgs/TFMessage", "geometry_msgs/TransformStamped[] transforms"),
    ("tf/tfMessage", "geometry_msgs/TransformStamped[] transforms"),
    (
        "sensor_msgs/LaserScan",
        "std_msgs/Header header, float32 angle_min, float32 angle_max, float32 angle_increment, \
         float32 time_increment, float32 scan_time, float32 range_min, float32 range_max, float32[] ranges, \
         float32[] intensities",
    ),
    ("sensor_msgs/PointField", "string name, uint32 offset, uint8 datatype, uint32 count"),
    (
        "sensor_msgs/PointCloud2",
        "std_msgs/Header header, uint32 height, uint32 width, PointField[] fields, bool is_bigendian, \
         uint32 point_step, uint32 row_step, uint8[] data, bool is_dense",
    ),
    ("sensor_msgs/Temperature", "std_msgs/Header header, float64 temperature, float64 variance"),
    ("sensor_msgs/RelativeHumidity", "std_msgs/Header header, float64 relative_humidity, float64 variance"),
    ("sensor_msgs/Illuminance", "std_msgs/Header header, float64 illuminance, float64 variance"),
    ("sensor_msgs/FluidPressure", "std_msgs/Header header, float64 fluid_pressure, float64 variance"),
    (
        "nav_msgs/MapMetaData",
        "builtin_interfaces/Time map_load_time, float32 resolution, uint32 width, uint32 height, \
         geometry_msgs/Pose origin",
    ),
    ("nav_msgs/OccupancyGrid", "std_msgs/Header header, MapMetaData info, int8[] data"),
    (
        "nav_msgs/Odometry",
        "std_msgs/Header header, string child_frame_id, geometry_msgs/PoseWithCovariance pose, \
         geometry_msgs/TwistWithCovariance twist",
    ),
    ("nav_msgs/Path", "std_msgs/Header header, geometry_msgs/PoseStamped[] poses"),
    (
        "map_msgs/OccupancyGridUpdate",
        "std_msgs/Header header, int32 x, int32 y, uint32 width, uint32 height, int8[] data",
    ),
    (
        "rmf_door_msgs/DoorMode",
        "uint32 MODE_CLOSED=0, uint32 MODE_MOVING=1, uint32 MODE_OPEN=2, uint32 MODE_OFFLINE=3, \
         uint32 MODE_UNKNOWN=4, uint32 value",
    ),
    ("rmf_door_msgs/DoorState", "builtin_interfaces/Time door_time, string door_name, DoorMode current_mode"),
    (
        "people_msgs/Person",
        "string name, geometry_msgs/Point position, geometry_msgs/Point velocity, float64 reliability, \
         string[] tagnames, string[] tags",
    ),
    ("people_msgs/People", "std_msgs/Header header, Person[] people"),
    (
        "people_msgs/PositionMeasurement",
        "std_msgs/Header header, string name, string object_id, geometry_msgs/Point pos, float64 reliability, \
         float64[9] covariance, byte initialization",
    ),
    (
        "people_msgs/PositionMeasurementArray",
        "std_msgs/Header header, PositionMeasurement[] people, float32[] cooccurrence",
    ),
];

/// The definition of a type by its short name.
pub(crate) fn definition(name: &str) -> Option<Definition> {
    let (name, fields) = TYPES.iter().find(|(known, _)| *known == name)?;
    let text: Vec<&str> = fields.split(',').map(str::trim).collect();
    definition::parse(name, &text.join("\n")).ok()?.remove(*name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{layout, recording::Encoding};

    #[test]
    fn every_known_type_has_a_layout() {
        for (name, fields) in TYPES {
            let layout = layout::of_type(name, "", &Encoding::Cdr);
            let count =
                if fields.is_empty() { 0 } else { fields.split(',').filter(|field| !field.contains('=')).count() };
            assert_eq!(layout.map(|layout| layout.fields.len()), Ok(count), "{name}");
        }
    }
}
