//! `FindAnomalies`: the unexpected observations of an interval.
//!
//! Invariant: each observation of the interval is judged once, by one view's model at its own time.

use std::sync::Arc;

use tidemap_map::{
    anomaly::{Anomaly, Confidence, anomalies},
    grid::view::CellDescription,
    history::Reading,
    ids::StateId,
    selector::ModelSelector,
    view::MapView,
};
use tidemap_proto::{
    convert::{
        anomaly::{confidence_from_wire, judge_from_wire},
        query::check_for_cells,
        time::interval_from_wire,
    },
    v1,
};

use super::{
    Queries,
    fitting::LearnedState,
    reconstruct::{PastQuery, past},
};
use crate::{
    model_cache::CachedModel,
    rpc::{
        lookup::{cell_of, find_cell, find_map, find_state},
        replies::{Replies, compute_replies},
        status::RpcError,
    },
};

/// Observations that are judged at once, and of one reply: their phasors take some 10 MB at 168 periodicities.
const READINGS_PER_REPLY: usize = 4096;

/// The model that observations are judged by.
enum Judge {
    /// The view's model of a state.
    State(StateId),
    /// A model that was fitted to the state's readings.
    Fitted(StateId, Arc<CachedModel>),
    /// The view's model of a cell.
    Cell(Box<CellDescription>),
}

impl Judge {
    fn expected(&self, view: &MapView, readings: &[Reading], selector: ModelSelector) -> Vec<f64> {
        let times: Vec<i64> = readings.iter().map(|(nanos, _)| *nanos).collect();
        let mut expected = vec![0.0; times.len()];
        match self {
            Self::State(id) => view.predict_into(*id, &view.prepare(&times), selector, &mut expected),
            Self::Fitted(id, fitted) => fitted.expect_into(view, *id, &view.moments(&times), selector, &mut expected),
            Self::Cell(cell) => view.predict_cell_into(cell, &view.prepare(&times), selector, &mut expected),
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
        match self {
            Self::State(id) | Self::Fitted(id, _) => {
                view.judged(*id, selector, readings, &expected, confidence).into_iter().flatten().collect()
            }
            Self::Cell(_) => anomalies(readings, &expected, confidence).collect(),
        }
    }
}

pub(super) async fn find_anomalies(
    queries: &Queries,
    request: v1::FindAnomaliesRequest,
) -> Result<Replies<v1::FindAnomaliesResponse>, RpcError> {
    let v1::FindAnomaliesRequest { map, state: name, from_time, to_time, confidence, model } = request;
    let handle = find_map(&queries.catalog, &map).await?;
    let asked = PastQuery { name: name.clone(), within_nanos: interval_from_wire(from_time, to_time)? };
    let confidence = confidence_from_wire("confidence", confidence)?;
    let selector = judge_from_wire("model", model)?;
    let view = handle.view();
    let cell = cell_of("state", &name)?;
    if cell.is_some() {
        check_for_cells("model", selector)?;
    }
    // Before the permits to look up are taken: a fit has its own permits, and may take long.
    let fitted = if selector.kind.needs_readings() {
        let learned = LearnedState::new(Arc::clone(&handle), Arc::clone(&view), find_state(&view, &name)?);
        Some(queries.fitting.fitted(&learned, selector.kind).await?)
    } else {
        None
    };
    let (permits, gather) = past(queries, &handle, Arc::clone(&view), asked).await?;
    Ok(compute_replies(permits, move |sink| {
        let judge = match (cell, fitted) {
            (Some(cell), _) => Judge::Cell(Box::new(find_cell(&view, cell)?)),
            (None, Some(fitted)) => Judge::Fitted(find_state(&view, &name)?, fitted),
            (None, None) => Judge::State(find_state(&view, &name)?),
        };
        for readings in gather()?.chunks(READINGS_PER_REPLY) {
            let mut reply = v1::FindAnomaliesResponse::default();
            for Anomaly { utc_nanos, value, probability } in judge.unexpected(&view, readings, selector, confidence) {
                reply.times_nanos.push(utc_nanos);
                reply.values.push(value);
                reply.probabilities.push(probability);
            }
            // An empty reply too, because only sending shows whether the client still listens.
            if !sink.send(reply) {
                break;
            }
        }
        Ok(())
    }))
}
