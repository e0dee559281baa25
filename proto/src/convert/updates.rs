//! Reports of updates: the orders and errors of each state, and of all cells of the grid together.
//!
//! Invariant: a row without scored observations has no errors.

use tidemap_grid::outcome::GridOutcome;
use tidemap_map::update::StateOutcome;
use tidemap_model::selector::{ModelKind, ModelSelector};

use super::query::selector_to_wire;
use crate::v1;

/// The name of the row of all cells.
const CELLS: &str = "cell/*";

fn order_to_wire(order: usize) -> u32 {
    u32::try_from(order).unwrap_or(u32::MAX)
}

/// The order that most cells have; in a tie the lower one.
fn most_frequent_order(cells_by_order: &[u64]) -> usize {
    let orders = cells_by_order.iter().enumerate().rev();
    orders.max_by_key(|(_, cells)| **cells).map_or(0, |(order, _)| order)
}

/// The row of all cells of the grid for the wire: the most frequent orders, and the errors with each cell's own order.
#[must_use]
pub fn cells_update_to_wire(grid: &GridOutcome) -> v1::StateUpdate {
    let cells = &grid.cells;
    let scored = (cells.scored > 0).then_some(cells.scored as f64);
    let order = most_frequent_order(&grid.cells_by_order);
    v1::StateUpdate {
        state: CELLS.to_owned(),
        order_before: order_to_wire(most_frequent_order(&grid.cells_by_order_before)),
        order: order_to_wire(order),
        mean_squared_error_before: scored.map(|scored| cells.squared_error_in_force / scored),
        mean_squared_error: scored.map(|scored| cells.squared_error_chosen / scored),
        observations: cells.observations,
        scored: cells.scored,
        model: Some(selector_to_wire(ModelSelector::default().answering_with(order))),
    }
}

/// The sum of squared errors of the model that predicts a state from now on. Each error is that of the model on the day
/// of the observation.
fn squared_error(StateOutcome { outcome, chosen, .. }: &StateOutcome) -> f64 {
    if chosen.kind == ModelKind::Spectral {
        outcome.squared_errors[outcome.order]
    } else {
        outcome.squared_error_in_force
    }
}

/// The row of a state for the wire.
#[must_use]
pub fn state_update_to_wire(entry: &StateOutcome) -> v1::StateUpdate {
    let outcome = &entry.outcome;
    let scored = (outcome.scored > 0).then_some(outcome.scored as f64);
    v1::StateUpdate {
        state: entry.name.as_str().to_owned(),
        order_before: order_to_wire(outcome.order_before),
        order: order_to_wire(outcome.order),
        mean_squared_error_before: scored.map(|scored| outcome.squared_errors[outcome.order_before] / scored),
        mean_squared_error: scored.map(|scored| squared_error(entry) / scored),
        observations: outcome.observations,
        scored: outcome.scored,
        model: Some(selector_to_wire(entry.chosen)),
    }
}
