//! Publishes observations as they are applied, with the models in force, to those who watch for anomalies.
//!
//! Invariant: publishing never waits, and costs nothing without watchers. A piece is dropped when all have read it; a
//! bounded number of unread pieces is kept. Pieces keep no models alive: the writer keeps those of two generations.

use std::sync::{Arc, Weak};

use tidemap_map::{event::Observations, ids::StateId, view::MapView};
use tokio::sync::broadcast;

use super::ending::Ending;

/// Maximum number of observations of one piece.
const PIECE: usize = 4096;
/// Maximum number of pieces that wait for a watcher: 5 MB.
const PIECES: usize = 64;
/// Generations whose models are kept for watchers: the one in force and the one before.
const GENERATIONS: usize = 2;

/// Observations that were applied one after another.
#[derive(Debug, Default)]
pub(crate) struct FeedPiece {
    /// The models that were in force; gone after two more updates.
    pub models: Weak<MapView>,
    /// Number of observations sent before this piece.
    pub before: u64,
    /// Per observation: the state.
    pub states: Vec<StateId>,
    /// Per observation: time in nanoseconds UTC.
    pub times_nanos: Vec<i64>,
    /// Per observation: its value.
    pub values: Vec<f64>,
}

/// A message to the watchers.
#[derive(Debug)]
pub(crate) enum FeedMessage {
    Applied(FeedPiece),
    /// The map stops.
    End(Ending),
}

/// The watcher's end.
pub(crate) type FeedReceiver = broadcast::Receiver<Arc<FeedMessage>>;

/// The writer's end.
#[derive(Debug)]
pub(crate) struct AnomalyFeed {
    sender: broadcast::Sender<Arc<FeedMessage>>,
    /// Applied, and not public yet.
    waiting: Vec<FeedPiece>,
    /// Number of observations sent so far.
    sent: u64,
    /// The models that watchers may still need, oldest first.
    models: Vec<Arc<MapView>>,
}

impl Default for AnomalyFeed {
    fn default() -> Self {
        Self { sender: broadcast::channel(PIECES).0, waiting: Vec::new(), sent: 0, models: Vec::new() }
    }
}

impl AnomalyFeed {
    /// Subscribes a watcher; gives the receiver, and the number of observations sent before. If others watched already,
    /// observations that are applied and not public yet come too.
    pub(crate) fn listen(&self) -> (FeedReceiver, u64) {
        (self.sender.subscribe(), self.sent)
    }

    /// Collects observations that were applied.
    pub(crate) fn applied(&mut self, observations: &Observations) {
        if self.sender.receiver_count() == 0 {
            return;
        }
        for (state, sample) in observations.samples() {
            if self.waiting.last().is_none_or(|piece| piece.states.len() >= PIECE) {
                self.waiting.push(FeedPiece::default());
            }
            if let Some(piece) = self.waiting.last_mut() {
                piece.states.push(state);
                piece.times_nanos.push(sample.utc_nanos);
                piece.values.push(sample.value);
            }
        }
    }

    /// Sends what was collected, after this view has been published.
    pub(crate) fn tell(&mut self, view: &MapView) {
        let waiting = std::mem::take(&mut self.waiting);
        if self.sender.receiver_count() == 0 {
            return self.models.clear();
        }
        if waiting.is_empty() {
            return;
        }
        if self.models.last().is_none_or(|models| models.generation() != view.generation()) {
            self.models.push(Arc::new(view.models_only()));
            self.models.drain(..self.models.len().saturating_sub(GENERATIONS));
        }
        for mut piece in waiting {
            piece.models = self.models.last().map_or_else(Weak::new, Arc::downgrade);
            piece.before = self.sent;
            self.sent += piece.states.len() as u64;
            // All watchers may have just left.
            let _ = self.sender.send(Arc::new(FeedMessage::Applied(piece)));
        }
    }

    /// Tells the watchers that the map stops.
    pub(crate) fn end(&self, ending: Ending) {
        // There may be no watcher.
        let _ = self.sender.send(Arc::new(FeedMessage::End(ending)));
    }
}

#[cfg(test)]
mod tests;
