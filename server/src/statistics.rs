//! Counters of a map and of the daemon.
//!
//! Invariant: names are never reused for something else; new ones are added at the end.

use crate::{catalog::Catalog, ingest::handle::MapHandle};

pub mod tiles;

/// Name, value, unit.
pub type Row = (&'static str, f64, &'static str);

/// Counters of one map.
#[must_use]
pub fn of_map(catalog: &Catalog, handle: &MapHandle) -> Vec<Row> {
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
    rows.extend(tiles::rows(catalog, handle, &sizes));
    rows
}

/// Counters of the daemon.
#[must_use]
pub fn of_daemon(catalog: &Catalog) -> Vec<Row> {
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
    rows.extend(of_storage(catalog));
    rows
}

fn of_storage(catalog: &Catalog) -> [Row; 3] {
    let sync = catalog.context().store.sync_stats();
    [
        ("fdatasyncs", sync.count as f64, ""),
        ("fdatasync_p50_secs", sync.p50.as_secs_f64(), "s"),
        ("fdatasync_p99_secs", sync.p99.as_secs_f64(), "s"),
    ]
}
