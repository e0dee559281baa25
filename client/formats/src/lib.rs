//! Readers and writers of files: maps, scans, observations and topologies; tables and pictures of results.
//!
//! Invariant: bytes in, values out, or the reverse; no file is opened here. Reading never panics, and never allocates
//! memory for a number in a file before that number was checked against the file's length. A truncated file is an
//! error, never a smaller map. Numbers in error messages count as the file does: lines from 1, bytes from 0.

pub mod cdr;
pub mod cells_csv;
#[cfg(test)]
mod cuts;
pub mod drawing;
mod error;
pub mod grid_text;
pub mod map_recording;
pub mod nav2;
pub mod observation_file;
pub mod octomap;
pub mod pattern;
pub mod pcd;
mod picture;
pub mod ply;
pub mod png;
mod points;
pub mod robot_recording;
mod ros_types;
pub mod route_graph;
mod scalar;
pub mod svg;
pub mod table;
mod text;
pub mod topology;
pub mod topology_svg;
pub mod tour_svg;

pub use picture::{MapPicture, PictureCell, PictureError, PictureValue};
pub use points::PointFile;
pub use tidemap_picture::SCALE_MAX;

/// Maximum number of points in a file.
pub const POINTS_MAX: u64 = 50_000_000;
/// Maximum number of cells of a grid, or leaves of a tree, in a file.
pub const CELLS_MAX: u64 = 50_000_000;
