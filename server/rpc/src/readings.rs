//! The exact observations of a state or a cell, from history files, unsaved history and pending observations.
//!
//! Invariant: each observation is returned once, saved or not; ascending by time, and at equal times in the order of
//! the updates.

use std::{ops::Range, time::Duration};

use tidemap_grid::spec::Retention;
use tidemap_ingest::{
    ending::Ending,
    handle::MapHandle,
    protocol::{Command, HistoryTail, ReadHistory},
};
use tidemap_map::{
    history::{Reading, Subject, cell_readings},
    spec::MapSpec,
};
use tidemap_model::StopSignal;
use tidemap_store::History;
use tokio::sync::oneshot;

use crate::status::RpcError;

/// How long to wait for a running update that has the observations.
pub(super) const UPDATE_WITHIN: Duration = Duration::from_secs(30);

/// A query for readings.
#[derive(Clone, Debug)]
pub(super) struct ReadingsQuery {
    pub subject: Subject,
    /// From the first instant up to but not including the last, nanoseconds UTC.
    pub within_nanos: Range<i64>,
    /// Gathering stops when it has more readings than this.
    pub enough: usize,
}

/// The retention of the subject's readings; `None`: none are kept.
pub(super) fn retention(spec: &MapSpec, subject: Subject) -> Option<Retention> {
    let retention = match subject {
        Subject::State(_) => spec.retention,
        Subject::Cell(..) => spec.grid.as_ref().map_or(Retention::None, |grid| grid.retention),
    };
    (retention != Retention::None).then_some(retention)
}

/// Reads the writer's part: pending observations, and history that is not saved.
pub(super) async fn read(handle: &MapHandle, wanted: &ReadingsQuery) -> Result<HistoryTail, RpcError> {
    let (reply, tail) = oneshot::channel();
    let stopped = || RpcError::Ended(Ending::Shutdown);
    let read = ReadHistory {
        subject: wanted.subject,
        from_nanos: wanted.within_nanos.start,
        to_nanos: wanted.within_nanos.end,
        // One more than `enough` shows that there are too many.
        at_most: wanted.enough.saturating_add(1),
        reply,
    };
    if !handle.send(Command::ReadHistory(read)) {
        return Err(stopped());
    }
    match tokio::time::timeout(UPDATE_WITHIN, tail).await {
        Ok(tail) => tail.map_err(|_| stopped()),
        Err(_) => Err(RpcError::Updating(UPDATE_WITHIN.as_secs())),
    }
}

/// Checks that the ids in the data that was read are still those of the map.
pub(super) fn not_replaced(handle: &MapHandle) -> Result<(), RpcError> {
    if handle.is_replaced() { Err(RpcError::Ended(Ending::Erasure)) } else { Ok(()) }
}

/// Gathers the readings, unless the work is stopped. If there are more than `enough`, it returns some of them, more
/// than `enough`, unordered.
pub(super) fn gather(
    history: &History,
    spec: &MapSpec,
    tail: HistoryTail,
    wanted: &ReadingsQuery,
    stop: StopSignal<'_>,
) -> Result<Vec<Reading>, RpcError> {
    let &ReadingsQuery { subject, ref within_nanos, enough } = wanted;
    let (from_nanos, to_nanos) = (within_nanos.start, within_nanos.end);
    let mut found: Vec<Reading> = Vec::new();
    match subject {
        Subject::State(state) => {
            let samples = history.clone().at_most(enough).state_until(state, from_nanos, to_nanos, stop)?;
            found.extend(samples.iter().map(|sample| (sample.utc_nanos, sample.value)));
        }
        Subject::Cell(tile, cell) => {
            for day in history.grid_days(from_nanos, to_nanos, Some(vec![tile])) {
                stop.check()?;
                let readings = day?.readings(tile, cell, &spec.periodicities);
                found.extend(cell_readings(readings.into_iter().filter(|(nanos, _)| within_nanos.contains(nanos))));
                if found.len() > enough {
                    return Ok(found);
                }
            }
        }
    }
    let mut unsaved = tail.unsaved;
    unsaved.sort_by_key(|piece| piece.generation);
    unsaved.dedup_by_key(|piece| piece.generation);
    for piece in &unsaved {
        stop.check()?;
        if found.len() > enough {
            return Ok(found);
        }
        found.extend(piece.readings(subject, from_nanos, to_nanos, &spec.periodicities));
    }
    found.extend(tail.pending);
    stop.check()?;
    found.sort_by_key(|(nanos, _)| *nanos);
    Ok(found)
}
