//! Checks the storage once a second: whether the data folder still belongs to this daemon, the state for the health
//! service, and whether an index that a full or failing disk had closed can be used again.
//!
//! Invariant: a folder or a log that no longer belongs to this daemon ends it, also while nothing is observed. The
//! health service reports the same state as readiness. Opening an index never delays a check of the folder.

use std::{
    sync::{Arc, Weak},
    time::Duration,
};

use tidemap_base::task::Task;
use tidemap_ingest::catalog::Catalog;
use tidemap_rpc::serve::Health;
use tidemap_store::{Repair, Store};
use tokio::{
    sync::{mpsc, watch},
    time::{MissedTickBehavior, interval},
};
use tracing::{info, warn};

use crate::http::readiness;

const EVERY: Duration = Duration::from_secs(1);

/// Watches until nothing else holds the catalog, and with it the store; `fatal` receives the reason why appends have
/// stopped.
pub(crate) async fn run(
    catalog: Weak<Catalog>,
    health: Health,
    stopping: watch::Receiver<bool>,
    fatal: mpsc::UnboundedSender<String>,
) {
    let mut was_ready = None;
    let mut index = None;
    let mut ticks = interval(EVERY);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        ticks.tick().await;
        let Some(catalog) = catalog.upgrade() else { return };
        let (is_ready, _) = readiness(&catalog, *stopping.borrow());
        if was_ready != Some(is_ready) {
            health.set_ready(is_ready).await;
            was_ready = Some(is_ready);
        }
        let store = Arc::clone(&catalog.context().store);
        drop(catalog);
        recover_index(&store, &mut index).await;
        // A disk that hangs delays only the next check.
        if let Ok(Some(error)) = tidemap_base::task::blocking(move || store.verify()).await
            && fatal.send(error.to_string()).is_err()
        {
            return;
        }
    }
}

/// Starts to open an index again that is not open, unless this is still under way.
async fn recover_index(store: &Arc<Store>, under_way: &mut Option<Task<()>>) {
    if let Some(work) = under_way {
        if tokio::time::timeout(Duration::ZERO, work).await.is_err() {
            return;
        }
        *under_way = None;
    }
    if store.is_index_recoverable() {
        let store = Arc::clone(store);
        *under_way = Some(tidemap_base::task::blocking(move || {
            for repair in store.recover_index() {
                match repair {
                    Repair::IndexRecovered => info!("{repair}"),
                    repair => warn!("{repair}"),
                }
            }
        }));
    }
}
