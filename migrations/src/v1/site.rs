//! What a map is told about the place besides observations.
//!
//! Invariant: doubles are kept as their bits; a place has two of them, x and y, and a message without has none.

/// Where something is: x and y in metres, as bits.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub struct Place {
    /// Along x.
    #[prost(fixed64, tag = "1")]
    pub x_bits: u64,
    /// Along y.
    #[prost(fixed64, tag = "2")]
    pub y_bits: u64,
}

/// States that are seen together.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Location {
    #[prost(string, tag = "1")]
    pub name: String,
    /// Numbers of the states, ascending.
    #[prost(uint32, repeated, tag = "2")]
    pub states: Vec<u32>,
    /// Where the robot stands; absent: not told.
    #[prost(message, optional, tag = "3")]
    pub place: Option<Place>,
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
    /// How many, 1 to 5.
    #[prost(uint32, tag = "3")]
    pub count: u32,
    /// Whether they succeeded, the newest in the lowest bit.
    #[prost(uint32, tag = "4")]
    pub reached: u32,
    /// Time of the newest.
    #[prost(sint64, tag = "5")]
    pub last_nanos: i64,
}

/// A robot reached a place, or did not.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub struct Visit {
    /// Where.
    #[prost(message, optional, tag = "1")]
    pub place: Option<Place>,
    /// Whether it got there.
    #[prost(bool, tag = "2")]
    pub reached: bool,
    /// When.
    #[prost(sint64, tag = "3")]
    pub utc_nanos: i64,
}

/// A traversal of an edge that failed.
#[derive(Clone, PartialEq, prost::Message)]
pub struct EdgeFailure {
    /// Name of the node where the edge begins.
    #[prost(string, tag = "1")]
    pub from: String,
    /// Name of the node where it ends.
    #[prost(string, tag = "2")]
    pub to: String,
    /// Its action; empty: the usual one.
    #[prost(string, tag = "3")]
    pub action: String,
    /// When the robot set out.
    #[prost(sint64, tag = "4")]
    pub start_nanos: i64,
    /// When it gave up.
    #[prost(sint64, tag = "5")]
    pub end_nanos: i64,
    /// Why, at most 200 characters.
    #[prost(string, tag = "6")]
    pub reason: String,
}

/// An area that nothing is planned through.
#[derive(Clone, PartialEq, prost::Message)]
pub struct NoGoArea {
    #[prost(string, tag = "1")]
    pub name: String,
    /// At least three.
    #[prost(message, repeated, tag = "2")]
    pub corners: Vec<Place>,
}

/// All of it, in a checkpoint and, in chunks, in the index.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Site {
    /// Where the robot rests.
    #[prost(message, optional, tag = "1")]
    pub charger: Option<Place>,
    /// The locations, ascending by name.
    #[prost(message, repeated, tag = "2")]
    pub locations: Vec<Location>,
    /// The places that robots tried to reach, ascending by x, then y.
    #[prost(message, repeated, tag = "3")]
    pub attempts: Vec<Attempts>,
    /// The topological map; absent: none was ever told.
    #[prost(message, optional, tag = "4")]
    pub topology: Option<super::topology::Topology>,
    /// The newest traversals that failed, ascending by start.
    #[prost(message, repeated, tag = "5")]
    pub failures: Vec<EdgeFailure>,
    /// The tasks; absent: there were never any.
    #[prost(message, optional, tag = "6")]
    pub tasks: Option<super::task::TaskBook>,
    /// The no-go areas, ascending by name.
    #[prost(message, repeated, tag = "7")]
    pub no_go: Vec<NoGoArea>,
}

/// One change, in the log.
#[derive(Clone, PartialEq, prost::Message)]
pub struct SiteEdit {
    /// What changes.
    #[prost(oneof = "Change", tags = "1, 2, 3, 4, 5, 6, 7, 8, 9, 10")]
    pub change: Option<Change>,
}

/// What changes.
#[derive(Clone, PartialEq, prost::Oneof)]
pub enum Change {
    /// Where the robot rests.
    #[prost(message, tag = "1")]
    Charger(Place),
    /// It rests nowhere in particular; always true.
    #[prost(bool, tag = "2")]
    NoCharger(bool),
    /// A location is set or replaced.
    #[prost(message, tag = "3")]
    SetLocation(Location),
    /// The location of this name is removed.
    #[prost(string, tag = "4")]
    RemoveLocation(String),
    /// A robot reached a place, or did not.
    #[prost(message, tag = "5")]
    Visit(Visit),
    /// The topological map is changed.
    #[prost(message, tag = "6")]
    Topology(super::topology::Edit),
    /// The landmarks of a place are changed; since format 2.
    #[prost(message, tag = "7")]
    Landmarks(crate::v2::LandmarkEdit),
    /// The tasks are changed, or a plan is kept.
    #[prost(message, tag = "8")]
    Task(super::task::TaskEdit),
    /// A no-go area is set or replaced.
    #[prost(message, tag = "9")]
    SetNoGo(NoGoArea),
    /// The no-go area of this name is removed.
    #[prost(string, tag = "10")]
    RemoveNoGo(String),
}
