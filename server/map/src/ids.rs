//! Identifiers within a map, and the reasons why an observation is refused.
//!
//! Invariant: ids are dense from 0, assigned in log order, and never reused.

use tidemap_grid::sensors::ProducerSensor;

use crate::name::ProducerKey;

/// Index of a state within its map: dense from 0, in order of first appearance, never reused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct StateId(pub u32);

/// Index of a producer key within its map: dense from 0, never reused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ProducerId(pub u32);

/// The reason why an observation was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum RefusalReason {
    /// The value is not a number, infinite, or not allowed for the state's kind.
    Value,
    /// The time is before 1970, or beyond the range of i64 nanoseconds.
    Time,
    /// The state's name is not valid.
    StateName,
    /// The index is not in the stream's table of names.
    StateIndex,
    /// The map or the stream may not have more states.
    StateLimit,
    /// The state is of another kind than the stream stated.
    StateKind,
    /// The map has no grid.
    NoGrid,
    /// A scan is malformed: masks, points, pose or range.
    Scan,
    /// The scan sees nothing of the grid.
    Empty,
    /// The map may not have more tiles.
    TileLimit,
    /// The scan is in another frame than the map.
    Frame,
    /// The map has no such edge.
    Edge,
    /// The map has no such place or landmark, or a sighting names one twice.
    Landmark,
}

/// A producer that appears for the first time.
#[derive(Clone, Debug, PartialEq)]
pub struct NewProducer {
    /// The producer's name and the label of its sequence.
    pub key: ProducerKey,
    /// The sensor of all its scans; `None`: the map's own.
    pub sensor: Option<ProducerSensor>,
    /// The client that introduces the producer, for the shares per client; empty: a client without a share.
    pub introduced_by: String,
}

impl From<ProducerKey> for NewProducer {
    /// A producer that has the map's own sensor.
    fn from(key: ProducerKey) -> NewProducer {
        NewProducer { key, sensor: None, introduced_by: String::new() }
    }
}
