//! Creating, listing and deleting maps.
//!
//! Invariant: the daemon fills in the fields that a new map leaves out; this library repeats no default.

mod site;

pub use site::NoGoArea;
use site::point_from_wire;
pub use tidemap_map::name::StateName;
pub use tidemap_proto::convert::site::NamedLocation;

pub use tidemap_grid::{
    index::{CellBox, CellIndex},
    spec::{GridSpec, Retention, SensorNoise},
};
pub use tidemap_map::event::{Dimensions, RowKind, StateKind, StateSensor, StateShape, StatedReporting};
pub use tidemap_map::view::NotLearned;
pub use tidemap_model::{EnabledModels, OrderCriterion, PeriodicityDefinition};
pub use tidemap_model::{InvalidReporting, Reporting};
use tidemap_proto::convert::time::{duration, instant, span};
use tidemap_proto::convert::{
    enabled::{enabled_from_wire, enabled_to_wire},
    grid::{cell_box_from_wire, grid_from_wire, grid_to_wire, retention_from_wire, retention_to_wire},
    map::{
        criterion_from_wire, criterion_to_wire, not_learned_from_wire, periodicities_from_wire, periodicities_to_wire,
    },
    reporting::{reporting_from_wire, stated_reporting_to_wire},
    state_sensor::{state_sensor_from_wire, state_sensor_to_wire},
    vectors::{shape_from_wire, shape_to_wire},
};
use tidemap_proto::v1::{self, map_service_client::MapServiceClient};

use crate::{
    connection::{Client, Connection, REPLY_BYTES_MAX},
    error::Error,
};

/// A map to create.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NewMap {
    /// Name of the map, 1 to 63 of the characters a-z 0-9 _ -, the first a letter or digit.
    pub name: String,
    /// IANA time zone; UTC if absent.
    pub time_zone: Option<String>,
    /// Candidate periodicities; 168 harmonics of 7 days if absent.
    pub periodicities: Option<PeriodicityDefinition>,
    /// The criterion by which updates compare orders.
    pub order_criterion: OrderCriterion,
    /// The time for which the exact observations of named states are kept; forever if absent.
    pub retention: Option<Retention>,
    /// The occupancy grid; none if absent.
    pub grid: Option<GridSpec>,
    /// Half-life of the weight of observations of named states; all have the same weight if absent.
    pub half_life_nanos: Option<i64>,
    /// Prediction of an untrained probability; 0.5 if absent.
    pub prior: Option<f64>,
    /// The models that the nightly update selects from; `None`: the daemon's default.
    pub models: Option<EnabledModels>,
    /// Whether observations before 1990, which come from clocks that are not set, are refused.
    pub has_real_clock: bool,
}

/// The last update of a map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct UpdateSummary {
    /// Number of updates published so far.
    pub generation: u64,
    /// The update learned all observations before this time.
    pub cut_nanos: Option<i64>,
}

impl UpdateSummary {
    pub(crate) fn from_wire(summary: Option<v1::UpdateSummary>) -> Self {
        summary.map_or_else(Self::default, |summary| Self {
            generation: summary.generation,
            cut_nanos: instant(summary.cut),
        })
    }
}

/// A map.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    /// Name of the map.
    pub name: String,
    /// IANA time zone of the people on the map.
    pub time_zone: String,
    /// Candidate periodicities.
    pub periodicities: PeriodicityDefinition,
    /// The criterion by which updates compare orders.
    pub order_criterion: OrderCriterion,
    /// The time of creation.
    pub created_nanos: Option<i64>,
    /// Number of states.
    pub states: u64,
    /// Number of acknowledged observations, without refused ones.
    pub observations: u64,
    /// Number of observations that no update has learned yet.
    pub pending_observations: u64,
    /// The last update.
    pub last_update: UpdateSummary,
    /// The time for which the exact observations of named states are kept.
    pub retention: Retention,
    /// The occupancy grid, if any.
    pub grid: Option<GridSpec>,
    /// Counters of the grid.
    pub grid_summary: Option<GridSummary>,
    /// Half-life of the weight of observations of named states.
    pub half_life_nanos: Option<i64>,
    /// Prediction of an untrained probability.
    pub prior: f64,
    /// Position of the robot's charger, x and y in metres.
    pub charger_m: Option<[f64; 2]>,
    /// Number of locations.
    pub locations: u64,
    /// The models that the nightly update selects from.
    pub models: EnabledModels,
    /// Whether observations before 1990 are refused.
    pub has_real_clock: bool,
    /// Number of the pending observations that wait because their time is later than the daemon's clock.
    pub ahead_observations: u64,
    /// The data that an update would learn now; `None`: there is none.
    pub not_learned: Option<NotLearned>,
}

/// Counters of a grid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GridSummary {
    /// Number of tiles of 8x8x8 cells that were ever seen.
    pub tiles: u64,
    /// Number of acknowledged scans, without refused ones.
    pub scans: u64,
    /// Number of scans that no update has learned yet.
    pub pending_scans: u64,
    /// Number of observations of single cells in all scans.
    pub cell_observations: u64,
    /// The smallest box of whole tiles that contains every tile.
    pub bounds: Option<CellBox>,
    /// The cells of a picture of the whole grid.
    pub region: Option<CellBox>,
    /// Number of the pending scans that wait because their time is later than the daemon's clock.
    pub ahead_scans: u64,
}

/// A state of a map.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct State {
    /// Name of the state, unique within the map.
    pub name: String,
    /// Values of a kind, positions of a vector, angles, or labels.
    pub shape: StateShape,
    /// Number of its acknowledged observations.
    pub observations: u64,
    /// Order of its selected model; 0 for a vector or an angle, whose axes have orders of their own.
    pub order: u32,
    /// Time of the newest observation.
    pub last_nanos: Option<i64>,
    /// Number of observations that no update has learned yet.
    pub pending: u64,
    /// The sensor that reads it, if one was stated.
    pub sensor: Option<StateSensor>,
    /// The reporting of the state, with its durations.
    pub reporting: StatedReporting,
    /// The labels of a categorical state, in order.
    pub labels: Vec<String>,
}

impl Client {
    fn map_service(&self) -> MapServiceClient<Connection> {
        MapServiceClient::new(self.requests()).max_decoding_message_size(REPLY_BYTES_MAX)
    }

    /// Creates an empty map, and returns it with the defaults filled in.
    ///
    /// # Errors
    /// [`Error`]; the code is `ALREADY_EXISTS` if the name is taken, `INVALID_ARGUMENT` if a value is invalid.
    pub async fn create_map(&self, map: NewMap) -> Result<Map, Error> {
        let request = v1::CreateMapRequest {
            name: map.name,
            time_zone: map.time_zone.unwrap_or_default(),
            periodicities: map.periodicities.as_ref().map(periodicities_to_wire),
            order_criterion: criterion_to_wire(map.order_criterion).into(),
            retention: map.retention.map(retention_to_wire),
            grid: map.grid.as_ref().map(grid_to_wire),
            half_life: map.half_life_nanos.map(duration),
            prior: map.prior,
            models: map.models.map(enabled_to_wire).unwrap_or_default(),
            real_clock: map.has_real_clock,
        };
        let response = self.map_service().create_map(request).await.map_err(|status| self.error(&status))?;
        map_from_wire(response.into_inner().map)
    }

    /// One map.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if no such name exists.
    pub async fn map(&self, name: &str) -> Result<Map, Error> {
        let request = v1::GetMapRequest { name: name.to_owned() };
        let response = self.map_service().get_map(request).await.map_err(|status| self.error(&status))?;
        map_from_wire(response.into_inner().map)
    }

    /// All maps, ordered by name.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn maps(&self) -> Result<Vec<Map>, Error> {
        Ok(self.all_maps().await?.0)
    }

    /// All maps that can be used, ordered by name, and those that cannot, each with the reason.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn all_maps(&self) -> Result<(Vec<Map>, Vec<UnavailableMap>), Error> {
        let mut maps = Vec::new();
        let mut request = v1::ListMapsRequest { page_size: 1000, page_token: String::new() };
        loop {
            let response = self.map_service().list_maps(request.clone()).await.map_err(|status| self.error(&status))?;
            let page = response.into_inner();
            for map in page.maps {
                maps.push(map_from_wire(Some(map))?);
            }
            if page.next_page_token.is_empty() {
                let unavailable = page.unavailable.into_iter();
                let unavailable = unavailable.map(|map| UnavailableMap { name: map.name, reason: map.reason });
                return Ok((maps, unavailable.collect()));
            }
            request.page_token = page.next_page_token;
        }
    }

    /// Deletes a map and all its data permanently.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if no such name exists.
    pub async fn delete_map(&self, name: &str) -> Result<(), Error> {
        let request = v1::DeleteMapRequest { name: name.to_owned() };
        self.map_service().delete_map(request).await.map_err(|status| self.error(&status))?;
        Ok(())
    }

    /// Adds a state or a vector before its first observation; it is durable when this returns. Succeeds if it exists
    /// with the same shape, and with the same sensor if one is stated. `sensor`: how reliable the readings of a
    /// probability are; `None`: not known. `reporting`: how it is reported; `None`: by samples.
    ///
    /// # Errors
    /// [`Error`]; the code is `ALREADY_EXISTS` if it exists with another shape or sensor, `NOT_FOUND` if the map does
    /// not exist, `INVALID_ARGUMENT` if a state that is not a probability has a sensor.
    pub async fn add_state(
        &self,
        map: &str,
        state: &str,
        shape: StateShape,
        sensor: Option<StateSensor>,
        reporting: Option<StatedReporting>,
    ) -> Result<State, Error> {
        let ((kind, dimensions), map, state) = (shape_to_wire(shape), map.to_owned(), state.to_owned());
        let sensor = sensor.map(state_sensor_to_wire);
        let reporting = reporting.map(stated_reporting_to_wire);
        let labels = Vec::new();
        let request = v1::AddStateRequest { map, state, kind: kind.into(), dimensions, sensor, reporting, labels };
        self.added(request).await
    }

    /// Adds a state from a request of the wire; it is durable when this returns.
    ///
    /// # Errors
    /// The errors of [`Client::add_state`] and [`Client::add_categorical`].
    pub async fn add_requested_state(&self, request: v1::AddStateRequest) -> Result<State, Error> {
        self.added(request).await
    }

    /// Adds a categorical state with these labels, 2 to 64; it is durable when this returns. Succeeds if it exists with
    /// the same labels in this order.
    ///
    /// # Errors
    /// [`Error`]; the code is `ALREADY_EXISTS` if it exists with another kind or other labels, `NOT_FOUND` if the map
    /// does not exist, `INVALID_ARGUMENT` if the labels are not valid.
    pub async fn add_categorical(&self, map: &str, state: &str, labels: &[String]) -> Result<State, Error> {
        let request = v1::AddStateRequest {
            map: map.to_owned(),
            state: state.to_owned(),
            kind: v1::StateKind::Categorical.into(),
            labels: labels.to_vec(),
            ..v1::AddStateRequest::default()
        };
        self.added(request).await
    }

    async fn added(&self, request: v1::AddStateRequest) -> Result<State, Error> {
        let response = self.map_service().add_state(request).await.map_err(|status| self.error(&status))?;
        response.into_inner().state.map_or(Err(Error::Protocol("no state in the answer")), state_from_wire)
    }

    /// A page of the states of a map, in the order in which they were first seen, and the token of the next page; the
    /// first page has the token "", and the last page returns `None`.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map does not exist.
    pub async fn states(&self, map: &str, page_token: &str) -> Result<(Vec<State>, Option<String>), Error> {
        let request =
            v1::ListStatesRequest { map: map.to_owned(), page_size: 10_000, page_token: page_token.to_owned() };
        let response = self.map_service().list_states(request).await.map_err(|status| self.error(&status))?;
        let page = response.into_inner();
        let states = page.states.into_iter().map(state_from_wire).collect::<Result<_, _>>()?;
        Ok((states, Some(page.next_page_token).filter(|token| !token.is_empty())))
    }
}

/// A map that cannot be used, because its data is damaged or missing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnavailableMap {
    /// Name of the map.
    pub name: String,
    /// The fault of the map, and the remedy.
    pub reason: String,
}

fn map_from_wire(map: Option<v1::Map>) -> Result<Map, Error> {
    let map = map.ok_or(Error::Protocol("no map in the answer"))?;
    let order_criterion = criterion_from_wire(map.order_criterion()).unwrap_or_default();
    let wrong = |_| Error::Protocol("an invalid map");
    let periodicities = periodicities_from_wire(map.periodicities).map_err(wrong)?.definition().clone();
    let retention = retention_from_wire("retention", map.retention, Retention::Forever).map_err(wrong)?;
    Ok(Map {
        name: map.name,
        time_zone: map.time_zone,
        periodicities,
        order_criterion,
        created_nanos: instant(map.create_time),
        states: map.states,
        observations: map.observations,
        pending_observations: map.pending_observations,
        last_update: UpdateSummary::from_wire(map.last_update),
        retention,
        grid: map.grid.map(grid_from_wire).transpose().map_err(wrong)?,
        grid_summary: map.grid_summary.as_ref().map(summary_from_wire),
        half_life_nanos: span(map.half_life),
        prior: map.prior,
        charger_m: map.charger.map(point_from_wire),
        locations: map.locations,
        models: enabled_from_wire("models", &map.models, Retention::Forever).map_err(wrong)?,
        has_real_clock: map.real_clock,
        ahead_observations: map.ahead_observations,
        not_learned: map.not_learned.as_ref().map(not_learned_from_wire),
    })
}

fn summary_from_wire(summary: &v1::GridSummary) -> GridSummary {
    GridSummary {
        tiles: summary.tiles,
        scans: summary.scans,
        pending_scans: summary.pending_scans,
        cell_observations: summary.cell_observations,
        bounds: summary.bounds.as_ref().map(cell_box_from_wire),
        region: summary.region.as_ref().map(cell_box_from_wire),
        ahead_scans: summary.ahead_scans,
    }
}

fn state_from_wire(state: v1::State) -> Result<State, Error> {
    let shape = shape_from_wire(("kind", state.kind), ("dimensions", state.dimensions)).ok().flatten();
    let sensor = state.sensor.as_ref().map(state_sensor_from_wire).transpose();
    let reporting = state.reporting.as_ref().map(|wire| reporting_from_wire("reporting", wire)).transpose();
    Ok(State {
        shape: shape.ok_or(Error::Protocol("a state of a kind that this version does not support"))?,
        name: state.name,
        observations: state.observations,
        order: state.order,
        last_nanos: instant(state.last_time),
        pending: state.pending,
        labels: state.labels,
        sensor: sensor.map_err(|_| Error::Protocol("a sensor that cannot be"))?,
        reporting: reporting
            .map_err(|_| Error::Protocol("a way to report that cannot be"))?
            .unwrap_or_else(|| Reporting::Samples.into()),
    })
}
