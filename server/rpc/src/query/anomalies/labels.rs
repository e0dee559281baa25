//! `FindAnomalies` of a categorical state: observed labels whose predicted share was small.
//!
//! Invariant: the labels of an observation have its time, and come in the order of their states; so the n-th reading of
//! each label belongs to the n-th observation.

use std::sync::Arc;

use tidemap_ingest::handle::MapHandle;
use tidemap_map::{
    anomaly::{Anomaly, Confidence},
    history::Reading,
    ids::StateId,
    view::MapView,
};
use tidemap_model::{StopSignal, label_evidence::normalise, selector::ModelSelector};
use tidemap_proto::{convert::anomaly::label_anomalies_to_wire, v1};

use super::{Judge, READINGS_PER_REPLY};
use crate::{
    lookup::check_limit,
    permits::run_while_awaited,
    query::{
        Queries,
        reconstruct::{PastQuery, past},
    },
    replies::{Replies, compute_replies},
    status::RpcError,
    training::LearnedState,
};

/// A label with its readings and its judge.
struct JudgedLabel {
    name: String,
    judge: Judge,
    readings: Vec<Reading>,
}

pub(super) async fn find_anomalies(
    queries: &Queries,
    handle: Arc<MapHandle>,
    view: Arc<MapView>,
    query: PastQuery,
    (selector, confidence): (ModelSelector, Confidence),
) -> Result<Replies<v1::FindAnomaliesResponse>, RpcError> {
    let labels: Vec<(StateId, String)> =
        view.labels(&query.name).into_iter().map(|(id, label)| (id, label.to_owned())).collect();
    let mut judged = Vec::with_capacity(labels.len());
    let mut total = 0;
    for (id, label) in labels {
        let trained = if selector.kind.needs_readings() {
            let learned = LearnedState::new(Arc::clone(&handle), Arc::clone(&view), id.into());
            Some(queries.trainer.trained(&learned, selector.kind).await?)
        } else {
            None
        };
        let name = format!("{}/{label}", query.name);
        let of_label = PastQuery { name, ..query.clone() };
        let (permits, gather) = past(queries, &handle, Arc::clone(&view), of_label).await?;
        let readings = run_while_awaited(permits, None, move |stop: StopSignal<'_>| gather(stop)).await??;
        total += readings.len() as u64;
        check_limit("readings of all labels", total, queries.max_predictions, "setting max_predictions")?;
        judged.push(JudgedLabel { name: label, judge: Judge { subject: id.into(), trained }, readings });
    }
    let permit = queries.permit_for(total).await?;
    Ok(compute_replies(vec![permit], move |sink| {
        let count = judged.iter().map(|label| label.readings.len()).min().unwrap_or(0);
        for start in (0..count).step_by(READINGS_PER_REPLY) {
            let range = start..count.min(start + READINGS_PER_REPLY);
            let found = unexpected(&view, &judged, range, (selector, confidence));
            if !sink.send(label_anomalies_to_wire(found)) {
                break;
            }
        }
        Ok(())
    }))
}

/// The unexpected labels of some observations, each with its anomaly.
fn unexpected(
    view: &MapView,
    labels: &[JudgedLabel],
    range: std::ops::Range<usize>,
    (selector, confidence): (ModelSelector, Confidence),
) -> Vec<(String, Anomaly)> {
    let of_label = |label: &JudgedLabel| label.judge.expected(view, &label.readings[range.clone()], selector);
    let expected: Vec<Vec<f64>> = labels.iter().map(of_label).collect();
    let mut found = Vec::new();
    for (place, index) in range.clone().enumerate() {
        let mut shares: Vec<f64> = expected.iter().map(|expected| expected[place]).collect();
        normalise(&mut shares);
        let observed = || labels.iter().map(|label| label.readings[index].1);
        let probability: f64 = observed().zip(&shares).map(|(observed, share)| observed * share).sum();
        if probability > 1.0 - confidence.get() {
            continue;
        }
        let largest = observed().zip(labels).max_by(|(one, _), (other, _)| one.total_cmp(other));
        let Some((value, label)) = largest else { continue };
        found.push((label.name.clone(), Anomaly { utc_nanos: label.readings[index].0, value, probability }));
    }
    found
}
