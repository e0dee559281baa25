//! Reads the data folder again in the background, at a bounded rate.
//!
//! Invariant: it never reads faster than the setting allows, changes nothing, and stops nothing. Its findings are
//! logged, and shown by readiness and metrics.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use tidemap_base::config::Settings;
use tidemap_store::{Store, Trouble};
use tracing::{error, info, warn};

/// The longest wait before the thread checks whether it has to stop.
const STEP: Duration = Duration::from_millis(200);

/// The thread that reads; it stops when this is dropped.
#[derive(Debug, Default)]
pub(crate) struct Scrubber {
    is_stopping: Arc<AtomicBool>,
}

impl Drop for Scrubber {
    fn drop(&mut self) {
        self.is_stopping.store(true, Ordering::Relaxed);
    }
}

/// Waits; `false`: the daemon stops.
fn wait(is_stopping: &AtomicBool, mut time: Duration) -> bool {
    while !time.is_zero() && !is_stopping.load(Ordering::Relaxed) {
        let step = time.min(STEP);
        std::thread::sleep(step);
        time -= step;
    }
    !is_stopping.load(Ordering::Relaxed)
}

impl Scrubber {
    /// Starts the rounds in a thread of their own; with 0 bytes a second there are none.
    pub(crate) fn start(store: &Arc<Store>, settings: &Settings) -> Scrubber {
        let scrubber = Scrubber::default();
        let bytes_per_sec = settings.scrub_bytes_per_sec;
        if bytes_per_sec == 0 {
            return scrubber;
        }
        let pause = Duration::from_secs(settings.scrub_every_secs);
        // The store closes when nothing holds it, so a round holds it only while it runs.
        let (stopping, store) = (Arc::clone(&scrubber.is_stopping), Arc::downgrade(store));
        let spawned = std::thread::Builder::new().name("scrub".to_owned()).spawn(move || {
            let mut reported = Vec::new();
            while wait(&stopping, pause) {
                let Some(store) = store.upgrade() else { return };
                let mut pace =
                    |bytes: u64| wait(&stopping, Duration::from_secs_f64(bytes as f64 / bytes_per_sec as f64));
                let Some(damaged) = store.scrub(&mut pace) else { return };
                let mut found = store.trouble();
                found.retain(|trouble| matches!(trouble, Trouble::Damaged { .. }));
                for trouble in found.iter().filter(|trouble| !reported.contains(*trouble)) {
                    error!("{trouble}");
                }
                reported = found;
                info!(damaged, "the data folder was read again");
            }
        });
        if let Err(error) = spawned {
            warn!(%error, "no thread to read the data folder again");
        }
        scrubber
    }
}
