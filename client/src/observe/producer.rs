//! [`Producer`]: the handle by which a program sends its observations.
//!
//! Invariant: the handle and its task share only the window and the progress; no lock is held across an await.

mod scans;

use std::sync::{Arc, Mutex};

use tidemap_model::Position;
use tidemap_proto::convert::{sightings::SightingReport, traversals::TraversalReport};
use tokio::{
    sync::{Notify, watch},
    task::JoinHandle,
};

use super::{
    Phase, ProducerError, ProducerOptions, Progress, Refusal, STATE_NAME_BYTES_MAX,
    link::Link,
    shared::{Shared, SharedState},
    window::Window,
};
use crate::connection::Client;

/// Sends observations of one producer and label to one map, each exactly once.
///
/// ```no_run
/// # async fn example() -> Result<(), Box<dyn std::error::Error>> {
/// use tidemap_client::{Client, observe::{Producer, ProducerOptions}};
/// let client = Client::new("127.0.0.1:7435")?;
/// let mut producer = Producer::open(&client, ProducerOptions::new("robot-1", "", "office")).await?;
/// producer.send("door", 1_458_518_400_000_000_000, 1.0).await?;
/// producer.flush().await?; // from here on it survives kill -9 and power loss
/// # Ok(()) }
/// ```
#[derive(Debug)]
pub struct Producer {
    shared: Arc<Shared>,
    progress: watch::Receiver<Progress>,
    task: JoinHandle<()>,
}

impl Producer {
    /// Connects, sends Hello and waits for the answer, within the patience.
    ///
    /// # Errors
    /// [`ProducerError`].
    pub async fn open(client: &Client, options: ProducerOptions) -> Result<Self, ProducerError> {
        let mut producer = Self::start(client, options);
        producer.opened().await?;
        Ok(producer)
    }

    /// Does the same as [`Producer::open`], but does not wait: use [`Producer::opened`]. [`Producer::watch`] shows the
    /// progress meanwhile.
    #[must_use]
    pub fn start(client: &Client, options: ProducerOptions) -> Self {
        let (sender, progress) = watch::channel(Progress::default());
        let state = SharedState { window: None, urgent: 0, closing: false, refusals: Vec::new() };
        let shared = Arc::new(Shared { options, state: Mutex::new(state), more: Notify::new(), progress: sender });
        let task = tokio::spawn(Link::new(client.clone(), Arc::clone(&shared)).run());
        Self { shared, progress, task }
    }

    /// Waits until the daemon has answered the Hello. Observation number `durable_sequence` + 1 is the first to send.
    ///
    /// # Errors
    /// [`ProducerError`].
    pub async fn opened(&mut self) -> Result<Progress, ProducerError> {
        self.reached(|progress| progress.phase == Phase::Connected).await
    }

    /// Accepts a traversal and returns its number; waits while the window is full. It is durable once
    /// [`Progress::durable_sequence`] has reached the number.
    ///
    /// # Errors
    /// [`ProducerError`]; the traversal is then not accepted.
    pub async fn send_traversal(&mut self, report: &TraversalReport) -> Result<u64, ProducerError> {
        let TraversalReport { from, to, action, .. } = report;
        if let Some(long) = [from, to, action].into_iter().find(|name| name.len() > STATE_NAME_BYTES_MAX) {
            return Err(ProducerError::NameTooLong(long.len()));
        }
        let wire = report.to_report();
        self.push(|window| window.push_report(wire)).await
    }

    /// Accepts a sighting and returns its number; waits while the window is full. It is durable once
    /// [`Progress::durable_sequence`] has reached the number.
    ///
    /// # Errors
    /// [`ProducerError`]; the sighting is then not accepted.
    pub async fn send_sighting(&mut self, report: &SightingReport) -> Result<u64, ProducerError> {
        let SightingReport { place, seen, out_of_view, .. } = report;
        let names = seen.iter().chain(out_of_view).chain([place]);
        if let Some(long) = names.into_iter().find(|name| name.len() > STATE_NAME_BYTES_MAX) {
            return Err(ProducerError::NameTooLong(long.len()));
        }
        let wire = report.to_report();
        self.push(|window| window.push_report(wire)).await
    }

    /// Accepts an observation and returns its number; waits while the window is full. The observation is durable once
    /// [`Progress::durable_sequence`] has reached the number.
    ///
    /// # Errors
    /// [`ProducerError`]; the observation is then not accepted.
    pub async fn send(&mut self, state: &str, time_nanos: i64, value: f64) -> Result<u64, ProducerError> {
        self.take(state, time_nanos, |window| window.push(state, time_nanos, value)).await
    }

    /// Does the same as [`Producer::send`], for a vector: the coordinates in metres, x and y, or x, y and z. A new
    /// state becomes a vector of this many coordinates; [`ProducerOptions::kind`] is ignored.
    ///
    /// # Errors
    /// [`ProducerError`]; the observation is then not accepted.
    pub async fn send_position(
        &mut self,
        state: &str,
        time_nanos: i64,
        coordinates: &[f64],
    ) -> Result<u64, ProducerError> {
        let position = Position::of(coordinates).ok_or(ProducerError::Coordinates(coordinates.len()))?;
        self.take(state, time_nanos, |window| window.push_position(state, time_nanos, position)).await
    }

    /// Does the same as [`Producer::send`], for a categorical state: sends the label that holds.
    ///
    /// # Errors
    /// [`ProducerError`]; the observation is then not accepted.
    pub async fn send_label(&mut self, state: &str, time_nanos: i64, label: &str) -> Result<u64, ProducerError> {
        let name = label_name(state, label);
        self.take(&name, time_nanos, |window| window.push_label(&name, time_nanos)).await
    }

    async fn take(
        &mut self,
        state: &str,
        time_nanos: i64,
        push: impl FnOnce(&mut Window) -> Option<u64>,
    ) -> Result<u64, ProducerError> {
        if time_nanos < 0 {
            return Err(ProducerError::TimeBefore1970(time_nanos));
        }
        if state.len() > STATE_NAME_BYTES_MAX {
            return Err(ProducerError::NameTooLong(state.len()));
        }
        self.push(push).await
    }

    /// Waits for room, and pushes into the window.
    pub(super) async fn push(&mut self, push: impl FnOnce(&mut Window) -> Option<u64>) -> Result<u64, ProducerError> {
        self.room().await?;
        let sequence = self.shared.state().window.as_mut().and_then(push);
        // There is room: only this handle pushes.
        let sequence = sequence.ok_or(ProducerError::Closed)?;
        self.shared.more.notify_one();
        Ok(sequence)
    }

    /// Waits until the window is open and has room.
    async fn room(&mut self) -> Result<(), ProducerError> {
        loop {
            if let Phase::Ended(error) = &self.progress.borrow().phase {
                return Err(error.clone());
            }
            let durable = match &self.shared.state().window {
                Some(window) if window.has_room() => return Ok(()),
                Some(window) => Some(window.durable()),
                None => None,
            };
            // Any acknowledgement of something in the window makes room.
            let goal = |progress: &Progress| match durable {
                Some(durable) => progress.durable_sequence > durable,
                None => progress.phase == Phase::Connected,
            };
            self.reached(goal).await?;
        }
    }

    /// Waits until everything sent so far is durable, or refused.
    ///
    /// # Errors
    /// [`ProducerError`].
    pub async fn flush(&mut self) -> Result<Progress, ProducerError> {
        let last = {
            let mut shared = self.shared.state();
            let last = shared.window.as_ref().map_or(0, Window::last);
            shared.urgent = shared.urgent.max(last);
            last
        };
        self.shared.more.notify_one();
        self.reached(|progress| progress.durable_sequence >= last).await
    }

    /// Waits until everything sent is durable, and ends the stream. A producer that announced data time (`nightly`)
    /// reports its end to the daemon, so that updates no longer wait for it, and tries until this succeeds; if such a
    /// producer is dropped instead, the daemon assumes that it may return. Any other producer does not need the daemon
    /// once everything is durable.
    ///
    /// # Errors
    /// [`ProducerError`].
    pub async fn close(&mut self) -> Result<Progress, ProducerError> {
        let progress = self.flush().await?;
        self.shared.state().closing = true;
        self.shared.more.notify_one();
        let closed = |progress: &Progress| progress.phase == Phase::Ended(ProducerError::Closed);
        self.reached(closed).await.map(|_| progress)
    }

    /// Number of the last accepted observation, durable or not.
    #[must_use]
    pub fn last_sequence(&self) -> u64 {
        self.shared.state().window.as_ref().map_or(0, Window::last)
    }

    /// The progress now.
    #[must_use]
    pub fn progress(&self) -> Progress {
        self.progress.borrow().clone()
    }

    /// Watches the progress, and whether the daemon can be reached.
    #[must_use]
    pub fn watch(&self) -> watch::Receiver<Progress> {
        self.progress.clone()
    }

    /// The refusals that arrived since the last call, in order. At most 65,536 are kept; further ones are counted in
    /// [`Progress::dropped_refusals`].
    #[must_use]
    pub fn take_refusals(&mut self) -> Vec<Refusal> {
        std::mem::take(&mut self.shared.state().refusals)
    }

    async fn reached(&mut self, goal: impl Fn(&Progress) -> bool) -> Result<Progress, ProducerError> {
        let done = |progress: &Progress| goal(progress) || matches!(progress.phase, Phase::Ended(_));
        // The sender is part of `shared`, so it cannot be gone.
        let progress = match self.progress.wait_for(done).await {
            Ok(progress) => progress.clone(),
            Err(_) => self.shared.progress.borrow().clone(),
        };
        match &progress.phase {
            Phase::Ended(error) if !goal(&progress) => Err(error.clone()),
            _ => Ok(progress),
        }
    }
}

/// The name by which a label is sent.
pub(super) fn label_name(state: &str, label: &str) -> String {
    format!("{state}/{label}")
}

impl Drop for Producer {
    fn drop(&mut self) {
        self.task.abort();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observe::{RefusalReason, shared::REFUSALS_MAX};

    #[test]
    fn refusals_that_nobody_takes_are_counted_instead() {
        let refusals = |numbers: std::ops::Range<usize>| {
            numbers.map(|i| Refusal { sequence: i as u64, reason: Some(RefusalReason::Value), detail: String::new() })
        };
        let mut state = SharedState { window: None, urgent: 0, closing: false, refusals: Vec::new() };
        assert_eq!(state.keep_refusals(refusals(0..REFUSALS_MAX - 1)), 0);
        assert_eq!(state.keep_refusals(refusals(REFUSALS_MAX - 1..REFUSALS_MAX + 9)), 9);
        assert_eq!(state.keep_refusals(refusals(0..5)), 5);
        assert_eq!(state.refusals.len(), REFUSALS_MAX);
        assert_eq!(state.refusals.last().map(|refusal| refusal.sequence), Some(REFUSALS_MAX as u64 - 1));
        state.refusals.clear();
        assert_eq!(state.keep_refusals(refusals(0..5)), 0);
    }
}
