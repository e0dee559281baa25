//! Forecasts of edges at a time, and their source.
//!
//! Invariant: all used forecasts lie in range; a forecast out of range is refused with the name of its edge.

pub use tidemap_map::edge_forecast::EdgeForecast;
use tidemap_map::topology::{Edge, NOMINAL_MAX_SECS};

/// The least success of an edge that is not closed.
pub const SUCCESS_MIN: f64 = 1e-9;

/// Bounds of an edge over a span of time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeBest {
    /// Upper bound of the success, above 0, at most 1.
    pub success: f64,
    /// Lower bound of the duration, in seconds, at least 0.
    pub duration_secs: f64,
}

/// A source of forecasts. A closure `FnMut(&Edge, f64) -> Option<EdgeForecast>` is a source without bounds.
pub trait Forecasts {
    /// The forecast of an edge at a time in seconds after the reference time; `None`: the edge is closed then. The same
    /// arguments must give the same result.
    fn at(&mut self, edge: &Edge, at_secs: f64) -> Option<EdgeForecast>;

    /// Bounds of [`Forecasts::at`] of an edge over a span of time, both ends included; `None` if unknown. Bounds let a
    /// search prove that a route is the best; wrong bounds invalidate the proof.
    fn best(&mut self, _edge: &Edge, _from_secs: f64, _to_secs: f64) -> Option<EdgeBest> {
        None
    }

    /// Expected number of encounters with people while the robot passes an edge that it enters at a time; at least 0.
    /// Nobody is expected by default.
    fn encounters(&mut self, _edge: &Edge, _at_secs: f64, _duration_secs: f64) -> f64 {
        0.0
    }
}

impl<F: FnMut(&Edge, f64) -> Option<EdgeForecast>> Forecasts for F {
    fn at(&mut self, edge: &Edge, at_secs: f64) -> Option<EdgeForecast> {
        self(edge, at_secs)
    }
}

/// The reason why a forecast is invalid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum ForecastError {
    /// A success is out of range.
    #[error(
        "edge {edge} succeeds with probability {found}: expected {SUCCESS_MIN} to 1; close an edge that never succeeds"
    )]
    Success { edge: String, found: f64 },
    /// A duration is out of range.
    #[error("edge {edge} would take {found} s: expected above 0 s, at most {NOMINAL_MAX_SECS} s")]
    Duration { edge: String, found: f64 },
    /// The encounters are out of range.
    #[error("edge {edge} has {found} encounters: expected a number, at least 0")]
    Encounters { edge: String, found: f64 },
    /// The evidence is out of range.
    #[error("the evidence of edge {edge} is {found} observations: expected above 0")]
    Evidence { edge: String, found: f64 },
}

/// Checks that a forecast lies in range; `name` returns the edge's name for the error.
pub(crate) fn check_forecast(forecast: &EdgeForecast, name: impl FnOnce() -> String) -> Result<(), ForecastError> {
    let EdgeForecast { success, evidence, duration_secs } = *forecast;
    if !(SUCCESS_MIN..=1.0).contains(&success) {
        return Err(ForecastError::Success { edge: name(), found: success });
    }
    if !(duration_secs > 0.0 && duration_secs <= NOMINAL_MAX_SECS) {
        return Err(ForecastError::Duration { edge: name(), found: duration_secs });
    }
    if evidence.is_nan() || evidence <= 0.0 {
        return Err(ForecastError::Evidence { edge: name(), found: evidence });
    }
    Ok(())
}

/// Expected seconds to traverse an edge with repeated attempts: d + (1 - p)/p · (d + r). The number of failures before
/// the first success is geometric, (1 - p)/p on average, and each costs the attempt's time d and recovery r.
#[must_use]
pub fn expected_secs(success: f64, duration_secs: f64, recovery_secs: f64) -> f64 {
    duration_secs + (1.0 - success) / success * (duration_secs + recovery_secs)
}
