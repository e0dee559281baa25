//! `Reconstruct`: the exact observations of the past.
//!
//! Invariant: each acknowledged observation of the interval is sent once, learned or pending, saved or not.

use std::{ops::Range, sync::Arc};

use tidemap_grid::spec::Retention;
use tidemap_ingest::handle::MapHandle;
use tidemap_map::{
    history::{Reading, Subject},
    spec::MapSpec,
    view::MapView,
};
use tidemap_model::StopSignal;
use tidemap_proto::{
    convert::{cells::cell_from_wire, query::past_to_wire, time::interval_from_wire},
    v1,
};

use super::Queries;
use crate::{
    lookup::{check_limit, find_cell, find_map, find_state},
    permits::Permit,
    readings::{self, ReadingsQuery, gather, not_replaced, read},
    replies::{Replies, compute_replies},
    status::RpcError,
};

/// Number of observations in one reply.
const READINGS_PER_REPLY: usize = 8192;

pub(super) async fn reconstruct(
    queries: &Queries,
    request: v1::ReconstructRequest,
) -> Result<Replies<v1::ReconstructResponse>, RpcError> {
    let v1::ReconstructRequest { map, state: name, from_time, to_time } = request;
    let handle = find_map(&queries.catalog, &map).await?;
    let query = PastQuery { name, within_nanos: interval_from_wire(from_time, to_time)? };
    let view = handle.view();
    let (permits, gather) = past(queries, &handle, view, query).await?;
    Ok(compute_replies(permits, move |sink| {
        let is_left = || sink.is_closed();
        for readings in gather(StopSignal::new(&is_left))?.chunks(READINGS_PER_REPLY) {
            if !sink.send(past_to_wire(readings)) {
                break;
            }
        }
        Ok(())
    }))
}

/// A question about the past.
#[derive(Clone, Debug)]
pub(super) struct PastQuery {
    /// Name of a state or cell.
    pub(super) name: String,
    /// From the first instant up to but not including the second.
    pub(super) within_nanos: Range<i64>,
}

/// Returns a function that gathers the readings in a blocking thread unless it is stopped, and the permits to hold
/// meanwhile.
pub(super) async fn past(
    queries: &Queries,
    handle: &Arc<MapHandle>,
    view: Arc<MapView>,
    query: PastQuery,
) -> Result<(Vec<Permit>, impl FnOnce(StopSignal<'_>) -> Result<Vec<Reading>, RpcError> + Send + use<>), RpcError> {
    let PastQuery { name, within_nanos } = query;
    let to_nanos = within_nanos.end;
    let past_permit = queries.past_permits.take().await?;
    let subject = find_subject(&view, &name).await?;
    let spec = Arc::clone(&handle.spec);
    let retention = retention(&spec, subject)?;
    let max = queries.max_predictions;
    let enough = usize::try_from(max).unwrap_or(usize::MAX);
    let wanted = ReadingsQuery { subject, within_nanos, enough };
    let tail = read(handle, &wanted).await?;
    let permit = queries.large_permits.take().await?;
    let history = queries.catalog.context().store.history(handle.id)?.before(tail.stored_before);
    let handle = Arc::clone(handle);
    let gather = move |stop: StopSignal<'_>| {
        let newest_nanos = tail.newest_nanos;
        let map = || spec.name.as_str().to_owned();
        let found = gather(&history, &spec, tail, &wanted, stop)?;
        not_replaced(&handle)?;
        check_limit("observations of the interval", found.len() as u64, max, "setting max_predictions")?;
        if let (true, Retention::Duration(nanos)) = (found.is_empty(), retention) {
            let kept_from_nanos = newest_nanos.saturating_sub(nanos);
            if to_nanos <= kept_from_nanos {
                return Err(RpcError::BeyondHistory { map: map(), name, kept_from_nanos });
            }
        }
        Ok(found)
    };
    Ok((vec![past_permit, permit], gather))
}

async fn find_subject(view: &Arc<MapView>, name: &str) -> Result<Subject, RpcError> {
    let Some(cell) = cell_from_wire("state", name)? else { return find_state(view, name).map(Subject::State) };
    let for_thread = Arc::clone(view);
    // The tile of the cell may have to be read from the disk.
    let found = tidemap_base::task::blocking(move || find_cell(&for_thread, cell).map(drop));
    found.await??;
    let (index, place) = cell.tile();
    let tile = view.grid().and_then(|grid| grid.find(index));
    let unknown = || RpcError::UnknownCell { map: view.spec().name.as_str().to_owned(), name: cell.name() };
    tile.map(|tile| Subject::Cell(tile, place)).ok_or_else(unknown)
}

/// The retention of the subject.
fn retention(spec: &MapSpec, subject: Subject) -> Result<Retention, RpcError> {
    let (what, option) = match subject {
        Subject::State(_) => ("states", "a retention"),
        Subject::Cell(..) => ("its grid", "a grid retention"),
    };
    let no_history = || RpcError::NoHistory { map: spec.name.as_str().to_owned(), what, option };
    readings::retention(spec, subject).ok_or_else(no_history)
}
