//! Models of requests, and descriptions of the models of states.

use tidemap_map::{ids::StateId, view::MapView};
use tidemap_model::{
    Component, LocalDay, ORDER_MAX, SpectralModel, StateModel,
    models::HistogramCycle,
    selector::{CLUSTERS_MAX, GAUSSIANS_MAX, ModelKind, ModelSelector, PERGAM_PERIOD_NANOS, PERGAM_PERIODS},
};

use super::{
    InvalidField,
    map::kind_to_wire,
    time::{duration, nanos_from_duration, timestamp},
};
use crate::v1;

mod evaluation;
mod positions;
mod states;

pub use evaluation::{EvaluationQuestion, evaluated_from_wire, evaluation_from_wire, header_of, unpack_evaluated};
pub use positions::{PlacesQuestion, PositionRegion, PositionsQuestion, places_from_wire, positions_from_wire};
pub use states::{StateFacts, StateForecast, StatesQuestion, forecast_to_wire, states_from_wire};

/// A model of a request.
///
/// # Errors
/// An unknown kind, an order above 15, or an order for a model that has none.
pub fn selector_from_wire(field: &str, wire: Option<v1::ModelSelector>) -> Result<ModelSelector, InvalidField> {
    let wire = wire.unwrap_or_default();
    let wrong = |name: &str, text: String| InvalidField::new(format!("{field}.{name}"), text);
    let parameter = |default: u32, max: u32, what: &str| match wire.parameter {
        None => Ok(default),
        Some(found) if (1..=max).contains(&found) => Ok(found),
        Some(found) => Err(wrong("parameter", format!("{found} {what}: 1 to {max} are possible"))),
    };
    let kind = match v1::ModelKind::try_from(wire.kind) {
        Ok(v1::ModelKind::Unspecified | v1::ModelKind::Auto) => ModelKind::Auto,
        Ok(v1::ModelKind::Mean) => ModelKind::Mean,
        Ok(v1::ModelKind::Latest) => ModelKind::Latest,
        Ok(v1::ModelKind::Spectral) => ModelKind::Spectral,
        Ok(v1::ModelKind::Persistence) => ModelKind::Persistence,
        Ok(v1::ModelKind::Histogram) => {
            let (cycle, default) = match v1::HistogramCycle::try_from(wire.cycle) {
                Ok(v1::HistogramCycle::Unspecified | v1::HistogramCycle::Day) => (HistogramCycle::Day, 24),
                Ok(v1::HistogramCycle::Week) => (HistogramCycle::Week, 168),
                Ok(v1::HistogramCycle::WeekdayWeekend) => (HistogramCycle::WeekdayWeekend, 24),
                Err(_) => return Err(wrong("cycle", format!("{} is not known", wire.cycle))),
            };
            let max = u32::try_from(cycle.max_bins()).unwrap_or(u32::MAX);
            ModelKind::Histogram { cycle, bins: parameter(default, max, "bins")? }
        }
        Ok(v1::ModelKind::Pergam) => ModelKind::Pergam {
            gaussians: parameter(3, GAUSSIANS_MAX, "Gaussians")?,
            period_nanos: period_from_wire(field, wire.period)?,
        },
        Ok(v1::ModelKind::HypertimeEm) => ModelKind::HypertimeEm { clusters: parameter(3, CLUSTERS_MAX, "clusters")? },
        Ok(v1::ModelKind::HypertimeKm) => ModelKind::HypertimeKm { clusters: parameter(3, CLUSTERS_MAX, "clusters")? },
        Ok(v1::ModelKind::Poisson) => ModelKind::Poisson,
        Ok(v1::ModelKind::Calibrated) => ModelKind::Calibrated,
        Ok(v1::ModelKind::Uniform) => ModelKind::Uniform,
        Err(_) => return Err(wrong("kind", format!("{} is not known", wire.kind))),
    };
    if let (Some(found), None) = (wire.parameter, parameter_of(kind)) {
        return Err(wrong("parameter", format!("{found} was given, but this model has none")));
    }
    if wire.cycle != 0 && !matches!(kind, ModelKind::Histogram { .. }) {
        return Err(wrong("cycle", "only a histogram has one".to_owned()));
    }
    if let (Some(period), false) = (wire.period, matches!(kind, ModelKind::Pergam { .. })) {
        return Err(wrong("period", format!("{} s was given, but only pergam has one", period.seconds)));
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
    if wire.persistence && wire.memory {
        return Err(wrong("memory", "use either persistence or memory, not both".to_owned()));
    }
    Ok(ModelSelector { kind, order, persistence: wire.persistence, memory: wire.memory })
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
        "all cells at once have no model {}: use auto, mean, latest or spectral; cells by name have it",
        selector.kind
    );
    Err(InvalidField::new(format!("{field}.kind"), text))
}

/// The period of a periodic mixture.
fn period_from_wire(field: &str, period: Option<prost_types::Duration>) -> Result<i64, InvalidField> {
    let field = format!("{field}.period");
    let Some(period) = period else { return Ok(PERGAM_PERIOD_NANOS) };
    let nanos = nanos_from_duration(&field, period)?;
    if PERGAM_PERIODS.contains(&nanos) {
        return Ok(nanos);
    }
    Err(InvalidField::new(field, format!("{} s: 1 minute to 366 days are possible", nanos as f64 / 1e9)))
}

/// The parameter of a kind that has one.
fn parameter_of(kind: ModelKind) -> Option<u32> {
    match kind {
        ModelKind::Histogram { bins: parameter, .. }
        | ModelKind::Pergam { gaussians: parameter, .. }
        | ModelKind::HypertimeEm { clusters: parameter }
        | ModelKind::HypertimeKm { clusters: parameter } => Some(parameter),
        _ => None,
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
    let kind = match selector.kind {
        ModelKind::Auto => v1::ModelKind::Auto,
        ModelKind::Mean => v1::ModelKind::Mean,
        ModelKind::Latest => v1::ModelKind::Latest,
        ModelKind::Spectral => v1::ModelKind::Spectral,
        ModelKind::Persistence => v1::ModelKind::Persistence,
        ModelKind::Histogram { .. } => v1::ModelKind::Histogram,
        ModelKind::Pergam { .. } => v1::ModelKind::Pergam,
        ModelKind::HypertimeEm { .. } => v1::ModelKind::HypertimeEm,
        ModelKind::HypertimeKm { .. } => v1::ModelKind::HypertimeKm,
        ModelKind::Poisson => v1::ModelKind::Poisson,
        ModelKind::Calibrated => v1::ModelKind::Calibrated,
        ModelKind::Uniform => v1::ModelKind::Uniform,
    };
    let cycle = match selector.kind {
        ModelKind::Histogram { cycle: HistogramCycle::Day, .. } => v1::HistogramCycle::Day,
        ModelKind::Histogram { cycle: HistogramCycle::Week, .. } => v1::HistogramCycle::Week,
        ModelKind::Histogram { cycle: HistogramCycle::WeekdayWeekend, .. } => v1::HistogramCycle::WeekdayWeekend,
        _ => v1::HistogramCycle::Unspecified,
    };
    let period = match selector.kind {
        ModelKind::Pergam { period_nanos, .. } if period_nanos != PERGAM_PERIOD_NANOS => Some(duration(period_nanos)),
        _ => None,
    };
    v1::ModelSelector {
        kind: kind.into(),
        order: selector.order.map(|order| u32::try_from(order).unwrap_or(u32::MAX)),
        persistence: selector.persistence,
        memory: selector.memory && !selector.persistence,
        parameter: parameter_of(selector.kind),
        cycle: cycle.into(),
        period,
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
        learned_observations: model.accumulator().observations(),
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
    date_or_empty(model.alternatives().and_then(|alternatives| alternatives.alarm().rang_on()))
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
