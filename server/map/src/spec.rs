//! What a map is: the choices made when it is created, which never change afterwards.

use tidemap_model::{OrderCriterion, Periodicities, Zone};

use crate::{
    grid::spec::{GridSpec, Retention},
    name::MapName,
};

/// The fixed properties of a map.
#[derive(Clone, Debug, PartialEq)]
pub struct MapSpec {
    /// Its name.
    pub name: MapName,
    /// The time zone by whose civil time the people on the map live.
    pub zone: Zone,
    /// Candidate periodicities of every state.
    pub periodicities: Periodicities,
    /// How orders of the spectral model are compared.
    pub criterion: OrderCriterion,
    /// When the map was created, nanoseconds UTC.
    pub created_nanos: i64,
    /// How long the exact observations of named states are kept for recall.
    pub retention: Retention,
    /// Its occupancy grid, if it has one.
    pub grid: Option<GridSpec>,
}
