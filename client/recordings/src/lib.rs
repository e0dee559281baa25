//! Recordings of robots: bags of ROS 1, rosbag2, MCAP.
//!
//! Invariant: bytes in, values out; no file is opened here, and no ROS is needed. Reading never panics, and memory is
//! bounded whatever the bytes contain. A recording that is cut off gives the messages that it has, and reports the cut.

#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod bag;
mod built_in;
mod chunk;
pub mod convert;
pub mod definition;
pub mod folder;
mod foreign;
pub mod frames;
pub mod kind;
pub mod known;
pub mod layout;
pub mod mapping;
pub mod mcap_file;
pub mod message;
pub mod plan;
pub mod recording;
pub mod rosbag2;
mod source;
mod sqlite;
pub mod survey;
#[cfg(test)]
mod testing;
mod topics;
pub mod zstd_stream;
