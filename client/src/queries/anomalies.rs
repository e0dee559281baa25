//! Anomalies: observations that the model did not expect, past ones and as they occur.
//!
//! Invariant: past anomalies come by time, each once, within the requested interval; watched anomalies come in the
//! order in which the daemon applied them, and missed observations are counted.

use tidemap_grid::index::CellBox;
pub use tidemap_map::anomaly::Anomaly;
use tidemap_proto::{
    convert::{grid::cell_box_to_wire, query::selector_to_wire, time::timestamp},
    v1,
};
use tonic::Streaming;

use super::ModelSelector;
use crate::{connection::Client, error::Error};

/// The criterion of an anomaly (T-RO 2017, section V): the model predicts the contrary with this confidence. For other
/// kinds than probabilities: the value lies outside the prediction interval of a single value with this confidence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Judgement {
    /// Above 0.5, at most 1.
    pub confidence: f64,
    /// The model that judges.
    pub model: ModelSelector,
}

impl Default for Judgement {
    fn default() -> Self {
        Self { confidence: 0.99, model: ModelSelector::default() }
    }
}

/// The states or cells that a watch covers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WatchedPlaces {
    /// Names of states, and of cells (`cell/X/Y/Z`).
    pub states: Vec<String>,
    /// Cells of the grid, observed or not.
    pub region: Option<CellBox>,
    /// A location: its states and cells.
    pub location: Option<String>,
}

impl From<Vec<String>> for WatchedPlaces {
    fn from(states: Vec<String>) -> WatchedPlaces {
        WatchedPlaces { states, ..WatchedPlaces::default() }
    }
}

/// A search for past anomalies in progress.
#[derive(Debug)]
pub struct Anomalies {
    client: Client,
    replies: Streaming<v1::FindAnomaliesResponse>,
    from_nanos: i64,
    to_nanos: i64,
}

/// A watch in progress. It ends when it is dropped.
#[derive(Debug)]
pub struct AnomalyWatch {
    client: Client,
    replies: Streaming<v1::WatchAnomaliesResponse>,
}

/// A reply of a watch.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Watched {
    /// Names of states and their anomalies, in the order in which the observations were applied.
    pub anomalies: Vec<(String, Anomaly)>,
    /// Number of observations of the map before these that were not judged, because replies were not read in time.
    pub missed: u64,
}

impl Client {
    /// Finds the anomalies of a state, or of a cell (`cell/X/Y/Z`), from one time up to, not including, another, judged
    /// by the current model.
    ///
    /// # Errors
    /// [`Error`]; the code is `INVALID_ARGUMENT` if the confidence is invalid or the model predicts from the newest
    /// value, and otherwise as for [`Client::reconstruct`].
    pub async fn anomalies(
        &self,
        map: &str,
        state: &str,
        from_nanos: i64,
        to_nanos: i64,
        judgement: Judgement,
    ) -> Result<Anomalies, Error> {
        let request = v1::FindAnomaliesRequest {
            map: map.to_owned(),
            state: state.to_owned(),
            from_time: Some(timestamp(from_nanos)),
            to_time: Some(timestamp(to_nanos)),
            confidence: Some(judgement.confidence),
            model: Some(selector_to_wire(judgement.model)),
        };
        let answer = self.query_service().find_anomalies(request).await.map_err(|status| self.error(&status))?;
        Ok(Anomalies { client: self.clone(), replies: answer.into_inner(), from_nanos, to_nanos })
    }

    /// Watches the anomalies of these states and cells from now on; of all states, but no cells, if there are none.
    /// When this returns the watch has begun.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map, state, cell or location does not exist, `INVALID_ARGUMENT` if the
    /// confidence is
    /// invalid or the model is not `auto`, `mean` or `spectral`, `RESOURCE_EXHAUSTED` if there are too many watches.
    pub async fn watch_anomalies(
        &self,
        map: &str,
        places: impl Into<WatchedPlaces>,
        judgement: Judgement,
    ) -> Result<AnomalyWatch, Error> {
        let WatchedPlaces { states, region, location } = places.into();
        let request = v1::WatchAnomaliesRequest {
            map: map.to_owned(),
            states,
            confidence: Some(judgement.confidence),
            model: Some(selector_to_wire(judgement.model)),
            region: region.as_ref().map(cell_box_to_wire),
            location: location.unwrap_or_default(),
        };
        let answer = self.query_service().watch_anomalies(request).await.map_err(|status| self.error(&status))?;
        Ok(AnomalyWatch { client: self.clone(), replies: answer.into_inner() })
    }
}

impl Anomalies {
    /// The next anomalies, possibly none; `None` after the last.
    ///
    /// # Errors
    /// [`Error`]
    pub async fn next(&mut self) -> Result<Option<Vec<Anomaly>>, Error> {
        Ok(self.next_labelled().await?.map(|(found, _)| found))
    }

    /// Does the same as [`Anomalies::next`], and also returns the observed label of each anomaly of a categorical
    /// state; no labels for other kinds.
    ///
    /// # Errors
    /// [`Error`]
    pub async fn next_labelled(&mut self) -> Result<Option<(Vec<Anomaly>, Vec<String>)>, Error> {
        let Some(mut reply) = self.replies.message().await.map_err(|status| self.client.error(&status))? else {
            return Ok(None);
        };
        let labels = std::mem::take(&mut reply.labels);
        let found = found(reply, self.from_nanos..self.to_nanos)?;
        if !labels.is_empty() && labels.len() != found.len() {
            return Err(Error::Protocol("anomalies are not whole"));
        }
        if let Some(last) = found.last() {
            self.from_nanos = last.utc_nanos;
        }
        Ok(Some((found, labels)))
    }
}

impl AnomalyWatch {
    /// Waits for the next reply; `None` if the daemon ends the watch without an error.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map is deleted, `UNAVAILABLE` if the daemon stops.
    pub async fn next(&mut self) -> Result<Option<Watched>, Error> {
        let reply = self.replies.message().await.map_err(|status| self.client.error(&status))?;
        reply.map(watched).transpose()
    }
}

/// Several producers may observe a state at the same time.
fn found(reply: v1::FindAnomaliesResponse, requested: std::ops::Range<i64>) -> Result<Vec<Anomaly>, Error> {
    let v1::FindAnomaliesResponse { times_nanos, values, probabilities, .. } = reply;
    if !times_nanos.is_sorted() || !times_nanos.iter().all(|time| requested.contains(time)) {
        return Err(Error::Protocol("anomalies are not those that were requested"));
    }
    rows(times_nanos, values, probabilities)
}

fn watched(reply: v1::WatchAnomaliesResponse) -> Result<Watched, Error> {
    let v1::WatchAnomaliesResponse { states, times_nanos, values, probabilities, missed_observations } = reply;
    let anomalies = rows(times_nanos, values, probabilities)?;
    if anomalies.len() != states.len() {
        return Err(Error::Protocol("anomalies lack the names of their states"));
    }
    Ok(Watched { anomalies: states.into_iter().zip(anomalies).collect(), missed: missed_observations })
}

fn rows(times_nanos: Vec<i64>, values: Vec<f64>, probabilities: Vec<f64>) -> Result<Vec<Anomaly>, Error> {
    if times_nanos.len() != values.len() || times_nanos.len() != probabilities.len() {
        return Err(Error::Protocol("anomalies are not whole"));
    }
    let rows = times_nanos.into_iter().zip(values).zip(probabilities);
    Ok(rows.map(|((utc_nanos, value), probability)| Anomaly { utc_nanos, value, probability }).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn anomalies_come_by_time_and_within_what_was_requested() {
        let reply = |times: &[i64]| v1::FindAnomaliesResponse {
            times_nanos: times.to_vec(),
            values: vec![0.0; 2],
            probabilities: vec![1.0; 2],
            labels: Vec::new(),
        };
        let anomaly = |utc_nanos| Anomaly { utc_nanos, value: 0.0, probability: 1.0 };
        assert_eq!(found(reply(&[5, 9]), 5..10), Ok(vec![anomaly(5), anomaly(9)]));
        assert_eq!(found(reply(&[5, 5]), 5..10), Ok(vec![anomaly(5), anomaly(5)]));
        for wrong in [&[9, 5][..], &[4, 5], &[5, 10], &[5], &[5, 6, 7]] {
            assert!(found(reply(wrong), 5..10).is_err(), "{wrong:?}");
        }
    }

    #[test]
    fn what_is_watched_has_names_and_may_be_in_any_order() {
        let reply = v1::WatchAnomaliesResponse {
            states: vec!["door".to_owned(), "gate".to_owned()],
            times_nanos: vec![9, 5],
            values: vec![0.0, 1.0],
            probabilities: vec![1.0, 0.0],
            missed_observations: 7,
        };
        let anomalies = vec![
            ("door".to_owned(), Anomaly { utc_nanos: 9, value: 0.0, probability: 1.0 }),
            ("gate".to_owned(), Anomaly { utc_nanos: 5, value: 1.0, probability: 0.0 }),
        ];
        assert_eq!(watched(reply.clone()), Ok(Watched { anomalies, missed: 7 }));
        assert!(watched(v1::WatchAnomaliesResponse { states: vec!["door".to_owned()], ..reply.clone() }).is_err());
        assert!(watched(v1::WatchAnomaliesResponse { values: vec![0.0], ..reply }).is_err());
    }
}
