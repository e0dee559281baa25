//! `ListSurprises`: learned observations that were unusual before they were learned, and unusual observations that no
//! update has learned yet.
//!
//! Invariant: an observation is either pending or learned: the pending ones and the view are of the same generation.

use std::sync::Arc;

use tidemap_ingest::handle::MapHandle;
use tidemap_map::{
    anomaly::SurpriseQuestion,
    history::{Reading, Subject},
    ids::StateId,
    row_samples::RequestedReadings,
    view::MapView,
};
use tidemap_proto::{
    convert::anomaly::{no_cell_from_wire, surprise_to_wire, surprises_from_wire},
    v1,
};

use super::{Queries, STATES_MAX};
use crate::{
    lookup::{check_limit, find_map, find_parts},
    readings::{ReadingsQuery, UPDATE_WITHIN, not_replaced, read},
    status::RpcError,
};

/// Number of attempts to read the pending observations, if an update has ended meanwhile.
const ATTEMPTS: usize = 3;

pub(super) async fn list_surprises(
    queries: &Queries,
    request: v1::ListSurprisesRequest,
) -> Result<v1::ListSurprisesResponse, RpcError> {
    // The map is looked up first, so that the answer to a request for a map of others does not depend on the rest of
    // the request.
    let handle = find_map(&queries.catalog, &request.map).await?;
    let (names, question) = surprises_from_wire(request)?;
    check_limit("states", names.len() as u64, STATES_MAX as u64, "states of a request")?;
    let _past_permit = queries.past_permits.take().await?;
    for _ in 0..ATTEMPTS {
        let view = handle.view();
        let states = requested_states(&view, &names)?;
        let found = pending(&handle, &view, states, &question, queries.max_predictions).await?;
        if handle.view().generation() != view.generation() {
            continue;
        }
        not_replaced(&handle)?;
        let rows = found.iter().map(|(_, pending)| pending.len() as u64).sum();
        let (permit, max) = (queries.permit_for(rows).await?, queries.max_predictions);
        let answer = tidemap_base::task::blocking(move || {
            let _permit = permit;
            let found = stand_for(&view, found, &question, max)?;
            Ok(reply(&view, &found, &question))
        });
        return answer.await.map_err(|_| RpcError::Stopping)?;
    }
    Err(RpcError::Updating(UPDATE_WITHIN.as_secs()))
}

/// The states of these names, each once; all states if there are no names.
fn requested_states(view: &MapView, names: &[String]) -> Result<Vec<StateId>, RpcError> {
    if names.is_empty() {
        // The number of states is at most the number of ids.
        return Ok((0..view.len()).map(|id| StateId(id as u32)).collect());
    }
    let find = |(index, name): (usize, &String)| {
        no_cell_from_wire(&format!("states[{index}]"), name)?;
        find_parts(view, name)
    };
    let states = names.iter().enumerate().map(find).collect::<Result<Vec<Vec<StateId>>, RpcError>>()?;
    let mut states = states.concat();
    states.sort_unstable();
    states.dedup();
    Ok(states)
}

/// The states with their pending observations of the interval.
async fn pending(
    handle: &Arc<MapHandle>,
    view: &MapView,
    states: Vec<StateId>,
    question: &SurpriseQuestion,
    max: u64,
) -> Result<Vec<(StateId, Vec<Reading>)>, RpcError> {
    let mut found = Vec::with_capacity(states.len());
    let mut total = 0;
    for state in states {
        let mut readings = Vec::new();
        if view.pending_of(state) > 0 {
            let enough = usize::try_from(max).unwrap_or(usize::MAX);
            let within_nanos = view.rows_about(state, &question.within_nanos);
            readings =
                read(handle, &ReadingsQuery { subject: Subject::State(state), within_nanos, enough }).await?.pending;
        }
        total += readings.len() as u64;
        check_limit("observations to judge", total, max, "setting max_predictions")?;
        found.push((state, readings));
    }
    Ok(found)
}

/// The readings that the pending observations of states represent.
///
/// # Errors
/// More than `max` readings together.
fn stand_for(
    view: &MapView,
    found: Vec<(StateId, Vec<Reading>)>,
    question: &SurpriseQuestion,
    max: u64,
) -> Result<Vec<(StateId, Vec<Reading>)>, RpcError> {
    let mut total = 0_u64;
    let readings = |(state, pending)| {
        let at_most = usize::try_from(max - total).unwrap_or(usize::MAX).saturating_add(1);
        let requested = RequestedReadings { within_nanos: question.within_nanos.clone(), at_most };
        let readings = view.pending_readings(state, pending, &requested);
        total += readings.len() as u64;
        check_limit("observations to judge", total, max, "setting max_predictions")?;
        Ok((state, readings))
    };
    found.into_iter().map(readings).collect()
}

fn reply(view: &MapView, states: &[(StateId, Vec<Reading>)], question: &SurpriseQuestion) -> v1::ListSurprisesResponse {
    let name = |state: StateId| view.info(state).map_or("", |info| info.name.as_str());
    let runs = view.surprises(states, question);
    v1::ListSurprisesResponse {
        surprises: runs.iter().map(|found| surprise_to_wire(name(found.state), &found.run)).collect(),
        dropped_runs: states.iter().map(|(state, _)| view.dropped_surprises(*state)).sum(),
    }
}
