//! The specification of a map: the choices made when it is created, which never change afterwards.

use tidemap_grid::spec::{GridSpec, Retention};
use tidemap_model::{EnabledModels, OrderCriterion, Periodicities, UpdateRules, Zone};

use crate::name::MapName;

/// The earliest time that a real clock shows: 1 January 1990. Robots whose clock is not set begin near 1970 or 1980.
pub const REAL_CLOCK_MIN_NANOS: i64 = 631_152_000 * 1_000_000_000;

/// The fixed properties of a map.
#[derive(Clone, Debug, PartialEq)]
pub struct MapSpec {
    /// The name of the map, unique within the daemon.
    pub name: MapName,
    /// The time zone by whose civil time the people on the map live.
    pub zone: Zone,
    /// Candidate periodicities of every state.
    pub periodicities: Periodicities,
    /// How orders of the spectral model are compared.
    pub criterion: OrderCriterion,
    /// When the map was created, nanoseconds UTC.
    pub created_nanos: i64,
    /// An observation of a named state that is this much older than the newest observation counts half; in nanoseconds,
    /// above 0. `None`: all observations count alike.
    pub half_life_nanos: Option<i64>,
    /// The prediction of an untrained state, in [0, 1].
    pub prior: f64,
    /// How long the exact observations of named states are kept.
    pub retention: Retention,
    /// The models among which the nightly update of a named state chooses.
    pub models: EnabledModels,
    /// Whether the clocks of the map's producers are real: observations before [`REAL_CLOCK_MIN_NANOS`] are then
    /// refused. A simulation may begin at 0.
    pub has_real_clock: bool,
    /// The occupancy grid of the map, if it has one.
    pub grid: Option<GridSpec>,
}

impl MapSpec {
    /// A map with the defaults of the daemon: UTC, no grid, no half-life, history kept forever. Change fields as
    /// `MapSpec { zone, ..MapSpec::new(name) }`.
    pub fn new(name: MapName) -> MapSpec {
        MapSpec {
            name,
            zone: Zone::utc(),
            periodicities: Periodicities::default(),
            criterion: OrderCriterion::SquaredError,
            created_nanos: 0,
            half_life_nanos: None,
            prior: 0.5,
            retention: Retention::Forever,
            models: EnabledModels::default(),
            has_real_clock: false,
            grid: None,
        }
    }

    /// The earliest time of an observation, nanoseconds UTC.
    pub fn earliest_nanos(&self) -> i64 {
        if self.has_real_clock { REAL_CLOCK_MIN_NANOS } else { 0 }
    }

    /// How its states are updated.
    pub fn update_rules(&self) -> UpdateRules {
        let days = |nanos: i64| nanos as f64 / (86_400.0 * 1e9);
        let half_life_days = self.half_life_nanos.map(days);
        UpdateRules { criterion: self.criterion, half_life_days, models: self.models }
    }
}
