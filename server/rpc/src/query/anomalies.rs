//! `FindAnomalies`: the unexpected observations of an interval.
//!
//! Invariant: each observation of the interval is judged once, by one view's model at its own time.

use std::sync::Arc;

use tidemap_answer::{CachedModel, StateOrCell};
use tidemap_map::{
    anomaly::{Anomaly, Confidence, anomalies},
    history::Reading,
    row_samples::RequestedReadings,
    view::MapView,
};
use tidemap_model::{StopSignal, selector::ModelSelector};
use tidemap_proto::{
    convert::{
        anomaly::{anomalies_to_wire, confidence_from_wire, judge_from_wire},
        time::interval_from_wire,
    },
    v1,
};

use super::{
    Queries,
    reconstruct::{PastQuery, past},
};
use crate::{
    lookup::{check_limit, find_all, find_map},
    replies::{Replies, compute_replies},
    status::RpcError,
    training::LearnedState,
};

mod labels;

/// Number of observations that are judged at once, and of one reply: their phasors take some 10 MB at 168
/// periodicities.
const READINGS_PER_REPLY: usize = 4096;

/// The model by which observations are judged: one that was trained on the readings, or the view's model.
struct Judge {
    subject: StateOrCell,
    trained: Option<Arc<CachedModel>>,
}

impl Judge {
    fn expected(&self, view: &MapView, readings: &[Reading], selector: ModelSelector) -> Vec<f64> {
        let times: Vec<i64> = readings.iter().map(|(nanos, _)| *nanos).collect();
        let mut expected = vec![0.0; times.len()];
        match &self.trained {
            None => {
                self.subject.predict_long_term_into(view, &view.prepare(&times), selector, &mut expected);
            }
            Some(trained) => {
                trained.expect_into(view, &self.subject, &view.moments(&times), selector, &mut expected);
            }
        }
        expected
    }

    /// The unexpected readings.
    fn unexpected(
        &self,
        view: &MapView,
        readings: &[Reading],
        selector: ModelSelector,
        confidence: Confidence,
    ) -> Vec<Anomaly> {
        let expected = self.expected(view, readings, selector);
        match self.subject {
            StateOrCell::State(id) => {
                view.judged(id, selector, readings, &expected, confidence).into_iter().flatten().collect()
            }
            StateOrCell::Cell(_) => anomalies(readings, &expected, confidence).collect(),
        }
    }
}

pub(super) async fn find_anomalies(
    queries: &Queries,
    request: v1::FindAnomaliesRequest,
) -> Result<Replies<v1::FindAnomaliesResponse>, RpcError> {
    let v1::FindAnomaliesRequest { map, state: name, from_time, to_time, confidence, model } = request;
    let handle = find_map(&queries.catalog, &map).await?;
    let within_nanos = interval_from_wire(from_time, to_time)?;
    let mut query = PastQuery { name: name.clone(), within_nanos: within_nanos.clone() };
    let confidence = confidence_from_wire("confidence", confidence)?;
    let selector = judge_from_wire("model", model)?;
    let view = handle.view();
    if !view.labels(&name).is_empty() {
        return labels::find_anomalies(queries, handle, view, query, (selector, confidence)).await;
    }
    let subject = find_all(&view, |_| "state".to_owned(), vec![name]).await?.pop().ok_or(RpcError::Stopping)?;
    if let StateOrCell::State(id) = subject {
        query.within_nanos = view.rows_about(id, &within_nanos);
    }
    let max = queries.max_predictions;
    // Training comes before the permits to read are taken: it has its own permits, and may take long.
    let trained = if selector.kind.needs_readings() {
        let learned = LearnedState::new(Arc::clone(&handle), Arc::clone(&view), subject.clone());
        Some(queries.trainer.trained(&learned, selector.kind).await?)
    } else {
        None
    };
    let (permits, gather) = past(queries, &handle, Arc::clone(&view), query).await?;
    Ok(compute_replies(permits, move |sink| {
        let judge = Judge { subject, trained };
        let is_left = || sink.is_closed();
        let mut readings = gather(StopSignal::new(&is_left))?;
        if let StateOrCell::State(id) = judge.subject {
            let at_most = usize::try_from(max).unwrap_or(usize::MAX).saturating_add(1);
            readings = view.observed_readings(id, readings, &RequestedReadings { within_nanos, at_most });
            check_limit("readings of the interval", readings.len() as u64, max, "setting max_predictions")?;
        }
        for readings in readings.chunks(READINGS_PER_REPLY) {
            let found = judge.unexpected(&view, readings, selector, confidence);
            // An empty reply is sent too, because only sending shows whether the client is still there.
            if !sink.send(anomalies_to_wire(found)) {
                break;
            }
        }
        Ok(())
    }))
}
