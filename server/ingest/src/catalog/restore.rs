//! Restores a map from its newest checkpoint and the log after it.
//!
//! Invariant: a restored map equals the stopped map, even if its last update was cut off.

use std::sync::{Arc, atomic::AtomicU64};

use tidemap_map::{
    event::{Event, UpdateDone},
    live_map::LiveMap,
    snapshot::MapSnapshot,
    spec::MapSpec,
    update::UpdateWork,
};
use tidemap_store::{MapId, Replay};
use tracing::{info, warn};

use super::CatalogError;
use crate::{
    handle::{MapHandle, WriterEndpoints},
    writer::{Context, RestoredMap, UpdateFailed, start_in},
};

/// The size of history at which it is saved while a start repeats the updates in the log behind the checkpoint.
const HISTORY_BYTES: usize = 64 << 20;

/// Number of replayed records between two reports of progress.
const RECORDS_PER_REPORT: u64 = 256;

/// Restores a map and starts its writer.
pub(super) fn open_map(
    context: &Context,
    (id, shared_uid): (MapId, Option<u64>),
    spec: &Arc<MapSpec>,
) -> Result<Arc<MapHandle>, CatalogError> {
    let mut restored = restore_map(context, id, spec, &|_, _| true)?;
    let view = restored.map.publish();
    let (handle, endpoints) = MapHandle::with_endpoints((id, shared_uid), Arc::clone(spec), view, &context.clock);
    let restored = share(context, (id, shared_uid), &endpoints, restored)?;
    start_in(endpoints, context.clone(), id, restored)?;
    Ok(Arc::new(handle))
}

/// Makes the log of a restored map a shared one, if the map belongs to a cluster.
pub fn share(
    context: &Context,
    (id, shared_uid): (MapId, Option<u64>),
    endpoints: &WriterEndpoints,
    restored: RestoredMap,
) -> Result<RestoredMap, CatalogError> {
    let Some(uid) = shared_uid else { return Ok(restored) };
    let name = &restored.map.spec().name;
    let no_cluster = || CatalogError::NoCluster(name.clone());
    let cluster = context.cluster.as_ref().ok_or_else(no_cluster)?;
    let log = context.store.group_log(id).ok_or_else(no_cluster)?;
    let log = Arc::new(cluster.share(uid, name, log, endpoints.replica_listener()));
    Ok(RestoredMap { log, is_shared: true, ..restored })
}

/// Restores a map from its newest checkpoint and the log after it. The last update in the log may have been cut off:
/// the writer repeats it while the map is served from the generation before. `report` is called at intervals with the
/// number of replayed records and the total; its result decides whether to continue.
pub fn restore_map(
    context: &Context,
    id: MapId,
    spec: &Arc<MapSpec>,
    report: &dyn Fn(u64, u64) -> bool,
) -> Result<RestoredMap, CatalogError> {
    let opened = context.store.open_map(id, spec)?;
    for repair in &opened.repairs {
        warn!(map = %spec.name, "{repair}");
    }
    let from = opened.snapshot.as_ref().map_or(1, |snapshot| snapshot.replay_from.max(1));
    let total = (opened.log.end() + 1).saturating_sub(from);
    let mut repeated = UpdateReplay { context, id, spec, unsaved: None, save_above: HISTORY_BYTES };
    let goes_on = |replayed| report(replayed, total);
    let replayed = replay(spec, opened.snapshot, opened.replay, &goes_on, &mut |map, work| repeated.run(map, work))?;
    let ReplayedMap { map, replayed, logged, begun } = replayed;
    let unsaved = repeated.unsaved;
    info!(
        map = %spec.name, source = opened.source.name(), replayed, states = map.states(), pending = map.pending(),
        "map opened"
    );
    Ok(RestoredMap { map, log: Arc::new(opened.log), is_shared: false, logged, unsaved, begun })
}

/// A map that was made from its newest snapshot and the log behind it.
struct ReplayedMap {
    map: LiveMap,
    /// Number of events.
    replayed: u64,
    /// The end of the last update whose end is in the log.
    logged: Option<UpdateDone>,
    /// The last update that has begun in the log. It may take long, so it is run here only if another event shows that
    /// it ended.
    begun: Option<UpdateWork>,
}

/// Makes a map from its newest snapshot and the events behind it. `goes_on` is called at intervals with the number of
/// events so far; `run` repeats an update that had ended.
///
/// # Errors
/// The log cannot be read or does not fit the map, an update fails, or [`CatalogError::Stopping`].
fn replay(
    spec: &Arc<MapSpec>,
    snapshot: Option<MapSnapshot>,
    events: Replay,
    goes_on: &dyn Fn(u64) -> bool,
    run: &mut dyn FnMut(&mut LiveMap, UpdateWork) -> Result<(), CatalogError>,
) -> Result<ReplayedMap, CatalogError> {
    let known = snapshot.as_ref().map_or(0, |snapshot| snapshot.position);
    let mut map = match snapshot {
        Some(snapshot) => LiveMap::restore(Arc::clone(spec), snapshot),
        None => LiveMap::new(Arc::clone(spec)),
    };
    let (mut replayed, mut begun, mut logged) = (0u64, None, None);
    for entry in events {
        let (position, event) = entry?;
        if replayed.is_multiple_of(RECORDS_PER_REPORT) && !goes_on(replayed) {
            return Err(CatalogError::Stopping);
        }
        replayed += 1;
        if let Event::UpdateDone(done) = &event {
            logged = Some(*done);
        }
        if position <= known {
            map.recover_pending(position, &event)
        } else {
            // The update ended before the next one began.
            if matches!(event, Event::UpdateStart(_))
                && let Some(work) = begun.take()
            {
                run(&mut map, work)?;
            }
            map.apply(position, &event).map(|work| begun = work.or(begun.take()))
        }
        .map_err(|error| CatalogError::Inconsistent { map: spec.name.clone(), reason: error.to_string() })?;
    }
    Ok(ReplayedMap { map, replayed, logged, begun })
}

/// Checks that a start can make a map from its newest snapshot and the events behind it. Writes nothing; models that
/// need history are not trained by the updates that are repeated.
///
/// # Errors
/// The errors that a start reports.
pub fn try_restore(spec: &MapSpec, snapshot: Option<MapSnapshot>, events: Replay) -> Result<(), String> {
    let spec = Arc::new(spec.clone());
    let mut run = |map: &mut LiveMap, work: UpdateWork| {
        let result = work.run(&AtomicU64::new(0));
        let result = result.map_err(|source| CatalogError::Sums { map: spec.name.clone(), source })?;
        drop(map.finish_update(result));
        Ok(())
    };
    replay(&spec, snapshot, events, &|_| true, &mut run).map(drop).map_err(|error| error.to_string())
}

/// Repeats updates at the start, because other updates followed them, and keeps their unsaved results.
struct UpdateReplay<'a> {
    context: &'a Context,
    id: MapId,
    spec: &'a MapSpec,
    unsaved: Option<MapSnapshot>,
    save_above: usize,
}

impl UpdateReplay<'_> {
    fn run(&mut self, map: &mut LiveMap, work: UpdateWork) -> Result<(), CatalogError> {
        let done = AtomicU64::new(0);
        let kept = self.unsaved.as_ref().map_or(Vec::new(), |snapshot| snapshot.history.clone());
        let result = self.context.run_update(self.id, &self.spec.name, work, kept, &done);
        let result = result.map_err(|failed| match failed {
            UpdateFailed::Sums(source) => CatalogError::Sums { map: self.spec.name.clone(), source },
            UpdateFailed::Threads(error) => CatalogError::Thread(std::io::Error::other(error)),
        })?;
        let mut snapshot = map.finish_update(result);
        // This snapshot contains everything of the older ones except their history.
        let mut history = self.unsaved.take().map_or(Vec::new(), |older| older.history);
        history.append(&mut snapshot.history);
        snapshot.history = history;
        let bytes = snapshot.history.iter().map(|piece| piece.bytes()).sum::<usize>();
        if bytes <= self.save_above {
            self.unsaved = Some(snapshot);
            return Ok(());
        }
        self.unsaved = save_or_keep(self.context, self.id, snapshot);
        // If a snapshot could not be saved, the next attempt is made when the same amount of history has been added
        // again.
        self.save_above = HISTORY_BYTES + if self.unsaved.is_some() { bytes } else { 0 };
        Ok(())
    }
}

/// Saves a snapshot; returns it if that fails, because the log contains everything in it.
fn save_or_keep(context: &Context, id: MapId, snapshot: MapSnapshot) -> Option<MapSnapshot> {
    match context.store.save(id, &snapshot) {
        Ok(_) => None,
        Err(error) => {
            warn!(id = id.0, %error, "checkpoint not saved: the log has everything, and the save is retried");
            Some(snapshot)
        }
    }
}
