//! Opens the data folder and the maps in it.
//!
//! Invariant: the state of the folder is written to the log before a map is served.

use std::{os::unix::fs::PermissionsExt as _, path::Path, sync::Arc};

use tidemap_base::{
    clock::SystemClock,
    config::Settings,
    random_id::random_id,
    telemetry::{self, traces::Span},
};
use tidemap_ingest::{
    catalog::{Catalog, RESTORED_FIRST_BYTES, UnopenedMap},
    cluster::Cluster,
    jobs::Jobs,
    update_turns::UpdateTurns,
    writer::{Context, ForkedMap},
};
use tidemap_map::{live_map::PendingLimits, update::UPDATE_READINGS_MAX};
use tidemap_model::time::format_rfc3339;
use tidemap_store::{CommitStep, OpenError, Store, StoreOptions, disk::Disk};
use tokio::sync::mpsc;
use tracing::{error, info, warn};

use super::DaemonError;

/// Opens the store of the settings, on a blocking thread.
///
/// # Errors
/// Another daemon has the store, or it cannot be used.
pub(super) async fn open_store(settings: &Settings, disk: Arc<dyn Disk>) -> Result<Arc<Store>, DaemonError> {
    let for_store = settings.clone();
    let open = move || open_now(&for_store, disk);
    let store = tidemap_base::task::blocking(open).await.map_err(anyhow::Error::from)??;
    close_to_others(&settings.data_dir);
    telemetry::report_build(store.store_id());
    report_state(&store, &settings.data_dir);
    Ok(Arc::new(store))
}

fn open_now(settings: &Settings, disk: Arc<dyn Disk>) -> Result<Store, DaemonError> {
    let options = StoreOptions {
        segment_bytes: settings.segment_bytes,
        index_cache_bytes: settings.index_cache_bytes,
        checkpoints_kept: settings.checkpoints_kept,
        tile_cache_bytes: settings.tile_cache_bytes,
        spectrum_cache_bytes: settings.spectrum_cache_bytes,
        new_store_id: random_id()?,
        expected_store_id: Some(settings.expect_store_id.clone()).filter(|id| !id.is_empty()),
    };
    Store::open_on(disk, &settings.data_dir, options).map_err(|error| match error {
        OpenError::Locked { .. } => DaemonError::Locked(error.to_string()),
        _ => DaemonError::Data(error.to_string()),
    })
}

/// Opens the maps; returns the maps that are served from the index, and have to be restored. `fatal` receives failures
/// of the storage, `forks` the maps whose logs differ from the shared ones.
///
/// # Errors
/// A map cannot be opened, and cannot be set aside.
pub(super) async fn open_catalog(
    settings: &Settings,
    store: Arc<Store>,
    fatal: mpsc::UnboundedSender<String>,
    forks: mpsc::UnboundedSender<ForkedMap>,
    cluster: Option<Cluster>,
) -> Result<(Arc<Catalog>, Vec<UnopenedMap>), DaemonError> {
    let member = cluster.as_ref().map(|cluster| Jobs::of_member(&cluster.settings().member));
    let jobs = member.unwrap_or_default();
    let context = Context {
        store,
        jobs: Arc::new(jobs),
        clock: Arc::new(SystemClock),
        update_turns: Arc::new(UpdateTurns::new(settings.update_threads())),
        fatal,
        forks,
        max_states: settings.max_states_per_map,
        max_producers: settings.max_producers_per_map,
        max_producers_of_client: settings.max_producers_per_client,
        max_pending: PendingLimits {
            observations: settings.max_pending_observations,
            changes: settings.max_pending_changes,
        },
        update_readings_max: UPDATE_READINGS_MAX,
        update_at_midnight: settings.update_at_midnight,
        max_tiles: settings.max_tiles_per_map,
        tile_cache_bytes: settings.tile_cache_bytes,
        cluster,
    };
    let max_maps = settings.max_maps;
    let open = move || Catalog::open(context, max_maps, RESTORED_FIRST_BYTES);
    let (catalog, rest) = tidemap_base::task::blocking(open).await.map_err(anyhow::Error::from)??;
    let catalog = Arc::new(catalog);
    follow_commits(&catalog);
    Ok((catalog, rest))
}

/// Removes the permissions of other users on the data folder, which an earlier version or a copy may have given.
fn close_to_others(folder: &Path) {
    let mode = match std::fs::metadata(folder) {
        Ok(metadata) => metadata.permissions().mode() & 0o777,
        Err(error) => return warn!(%error, "the permissions of the data folder cannot be read"),
    };
    if mode & 0o077 == 0 {
        return;
    }
    match std::fs::set_permissions(folder, std::fs::Permissions::from_mode(0o700)) {
        Ok(()) => warn!("the data folder was open to others with permissions {mode:o}; now they are 700"),
        Err(error) => {
            warn!(%error, "the data folder is open to others with permissions {mode:o}, which cannot be changed");
        }
    }
}

/// Writes to the log the opened folder and the state that was found in it.
fn report_state(store: &Store, folder: &Path) {
    let (id, folder) = (store.store_id(), folder.display());
    if store.is_new() {
        info!(
            "{folder} is a new data folder, with the store id {id}. If it should contain data: is its disk mounted? To \
             refuse any other folder from now on, put this line into the config file: expect_store_id = \"{id}\""
        );
    }
    for repair in store.repairs() {
        warn!("{repair}");
    }
    for trouble in store.trouble() {
        error!("{trouble}");
    }
    match store.losses() {
        Ok(losses) => losses.iter().for_each(|loss| {
            let accepted = format_rfc3339(loss.accepted_nanos);
            warn!(file = loss.file, accepted, "accepted as lost: {}", loss.problem);
        }),
        Err(error) => error!(%error, "the record of accepted losses cannot be read"),
    }
}

/// Makes a span of each group commit.
fn follow_commits(catalog: &Arc<Catalog>) {
    // This reference is weak, because the catalog holds the store.
    let maps = Arc::downgrade(catalog);
    catalog.context().store.follow_commits(Box::new(move |map, records, bytes| {
        let span = Span::root("commit");
        if span.is_recorded()
            && let Some(maps) = maps.upgrade()
            && let Some(handle) = maps.all().values().find(|handle| handle.id == map)
        {
            span.text("tidemap.map", &handle.spec.name);
        }
        span.number("tidemap.records", records as u64);
        span.number("tidemap.bytes", bytes);
        let mut part = span.child("write");
        Box::new(move |step| {
            part.end();
            match step {
                CommitStep::Written => part = span.child("fdatasync"),
                CommitStep::Durable => span.end(),
                CommitStep::Failed => {
                    span.fail("not durable: the log has the reason");
                    span.end();
                }
            }
        })
    }));
}
