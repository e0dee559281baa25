//! Recordings of robots: bags of ROS 1, rosbag2, MCAP.
//!
//! Invariant: bytes in, values out; no file is opened here, and no ROS is needed. Reading never panics, and memory is
//! bounded whatever the bytes say. A recording that is cut off gives what it has, and says so.

mod built_in;
pub mod convert;
pub mod definition;
pub mod frames;
pub mod known;
pub mod layout;
pub mod mapping;
pub mod message;
pub mod plan;
pub mod recording;
pub mod survey;
