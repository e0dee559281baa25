//! A text that takes work to make, for all callers that request it at the same time.
//!
//! Invariant: a caller gets a text whose making began after the request. One text is made at a time, also when its
//! callers are gone, and making texts takes at most a quarter of the time, however many callers there are.

use std::{sync::Arc, time::Duration};

use axum::body::Bytes;
use tidemap_base::task::NoResult;
use tokio::{sync::Mutex, time::Instant};

/// The pause after a text, as a multiple of the time for which it was made.
const PAUSES: u32 = 3;
const PAUSE_MAX: Duration = Duration::from_secs(1);

/// The last text. Clones share it.
#[derive(Clone, Debug, Default)]
pub(super) struct SharedText(Arc<Mutex<Option<Made>>>);

#[derive(Debug)]
struct Made {
    began: Instant,
    /// The next text is not made before this time.
    next: Instant,
    text: Bytes,
}

impl SharedText {
    /// Returns a text that is made from now on. `gather` collects the data for it, and `write` works off the threads
    /// that answer.
    ///
    /// # Errors
    /// The work ended without a result.
    pub(super) async fn get<T, G, W>(&self, gather: G, write: W) -> Result<Bytes, NoResult>
    where
        T: Send + 'static,
        G: Future<Output = T> + Send + 'static,
        W: FnOnce(T) -> String + Send + 'static,
    {
        let requested = Instant::now();
        let last = Arc::clone(&self.0);
        // The task is separate: work that was begun has the lock until it ends.
        let made = tidemap_base::task::spawn(async move {
            let mut last = last.lock_owned().await;
            if let Some(made) = last.as_ref() {
                if made.began >= requested {
                    return Ok(made.text.clone());
                }
                tokio::time::sleep_until(made.next).await;
            }
            let began = Instant::now();
            let gathered = gather.await;
            let writes = Instant::now();
            let text = Bytes::from(tidemap_base::task::blocking(move || write(gathered)).await?);
            let next = Instant::now() + (writes.elapsed() * PAUSES).min(PAUSE_MAX);
            *last = Some(Made { began, next, text: text.clone() });
            Ok(text)
        });
        made.await?
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    #[tokio::test(flavor = "multi_thread")]
    async fn those_who_ask_together_share_a_text_that_is_new_to_each() {
        let (text, made) = (SharedText::default(), Arc::new(AtomicUsize::new(0)));
        let ask = || {
            let made = Arc::clone(&made);
            let write = move |()| {
                let number = made.fetch_add(1, Ordering::SeqCst);
                std::thread::sleep(Duration::from_millis(20));
                number.to_string()
            };
            let text = text.clone();
            async move { text.get(async {}, write).await.expect("a text") }
        };
        let before = ask().await;
        let asking: Vec<_> = (0..50).map(|_| tokio::spawn(ask())).collect();
        for waiting in asking {
            assert_ne!(waiting.await.expect("no panic"), before, "an old text");
        }
        assert!(made.load(Ordering::SeqCst) < 10, "{made:?} texts were made for 51 requests");
    }
}
