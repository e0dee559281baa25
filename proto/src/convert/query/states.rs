//! Predictions of states at times: questions and replies.
//!
//! Invariant: a question has at least one name and one time; whether the map has the names is not checked.

use tidemap_map::event::StateKind;
use tidemap_model::{HeldInterval, entropy_bits, selector::ModelSelector};

use super::{interval_level_from_wire, selector_from_wire, selector_to_wire};
use crate::{
    convert::{
        InvalidField,
        time::{times_from_wire, timestamp},
    },
    v1,
};

/// The question of a request for predictions of states.
#[derive(Clone, Debug, PartialEq)]
pub struct StatesQuestion {
    /// Names of states, cells, vectors and angles; at least one.
    pub names: Vec<String>,
    /// Nanoseconds UTC; at least one.
    pub times_nanos: Vec<i64>,
    /// The model.
    pub selector: ModelSelector,
    /// The probability of the intervals, above 0 and below 1; `None`: no intervals are requested.
    pub interval_level: Option<f64>,
}

/// The question of a request for predictions of states.
///
/// # Errors
/// The invalid field.
pub fn states_from_wire(request: v1::PredictStatesRequest) -> Result<StatesQuestion, InvalidField> {
    let v1::PredictStatesRequest { states: names, times_nanos, model, interval_level: level, .. } = request;
    let selector = selector_from_wire("model", model)?;
    if names.is_empty() {
        return Err(InvalidField::new("states", "name at least one state"));
    }
    times_from_wire("times_nanos", &times_nanos)?;
    let interval_level = interval_level_from_wire(level)?;
    Ok(StatesQuestion { names, times_nanos, selector, interval_level })
}

/// The properties of a state in a reply besides its predictions.
#[derive(Clone, Debug)]
pub struct StateFacts {
    /// The kind of its values.
    pub kind: StateKind,
    /// The order of its model.
    pub order: usize,
    /// Number of all observations of the state.
    pub observations: u64,
    /// Number of observations that no update has learned.
    pub pending: u64,
    /// The model that predicts; `None`: nothing was learned, and the prior predicts.
    pub answered_by: Option<ModelSelector>,
    /// Time of its newest value, nanoseconds UTC.
    pub last_nanos: Option<i64>,
}

/// Predictions of one state, or of one axis of a vector, at successive times of a question.
#[derive(Clone, Debug)]
pub struct StateForecast {
    /// The predicted values, one per time.
    pub values: Vec<f64>,
    /// The intervals, one per time; empty if none were requested.
    pub intervals: Vec<HeldInterval>,
    /// The state.
    pub facts: StateFacts,
}

/// Predictions of the name at `state_index` of a question, from the time at `first_time_index` on, for the wire.
/// `axis`: 1 for x and so on; 0 for what is no vector.
#[must_use]
pub fn forecast_to_wire(
    state_index: usize,
    axis: u32,
    first_time_index: usize,
    StateForecast { values, intervals, facts }: StateForecast,
) -> v1::PredictStatesResponse {
    let StateFacts { kind, order, observations, pending, answered_by, last_nanos } = facts;
    v1::PredictStatesResponse {
        state_index: u32::try_from(state_index).unwrap_or(u32::MAX),
        first_time_index: u32::try_from(first_time_index).unwrap_or(u32::MAX),
        entropies_bits: match kind {
            StateKind::Probability => values.iter().map(|&probability| entropy_bits(probability)).collect(),
            StateKind::Continuous | StateKind::Count => Vec::new(),
        },
        probabilities: values,
        lower: intervals.iter().map(|held| held.interval.lower).collect(),
        upper: intervals.iter().map(|held| held.interval.upper).collect(),
        masses: intervals.iter().map(|held| held.mass).collect(),
        order: u32::try_from(order).unwrap_or(u32::MAX),
        observations,
        last_time: last_nanos.map(timestamp),
        axis,
        pending,
        answered_by: answered_by.map(selector_to_wire),
        label: String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request() -> v1::PredictStatesRequest {
        v1::PredictStatesRequest {
            states: vec!["door".to_owned()],
            times_nanos: vec![5],
            ..v1::PredictStatesRequest::default()
        }
    }

    #[test]
    fn a_level_of_zero_asks_for_no_intervals() {
        let level = |interval_level| states_from_wire(v1::PredictStatesRequest { interval_level, ..request() });
        assert_eq!(level(0.0).expect("right").interval_level, None);
        assert_eq!(level(0.9).expect("right").interval_level, Some(0.9));
        for wrong in [1.0, -0.1, f64::NAN] {
            assert_eq!(level(wrong).expect_err("wrong").field, "interval_level");
        }
    }

    #[test]
    fn names_and_times_are_needed() {
        let field = |request| states_from_wire(request).expect_err("wrong").field;
        assert_eq!(field(v1::PredictStatesRequest { states: Vec::new(), ..request() }), "states");
        assert_eq!(field(v1::PredictStatesRequest { times_nanos: Vec::new(), ..request() }), "times_nanos");
        assert_eq!(field(v1::PredictStatesRequest { times_nanos: vec![5, -1], ..request() }), "times_nanos[1]");
    }
}
