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
    /// Its name.
    #[prost(string, tag = "1")]
    pub name: String,
    /// Numbers of the states, ascending.
    #[prost(uint32, repeated, tag = "2")]
    pub states: Vec<u32>,
    /// Where the robot stands; absent: not told.
    #[prost(message, optional, tag = "3")]
    pub place: Option<Place>,
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
}

/// One change, in the log.
#[derive(Clone, PartialEq, prost::Message)]
pub struct SiteEdit {
    /// What changes.
    #[prost(oneof = "Change", tags = "1, 2, 3, 4")]
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
}
