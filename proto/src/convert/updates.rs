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

#[cfg(test)]
mod tests {
    use tidemap_grid::outcome::TileOutcome;
    use tidemap_map::name::StateName;
    use tidemap_model::{ORDER_MAX, UpdateOutcome};

    use super::*;

    fn state(kind: ModelKind, scored: u64) -> v1::StateUpdate {
        let mut squared_errors = [8.0; ORDER_MAX + 1];
        squared_errors[2] = 2.0;
        let outcome = UpdateOutcome {
            order_before: 1,
            order: 2,
            observations: 5,
            scored,
            squared_errors,
            squared_error_in_force: 3.0,
        };
        let name = StateName::new("door").expect("valid");
        state_update_to_wire(&StateOutcome {
            name,
            outcome,
            chosen: ModelSelector { kind, ..ModelSelector::default() },
        })
    }

    #[test]
    fn the_error_of_a_state_is_that_of_the_model_that_predicts_from_now_on() {
        let errors = |update: v1::StateUpdate| (update.mean_squared_error_before, update.mean_squared_error);
        assert_eq!(errors(state(ModelKind::Spectral, 4)), (Some(2.0), Some(0.5)));
        assert_eq!(errors(state(ModelKind::Mean, 4)), (Some(2.0), Some(0.75)));
        assert_eq!(errors(state(ModelKind::Mean, 0)), (None, None), "nothing was scored");
        let update = state(ModelKind::Spectral, 4);
        assert_eq!((update.state.as_str(), update.order_before, update.order), ("door", 1, 2));
    }

    #[test]
    fn the_row_of_cells_has_the_most_frequent_order_and_in_a_tie_the_lower_one() {
        let by_order = |counts: [u64; 3]| {
            let mut by_order = [0; ORDER_MAX + 1];
            by_order[..3].copy_from_slice(&counts);
            by_order
        };
        let cells =
            TileOutcome { scored: 4, squared_error_in_force: 2.0, squared_error_chosen: 1.0, ..TileOutcome::default() };
        let update = cells_update_to_wire(&GridOutcome {
            cells,
            cells_by_order_before: by_order([0, 3, 3]),
            cells_by_order: by_order([1, 2, 5]),
            ..GridOutcome::default()
        });
        assert_eq!((update.state.as_str(), update.order_before, update.order), ("cell/*", 1, 2));
        assert_eq!((update.mean_squared_error_before, update.mean_squared_error), (Some(0.5), Some(0.25)));
    }
}
