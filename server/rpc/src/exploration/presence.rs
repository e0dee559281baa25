//! The probability of each location that it has one person or object, which is at exactly one of the locations at any
//! time.
//!
//! Invariant: a row per location, with a probability per time; they sum to 1 at each time. Readings after the first of
//! the times do not count.

use std::sync::Arc;

use tidemap_answer::StateOrCell;
use tidemap_ingest::handle::MapHandle;
use tidemap_map::view::MapView;
use tidemap_model::StopSignal;
use tidemap_plan::presence::{READINGS_MAX_NANOS, Sighting, presence_series};

use super::{Explorations, locations::Locations};
use crate::{
    permits::run_while_awaited,
    status::{PlanError, Problem, RpcError},
};

/// The probability that the person or object is at each location, at each of the ascending times.
///
/// # Errors
/// A location has not exactly one state, there are fewer than 2 locations or more than 64, the map keeps no history of
/// states, or they have too many readings.
pub(super) async fn predict_presence(
    explorations: &Explorations,
    handle: &Arc<MapHandle>,
    view: &Arc<MapView>,
    locations: &Locations,
    (slot_nanos, times_nanos): (i64, Vec<i64>),
) -> Result<Vec<Vec<f64>>, RpcError> {
    let state_of = |(name, states): (&String, &Vec<StateOrCell>)| match states.as_slice() {
        [StateOrCell::State(id)] => Ok(*id),
        _ => Err(Problem::NotOneState { location: name.clone(), members: states.len() }.of("exactly_one")),
    };
    let states = locations.names.iter().zip(&locations.members).map(state_of).collect::<Result<Vec<_>, _>>()?;
    let first_nanos = times_nanos.first().copied().unwrap_or_default();
    let within_nanos = first_nanos.saturating_sub(READINGS_MAX_NANOS)..first_nanos.saturating_add(1);
    let readings = explorations.trainer.readings(handle, view, &states, within_nanos).await?;
    let view = Arc::clone(view);
    let predict = move |stop: StopSignal<'_>| {
        let of_place = |(place, readings): (usize, &Vec<(i64, f64)>)| {
            let sighting =
                move |&(utc_nanos, value): &(i64, f64)| Sighting { utc_nanos, place, is_there: value >= 0.5 };
            readings.iter().map(sighting).collect::<Vec<_>>()
        };
        let sightings: Vec<Sighting> = readings.iter().enumerate().flat_map(of_place).collect();
        let offset = |utc_nanos| view.moments(&[utc_nanos]).first().map_or(0, |moment| moment.offset_secs);
        presence_series(readings.len(), &sightings, &times_nanos, slot_nanos, offset, stop)
    };
    let permit = explorations.permits.take().await?;
    Ok(run_while_awaited(permit, None, predict).await?.map_err(PlanError::from)?)
}
