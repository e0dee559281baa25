//! Counters of a map and of the daemon.
//!
//! Invariant: a name never changes its meaning; new names are added at the end.

use std::sync::{Arc, atomic::Ordering};

use tidemap_grid::{index::TileId, spec::Retention};
use tidemap_model::UpdateWorth;
use tidemap_store::{Sizes, Trouble};

use crate::{catalog::Catalog, handle::MapHandle, jobs::Phase};

/// Name, value, unit.
pub(crate) type Counter = (&'static str, f64, &'static str);

/// Counters of one map. `worth`: the expected gain of an update, if the map can compute it.
pub fn of_map(catalog: &Catalog, handle: &MapHandle, worth: Option<UpdateWorth>) -> Vec<Counter> {
    let view = handle.view();
    let sizes = catalog.context().store.sizes(handle.id);
    let mut rows = vec![
        ("states", view.len() as f64, ""),
        ("observations", view.observations() as f64, ""),
        ("pending_observations", view.pending() as f64, ""),
        ("generation", view.generation() as f64, ""),
        ("log_position", view.position() as f64, ""),
        ("log_bytes", sizes.log_bytes as f64, "bytes"),
        ("checkpoint_bytes", sizes.checkpoint_bytes as f64, "bytes"),
    ];
    rows.extend(of_storage(catalog));
    rows.extend(of_grid(catalog, handle, &sizes));
    rows.push(("ahead_observations", view.ahead() as f64, ""));
    rows.push(("ahead_scans", view.grid().map_or(0, |grid| grid.scans_ahead()) as f64, ""));
    rows.push(("state_history_compression_ratio", state_history_ratio(catalog, handle), ""));
    if let Some(worth) = worth {
        rows.extend([
            ("pending_judged", worth.readings as f64, ""),
            ("pending_error", worth.pending_error(), ""),
            ("usual_error", worth.usual_error(), ""),
            ("update_gain", worth.gain(), ""),
        ]);
    }
    rows.push(("waiting_rows", view.waiting_rows() as f64, ""));
    rows
}

/// Counters of the daemon.
pub fn of_daemon(catalog: &Catalog) -> Vec<Counter> {
    let maps = catalog.all();
    let mut rows = vec![("maps", maps.len() as f64, "")];
    let mut sums = [
        ("states", 0.0, ""),
        ("observations", 0.0, ""),
        ("pending_observations", 0.0, ""),
        ("log_bytes", 0.0, "bytes"),
        ("checkpoint_bytes", 0.0, "bytes"),
    ];
    for handle in maps.values() {
        let view = handle.view();
        let sizes = catalog.context().store.sizes(handle.id);
        let values = [
            view.len() as f64,
            view.observations() as f64,
            view.pending() as f64,
            sizes.log_bytes as f64,
            sizes.checkpoint_bytes as f64,
        ];
        for (sum, value) in sums.iter_mut().zip(values) {
            sum.1 += value;
        }
    }
    rows.extend(sums);
    let trouble = catalog.context().store.trouble();
    let count = |is_counted: fn(&Trouble) -> bool| trouble.iter().filter(|trouble| is_counted(trouble)).count() as f64;
    rows.extend([
        ("disk_full", count(|trouble| *trouble == Trouble::DiskFull), ""),
        ("maps_not_saved", count(|trouble| matches!(trouble, Trouble::NotSaved { .. })), ""),
        ("damaged_files", count(|trouble| matches!(trouble, Trouble::Damaged { .. })), ""),
        ("index_unavailable", count(|trouble| matches!(trouble, Trouble::NoIndex(_))), ""),
    ]);
    rows.push(("maps_unavailable", catalog.unavailable().len() as f64, ""));
    rows.extend(of_storage(catalog));
    rows.push(("lists_lost", count(|trouble| matches!(trouble, Trouble::ListLost { .. })), ""));
    rows.push(("losses_accepted", catalog.context().store.losses().map_or(0, |losses| losses.len()) as f64, ""));
    rows
}

/// Gauges of updates: jobs, their progress, and the age of the oldest generation.
pub fn of_updates(catalog: &Catalog) -> [(&'static str, f64); 6] {
    let jobs = catalog.context().jobs.list();
    let mut progress = 1.0_f64;
    let (mut running, mut waiting) = (0_u32, 0_u32);
    for job in jobs.iter().filter(|job| !job.has_ended()) {
        let status = job.status();
        match status.phase {
            Phase::Waiting => waiting += 1,
            Phase::Running(_) => {
                running += 1;
                let done = job.states_done.load(Ordering::Relaxed) as f64;
                progress = progress.min(if status.states_total == 0 { 1.0 } else { done / status.states_total as f64 });
            }
            Phase::Done(_) | Phase::Failed(..) => {}
        }
    }
    let now = catalog.context().clock.now_nanos();
    let age = |handle: &Arc<MapHandle>| {
        let view = handle.view();
        let since = view.cut_nanos().unwrap_or(handle.spec.created_nanos);
        if view.pending() == 0 { 0.0 } else { now.saturating_sub(since).max(0) as f64 / 1e9 }
    };
    [
        ("tidemap_jobs_running", f64::from(running)),
        ("tidemap_jobs_waiting", f64::from(waiting)),
        ("tidemap_job_progress_ratio", progress),
        ("tidemap_updates_waiting_turn", catalog.context().update_turns.waiting() as f64),
        ("tidemap_waiting_rows", catalog.all().values().map(|handle| handle.view().waiting_rows() as f64).sum()),
        ("tidemap_generation_age_seconds", catalog.all().values().map(age).fold(0.0, f64::max)),
    ]
}

fn of_storage(catalog: &Catalog) -> [Counter; 3] {
    let sync = catalog.context().store.sync_stats();
    [
        ("fdatasyncs", sync.count as f64, ""),
        ("fdatasync_p50_secs", sync.p50.as_secs_f64(), "s"),
        ("fdatasync_p99_secs", sync.p99.as_secs_f64(), "s"),
    ]
}

/// Bits observed per bit stored (T-RO 2017, eq. 16); 0 if nothing is stored.
fn ratio(observed_bits: u64, kept_bytes: u64) -> f64 {
    if kept_bytes == 0 { 0.0 } else { observed_bits as f64 / (8.0 * kept_bytes as f64) }
}

/// Learned observations of named states, of one bit each, per bit of their history. The ratio is 0 if the map does not
/// keep all of them, or if the newest generation is not stored yet: then the files do not show the size of the history
/// of these observations.
fn state_history_ratio(catalog: &Catalog, handle: &MapHandle) -> f64 {
    let view = handle.view();
    let history = catalog.context().store.history(handle.id).ok().and_then(|history| history.sizes().ok());
    let sizes = history.unwrap_or_default();
    if handle.spec.retention == Retention::Forever && sizes.newest_generation == view.generation() {
        ratio(view.observations().saturating_sub(view.pending()), sizes.state_bytes)
    } else {
        0.0
    }
}

/// Counters of the grid of a map, and its compression; 0 if the map has no grid.
fn of_grid(catalog: &Catalog, handle: &MapHandle, sizes: &Sizes) -> Vec<Counter> {
    let view = handle.view();
    let totals = handle.tile_totals();
    let grid = view.grid();
    let live_bytes: u64 = grid.map_or(0, |grid| {
        let ids = (0..u32::try_from(grid.tiles()).unwrap_or(u32::MAX)).map(TileId);
        ids.filter_map(|id| grid.live(id)).map(|tile| tile.bytes() as u64).sum()
    });
    let cell_observations = grid.map_or(0, |grid| grid.cell_observations());
    let history = catalog.context().store.history(handle.id).ok().and_then(|history| history.sizes().ok());
    let grid_history = history.unwrap_or_default().grid_bytes;
    vec![
        ("history_bytes", sizes.history_bytes as f64, "bytes"),
        ("tiles", grid.map_or(0, |grid| grid.tiles()) as f64, ""),
        ("scans", grid.map_or(0, |grid| grid.scans()) as f64, ""),
        ("pending_scans", grid.map_or(0, |grid| grid.pending_scans()) as f64, ""),
        ("cell_observations", cell_observations as f64, ""),
        ("changed_cells", totals.changed_cells as f64, ""),
        ("tile_memory_bytes", (live_bytes + handle.tile_bytes()) as f64, "bytes"),
        ("published_model_bytes", totals.model_bytes as f64, "bytes"),
        ("compression_ratio", ratio(cell_observations, totals.model_bytes), ""),
        ("history_compression_ratio", ratio(cell_observations, totals.model_bytes + grid_history), ""),
    ]
}
