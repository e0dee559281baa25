//! The worth of an observation of each state or cell, at each time.
//!
//! Invariant: a row per state or cell, with a worth per time in bits, at least 0.

use std::sync::Arc;

use tidemap_answer::StateOrCell;
use tidemap_map::view::MapView;
use tidemap_model::{InformationMeasure, StopSignal};
use tidemap_plan::information::LookWorth;

use super::Explorations;
use crate::{permits::run_while_awaited, status::RpcError};

/// The worth of an observation of each of the states or cells at each of the times (nanoseconds UTC). `rows` has the
/// probabilities of the states or cells.
pub(super) async fn look_worths(
    explorations: &Explorations,
    view: &Arc<MapView>,
    (states, times_nanos): (Vec<StateOrCell>, &[i64]),
    rows: &[Vec<f64>],
    worth: LookWorth,
) -> Result<Vec<Vec<f64>>, RpcError> {
    if worth.measure == InformationMeasure::RaL {
        let of_row = |row: &Vec<f64>| row.iter().map(|&p| worth.bits(p, None)).collect();
        return Ok(rows.iter().map(of_row).collect());
    }
    let (view, moments, rows) = (Arc::clone(view), view.moments(times_nanos), rows.to_vec());
    let weigh = move |stop: StopSignal<'_>| {
        let of_state = |(state, row): (&StateOrCell, &Vec<f64>)| {
            stop.check()?;
            let known = state.predictive_around(&view, &moments, row);
            let bits =
                |(time, &p): (usize, &f64)| worth.bits(p, known.as_ref().and_then(|known| known.get(time).copied()));
            Ok(row.iter().enumerate().map(bits).collect())
        };
        states.iter().zip(&rows).map(of_state).collect::<Result<Vec<Vec<f64>>, tidemap_model::EarlyStop>>()
    };
    Ok(run_while_awaited(explorations.permits.take().await?, None, weigh).await??)
}
