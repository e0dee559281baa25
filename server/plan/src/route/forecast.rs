//! What is known of an edge at a time, and who says it.
//!
//! Invariant: a forecast that is used lies in range; one that does not is refused, with the name of its edge.

pub use tidemap_map::edge_forecast::EdgeForecast;
use tidemap_map::topology::{Edge, NOMINAL_MAX_SECS};

/// The least success of an edge that is not closed: trying again until it works would take too long to count.
pub const SUCCESS_MIN: f64 = 1e-9;

/// The best that an edge can be at any time of a span.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeBest {
    /// At most so likely it succeeds, above 0, at most 1.
    pub success: f64,
    /// At least so long it takes, in seconds, at least 0.
    pub duration_secs: f64,
}

/// Who forecasts edges. A closure `FnMut(&Edge, f64) -> Option<EdgeForecast>` does, without knowing bounds.
pub trait Forecasts {
    /// What is known of an edge so many seconds after the question's reference time; `None` closes it to who would enter it
    /// then. The same question has always the same answer.
    fn at(&mut self, edge: &Edge, at_secs: f64) -> Option<EdgeForecast>;

    /// The best that [`Forecasts::at`] says of an edge at any time from one to another, both included; `None` if that is not
    /// known. A search that is told may prove a route best among many; a bound that does not hold makes its proof void.
    fn best(&mut self, _edge: &Edge, _from_secs: f64, _to_secs: f64) -> Option<EdgeBest> {
        None
    }
}

impl<F: FnMut(&Edge, f64) -> Option<EdgeForecast>> Forecasts for F {
    fn at(&mut self, edge: &Edge, at_secs: f64) -> Option<EdgeForecast> {
        self(edge, at_secs)
    }
}

/// Why a forecast is not used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum ForecastError {
    /// A success is no probability that could be waited for.
    #[error(
        "edge {edge} succeeds with probability {found}: expected {SUCCESS_MIN} to 1; one that never does is to be closed"
    )]
    Success { edge: String, found: f64 },
    /// A duration is no time.
    #[error("edge {edge} would take {found} s: expected above 0 s, at most {NOMINAL_MAX_SECS} s")]
    Duration { edge: String, found: f64 },
    /// The evidence is none.
    #[error("the success of edge {edge} is worth {found} observations: expected above 0")]
    Evidence { edge: String, found: f64 },
}

/// Checks that a forecast lies in range; `name` gives the edge's name for the error.
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

/// Expected seconds until an edge is behind the robot that tries again until it works: d + (1 - p)/p · (d + r). The number of
/// failures before the first success is geometric, (1 - p)/p on average, and each costs the attempt's time d and recovery r.
pub(crate) fn expected_secs(success: f64, duration_secs: f64, recovery_secs: f64) -> f64 {
    duration_secs + (1.0 - success) / success * (duration_secs + recovery_secs)
}
