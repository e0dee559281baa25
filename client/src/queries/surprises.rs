//! Unusual observations, as judged before they were learned.
//!
//! Invariant: runs come with the most surprising first, each with the name of its state.

use tidemap_model::SurpriseRun;
use tidemap_proto::{
    convert::{anomaly::surprise_from_wire, time::timestamp},
    v1,
};

use crate::{connection::Client, error::Error};

/// A request for unusual observations.
#[derive(Clone, Debug, PartialEq)]
pub struct SurpriseQuery {
    /// Names of states; all states of the map if there are none.
    pub states: Vec<String>,
    /// First instant, nanoseconds UTC.
    pub from_nanos: i64,
    /// Last instant, not included, nanoseconds UTC; a run counts if a part of it lies between both.
    pub to_nanos: i64,
    /// The minimum certainty of the model that the contrary holds, 0.9 to 1.
    pub confidence: f64,
    /// Maximum number of runs, 1 to 10,000.
    pub top: u32,
}

/// The unusual observations.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Surprising {
    /// Names of states with their runs, the most surprising first.
    pub runs: Vec<(String, SurpriseRun)>,
    /// Number of runs of these states, of any time, that have made room for others.
    pub dropped: u64,
}

impl Client {
    /// Lists the observations of states that were unusual before updates learned them, and the unusual observations
    /// that no update has learned yet.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map or a state does not exist, `INVALID_ARGUMENT` if the confidence is
    /// below 0.9 or a name is the name of a cell.
    pub async fn surprises(&self, map: &str, query: SurpriseQuery) -> Result<Surprising, Error> {
        let SurpriseQuery { states, from_nanos, to_nanos, confidence, top } = query;
        let request = v1::ListSurprisesRequest {
            map: map.to_owned(),
            states,
            from_time: Some(timestamp(from_nanos)),
            to_time: Some(timestamp(to_nanos)),
            confidence: Some(confidence),
            top,
        };
        let answer = self.query_service().list_surprises(request).await.map_err(|status| self.error(&status))?;
        let v1::ListSurprisesResponse { surprises, dropped_runs: dropped } = answer.into_inner();
        let runs: Option<Vec<_>> = surprises.into_iter().map(surprise_from_wire).collect();
        Ok(Surprising { runs: runs.ok_or(Error::Protocol("runs of unusual observations are not whole"))?, dropped })
    }
}
