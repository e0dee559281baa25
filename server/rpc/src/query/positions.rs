//! `PredictPositions`: where something will be, as probabilities of the cells of a region.
//!
//! Invariant: the probabilities of the cells of a time and of everything outside sum up to 1. The number of cells is
//! checked before anything is trained or computed, except for a region that follows from the observations.

use std::sync::Arc;

use tidemap_answer::PositionModel;
use tidemap_map::{
    event::{Dimensions, StateShape},
    ids::StateId,
    view::MapView,
};
use tidemap_model::models::Moment;
use tidemap_proto::{
    convert::query::{
        ExpectedPositions, PositionRaster, PositionRegion, PositionsQuestion, position_cells_to_wire,
        positions_from_wire, positions_header_to_wire,
    },
    v1::{self, predict_positions_response::Message},
};

use super::Queries;
use crate::{
    lookup::{check_limit, find_map, find_state},
    permits::run_blocking,
    replies::{Replies, ReplySink, stream_replies},
    status::{Misfit, Problem, RpcError},
    training::LearnedState,
};

#[cfg(test)]
mod tests;

/// Maximum number of cells of one time: 24 MB.
const CELLS_MAX: u64 = 1_000_000;
/// Number of cells in one reply.
const CELLS_PER_REPLY: usize = 65_536;
/// Number of cells along the longest side of a region, if no resolution is given.
const CELLS_FLAT: f64 = 64.0;
const CELLS_DEEP: f64 = 24.0;
/// Margin of the observations on each side, as a share of their longest side.
const MARGIN: f64 = 0.1;
/// A window is summed in steps of at most five minutes.
const STEP_NANOS: i64 = 300 * 1_000_000_000;
/// Longest side of a region whose observations are all at one place, metres.
const ONE_PLACE_M: f64 = 1.0;

/// Cells that cover a region.
#[derive(Clone, Debug, PartialEq)]
struct Cells {
    low_m: Vec<f64>,
    edge_m: f64,
    counts: Vec<usize>,
}

impl Cells {
    /// Cells of a region, with the default edge if none is given.
    fn of(low_m: &[f64], high_m: &[f64], edge_m: Option<f64>) -> Self {
        let sides: Vec<f64> = low_m.iter().zip(high_m).map(|(low, high)| high - low).collect();
        let longest = sides.iter().copied().fold(0.0, f64::max);
        let usual = if sides.len() > 2 { CELLS_DEEP } else { CELLS_FLAT };
        let edge_m = edge_m.unwrap_or(longest / usual);
        // A fraction of a cell as small as this is rounding.
        let count = |side: f64| (side / edge_m - 1e-9).ceil().max(1.0) as usize;
        Self { low_m: low_m.to_vec(), edge_m, counts: sides.into_iter().map(count).collect() }
    }

    /// The cells of the region of observations, with a margin.
    fn around(low_m: &[f64], high_m: &[f64], edge_m: Option<f64>) -> Self {
        let longest = low_m.iter().zip(high_m).map(|(low, high)| high - low).fold(0.0, f64::max);
        let greatest = low_m.iter().chain(high_m).fold(0.0_f64, |greatest, number| greatest.max(number.abs()));
        // The side is large enough not to be lost beside the coordinates.
        let longest = if longest > (1e-9 * greatest).max(1e-9) { longest } else { ONE_PLACE_M.max(1e-6 * greatest) };
        let margin = (MARGIN * longest).max(edge_m.unwrap_or(0.0));
        let low: Vec<f64> = low_m.iter().map(|low| low - margin).collect();
        let high: Vec<f64> = high_m.iter().map(|high| high + margin).collect();
        Self::of(&low, &high, edge_m)
    }

    fn number(&self) -> u64 {
        self.counts.iter().fold(1, |all, &count| all.saturating_mul(count as u64))
    }
}

/// Limits of the cells of a question.
#[derive(Clone, Copy)]
struct CellLimits {
    times: u64,
    /// Number of steps of the window of a time.
    steps: u64,
    max_predictions: u64,
}

impl CellLimits {
    fn check(self, cells: &Cells) -> Result<(), RpcError> {
        let all = cells.number().saturating_mul(self.times).saturating_mul(self.steps);
        let what = "cells of all times, every five minutes of a window";
        check_limit(what, all, self.max_predictions, "setting max_predictions")?;
        check_limit("cells of one time", cells.number(), CELLS_MAX, "one request")
    }
}

pub(super) async fn predict_positions(
    queries: &Queries,
    request: v1::PredictPositionsRequest,
) -> Result<Replies<v1::PredictPositionsResponse>, RpcError> {
    let handle = find_map(&queries.catalog, &request.map).await?;
    let question = positions_from_wire(request)?;
    let view = handle.view();
    let (first, dimensions) = find_vector(&view, "state", &question.state)?;
    let limits = CellLimits {
        times: question.times_nanos.len() as u64,
        steps: question.window_nanos.map_or(1, steps_of),
        max_predictions: queries.max_predictions,
    };
    let cells = question.region.as_ref().map(|region| cells_of(region, dimensions, question.edge_m)).transpose()?;
    cells.as_ref().map_or(Ok(()), |cells| limits.check(cells))?;
    let axes = (first.0..).take(dimensions.count()).map(StateId);
    let axes = axes.map(|id| LearnedState::new(Arc::clone(&handle), Arc::clone(&view), id.into())).collect();
    let model = queries.trainer.position_model(axes, question.kind).await?;
    let (low, high) = model.bounds_m();
    let cells = cells.unwrap_or_else(|| Cells::around(low, high, question.edge_m));
    limits.check(&cells)?;
    let (moments, permits) = (moments_of(&view, &question), queries.large_permits.clone());
    Ok(stream_replies(move |sink| async move {
        let sink = sink.holding(vec![permits.take().await?]);
        let predict = move || {
            if sink.send(header(&view, first, &model, &cells)) {
                send_cells(&model, &cells, &moments, question.window_nanos, question.top, &sink);
            }
        };
        run_blocking((), predict).await
    }))
}

/// The first axis of a vector that a field names, and its number of axes.
pub(super) fn find_vector(view: &MapView, field: &str, name: &str) -> Result<(StateId, Dimensions), RpcError> {
    match view.shape(name) {
        Some((first, StateShape::Vector(dimensions))) => Ok((first, dimensions)),
        Some((_, shape @ (StateShape::Scalar(_) | StateShape::Angle | StateShape::Categorical(_)))) => {
            Err(Problem::NoVector { state: name.to_owned(), shape }.of(field).into())
        }
        // This returns the error of an unknown name.
        None => find_state(view, name).map(|first| (first, Dimensions::Two)),
    }
}

/// The cells of a region of a vector's positions.
fn cells_of(region: &PositionRegion, dimensions: Dimensions, edge_m: Option<f64>) -> Result<Cells, Misfit> {
    let expected = dimensions.count();
    for (field, corner) in [("region.low_m", &region.low_m), ("region.high_m", &region.high_m)] {
        if corner.len() != expected {
            return Err(Problem::Coordinates { found: corner.len(), expected }.of(field));
        }
    }
    Ok(Cells::of(&region.low_m, &region.high_m, edge_m))
}

/// The moments of each time of a question: the time itself, or the middles of its window's steps.
fn moments_of(view: &MapView, question: &PositionsQuestion) -> Vec<Vec<Moment>> {
    match question.window_nanos {
        None => view.moments(&question.times_nanos).into_iter().map(|moment| vec![moment]).collect(),
        Some(window) => question.times_nanos.iter().map(|&start| view.moments(&middles(start, window))).collect(),
    }
}

/// Number of steps of a window.
fn steps_of(window: i64) -> u64 {
    window.div_euclid(STEP_NANOS).unsigned_abs() + 1
}

/// The middles of a window's steps.
fn middles(start: i64, window: i64) -> Vec<i64> {
    let steps = steps_of(window);
    let middle = |step: u64| {
        let offset = i128::from(window) * (2 * i128::from(step) + 1) / (2 * i128::from(steps));
        start.saturating_add(i64::try_from(offset).unwrap_or(i64::MAX))
    };
    (0..steps).map(middle).collect()
}

fn header(view: &MapView, first: StateId, model: &PositionModel, cells: &Cells) -> v1::PredictPositionsResponse {
    let live = view.live(first);
    let header = PositionRaster {
        low_m: cells.low_m.clone(),
        edge_m: cells.edge_m,
        counts: cells.counts.clone(),
        observations: live.observations,
        trained_observations: model.positions(),
        last_nanos: live.persistence.last().map(|(nanos, _)| nanos),
        generation: view.generation(),
    };
    v1::PredictPositionsResponse { message: Some(Message::Header(positions_header_to_wire(header))) }
}

/// The expected positions at a time, or in the window that begins then.
struct Expected {
    probabilities: Vec<f64>,
    mean_m: Vec<f64>,
    /// Number of positions in the window; 0 without one.
    count: f64,
}

/// The mean over a window's steps, each weighted by the number of positions expected then; without a window there is
/// one step. `None` if the reader is gone.
fn expected(
    model: &PositionModel,
    cells: &Cells,
    moments: &[Moment],
    window: Option<i64>,
    is_gone: &dyn Fn() -> bool,
) -> Option<Expected> {
    let rates: Vec<f64> = moments.iter().map(|&moment| model.per_sec(moment)).collect();
    let all: f64 = rates.iter().sum();
    let mut found = Expected {
        probabilities: vec![0.0; usize::try_from(cells.number()).ok()?],
        mean_m: vec![0.0; cells.counts.len()],
        count: window.map_or(0.0, |window| all / moments.len() as f64 * (window as f64 / 1e9)),
    };
    for (&moment, rate) in moments.iter().zip(rates) {
        if is_gone() {
            return None;
        }
        let share = if moments.len() == 1 { 1.0 } else { rate / all };
        let at = model.at(moment)?;
        let of_step = at.cells(&cells.low_m, cells.edge_m, &cells.counts)?;
        found.probabilities.iter_mut().zip(of_step).for_each(|(sum, probability)| *sum += share * probability);
        found.mean_m.iter_mut().zip(at.mean()).for_each(|(sum, mean)| *sum += share * mean);
    }
    Some(found)
}

/// Computes and sends the cells of each time, until the client is gone.
fn send_cells(
    model: &PositionModel,
    cells: &Cells,
    moments: &[Vec<Moment>],
    window: Option<i64>,
    top: usize,
    sink: &ReplySink<v1::PredictPositionsResponse>,
) {
    for (time_index, moments) in (0..).zip(moments) {
        let Some(expected) = expected(model, cells, moments, window, &|| sink.is_closed()) else { return };
        let inside: f64 = expected.probabilities.iter().sum();
        let mut found: Vec<(u32, f64)> =
            (0..).zip(expected.probabilities).filter(|(_, probability)| *probability > 0.0).collect();
        found.sort_by(|(place, one), (other_place, other)| other.total_cmp(one).then(place.cmp(other_place)));
        found.truncate(top);
        let (mean_m, count, outside) = (expected.mean_m, expected.count, (1.0 - inside).clamp(0.0, 1.0));
        let forecast = ExpectedPositions { cells: found, mean_m, outside, count };
        for cells in position_cells_to_wire(time_index, forecast, CELLS_PER_REPLY) {
            if !sink.send(v1::PredictPositionsResponse { message: Some(Message::Cells(cells)) }) {
                return;
            }
        }
    }
}
