//! The site of a map: data that people and robots enter besides observations, as rows of tables, and changes of tables.
//!
//! | number | table | row | change |
//! | --- | --- | --- | --- |
//! | 1 | charger | [`Position`]; at most one | [`ChargerEdit`] |
//! | 2 | locations, ascending by name | [`Location`] | [`LocationEdit`] |
//! | 3 | no-go areas, ascending by name | [`NoGoArea`] | [`NoGoEdit`] |
//! | 4 | places that robots tried to reach | [`Reachability`]; at most one | [`Visit`] |
//! | 5 | topological map | [`super::topology::Topology`]; at most one | [`super::topology::Edit`] |
//! | 6 | failed traversals | [`FailedTraversals`]; at most one | with observations |
//! | 7 | tasks | [`super::task::TaskBook`]; at most one | [`super::task::TaskEdit`] |
//! | 8 | landmarks, by node, then by edge | [`super::landmark::LandmarksAtPlace`] | [`super::landmark::LandmarkEdit`] |
//!
//! Invariant: an empty table has no row; the number of a table is never given to another table. Doubles are stored as
//! their bits.

/// A row of a table, in a checkpoint and, in parts, in the index.
#[derive(Clone, PartialEq, prost::Message)]
pub struct TableRow {
    /// Number of the table.
    #[prost(uint32, tag = "1")]
    pub table: u32,
    /// The row, a message.
    #[prost(bytes = "vec", tag = "2")]
    pub row: Vec<u8>,
}

/// A change of a table, in the log.
#[derive(Clone, PartialEq, prost::Message)]
pub struct SiteEdit {
    /// Number of the table.
    #[prost(uint32, tag = "1")]
    pub table: u32,
    /// The change, a message.
    #[prost(bytes = "vec", tag = "2")]
    pub edit: Vec<u8>,
}

/// A position: x and y in metres, as bits.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub struct Position {
    /// Along x.
    #[prost(fixed64, tag = "1")]
    pub x_bits: u64,
    /// Along y.
    #[prost(fixed64, tag = "2")]
    pub y_bits: u64,
}

/// States that a robot observes together.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Location {
    #[prost(string, tag = "1")]
    pub name: String,
    /// Numbers of the states, ascending.
    #[prost(uint32, repeated, tag = "2")]
    pub states: Vec<u32>,
    /// Position of the robot when it observes the states; absent: not given.
    #[prost(message, optional, tag = "3")]
    pub position: Option<Position>,
    /// Cells of the grid, ascending.
    #[prost(message, repeated, tag = "4")]
    pub cells: Vec<SiteCell>,
}

/// A cell of the grid: its index along each axis.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub struct SiteCell {
    /// Along x.
    #[prost(sint32, tag = "1")]
    pub x: i32,
    /// Along y.
    #[prost(sint32, tag = "2")]
    pub y: i32,
    /// Along z.
    #[prost(sint32, tag = "3")]
    pub z: i32,
}

/// The last attempts to reach a cell of 50 cm.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub struct Attempts {
    /// Along x, in cells from the origin.
    #[prost(sint32, tag = "1")]
    pub x: i32,
    /// Along y.
    #[prost(sint32, tag = "2")]
    pub y: i32,
    /// Number of attempts, 1 to 5.
    #[prost(uint32, tag = "3")]
    pub count: u32,
    /// Whether the attempts succeeded, the newest in the lowest bit.
    #[prost(uint32, tag = "4")]
    pub reached: u32,
    /// Time of the newest attempt.
    #[prost(sint64, tag = "5")]
    pub last_nanos: i64,
}

/// A robot reached a place, or did not.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub struct Visit {
    /// The place.
    #[prost(message, optional, tag = "1")]
    pub position: Option<Position>,
    /// Whether the robot reached the place.
    #[prost(bool, tag = "2")]
    pub reached: bool,
    /// Time of the visit.
    #[prost(sint64, tag = "3")]
    pub utc_nanos: i64,
}

/// A traversal of an edge that failed.
#[derive(Clone, PartialEq, prost::Message)]
pub struct EdgeFailure {
    /// Name of the node where the edge begins.
    #[prost(string, tag = "1")]
    pub from: String,
    /// Name of the node where the edge ends.
    #[prost(string, tag = "2")]
    pub to: String,
    /// Action of the edge; empty: the usual one.
    #[prost(string, tag = "3")]
    pub action: String,
    /// Time at which the robot set out.
    #[prost(sint64, tag = "4")]
    pub start_nanos: i64,
    /// Time at which the robot gave up.
    #[prost(sint64, tag = "5")]
    pub end_nanos: i64,
    /// Reason of the failure, at most 200 characters.
    #[prost(string, tag = "6")]
    pub reason: String,
}

/// An area through which no path is planned.
#[derive(Clone, PartialEq, prost::Message)]
pub struct NoGoArea {
    #[prost(string, tag = "1")]
    pub name: String,
    /// The corners, at least three.
    #[prost(message, repeated, tag = "2")]
    pub corners: Vec<Position>,
}

/// The places that robots tried to reach.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Reachability {
    /// The cells, ascending by x, then y.
    #[prost(message, repeated, tag = "1")]
    pub cells: Vec<Attempts>,
}

/// The newest traversals that failed.
#[derive(Clone, PartialEq, prost::Message)]
pub struct FailedTraversals {
    /// The failures, ascending by start.
    #[prost(message, repeated, tag = "1")]
    pub failures: Vec<EdgeFailure>,
}

/// A change of the charger, where the robot rests.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub struct ChargerEdit {
    /// Position of the charger; absent: the robot rests at no particular place.
    #[prost(message, optional, tag = "1")]
    pub position: Option<Position>,
}

/// A change of the locations.
#[derive(Clone, PartialEq, prost::Message)]
pub struct LocationEdit {
    /// The change.
    #[prost(oneof = "LocationChange", tags = "1, 2")]
    pub change: Option<LocationChange>,
}

/// The kinds of changes of the locations.
#[derive(Clone, PartialEq, prost::Oneof)]
pub enum LocationChange {
    /// A location is added or replaced.
    #[prost(message, tag = "1")]
    Set(Location),
    /// The location of this name is removed.
    #[prost(string, tag = "2")]
    Remove(String),
}

/// A change of the no-go areas.
#[derive(Clone, PartialEq, prost::Message)]
pub struct NoGoEdit {
    /// The change.
    #[prost(oneof = "NoGoChange", tags = "1, 2")]
    pub change: Option<NoGoChange>,
}

/// The kinds of changes of the no-go areas.
#[derive(Clone, PartialEq, prost::Oneof)]
pub enum NoGoChange {
    /// An area is added or replaced.
    #[prost(message, tag = "1")]
    Set(NoGoArea),
    /// The area of this name is removed.
    #[prost(string, tag = "2")]
    Remove(String),
}
