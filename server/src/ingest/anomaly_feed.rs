//! What a writer tells those who watch: observations as they are applied, with the models in force.
//!
//! Invariant: telling never waits, and costs nothing while nobody watches. What is told is dropped when all have read it,
//! and of what somebody has not read there is a bounded number of pieces, which keep no models alive: the writer does,
//! those of two generations.

use std::sync::{Arc, Weak};

use tidemap_map::{event::Observations, ids::StateId, view::MapView};
use tokio::sync::broadcast;

use super::ending::Ending;

/// Most observations of one piece.
const PIECE: usize = 4096;
/// Most pieces that wait for a watcher: 5 MB.
const PIECES: usize = 64;
/// Generations whose models are kept for those who have not judged yet: the one in force and the one before.
const GENERATIONS: usize = 2;

/// Observations that were applied one after the other.
#[derive(Debug, Default)]
pub(crate) struct FeedPiece {
    /// The models that were in force; gone where two updates have ended since.
    pub models: Weak<MapView>,
    /// How many observations were told before.
    pub before: u64,
    /// Per observation: the state.
    pub states: Vec<StateId>,
    /// Per observation: time in nanoseconds UTC.
    pub times_nanos: Vec<i64>,
    /// Per observation: its value.
    pub values: Vec<f64>,
}

/// What watchers are told.
#[derive(Debug)]
pub(crate) enum FeedMessage {
    /// Observations were applied.
    Applied(FeedPiece),
    /// The map stops.
    End(Ending),
}

/// What watchers hear.
pub(crate) type FeedReceiver = broadcast::Receiver<Arc<FeedMessage>>;

/// The writer's end.
#[derive(Debug)]
pub(crate) struct AnomalyFeed {
    sender: broadcast::Sender<Arc<FeedMessage>>,
    /// FeedPiece, and not yet public.
    waiting: Vec<FeedPiece>,
    /// Observations told so far.
    told: u64,
    /// Models that may still be judged by, oldest first.
    models: Vec<Arc<MapView>>,
}

impl Default for AnomalyFeed {
    fn default() -> Self {
        Self { sender: broadcast::channel(PIECES).0, waiting: Vec::new(), told: 0, models: Vec::new() }
    }
}

impl AnomalyFeed {
    /// Another one who watches, and how many observations were told before. What was applied and is not public yet comes too,
    /// where somebody else watched.
    pub(crate) fn listen(&self) -> (FeedReceiver, u64) {
        (self.sender.subscribe(), self.told)
    }

    /// Takes note of observations that were applied.
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

    /// Tells what was applied, once this view shows it.
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
            piece.before = self.told;
            self.told += piece.states.len() as u64;
            // They may all have left just now.
            let _ = self.sender.send(Arc::new(FeedMessage::Applied(piece)));
        }
    }

    /// Tells that the map stops.
    pub(crate) fn end(&self, ending: Ending) {
        // Where nobody watches, nobody has to be told.
        let _ = self.sender.send(Arc::new(FeedMessage::End(ending)));
    }
}

#[cfg(test)]
mod tests;
