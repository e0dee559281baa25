//! Models of requests, and descriptions of the models of states.

use tidemap_map::{ids::StateId, view::MapView};
use tidemap_model::{
    Component, LocalDay, ORDER_MAX, SpectralModel, StateModel,
    models::HistogramCycle,
    selector::{Blend, ModelKind, ModelSelector},
};

use super::{
    InvalidField,
    map::kind_to_wire,
    model_kind::{model_kind_from_wire, model_kind_to_wire},
    time::{duration, nanos_from_duration, timestamp},
};
use crate::v1;

mod evaluation;
mod flow;
mod past;
mod positions;
mod states;

pub use evaluation::{
    EvaluatedModel, EvaluationQuestion, evaluated_from_wire, evaluated_model_to_wire, evaluation_from_wire, header_of,
    unavailable_model_to_wire, unpack_evaluated,
};
pub use flow::{
    AvoidedPeople, FlowQuestion, FlowSource, avoided_from_wire, flow_cells_to_wire, flow_from_wire,
    flow_header_to_wire, flow_source_to_wire,
};
pub use past::past_to_wire;
pub use positions::{
    ExpectedPositions, PlacesForecast, PlacesQuestion, PositionRaster, PositionRegion, PositionsQuestion,
    places_from_wire, places_to_wire, position_cells_to_wire, positions_from_wire, positions_header_to_wire,
};
pub use states::{StateFacts, StateForecast, StatesQuestion, forecast_to_wire, states_from_wire};

/// The probability of intervals; `None` for 0: no intervals are requested.
fn interval_level_from_wire(level: f64) -> Result<Option<f64>, InvalidField> {
    if (0.0..1.0).contains(&level) {
        return Ok(Some(level).filter(|&level| level > 0.0));
    }
    let text = format!("{level} is not a probability: 0 (no intervals) or more, and below 1");
    Err(InvalidField::new("interval_level", text))
}

/// A model of a request.
///
/// # Errors
/// An unknown kind, an order above 15, or an order for a model that has none.
pub fn selector_from_wire(field: &str, wire: Option<v1::ModelSelector>) -> Result<ModelSelector, InvalidField> {
    let wire = wire.unwrap_or_default();
    let wrong = |name: &str, text: String| InvalidField::new(format!("{field}.{name}"), text);
    let wire_kind =
        v1::ModelKind::try_from(wire.kind).map_err(|_| wrong("kind", format!("{} is not known", wire.kind)))?;
    let mut kind = model_kind_from_wire(wire_kind).unwrap_or_default();
    if kind.cycle().is_some() {
        let cycle = cycle_from_wire(wire.cycle);
        kind = kind.with_cycle(cycle.ok_or_else(|| wrong("cycle", format!("{} is not known", wire.cycle)))?);
    }
    match (wire.parameter, kind.count_limit()) {
        (None, _) => {}
        (Some(found), Some(limit)) if (1..=limit.max).contains(&found) => kind = kind.with_count(found),
        (Some(found), Some(limit)) => {
            let text = format!("{found} {}: 1 to {} are possible", limit.noun, limit.max);
            return Err(wrong("parameter", text));
        }
        (Some(found), None) => {
            return Err(wrong("parameter", format!("{found} was given, but this model has none")));
        }
    }
    if wire.cycle != 0 && kind.cycle().is_none() {
        return Err(wrong("cycle", "only a histogram has one".to_owned()));
    }
    match wire.period {
        None => {}
        Some(period) if kind.period_nanos().is_some() => kind = kind.with_period(period_from_wire(field, period)?),
        Some(period) => {
            return Err(wrong("period", format!("{} s was given, but only pergam has one", period.seconds)));
        }
    }
    let order = match wire.order {
        None => None,
        Some(order) if !kind.has_order() => {
            let text =
                format!("order {order} was given, but this model has none: use it with auto, spectral or uniform");
            return Err(wrong("order", text));
        }
        Some(order) => Some(order_from_wire(&format!("{field}.order"), order)?),
    };
    let blend = match (wire.persistence, wire.memory) {
        (false, false) => Blend::None,
        (true, false) => Blend::Persistence,
        (false, true) => Blend::Memory,
        (true, true) => return Err(wrong("memory", "use either persistence or memory, not both".to_owned())),
    };
    Ok(ModelSelector { kind, order, blend })
}

/// Checks that all cells of a grid have the model.
///
/// # Errors
/// Only named states, and cells by name, have the model.
pub fn check_for_cells(field: &str, selector: ModelSelector) -> Result<(), InvalidField> {
    if selector.kind.is_for_cells() {
        return Ok(());
    }
    let text = format!(
        "all cells at once have no model {}: use auto, mean, latest or spectral; {} have it",
        selector.kind,
        if selector.kind.needs_readings() { "cells by name" } else { "named states" }
    );
    Err(InvalidField::new(format!("{field}.kind"), text))
}

/// The period of a model.
fn period_from_wire(field: &str, period: prost_types::Duration) -> Result<i64, InvalidField> {
    let field = format!("{field}.period");
    let nanos = nanos_from_duration(&field, period)?;
    if ModelKind::PERIODS_NANOS.contains(&nanos) {
        return Ok(nanos);
    }
    Err(InvalidField::new(field, format!("{} s: 1 minute to 366 days are possible", nanos as f64 / 1e9)))
}

fn cycle_from_wire(number: i32) -> Option<HistogramCycle> {
    Some(match v1::HistogramCycle::try_from(number).ok()? {
        v1::HistogramCycle::Unspecified | v1::HistogramCycle::Day => HistogramCycle::Day,
        v1::HistogramCycle::Week => HistogramCycle::Week,
        v1::HistogramCycle::WeekdayWeekend => HistogramCycle::WeekdayWeekend,
    })
}

fn cycle_to_wire(cycle: HistogramCycle) -> v1::HistogramCycle {
    match cycle {
        HistogramCycle::Day => v1::HistogramCycle::Day,
        HistogramCycle::Week => v1::HistogramCycle::Week,
        HistogramCycle::WeekdayWeekend => v1::HistogramCycle::WeekdayWeekend,
    }
}

/// An order from the wire.
///
/// # Errors
/// An order above 15.
pub fn order_from_wire(field: &str, order: u32) -> Result<usize, InvalidField> {
    usize::try_from(order)
        .ok()
        .filter(|order| *order <= ORDER_MAX)
        .ok_or_else(|| InvalidField::new(field, format!("order {order} is too high: 0 to {ORDER_MAX} are possible")))
}

/// A model for the wire.
#[must_use]
pub fn selector_to_wire(selector: ModelSelector) -> v1::ModelSelector {
    let kind = selector.kind;
    v1::ModelSelector {
        kind: model_kind_to_wire(kind).into(),
        order: selector.order.map(|order| u32::try_from(order).unwrap_or(u32::MAX)),
        persistence: selector.blend == Blend::Persistence,
        memory: selector.blend == Blend::Memory,
        parameter: kind.count(),
        cycle: kind.cycle().map_or(v1::HistogramCycle::Unspecified, cycle_to_wire).into(),
        period: kind.period_nanos().filter(|&nanos| nanos != ModelKind::PERIOD_NANOS).map(duration),
    }
}

/// Describes the model of a state; `None` if the view has no such state.
#[must_use]
pub fn description_to_wire(view: &MapView, id: StateId) -> Option<v1::DescribeModelResponse> {
    let info = view.info(id)?;
    let live = view.live(id);
    let model = view.model(id);
    let spectral = model.spectral();
    Some(v1::DescribeModelResponse {
        state: info.name.as_str().to_owned(),
        kind: kind_to_wire(info.kind).into(),
        mean: spectral.mean(),
        learned_observations: model.learned_observations(),
        observations: live.observations,
        order: u32::try_from(model.order()).unwrap_or(u32::MAX),
        components: components_to_wire(view, spectral),
        order_errors: model.errors().sums().to_vec(),
        persistence_tau_secs: live.persistence.tau_secs_of(model.usual_change()),
        last_value: live.persistence.last().map(|(_, value)| value),
        last_time: live.persistence.last().map(|(nanos, _)| timestamp(nanos)),
        first_time: model.accumulator().first_nanos().map(timestamp),
        chosen: Some(selector_to_wire(ModelSelector::of_choice(model.choice(), model))),
        model_errors: model_errors_to_wire(model),
        change_date: change_date(model),
    })
}

fn model_errors_to_wire(model: &StateModel) -> Vec<v1::ModelError> {
    let Some(alternatives) = model.alternatives() else { return Vec::new() };
    let error = |(choice, error_sum)| v1::ModelError {
        model: Some(selector_to_wire(ModelSelector::of_choice(choice, model))),
        error_sum,
    };
    alternatives.error_sums().map(error).collect()
}

fn change_date(model: &StateModel) -> String {
    date_or_empty(model.alternatives().and_then(|alternatives| alternatives.alarm().alarm_day()))
}

/// A local date, YYYY-MM-DD; empty without one.
pub(super) fn date_or_empty(day: Option<LocalDay>) -> String {
    day.map_or_else(String::new, |day| day.to_string())
}

/// The components of a model, strongest first.
pub(super) fn components_to_wire(view: &MapView, spectral: &SpectralModel) -> Vec<v1::SpectralComponent> {
    let component = |component: &Component| v1::SpectralComponent {
        period_secs: view.spec().periodicities.period_secs(component.periodicity as usize),
        amplitude: component.amplitude(),
        phase_rad: component.phase_rad(),
    };
    spectral.components().iter().map(component).collect()
}
