//! Looks at the storage once a second: whether the data folder is still ours, and what the health service says.
//!
//! Invariant: a folder or a log that is no longer ours ends the daemon, also while nothing is observed. The health
//! service says the same as readiness.

use std::{
    sync::{Arc, Weak},
    time::Duration,
};

use tokio::{
    sync::{mpsc, watch},
    time::{MissedTickBehavior, interval},
};

use crate::{catalog::Catalog, http::readiness, rpc::serve::Health};

const EVERY: Duration = Duration::from_secs(1);

/// Watches until nobody else holds the catalog, and with it the store; `fatal` hears why appends have stopped.
pub(crate) async fn run(
    catalog: Weak<Catalog>,
    health: Health,
    stopping: watch::Receiver<bool>,
    fatal: mpsc::UnboundedSender<String>,
) {
    let mut was_ready = None;
    let mut ticks = interval(EVERY);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        ticks.tick().await;
        let Some(catalog) = catalog.upgrade() else { return };
        let (is_ready, _) = readiness(&catalog, *stopping.borrow());
        if was_ready != Some(is_ready) {
            health.tell(is_ready).await;
            was_ready = Some(is_ready);
        }
        let store = Arc::clone(&catalog.context().store);
        drop(catalog);
        // A disk that hangs delays the next look only.
        if let Ok(Some(error)) = crate::task::blocking(move || store.verify()).await
            && fatal.send(error.to_string()).is_err()
        {
            return;
        }
    }
}
