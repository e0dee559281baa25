//! Recordings of robots: bags of ROS 1, rosbag2, MCAP.
//!
//! Invariant: bytes in, values out; no file is opened here, and no ROS is needed. Reading never panics, and memory is
//! bounded whatever the bytes say. A recording that is cut off gives what it has, and says so.

#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod bag;
mod chunk;
pub mod folder;
pub mod kind;
pub mod mcap_file;
pub mod recording;
pub mod rosbag2;
mod source;
mod sqlite;
#[cfg(test)]
mod testing;
mod topics;
pub mod zstd_stream;
