//! `Reconstruct`: what was observed, exactly.
//!
//! Invariant: each acknowledged observation of the interval is told once, whether an update has folded it in or not and
//! whether that has been saved or not.

use std::{sync::Arc, time::Duration};

use tidemap_map::{
    grid::spec::Retention,
    history::{HistoryPiece, Reading, Subject, cell_readings},
    spec::MapSpec,
    view::MapView,
};
use tidemap_proto::{convert::InvalidField, v1};
use tidemap_store::History;
use tokio::sync::oneshot;

use super::{
    Queries, check_limit, find_state,
    replies::{Replies, computed},
    states::{cell_of, find_cell},
};
use crate::{
    ingest::protocol::{Command, Ending, Recall, Recalled},
    rpc::{map::find_map, status::RpcError},
};

/// Observations of one reply.
const READINGS_PER_REPLY: usize = 8192;
/// A running update that has what was asked for is waited for so long.
const UPDATE_WITHIN: Duration = Duration::from_secs(30);

/// What is asked for.
struct Question {
    name: String,
    subject: Subject,
    from_nanos: i64,
    to_nanos: i64,
}

pub(super) async fn reconstruct(
    queries: &Queries,
    request: v1::ReconstructRequest,
) -> Result<Replies<v1::ReconstructResponse>, RpcError> {
    let v1::ReconstructRequest { map, state: name, from_nanos, to_nanos } = request;
    let handle = find_map(&queries.catalog, &map)?;
    if from_nanos < 0 {
        return Err(InvalidField::new("from_nanos", format!("{from_nanos} ns is before 1970")).into());
    }
    if to_nanos <= from_nanos {
        let text = format!("{to_nanos} ns is not after from_nanos, {from_nanos} ns");
        return Err(InvalidField::new("to_nanos", text).into());
    }
    let view = handle.view();
    let recall_turn = queries.recalls.take().await?;
    let subject = find_subject(&view, &name).await?;
    let spec = Arc::clone(&handle.spec);
    let retention = retention(&spec, subject)?;
    let question = Question { name, subject, from_nanos, to_nanos };

    let max = queries.max_predictions;
    // One more than may be told says that there are too many.
    let at_most = usize::try_from(max).unwrap_or(usize::MAX).saturating_add(1);
    let (reply, recalled) = oneshot::channel();
    let stopped = || RpcError::Ended(Ending::Shutdown);
    if !handle.send(Command::Recall(Recall { subject, from_nanos, to_nanos, at_most, reply })) {
        return Err(stopped());
    }
    let recalled = match tokio::time::timeout(UPDATE_WITHIN, recalled).await {
        Ok(recalled) => recalled.map_err(|_| stopped())?,
        Err(_) => return Err(RpcError::Updating(UPDATE_WITHIN.as_secs())),
    };
    let turn = queries.turns.take().await?;
    let history = queries.catalog.context().store.history(handle.id)?.before(recalled.stored_before);
    let gather = move || {
        let newest_nanos = recalled.newest_nanos;
        if let Subject::State(_) = subject
            && !history.is_complete()
        {
            let kept_from_nanos = kept_from(first_of_states(&history, &recalled)?, view.cut_nanos());
            if let Some(kept_from_nanos) = kept_from_nanos.filter(|&kept| question.from_nanos < kept) {
                return Err(RpcError::BeyondHistory { map, name: question.name, kept_from_nanos });
            }
        }
        let found = gather(&history, &spec, recalled, &question, max)?;
        if let (true, Retention::Duration(nanos)) = (found.is_empty(), retention) {
            let kept_from_nanos = newest_nanos.saturating_sub(nanos);
            if question.to_nanos <= kept_from_nanos {
                return Err(RpcError::BeyondHistory { map, name: question.name, kept_from_nanos });
            }
        }
        Ok(found)
    };
    Ok(computed((recall_turn, turn), move |computed| {
        for readings in gather()?.chunks(READINGS_PER_REPLY) {
            let (times_nanos, values) = readings.iter().copied().unzip();
            if !computed.send(v1::ReconstructResponse { times_nanos, values }) {
                break;
            }
        }
        Ok(())
    }))
}

async fn find_subject(view: &Arc<MapView>, name: &str) -> Result<Subject, RpcError> {
    let Some(cell) = cell_of("state", name)? else { return find_state(view, name).map(Subject::State) };
    let for_thread = Arc::clone(view);
    // Its tile may have to be read from the disk.
    let found = tokio::task::spawn_blocking(move || find_cell(&for_thread, cell).map(drop));
    found.await.map_err(|_| RpcError::Stopping)??;
    let (index, place) = cell.tile();
    let tile = view.grid().and_then(|grid| grid.find(index));
    let unknown = || RpcError::UnknownCell { map: view.spec().name.as_str().to_owned(), name: cell.name() };
    tile.map(|tile| Subject::Cell(tile, place)).ok_or_else(unknown)
}

/// How long the map keeps what is asked for.
fn retention(spec: &MapSpec, subject: Subject) -> Result<Retention, RpcError> {
    let (retention, what, option) = match subject {
        Subject::State(_) => (spec.retention, "states", "--retention"),
        Subject::Cell(..) => {
            let retention = spec.grid.as_ref().map_or(Retention::None, |grid| grid.retention);
            (retention, "its grid", "--grid-retention")
        }
    };
    if retention == Retention::None {
        return Err(RpcError::NoHistory { map: spec.name.as_str().to_owned(), what, option });
    }
    Ok(retention)
}

/// The first update that left its observations of named states, and the greatest time of these.
fn first_of_states(history: &History, recalled: &Recalled) -> Result<Option<(u64, i64)>, RpcError> {
    let of_piece = |piece: &Arc<HistoryPiece>| {
        let samples = piece.states.iter().flat_map(|(_, samples)| samples);
        Some((piece.generation, samples.map(|sample| sample.utc_nanos).max()?))
    };
    let unsaved = || recalled.unsaved.iter().filter_map(of_piece).min();
    Ok(history.first_of_states()?.or_else(unsaved))
}

/// From when on everything is kept of a map whose first updates may have left nothing; `None` where none was without.
/// What those had folded in is older than the observations of the first that left its own, or than the last cut.
fn kept_from(first: Option<(u64, i64)>, cut_nanos: Option<i64>) -> Option<i64> {
    match first {
        Some((0 | 1, _)) => None,
        Some((_, last_nanos)) => Some(last_nanos.saturating_add(1)),
        None => cut_nanos,
    }
}

/// The readings, ascending by time; of equal times in the order in which updates took them.
fn gather(
    history: &History,
    spec: &MapSpec,
    recalled: Recalled,
    question: &Question,
    max: u64,
) -> Result<Vec<Reading>, RpcError> {
    let &Question { subject, from_nanos, to_nanos, .. } = question;
    let within = from_nanos..to_nanos;
    let check = |found: &Vec<Reading>| {
        check_limit("observations of the interval", found.len() as u64, max, "setting max_predictions")
    };
    let mut found: Vec<Reading> = Vec::new();
    match subject {
        Subject::State(state) => {
            let enough = usize::try_from(max).unwrap_or(usize::MAX);
            let samples = history.clone().at_most(enough).state(state, from_nanos, to_nanos)?;
            found.extend(samples.iter().map(|sample| (sample.utc_nanos, sample.value)));
        }
        Subject::Cell(tile, cell) => {
            for day in history.grid_days(from_nanos, to_nanos, Some(vec![tile])) {
                let readings = day?.readings(tile, cell, &spec.periodicities);
                found.extend(cell_readings(readings.into_iter().filter(|(nanos, _)| within.contains(nanos))));
                check(&found)?;
            }
        }
    }
    let mut unsaved = recalled.unsaved;
    unsaved.sort_by_key(|piece| piece.generation);
    unsaved.dedup_by_key(|piece| piece.generation);
    for piece in &unsaved {
        found.extend(piece.readings(subject, from_nanos, to_nanos, &spec.periodicities));
        check(&found)?;
    }
    found.extend(recalled.pending);
    check(&found)?;
    found.sort_by_key(|(nanos, _)| *nanos);
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn updates_that_left_nothing_are_known_by_what_came_after() {
        assert_eq!(kept_from(None, None), None);
        assert_eq!(kept_from(Some((1, 50)), Some(90)), None);
        assert_eq!(kept_from(Some((3, 50)), Some(90)), Some(51));
        assert_eq!(kept_from(None, Some(90)), Some(90));
    }
}
