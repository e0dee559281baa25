//! Closed to strangers: TLS, and later tokens, from outside.

mod tls;

use std::time::{Duration, Instant};

/// A change of files takes effect within this time, with much room for a busy machine.
const NOTICED_WITHIN: Duration = Duration::from_secs(30);

/// Waits until something is so.
async fn eventually(what: &str, mut is_so: impl AsyncFnMut() -> bool) {
    let start = Instant::now();
    while !is_so().await {
        assert!(start.elapsed() < NOTICED_WITHIN, "not within {} seconds: {what}", NOTICED_WITHIN.as_secs());
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}
