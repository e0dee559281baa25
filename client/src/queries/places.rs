//! Predictions of a state by place and time.
//!
//! Invariant: there is one prediction for each place and time, in the order of the places and then of the times.

use tidemap_proto::{convert::query::selector_to_wire, v1};

use super::ModelSelector;
use crate::{connection::Client, error::Error};

/// A request for a state at places.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlaceQuery {
    /// Name of the vector whose positions give the place of each observation.
    pub position_state: String,
    /// The places, in metres; each with as many coordinates as the vector has.
    pub places_m: Vec<Vec<f64>>,
    /// Times, nanoseconds UTC; at least one.
    pub times: Vec<i64>,
    /// The model that predicts: hypertime-em or hypertime-km; the daemon's default if absent.
    pub model: Option<ModelSelector>,
    /// Probability that an interval contains an observation; 0: no intervals.
    pub interval_level: f64,
    /// Values whose density is wanted.
    pub density_values: Vec<f64>,
}

/// The forecast at one place and time.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacePrediction {
    /// Index of the place in the request.
    pub place: usize,
    /// Index of the time in the request.
    pub time: usize,
    /// Expected value.
    pub expected: f64,
    /// Standard deviation of an observation.
    pub deviation: f64,
    /// The interval, if one was requested.
    pub interval: Option<(f64, f64)>,
    /// Densities p(a | x, t) of the values of the request.
    pub densities: Vec<f64>,
}

/// The forecasts at all places and times.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlacePredictions {
    /// One for each place and time.
    pub rows: Vec<PlacePrediction>,
    /// Number of observations that updates have learned.
    pub observations: u64,
    /// Number of observations with a position, on which the model was trained.
    pub trained_observations: u64,
    /// Number of updates published so far.
    pub generation: u64,
}

impl Client {
    /// Predicts a state at places.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map or a state does not exist, `FAILED_PRECONDITION` if the state was
    /// never observed at the same time as a position of the vector.
    pub async fn predict_at_places(
        &self,
        map: &str,
        state: &str,
        query: PlaceQuery,
    ) -> Result<PlacePredictions, Error> {
        let (places, times, values) = (query.places_m.len(), query.times.len(), query.density_values.len());
        let request = v1::PredictAtPlacesRequest {
            map: map.to_owned(),
            state: state.to_owned(),
            position_state: query.position_state,
            times_nanos: query.times,
            places_m: query.places_m.concat(),
            model: query.model.map(selector_to_wire),
            interval_level: query.interval_level,
            density_values: query.density_values,
        };
        let answer = self.query_service().predict_at_places(request).await;
        let reply = answer.map_err(|status| self.error(&status))?.into_inner();
        let wanted = places * times;
        let is_whole = reply.expected.len() == wanted
            && reply.deviations.len() == wanted
            && reply.lower.len() == reply.upper.len()
            && (reply.lower.is_empty() || reply.lower.len() == wanted)
            && reply.densities.len() == wanted * values;
        if !is_whole {
            return Err(Error::Protocol("predictions at places are missing"));
        }
        let row = |i: usize| PlacePrediction {
            place: i / times,
            time: i % times,
            expected: reply.expected[i],
            deviation: reply.deviations[i],
            interval: reply.lower.get(i).copied().zip(reply.upper.get(i).copied()),
            densities: reply.densities[i * values..(i + 1) * values].to_vec(),
        };
        Ok(PlacePredictions {
            rows: (0..wanted).map(row).collect(),
            observations: reply.observations,
            trained_observations: reply.trained_observations,
            generation: reply.generation,
        })
    }
}
