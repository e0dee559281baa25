//! Models as questions name them, and what was learned of a state.

use tidemap_map::{
    event::StateId,
    predict::{ModelKind, ModelSelector},
    view::MapView,
};
use tidemap_model::{Component, MAX_ORDER, SpectralModel};

use super::{InvalidField, map::kind_to_wire, time::timestamp};
use crate::v1;

/// The model that a request names.
///
/// # Errors
/// An unknown kind, an order above 15, or an order for a model that has none.
pub fn selector_from_wire(field: &str, wire: Option<v1::ModelSelector>) -> Result<ModelSelector, InvalidField> {
    let wire = wire.unwrap_or_default();
    let kind = match v1::ModelKind::try_from(wire.kind) {
        Ok(v1::ModelKind::Unspecified | v1::ModelKind::Auto) => ModelKind::Auto,
        Ok(v1::ModelKind::Mean) => ModelKind::Mean,
        Ok(v1::ModelKind::Latest) => ModelKind::Latest,
        Ok(v1::ModelKind::Spectral) => ModelKind::Spectral,
        Err(_) => return Err(InvalidField::new(format!("{field}.kind"), format!("{} is not known", wire.kind))),
    };
    let order = match wire.order {
        None => None,
        Some(order) if matches!(kind, ModelKind::Mean | ModelKind::Latest) => {
            let text = format!("order {order} was given, but this model has none: use it with auto or spectral");
            return Err(InvalidField::new(format!("{field}.order"), text));
        }
        Some(order) => Some(order_from_wire(&format!("{field}.order"), order)?),
    };
    Ok(ModelSelector { kind, order, persistence: wire.persistence })
}

/// An order from the wire.
///
/// # Errors
/// An order above 15.
pub fn order_from_wire(field: &str, order: u32) -> Result<usize, InvalidField> {
    usize::try_from(order)
        .ok()
        .filter(|order| *order <= MAX_ORDER)
        .ok_or_else(|| InvalidField::new(field, format!("order {order} is too high: 0 to {MAX_ORDER} are possible")))
}

/// A model for the wire.
#[must_use]
pub fn selector_to_wire(selector: ModelSelector) -> v1::ModelSelector {
    let kind = match selector.kind {
        ModelKind::Auto => v1::ModelKind::Auto,
        ModelKind::Mean => v1::ModelKind::Mean,
        ModelKind::Latest => v1::ModelKind::Latest,
        ModelKind::Spectral => v1::ModelKind::Spectral,
    };
    let order = selector.order.map(|order| u32::try_from(order).unwrap_or(u32::MAX));
    v1::ModelSelector { kind: kind.into(), order, persistence: selector.persistence }
}

/// What was learned of a state; `None` where the view has no such state.
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
        folded_observations: model.accumulator().observations(),
        observations: live.observations,
        order: u32::try_from(model.order()).unwrap_or(u32::MAX),
        components: components_to_wire(view, spectral),
        order_errors: model.errors().sums().to_vec(),
        persistence_tau_secs: live.persistence.tau_secs(),
        last_value: live.persistence.last().map(|(_, value)| value),
        last_time: live.persistence.last().map(|(nanos, _)| timestamp(nanos)),
        first_time: model.accumulator().first_nanos().map(timestamp),
    })
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
