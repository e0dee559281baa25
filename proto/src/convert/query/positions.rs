//! Predictions of positions, and of states by place: questions and replies.
//!
//! Invariant: numbers of a question are finite and within range. The handler of the request checks from the map how
//! many coordinates a place has.

use tidemap_model::{VALUE_MAX, selector::ModelKind};

use super::{interval_level_from_wire, selector_from_wire};
use crate::{
    convert::{
        InvalidField,
        time::{nanos_from_duration, times_from_wire, timestamp},
    },
    v1,
};

/// The longest window to count positions in.
const WINDOW_MAX_NANOS: i64 = 7 * 86_400 * 1_000_000_000;

/// A box of positions.
#[derive(Clone, Debug, PartialEq)]
pub struct PositionRegion {
    /// The lower corner, metres.
    pub low_m: Vec<f64>,
    /// The upper corner, metres: each coordinate is above that of the lower corner.
    pub high_m: Vec<f64>,
}

/// The question where something will be.
#[derive(Clone, Debug, PartialEq)]
pub struct PositionsQuestion {
    /// Name of the vector.
    pub state: String,
    /// Nanoseconds UTC; at least one.
    pub times_nanos: Vec<i64>,
    /// A model that positions have.
    pub kind: ModelKind,
    /// Edge of a cell, metres; `None`: the default.
    pub edge_m: Option<f64>,
    /// The window to count positions in, which begins at each time, nanoseconds; `None`: nothing is counted.
    pub window_nanos: Option<i64>,
    /// `None`: where the observations are.
    pub region: Option<PositionRegion>,
    /// Maximum number of cells of a time, the most probable ones.
    pub top: usize,
}

/// The question where something will be.
///
/// # Errors
/// The invalid field.
pub fn positions_from_wire(request: v1::PredictPositionsRequest) -> Result<PositionsQuestion, InvalidField> {
    let v1::PredictPositionsRequest { state, times_nanos, model, resolution_m, count_window, region, top, .. } =
        request;
    times_from_wire("times_nanos", &times_nanos)?;
    Ok(PositionsQuestion {
        state,
        times_nanos,
        kind: model_from_wire(model)?,
        edge_m: edge_from_wire("resolution_m", resolution_m)?,
        window_nanos: window_from_wire(count_window)?,
        region: region.map(|region| region_from_wire("region", region)).transpose()?,
        top: if top == 0 { usize::MAX } else { top as usize },
    })
}

/// The cells of all times of a reply, and what they were learned from.
#[derive(Clone, Debug, PartialEq)]
pub struct PositionRaster {
    /// The lower corner of the cells, metres.
    pub low_m: Vec<f64>,
    /// Edge of a cell, metres.
    pub edge_m: f64,
    /// Number of cells along each axis.
    pub counts: Vec<usize>,
    /// Number of observations of the vector.
    pub observations: u64,
    /// Number of observations that the model was trained on.
    pub trained_observations: u64,
    /// Time of the last observation, nanoseconds UTC.
    pub last_nanos: Option<i64>,
    /// Generation of the map.
    pub generation: u64,
}

/// The header of a reply for the wire.
#[must_use]
pub fn positions_header_to_wire(header: PositionRaster) -> v1::PositionsHeader {
    v1::PositionsHeader {
        low_m: header.low_m,
        resolution_m: header.edge_m,
        counts: header.counts.into_iter().map(|count| u32::try_from(count).unwrap_or(u32::MAX)).collect(),
        observations: header.observations,
        trained_observations: header.trained_observations,
        last_time: header.last_nanos.map(timestamp),
        generation: header.generation,
    }
}

/// The expected positions at a time, or in the window that begins then.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExpectedPositions {
    /// Cells by their index, with their probabilities.
    pub cells: Vec<(u32, f64)>,
    /// The mean position, metres.
    pub mean_m: Vec<f64>,
    /// Probability of everything outside the cells of the reply.
    pub outside: f64,
    /// Number of positions in the window; 0 without one.
    pub count: f64,
}

/// The expected positions at the time with this index of the question for the wire, at most `at_once` cells in each
/// part. The first part has all that is not a cell; there is always a first part.
pub fn position_cells_to_wire(
    time_index: u32,
    forecast: ExpectedPositions,
    at_once: usize,
) -> impl Iterator<Item = v1::PositionCells> {
    let ExpectedPositions { cells, mean_m, outside, count } = forecast;
    let mut head =
        Some(v1::PositionCells { expected_m: mean_m, outside, expected_count: count, ..v1::PositionCells::default() });
    let mut rest = cells.into_iter().peekable();
    std::iter::from_fn(move || {
        let head = match head.take() {
            Some(head) => head,
            None => rest.peek().map(|_| v1::PositionCells::default())?,
        };
        let (indices, probabilities) = rest.by_ref().take(at_once).unzip();
        Some(v1::PositionCells { time_index, indices, probabilities, ..head })
    })
}

/// The question for a state by place and time.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacesQuestion {
    /// Name of the state.
    pub state: String,
    /// Name of the vector whose positions are the places of its observations.
    pub position_state: String,
    /// Nanoseconds UTC; at least one.
    pub times_nanos: Vec<i64>,
    /// Coordinates of the places, one place after the other, metres.
    pub places_m: Vec<f64>,
    /// Values whose densities are requested.
    pub density_values: Vec<f64>,
    /// The probability of the intervals, above 0 and below 1; `None`: no intervals are requested.
    pub interval_level: Option<f64>,
    /// A model that positions have.
    pub kind: ModelKind,
}

/// The question for a state by place and time.
///
/// # Errors
/// The invalid field.
pub fn places_from_wire(request: v1::PredictAtPlacesRequest) -> Result<PlacesQuestion, InvalidField> {
    let v1::PredictAtPlacesRequest { state, position_state, times_nanos, places_m, density_values, model, .. } =
        request;
    let level = request.interval_level;
    times_from_wire("times_nanos", &times_nanos)?;
    check_numbers("places_m", &places_m)?;
    check_numbers("density_values", &density_values)?;
    let (interval_level, kind) = (interval_level_from_wire(level)?, model_from_wire(model)?);
    Ok(PlacesQuestion { state, position_state, times_nanos, places_m, density_values, interval_level, kind })
}

/// Predictions of a state by place and time. The columns are in the order of the places, and of the times of each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlacesForecast {
    /// The expected values; of an angle, the directions in radians.
    pub expected: Vec<f64>,
    /// The standard deviations; of an angle, the circular deviations in radians.
    pub deviations: Vec<f64>,
    /// The lower ends of the intervals; empty if none were requested.
    pub lower: Vec<f64>,
    /// The upper ends of the intervals; empty if none were requested.
    pub upper: Vec<f64>,
    /// The densities of the requested values, for each place and time.
    pub densities: Vec<f64>,
    /// Number of observations of the state.
    pub observations: u64,
    /// Number of observations that the model was trained on.
    pub trained_observations: u64,
    /// Generation of the map.
    pub generation: u64,
}

/// Predictions by place and time, for the wire.
#[must_use]
pub fn places_to_wire(forecast: PlacesForecast) -> v1::PredictAtPlacesResponse {
    v1::PredictAtPlacesResponse {
        expected: forecast.expected,
        deviations: forecast.deviations,
        lower: forecast.lower,
        upper: forecast.upper,
        densities: forecast.densities,
        observations: forecast.observations,
        trained_observations: forecast.trained_observations,
        generation: forecast.generation,
    }
}

/// A model of positions.
fn model_from_wire(wire: Option<v1::ModelSelector>) -> Result<ModelKind, InvalidField> {
    let mut wire = wire.unwrap_or_default();
    if wire.kind() == v1::ModelKind::Unspecified {
        wire.kind = v1::ModelKind::HypertimeEm.into();
    }
    let selector = selector_from_wire("model", Some(wire))?;
    if selector.kind.hypertime_options().is_none() {
        let text = format!("positions have no model {}: use hypertime-em or hypertime-km", selector.kind);
        return Err(InvalidField::new("model.kind", text));
    }
    if selector.is_blended() {
        let name = selector.blend.name();
        return Err(InvalidField::new(format!("model.{name}"), format!("models of positions have no {name}")));
    }
    Ok(selector.kind)
}

/// The edge of a cell.
pub(super) fn edge_from_wire(field: &str, resolution_m: f64) -> Result<Option<f64>, InvalidField> {
    match resolution_m {
        0.0 => Ok(None),
        edge if edge > 0.0 && edge <= VALUE_MAX => Ok(Some(edge)),
        other => {
            let text = format!(
                "{other} m is not a valid cell size: use a number above 0 and up to 1e12, or 0 for the default"
            );
            Err(InvalidField::new(field, text))
        }
    }
}

/// A box whose corners are numbers, the upper one above the lower.
pub(super) fn region_from_wire(field: &str, region: v1::PositionBox) -> Result<PositionRegion, InvalidField> {
    let v1::PositionBox { low_m, high_m } = region;
    for (name, corner) in [("low_m", &low_m), ("high_m", &high_m)] {
        if let Some(wrong) = corner.iter().find(|number| number.abs() > VALUE_MAX || number.is_nan()) {
            let text = format!("{wrong} m is not a number from -1e12 to 1e12");
            return Err(InvalidField::new(format!("{field}.{name}"), text));
        }
    }
    if let Some((low, high)) = low_m.iter().zip(&high_m).find(|(low, high)| low >= high) {
        let text = format!("{high} m is not above the lower corner's {low} m");
        return Err(InvalidField::new(format!("{field}.high_m"), text));
    }
    Ok(PositionRegion { low_m, high_m })
}

/// The window to count positions in, nanoseconds.
pub(super) fn window_from_wire(window: Option<prost_types::Duration>) -> Result<Option<i64>, InvalidField> {
    match window.map(|window| nanos_from_duration("count_window", window)).transpose()? {
        Some(nanos) if !(1..=WINDOW_MAX_NANOS).contains(&nanos) => {
            let text = format!("{} s: a window is above 0 s and at most 7 days", nanos as f64 / 1e9);
            Err(InvalidField::new("count_window", text))
        }
        window => Ok(window),
    }
}

fn check_numbers(field: &str, numbers: &[f64]) -> Result<(), InvalidField> {
    let wrong = numbers.iter().position(|number| number.is_nan() || number.abs() > VALUE_MAX);
    wrong.map_or(Ok(()), |i| {
        let text = format!("{} is not a number from -1e12 to 1e12", numbers[i]);
        Err(InvalidField::new(format!("{field}[{i}]"), text))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::convert::time::duration;

    fn request() -> v1::PredictPositionsRequest {
        v1::PredictPositionsRequest { times_nanos: vec![5], ..v1::PredictPositionsRequest::default() }
    }

    #[test]
    fn a_plain_question_has_the_defaults() {
        let question = positions_from_wire(request()).expect("right");
        assert_eq!(question.kind, ModelKind::HypertimeEm { clusters: 3 });
        assert_eq!(
            (question.edge_m, question.window_nanos, question.region, question.top),
            (None, None, None, usize::MAX)
        );
    }

    #[test]
    fn what_is_wrong_is_named() {
        let field = |request| positions_from_wire(request).expect_err("wrong").field;
        let model = |kind: v1::ModelKind, persistence, memory| {
            Some(v1::ModelSelector { kind: kind.into(), persistence, memory, ..v1::ModelSelector::default() })
        };
        let spectral = model(v1::ModelKind::Spectral, false, false);
        assert_eq!(field(v1::PredictPositionsRequest { model: spectral, ..request() }), "model.kind");
        let persistent = model(v1::ModelKind::Unspecified, true, false);
        assert_eq!(field(v1::PredictPositionsRequest { model: persistent, ..request() }), "model.persistence");
        let remembering = model(v1::ModelKind::HypertimeKm, false, true);
        assert_eq!(field(v1::PredictPositionsRequest { model: remembering, ..request() }), "model.memory");
        for resolution_m in [-1.0, f64::NAN, f64::INFINITY, 1e13] {
            assert_eq!(field(v1::PredictPositionsRequest { resolution_m, ..request() }), "resolution_m");
        }
        let count_window = Some(duration(WINDOW_MAX_NANOS + 1));
        assert_eq!(field(v1::PredictPositionsRequest { count_window, ..request() }), "count_window");
        let region = |low: f64, high: f64| Some(v1::PositionBox { low_m: vec![low; 2], high_m: vec![high; 2] });
        assert_eq!(field(v1::PredictPositionsRequest { region: region(1.0, 1.0), ..request() }), "region.high_m");
        assert_eq!(field(v1::PredictPositionsRequest { region: region(f64::NAN, 1.0), ..request() }), "region.low_m");
        let endless = region(0.0, f64::INFINITY);
        assert_eq!(field(v1::PredictPositionsRequest { region: endless, ..request() }), "region.high_m");
    }

    #[test]
    fn numbers_of_places_are_checked_one_by_one() {
        let request = || v1::PredictAtPlacesRequest { times_nanos: vec![5], ..v1::PredictAtPlacesRequest::default() };
        let field = |request| places_from_wire(request).expect_err("wrong").field;
        let places_m = vec![1.0, 2e12];
        assert_eq!(field(v1::PredictAtPlacesRequest { places_m, ..request() }), "places_m[1]");
        let density_values = vec![f64::NAN];
        assert_eq!(field(v1::PredictAtPlacesRequest { density_values, ..request() }), "density_values[0]");
        assert_eq!(field(v1::PredictAtPlacesRequest { interval_level: 1.0, ..request() }), "interval_level");
    }

    #[test]
    fn only_the_first_part_of_a_forecast_has_more_than_cells() {
        let parts = |count: u32| -> Vec<v1::PositionCells> {
            let cells = (0..count).map(|cell| (cell, 0.125)).collect();
            let forecast = ExpectedPositions { cells, mean_m: vec![1.0, 2.0], outside: 0.5, count: 3.0 };
            position_cells_to_wire(4, forecast, 2).collect()
        };
        let head = |indices: Vec<u32>| v1::PositionCells {
            time_index: 4,
            probabilities: vec![0.125; indices.len()],
            indices,
            expected_m: vec![1.0, 2.0],
            outside: 0.5,
            expected_count: 3.0,
        };
        assert_eq!(parts(0), [head(Vec::new())], "everything lies outside");
        assert_eq!(parts(2), [head(vec![0, 1])]);
        let rest = v1::PositionCells {
            time_index: 4,
            indices: vec![2],
            probabilities: vec![0.125],
            ..v1::PositionCells::default()
        };
        assert_eq!(parts(3), [head(vec![0, 1]), rest]);
    }
}
