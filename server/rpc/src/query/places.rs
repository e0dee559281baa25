//! `PredictAtPlaces`: a state by place and time.
//!
//! Invariant: the number of predictions and densities is checked before anything is trained. Answers are in the order
//! of the places, and of the times of each.

use std::sync::Arc;

use tidemap_answer::PlaceModel;
use tidemap_map::{event::StateShape, ids::StateId};
use tidemap_model::{
    ANGLE_AXES, StopSignal, circular_deviation_rad, direction_rad, models::Moment, special::normal_reach,
};
use tidemap_proto::{
    convert::query::{PlacesForecast, PlacesQuestion, places_from_wire, places_to_wire},
    v1,
};

use super::{Queries, positions::find_vector};
use crate::{
    lookup::{check_limit, find_all, find_map},
    permits::run_while_awaited,
    status::{Problem, RpcError},
    training::LearnedState,
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
    let question = places_from_wire(request)?;
    let view = handle.view();
    // An angle is learned as its cosine and its sine.
    let is_angle = matches!(view.shape(&question.state), Some((_, StateShape::Angle)));
    let names = match is_angle {
        true => ANGLE_AXES.map(|axis| format!("{}/{axis}", question.state)).to_vec(),
        false => vec![question.state.clone()],
    };
    if is_angle && !question.density_values.is_empty() {
        return Err(Problem::NoDensity { state: question.state }.of("density_values").into());
    }
    let states = find_all(&view, |_| "state".to_owned(), names).await?;
    let state = states.first().cloned().ok_or(RpcError::Stopping)?;
    let (first, dimensions) = find_vector(&view, "position_state", &question.position_state)?;
    let (coordinates, numbers) = (dimensions.count(), question.places_m.len());
    if numbers == 0 || !numbers.is_multiple_of(coordinates) {
        return Err(Problem::Places { found: numbers, each: coordinates }.of("places_m").into());
    }
    let predictions = (numbers / coordinates) as u64 * question.times_nanos.len() as u64;
    check_limit("predictions, places times times", predictions, PREDICTIONS_MAX, "one request")?;
    let densities = predictions.saturating_mul(question.density_values.len() as u64);
    check_limit("densities", densities, DENSITIES_MAX, "one request")?;
    let learned = |target| LearnedState::new(Arc::clone(&handle), Arc::clone(&view), target);
    let axes = || (first.0..).take(coordinates).map(|axis| learned(StateId(axis).into())).collect();
    let observations = state.learned(&view);
    let mut models = Vec::with_capacity(states.len());
    for part in states {
        models.push(queries.trainer.place_model(learned(part), axes(), first, question.kind).await?);
    }
    let permit = queries.permits.take().await?;
    let forecast = PlacesForecast {
        observations,
        trained_observations: models.first().map_or(0, |model| model.observations()),
        generation: view.generation(),
        ..PlacesForecast::default()
    };
    let moments = view.moments(&question.times_nanos);
    let predict = move |stop: StopSignal<'_>| match models.as_slice() {
        [cosine, sine] => predict_angle([cosine, sine], &question, (coordinates, &moments), forecast, stop),
        [model, ..] => predict(model, &question, (coordinates, &moments), forecast, stop),
        [] => forecast,
    };
    Ok(places_to_wire(run_while_awaited(permit, None, predict).await?))
}

/// Does the same as [`predict`], for the angle of a cosine and a sine: direction, circular deviation, and an interval
/// that contains an angle as if angles were distributed normally about the direction.
fn predict_angle(
    models: [&PlaceModel; 2],
    question: &PlacesQuestion,
    (coordinates, moments): (usize, &[Moment]),
    mut forecast: PlacesForecast,
    stop: StopSignal<'_>,
) -> PlacesForecast {
    for place_m in question.places_m.chunks_exact(coordinates) {
        if stop.is_set() {
            // Nobody reads the reply.
            break;
        }
        for &moment in moments {
            let [cos, sin] = models.map(|model| model.at(place_m, moment));
            let Some((cos, sin)) = cos.zip(sin) else { continue };
            let [cos, sin] = [&cos, &sin].map(|at| at.mean().first().copied().unwrap_or(0.0));
            let (direction, deviation) = (direction_rad([cos, sin]), circular_deviation_rad([cos, sin]));
            forecast.expected.push(direction);
            forecast.deviations.push(deviation);
            if let Some(level) = question.interval_level {
                let reach = (normal_reach(level) * deviation).min(std::f64::consts::PI);
                forecast.lower.push(direction - reach);
                forecast.upper.push(direction + reach);
            }
        }
    }
    forecast
}

/// Adds the predictions for the places, each with this number of coordinates, to a forecast.
fn predict(
    model: &PlaceModel,
    question: &PlacesQuestion,
    (coordinates, moments): (usize, &[Moment]),
    mut forecast: PlacesForecast,
    stop: StopSignal<'_>,
) -> PlacesForecast {
    for place_m in question.places_m.chunks_exact(coordinates) {
        if stop.is_set() {
            // Nobody reads the reply.
            break;
        }
        for &moment in moments {
            // A place of finite numbers has a distribution.
            let Some(at) = model.at(place_m, moment) else { continue };
            forecast.expected.extend(at.mean());
            forecast.deviations.extend(at.variance().into_iter().map(f64::sqrt));
            if let Some((lower, upper)) = question.interval_level.and_then(|level| at.interval(level)) {
                forecast.lower.push(lower);
                forecast.upper.push(upper);
            }
            let density = |value: &f64| at.density(&[*value], &[0.0]).unwrap_or(0.0);
            forecast.densities.extend(question.density_values.iter().map(density));
        }
    }
    forecast
}
