//! `PredictAtPlaces`: a state by place and time.
//!
//! Invariant: the number of predictions and densities is checked before anything is fitted. Answers are in the order of
//! the places, and of the times of each.

use std::sync::Arc;

use tidemap_map::ids::StateId;
use tidemap_model::{StopSignal, VALUE_MAX};
use tidemap_proto::{convert::InvalidField, v1};

use super::{Queries, positions};
use crate::rpc::{
    fitting::LearnedState,
    lookup::{check_limit, find_all, find_map},
    permits::run_while_awaited,
    status::RpcError,
};

/// Maximum number of predictions of a request.
const PREDICTIONS_MAX: u64 = 100_000;
/// Maximum number of densities of a request.
const DENSITIES_MAX: u64 = 1_000_000;

pub(super) async fn predict_at_places(
    queries: &Queries,
    request: v1::PredictAtPlacesRequest,
) -> Result<v1::PredictAtPlacesResponse, RpcError> {
    let handle = find_map(&queries.catalog, &request.map).await?;
    let view = handle.view();
    let found = find_all(&view, |_| "state".to_owned(), vec![request.state.clone()]).await?;
    let state = found.into_iter().next().ok_or(RpcError::Stopping)?;
    let (first, dimensions) = positions::find_vector(&view, &request.position_state)?;
    positions::check_times(&request.times_nanos)?;
    let coordinates = dimensions.count();
    check_numbers("places_m", &request.places_m)?;
    check_numbers("density_values", &request.density_values)?;
    if request.places_m.is_empty() || !request.places_m.len().is_multiple_of(coordinates) {
        let text = format!("{} numbers: each place has {coordinates}", request.places_m.len());
        return Err(InvalidField::new("places_m", text).into());
    }
    if !(0.0..1.0).contains(&request.interval_level) {
        let text = format!("{} is not a level: use 0 or more, and below 1", request.interval_level);
        return Err(InvalidField::new("interval_level", text).into());
    }
    let kind = positions::model_of(request.model)?;
    let predictions = (request.places_m.len() / coordinates) as u64 * request.times_nanos.len() as u64;
    check_limit("predictions, places times times", predictions, PREDICTIONS_MAX, "one request")?;
    let densities = predictions.saturating_mul(request.density_values.len() as u64);
    check_limit("densities", densities, DENSITIES_MAX, "one request")?;
    let learned = |of| LearnedState::new(Arc::clone(&handle), Arc::clone(&view), of);
    let axes = (first.0..).take(coordinates).map(|axis| learned(StateId(axis).into())).collect();
    let observations = state.learned(&view);
    let model = queries.fitting.place_model(learned(state), axes, first, kind).await?;
    let permit = queries.permits.take().await?;
    let (moments, generation) = (view.moments(&request.times_nanos), view.generation());
    let predict = move |stop: StopSignal<'_>| {
        let mut reply = v1::PredictAtPlacesResponse {
            observations,
            fitted_observations: model.observations(),
            generation,
            ..v1::PredictAtPlacesResponse::default()
        };
        for place_m in request.places_m.chunks_exact(coordinates) {
            if stop.is_set() {
                // Nobody reads the reply.
                break;
            }
            for &moment in &moments {
                // A place of finite numbers has a distribution.
                let Some(at) = model.at(place_m, moment) else { continue };
                reply.expected.extend(at.mean());
                reply.deviations.extend(at.variance().into_iter().map(f64::sqrt));
                if let Some((lower, upper)) =
                    at.interval(request.interval_level).filter(|_| request.interval_level > 0.0)
                {
                    reply.lower.push(lower);
                    reply.upper.push(upper);
                }
                let density = |value: &f64| at.density(&[*value], &[0.0]).unwrap_or(0.0);
                reply.densities.extend(request.density_values.iter().map(density));
            }
        }
        reply
    };
    run_while_awaited(permit, None, predict).await
}

fn check_numbers(field: &str, numbers: &[f64]) -> Result<(), InvalidField> {
    let wrong = numbers.iter().position(|number| number.is_nan() || number.abs() > VALUE_MAX);
    wrong.map_or(Ok(()), |i| {
        let text = format!("{} is not a number from -1e12 to 1e12", numbers[i]);
        Err(InvalidField::new(format!("{field}[{i}]"), text))
    })
}
