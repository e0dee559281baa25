//! Files of maps, scans and observations, tables, pictures and times: what people already have is read, and what is
//! predicted is written.
//!
//! Invariant: bytes in, values out, and the other way; no file is opened here. Reading never panics, and never takes
//! memory for a number that a file claims before that number has been held against the file's length. A file that is
//! cut off is an error and never a smaller map. Numbers in error messages are those of the file: lines from 1, bytes
//! from 0.

pub mod cells_csv;
mod colour;
#[cfg(test)]
mod cuts;
mod error;
pub mod nav2;
pub mod observation_file;
pub mod octomap;
pub mod pcd;
mod picture;
pub mod ply;
pub mod png;
mod points;
mod scalar;
pub mod svg;
pub mod table;
mod text;
pub mod topology;
pub mod topology_svg;
pub mod tour_svg;

pub use picture::{MapPicture, PictureCell, PictureError};
pub use points::PointFile;

/// Most points that are read from one file.
pub const POINTS_MAX: u64 = 50_000_000;
/// Most cells of a grid, and most leaves of a tree, that are read from one file or written to one.
pub const CELLS_MAX: u64 = 50_000_000;
