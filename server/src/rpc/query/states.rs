//! Predictions of states and cells at many times, and what was learned of one.
//!
//! Invariant: the phasors of a block of times are computed once and shared by all states and cells.

use std::sync::Arc;

use tidemap_map::{
    event::StateId,
    grid::{index::CellIndex, view::CellDescription},
    predict::ModelSelector,
    view::MapView,
};
use tidemap_model::{Persistence, entropy_bits};
use tidemap_proto::{
    convert::{
        InvalidField,
        cells::cell_description_to_wire,
        query::{description_to_wire, selector_from_wire},
        time::timestamp,
    },
    v1,
};

use tokio::sync::OwnedSemaphorePermit;

use super::{
    Queries, STATES_MAX, check_limit, find_state,
    replies::{Computed, Replies, computed},
};
use crate::rpc::{map::find_map, status::RpcError};

/// Times whose phasors are held at once: some 10 MB at 168 periodicities.
const TIMES_PER_BLOCK: usize = 4096;

/// What a name stands for.
enum Named {
    State(StateId),
    Cell(CellIndex, Box<CellDescription>),
}

/// The cell of a name, where it is one.
pub(super) fn cell_of(field: &str, name: &str) -> Result<Option<CellIndex>, RpcError> {
    CellIndex::from_name(name).transpose().map_err(|error| InvalidField::new(field, error).into())
}

/// What is known of a cell.
pub(super) fn find_cell(view: &MapView, cell: CellIndex) -> Result<CellDescription, RpcError> {
    let map = || view.spec().name.as_str().to_owned();
    let grid = view.grid().ok_or_else(|| RpcError::NoGrid { map: map() })?;
    grid.describe(cell)?.ok_or_else(|| RpcError::UnknownCell { map: map(), name: cell.name() })
}

/// What names stand for, and the turn again. `field` gives the name of the field of each.
async fn find_all(
    view: &Arc<MapView>,
    turn: OwnedSemaphorePermit,
    field: fn(usize) -> String,
    names: Vec<String>,
) -> Result<(Vec<Named>, OwnedSemaphorePermit), RpcError> {
    let view = Arc::clone(view);
    let any_cell = names.iter().any(|name| matches!(CellIndex::from_name(name), Some(Ok(_))));
    let find = move || {
        let find = |(i, name): (usize, &String)| match cell_of(&field(i), name)? {
            Some(cell) => Ok(Named::Cell(cell, Box::new(find_cell(&view, cell)?))),
            None => find_state(&view, name).map(Named::State),
        };
        let named = names.iter().enumerate().map(find).collect::<Result<_, RpcError>>()?;
        Ok((named, turn))
    };
    // A cell may have to be read from the disk. The turn lasts as long as that, even if nobody waits any more.
    if any_cell { tokio::task::spawn_blocking(find).await.map_err(|_| RpcError::Stopping)? } else { find() }
}

pub(super) async fn predict_states(
    queries: &Queries,
    request: v1::PredictStatesRequest,
) -> Result<Replies<v1::PredictStatesResponse>, RpcError> {
    let view = find_map(&queries.catalog, &request.map)?.view();
    if request.states.is_empty() {
        return Err(InvalidField::new("states", "name at least one state").into());
    }
    check_limit("states", request.states.len() as u64, STATES_MAX as u64, "one request")?;
    if request.times_nanos.is_empty() {
        return Err(InvalidField::new("times_nanos", "name at least one time").into());
    }
    if let Some(index) = request.times_nanos.iter().position(|&nanos| nanos < 0) {
        let text = format!("{} ns is before 1970", request.times_nanos[index]);
        return Err(InvalidField::new(format!("times_nanos[{index}]"), text).into());
    }
    let predictions = request.states.len() as u64 * request.times_nanos.len() as u64;
    check_limit("predictions", predictions, queries.max_predictions, "setting max_predictions")?;
    let selector = selector_from_wire("model", request.model)?;
    let turn = queries.turns.take().await?;
    let (named, turn) = find_all(&view, turn, |i| format!("states[{i}]"), request.states).await?;
    Ok(computed(turn, move |computed| {
        predict(&view, &named, &request.times_nanos, selector, computed);
        Ok(())
    }))
}

/// Computes the replies until all are taken or nobody takes them.
fn predict(
    view: &MapView,
    named: &[Named],
    times_nanos: &[i64],
    selector: ModelSelector,
    computed: &Computed<v1::PredictStatesResponse>,
) {
    for (block, times) in times_nanos.chunks(TIMES_PER_BLOCK).enumerate() {
        let prepared = view.prepare(times);
        for (state_index, named) in named.iter().enumerate() {
            let mut probabilities = vec![0.0; times.len()];
            let (order, observations, persistence): (usize, u64, Persistence) = match named {
                Named::State(id) => {
                    view.predict_into(*id, &prepared, selector, &mut probabilities);
                    let live = view.live(*id);
                    (selector.order_for(view.model(*id)), live.observations, live.persistence)
                }
                Named::Cell(_, cell) => {
                    view.predict_cell_into(cell, &prepared, selector, &mut probabilities);
                    (selector.order_for_cell(cell), cell.observations, cell.persistence)
                }
            };
            let reply = v1::PredictStatesResponse {
                state_index: u32::try_from(state_index).unwrap_or(u32::MAX),
                first_time_index: u32::try_from(block * TIMES_PER_BLOCK).unwrap_or(u32::MAX),
                entropies_bits: probabilities.iter().map(|&probability| entropy_bits(probability)).collect(),
                probabilities,
                lower: Vec::new(),
                upper: Vec::new(),
                order: u32::try_from(order).unwrap_or(u32::MAX),
                observations,
                last_time: persistence.last().map(|(nanos, _)| timestamp(nanos)),
            };
            if !computed.send(reply) {
                return;
            }
        }
    }
}

pub(super) async fn describe_model(
    queries: &Queries,
    request: v1::DescribeModelRequest,
) -> Result<v1::DescribeModelResponse, RpcError> {
    let view = find_map(&queries.catalog, &request.map)?.view();
    let turn = queries.turns.take().await?;
    let (mut found, _turn) = find_all(&view, turn, |_| "state".to_owned(), vec![request.state]).await?;
    Ok(match found.pop() {
        Some(Named::State(id)) => description_to_wire(&view, id).unwrap_or_default(),
        Some(Named::Cell(cell, description)) => cell_description_to_wire(&view, cell, &description),
        None => v1::DescribeModelResponse::default(),
    })
}
