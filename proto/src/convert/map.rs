//! Maps, their periodicities, their states, their producers and refusals.

use prost_types::Duration;
use tidemap_grid::spec::Retention;
use tidemap_map::{
    event::StateKind,
    ids::{RefusalReason, StateId},
    name::MapName,
    snapshot::ProducerMark,
    spec::MapSpec,
    view::{MapView, NotLearned},
};
use tidemap_model::{OrderCriterion, Periodicities, PeriodicityDefinition, Zone, time::HALF_LIFE_MIN_NANOS};

use super::{
    InvalidField,
    enabled::{enabled_from_wire, enabled_to_wire},
    grid::{grid_from_wire, grid_summary_to_wire, grid_to_wire, retention_from_wire, retention_to_wire},
    reporting::reporting_to_wire,
    site::point_to_wire,
    state_sensor::state_sensor_to_wire,
    time::{duration, nanos_from_duration, timestamp},
};
use crate::v1::{self, periodicities::Set};

/// Default base of the harmonic periodicities: 7 days, in nanoseconds.
pub const DEFAULT_BASE_NANOS: i64 = 7 * 86_400 * 1_000_000_000;
/// Default number of harmonic periodicities.
pub const DEFAULT_COUNT: u32 = 168;

/// The map of a request, with defaults filled in.
///
/// # Errors
/// The invalid field.
pub fn spec_from_request(request: v1::CreateMapRequest, created_nanos: i64) -> Result<MapSpec, InvalidField> {
    let name = MapName::new(&request.name).map_err(|error| InvalidField::new("name", error))?;
    let zone = match request.time_zone.as_str() {
        "" => Zone::utc(),
        name => Zone::named(name).map_err(|error| InvalidField::new("time_zone", error))?,
    };
    let periodicities = periodicities_from_wire(request.periodicities)?;
    let criterion = match v1::OrderCriterion::try_from(request.order_criterion) {
        Ok(criterion) => criterion_from_wire(criterion).unwrap_or_default(),
        Err(_) => {
            return Err(InvalidField::new("order_criterion", format!("{} is not known", request.order_criterion)));
        }
    };
    let retention = retention_from_wire("retention", request.retention, Retention::Forever)?;
    let grid = request.grid.map(grid_from_wire).transpose()?;
    let half_life_nanos = match request.half_life {
        None => None,
        Some(half_life) => match nanos_from_duration("half_life", half_life)? {
            nanos if nanos < HALF_LIFE_MIN_NANOS => {
                let text = format!("{} s is too short: it has to be 0.1 days (8640 s) or more", nanos as f64 / 1e9);
                return Err(InvalidField::new("half_life", text));
            }
            nanos => Some(nanos),
        },
    };
    let prior = match request.prior.unwrap_or(0.5) {
        prior if (0.0..=1.0).contains(&prior) => prior,
        other => return Err(InvalidField::new("prior", format!("{other} is not between 0 and 1"))),
    };
    let models = enabled_from_wire("models", &request.models, retention)?;
    Ok(MapSpec {
        name,
        zone,
        periodicities,
        criterion,
        created_nanos,
        half_life_nanos,
        prior,
        retention,
        models,
        has_real_clock: request.real_clock,
        grid,
    })
}

/// Periodicities, by default those of a new map.
///
/// # Errors
/// The field that is invalid.
pub fn periodicities_from_wire(wire: Option<v1::Periodicities>) -> Result<Periodicities, InvalidField> {
    match wire.and_then(|periodicities| periodicities.set) {
        None => Ok(Periodicities::default()),
        Some(Set::Harmonics(harmonics)) => {
            let base = match harmonics.base {
                Some(base) => nanos_from_duration("periodicities.harmonics.base", base)?,
                None => DEFAULT_BASE_NANOS,
            };
            let count = if harmonics.count == 0 { DEFAULT_COUNT } else { harmonics.count };
            Periodicities::harmonics(base, count).map_err(|error| InvalidField::new("periodicities.harmonics", error))
        }
        Some(Set::List(list)) => {
            let nanos = |(i, &period): (usize, &Duration)| {
                nanos_from_duration(&format!("periodicities.list.periods[{i}]"), period)
            };
            let periods = list.periods.iter().enumerate().map(nanos).collect::<Result<Vec<i64>, _>>()?;
            Periodicities::list(periods).map_err(|error| InvalidField::new("periodicities.list.periods", error))
        }
    }
}

/// A map for the wire.
#[must_use]
pub fn map_to_wire(view: &MapView) -> v1::Map {
    let spec = view.spec();
    v1::Map {
        name: spec.name.as_str().to_owned(),
        time_zone: spec.zone.name().to_owned(),
        periodicities: Some(periodicities_to_wire(spec.periodicities.definition())),
        order_criterion: criterion_to_wire(spec.criterion).into(),
        create_time: Some(timestamp(spec.created_nanos)),
        states: view.len() as u64,
        observations: view.observations(),
        pending_observations: view.pending(),
        last_update: Some(update_to_wire(view.generation(), view.cut_nanos())),
        retention: Some(retention_to_wire(spec.retention)),
        grid: spec.grid.as_ref().map(grid_to_wire),
        grid_summary: view.grid().map(grid_summary_to_wire),
        half_life: spec.half_life_nanos.map(duration),
        prior: spec.prior,
        charger: view.site().charger_m().map(point_to_wire),
        locations: view.site().locations().len() as u64,
        models: enabled_to_wire(spec.models),
        real_clock: spec.has_real_clock,
        ahead_observations: view.ahead(),
        not_learned: view.not_learned().as_ref().map(not_learned_to_wire),
    }
}

/// The data that an update would learn, for the wire.
fn not_learned_to_wire(waiting: &NotLearned) -> v1::NotLearned {
    v1::NotLearned { observations: waiting.observations, scans: waiting.scans, all: waiting.is_all }
}

/// The data that an update would learn.
#[must_use]
pub fn not_learned_from_wire(waiting: &v1::NotLearned) -> NotLearned {
    NotLearned { observations: waiting.observations, scans: waiting.scans, is_all: waiting.all }
}

/// The last update, for the wire.
#[must_use]
pub fn update_to_wire(generation: u64, cut_nanos: Option<i64>) -> v1::UpdateSummary {
    v1::UpdateSummary { generation, cut: cut_nanos.map(timestamp) }
}

/// A state for the wire; a vector or an angle takes the place of its first axis, a categorical state that of its first
/// label. `None` if the view has no such state, and for the other axes.
#[must_use]
pub fn state_to_wire(view: &MapView, id: StateId) -> Option<v1::State> {
    let info = view.info(id)?;
    let live = view.as_observed(id);
    if let Some((state, _)) = info.name.as_label() {
        // Included in the entry of its first label.
        let labels = view.labels(state);
        return labels.first().filter(|(first, _)| *first == id).map(|_| v1::State {
            name: state.to_owned(),
            kind: v1::StateKind::Categorical.into(),
            observations: live.observations,
            last_time: live.last_nanos().map(timestamp),
            dimensions: u32::try_from(labels.len()).unwrap_or(u32::MAX),
            pending: view.pending_of(id),
            labels: labels.iter().map(|(_, label)| (*label).to_owned()).collect(),
            ..v1::State::default()
        });
    }
    let (name, kind, order, dimensions) = match (info.name.as_axis(), info.name.as_angle_axis()) {
        (None, None) => {
            let order = u32::try_from(view.model(id).order()).unwrap_or(u32::MAX);
            (info.name.as_str(), kind_to_wire(info.kind), order, 0)
        }
        (Some((vector, 0)), _) => {
            let dimensions =
                view.shape(vector).map_or(0, |(_, shape)| u32::try_from(shape.states()).unwrap_or(u32::MAX));
            (vector, v1::StateKind::Vector, 0, dimensions)
        }
        (None, Some((angle, 0))) => (angle, v1::StateKind::Angle, 0, 0),
        // Included in the entry of its first axis.
        _ => return None,
    };
    Some(v1::State {
        name: name.to_owned(),
        kind: kind.into(),
        observations: live.observations,
        order,
        last_time: live.last_nanos().map(timestamp),
        dimensions,
        pending: view.pending_of(id),
        sensor: info.sensor.map(state_sensor_to_wire),
        reporting: reporting_to_wire(info.reporting),
        labels: Vec::new(),
    })
}

/// A kind of values for the wire.
#[must_use]
pub fn kind_to_wire(kind: StateKind) -> v1::StateKind {
    match kind {
        StateKind::Probability => v1::StateKind::Probability,
        StateKind::Continuous => v1::StateKind::Continuous,
        StateKind::Count => v1::StateKind::Count,
    }
}

/// A kind of values from the wire; `None` if the kind is unspecified, and for vectors, which have no kind of values.
#[must_use]
pub fn kind_from_wire(kind: v1::StateKind) -> Option<StateKind> {
    StateKind::ALL.into_iter().find(|&known| kind_to_wire(known) == kind)
}

both_ways!(
    /// Why an observation is refused, for the wire.
    refusal_to_wire, refusal_from_wire, RefusalReason, v1::RefusalReason,
    [
        Value = Value,
        Time = Time,
        StateName = StateName,
        StateIndex = StateIndex,
        StateLimit = StateLimit,
        StateKind = StateKind,
        NoGrid = NoGrid,
        Scan = Scan,
        Empty = Empty,
        TileLimit = TileLimit,
        Frame = Frame,
        Edge = Edge,
        Landmark = Landmark,
    ]
);

/// A refused observation for the wire.
#[must_use]
pub fn refused_to_wire(sequence: u64, reason: RefusalReason, detail: String) -> v1::Refusal {
    v1::Refusal { sequence, reason: refusal_to_wire(reason).into(), detail }
}

/// A producer of a map for the wire. `is_connected`: whether a stream of the producer is open.
#[must_use]
pub fn producer_to_wire(mark: &ProducerMark, is_connected: bool) -> v1::ProducerInfo {
    v1::ProducerInfo {
        producer: mark.key.producer().to_owned(),
        label: mark.key.label().to_owned(),
        durable_sequence: mark.durable_sequence,
        is_connected,
        received_time: Some(timestamp(mark.received_nanos)),
        is_forgotten: mark.is_forgotten,
    }
}

both_ways!(
    /// How orders are compared, for the wire.
    criterion_to_wire, criterion_from_wire, OrderCriterion, v1::OrderCriterion,
    [SquaredError = SquaredError, ZeroOne = ZeroOne]
);

/// Periodicities for the wire.
#[must_use]
pub fn periodicities_to_wire(definition: &PeriodicityDefinition) -> v1::Periodicities {
    let set = match definition {
        PeriodicityDefinition::Harmonics { base_nanos, count } => {
            Set::Harmonics(v1::Harmonics { base: Some(duration(*base_nanos)), count: *count })
        }
        PeriodicityDefinition::List { period_nanos } => {
            Set::List(v1::PeriodList { periods: period_nanos.iter().map(|&nanos| duration(nanos)).collect() })
        }
    };
    v1::Periodicities { set: Some(set) }
}
