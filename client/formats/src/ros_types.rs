//! The definitions of the messages of ROS 2 that recordings have, in the language of `.msg` files.
//!
//! Invariant: fields have the names, types and order of ROS 2; otherwise readers take the bytes for other values.

/// Line between a definition and the definition of a type inside.
const SEPARATOR: &str = "================================================================================\n";

/// Name and fields of each type.
const TYPES: &[(&str, &str)] = &[
    ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n"),
    ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n"),
    ("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n"),
    ("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n"),
    ("geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"),
    ("geometry_msgs/Pose", "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"),
    ("geometry_msgs/Transform", "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"),
    (
        "geometry_msgs/TransformStamped",
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n",
    ),
    ("tf2_msgs/TFMessage", "geometry_msgs/TransformStamped[] transforms\n"),
    (
        "sensor_msgs/LaserScan",
        "std_msgs/Header header\nfloat32 angle_min\nfloat32 angle_max\nfloat32 angle_increment\n\
         float32 time_increment\nfloat32 scan_time\nfloat32 range_min\nfloat32 range_max\nfloat32[] ranges\n\
         float32[] intensities\n",
    ),
    (
        "sensor_msgs/PointField",
        "uint8 INT8=1\nuint8 UINT8=2\nuint8 INT16=3\nuint8 UINT16=4\nuint8 INT32=5\nuint8 UINT32=6\nuint8 FLOAT32=7\n\
         uint8 FLOAT64=8\nstring name\nuint32 offset\nuint8 datatype\nuint32 count\n",
    ),
    (
        "sensor_msgs/PointCloud2",
        "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\nbool is_bigendian\n\
         uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n",
    ),
    (
        "nav_msgs/MapMetaData",
        "builtin_interfaces/Time map_load_time\nfloat32 resolution\nuint32 width\nuint32 height\n\
         geometry_msgs/Pose origin\n",
    ),
    (
        "nav_msgs/OccupancyGrid",
        "std_msgs/Header header\nnav_msgs/MapMetaData info\n# Rows from the cell at the origin on, along x first. Percent \
         of the probability that a cell is occupied; -1: unknown.\nint8[] data\n",
    ),
    (
        "rmf_door_msgs/DoorMode",
        "uint32 MODE_CLOSED=0\nuint32 MODE_MOVING=1\nuint32 MODE_OPEN=2\nuint32 MODE_OFFLINE=3\n\
         uint32 MODE_UNKNOWN=4\nuint32 value\n",
    ),
    (
        "rmf_door_msgs/DoorState",
        "builtin_interfaces/Time door_time\nstring door_name\nrmf_door_msgs/DoorMode current_mode\n",
    ),
];

/// The definition of a type, with the definitions of all types inside; empty for a type that is not known.
pub(crate) fn definition(name: &str) -> String {
    let mut names = vec![name];
    let mut text = String::new();
    let mut next = 0;
    while let Some(&name) = names.get(next) {
        let Some((_, fields)) = TYPES.iter().find(|(known, _)| *known == name) else { break };
        if next > 0 {
            text += SEPARATOR;
            text += &format!("MSG: {name}\n");
        }
        text += fields;
        for line in fields.lines() {
            let inner = line.split([' ', '[']).next().unwrap_or_default();
            if inner.contains('/') && !names.contains(&inner) {
                names.push(inner);
            }
        }
        next += 1;
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_definition_has_those_of_all_types_inside_once() {
        for (name, _) in TYPES {
            let text = definition(name);
            for line in text.lines().filter(|line| !line.starts_with("MSG:") && !line.starts_with('#')) {
                let inner = line.split([' ', '[']).next().unwrap_or_default();
                if inner.contains('/') {
                    assert_eq!(text.matches(&format!("MSG: {inner}\n")).count(), 1, "{name}: {inner}");
                }
            }
        }
    }
}
