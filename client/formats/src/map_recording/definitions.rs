//! The definitions of the messages of ROS 2 that a recording has, in the language of `.msg` files.
//!
//! Invariant: fields have the names, types and order of ROS 2; otherwise readers take the bytes for other values.

/// The type `nav_msgs/msg/OccupancyGrid` and all types inside.
pub(super) const OCCUPANCY_GRID: &str = "\
std_msgs/Header header
nav_msgs/MapMetaData info
# Rows from the cell at the origin on, along x first. Percent of the probability that a cell is occupied; -1: unknown.
int8[] data
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: nav_msgs/MapMetaData
builtin_interfaces/Time map_load_time
float32 resolution
uint32 width
uint32 height
geometry_msgs/Pose origin
================================================================================
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
";
