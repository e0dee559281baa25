//! Publishes observations as they are applied, with the models in force, to the watchers of anomalies.
//!
//! Invariant: publishing never waits, and costs nothing without watchers. A piece is dropped when all watchers have
//! read it; a bounded number of unread pieces is kept. Pieces keep no models alive: the writer keeps those of two
//! generations.

use std::sync::{Arc, Weak};

use tidemap_grid::scan::Scans;
use tidemap_map::{event::Observations, ids::StateId, view::MapView};
use tokio::sync::broadcast;

use super::ending::Ending;

/// Maximum number of observations of one piece.
const PIECE: usize = 4096;
/// Maximum number of pieces that wait for a watcher: 5 MB.
const PIECES: usize = 64;
/// Maximum number of events of scans that wait for a watcher, each at most as large as a message.
const SCAN_PIECES: usize = 16;
/// Number of generations whose models are kept for watchers: the one in force and the one before.
const GENERATIONS: usize = 2;

/// Observations that were applied one after another.
#[derive(Debug, Default)]
pub struct FeedPiece {
    /// The models that were in force; dropped after two more updates.
    pub models: Weak<MapView>,
    /// Number of observations sent before this piece.
    pub before: u64,
    /// The state of each observation.
    pub states: Vec<StateId>,
    /// The time of each observation, nanoseconds UTC.
    pub times_nanos: Vec<i64>,
    /// The value of each observation.
    pub values: Vec<f64>,
}

/// Scans that were applied.
#[derive(Debug)]
pub struct FeedScans {
    /// The models that were in force, as in [`FeedPiece::models`].
    pub models: Weak<MapView>,
    /// Number of scans sent before this message.
    pub before: u64,
    /// The scans.
    pub event: Scans,
}

/// A message to the watchers.
#[derive(Debug)]
pub enum FeedMessage {
    /// Observations that the map has applied.
    Applied(FeedPiece),
    /// Scans, only for watchers of cells.
    Scanned(FeedScans),
    /// The map stops.
    End(Ending),
}

/// The watcher's end of the channel.
pub type FeedReceiver = broadcast::Receiver<Arc<FeedMessage>>;

/// The start of a watch of cells.
#[derive(Debug)]
pub struct CellFeed {
    /// The receiver of the scans from now on.
    pub scans: FeedReceiver,
    /// Number of scans sent before.
    pub sent: u64,
    /// The view that contains all scans before.
    pub view: Arc<MapView>,
}

/// The writer's end of the feed.
#[derive(Debug)]
pub(crate) struct AnomalyFeed {
    sender: broadcast::Sender<Arc<FeedMessage>>,
    /// Observations that are applied and not public yet.
    waiting: Vec<FeedPiece>,
    /// Number of observations sent so far.
    sent: u64,
    /// The channel to the watchers of cells.
    scans: broadcast::Sender<Arc<FeedMessage>>,
    waiting_scans: Vec<Scans>,
    /// Number of scans sent so far.
    sent_scans: u64,
    /// The models that watchers may still need, oldest first.
    models: Vec<Arc<MapView>>,
}

impl Default for AnomalyFeed {
    fn default() -> Self {
        Self {
            sender: broadcast::channel(PIECES).0,
            waiting: Vec::new(),
            sent: 0,
            scans: broadcast::channel(SCAN_PIECES).0,
            waiting_scans: Vec::new(),
            sent_scans: 0,
            models: Vec::new(),
        }
    }
}

impl AnomalyFeed {
    /// Subscribes a watcher; returns the receiver, and the number of observations sent before. If there were watchers
    /// already, the new one also receives observations that are applied and not public yet.
    pub(crate) fn listen(&self) -> (FeedReceiver, u64) {
        (self.sender.subscribe(), self.sent)
    }

    /// Subscribes a watcher of cells, after all applied scans have been sent with this view.
    pub(crate) fn listen_to_cells(&self, view: Arc<MapView>) -> CellFeed {
        CellFeed { scans: self.scans.subscribe(), sent: self.sent_scans, view }
    }

    /// Collects scans that were applied.
    pub(crate) fn scanned(&mut self, event: &Scans) {
        if self.scans.receiver_count() > 0 {
            self.waiting_scans.push(event.clone());
        }
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

    /// Sends the collected observations and scans, after this view has been published.
    pub(crate) fn send_waiting(&mut self, view: &MapView) {
        let (waiting, scans) = (std::mem::take(&mut self.waiting), std::mem::take(&mut self.waiting_scans));
        if self.sender.receiver_count() + self.scans.receiver_count() == 0 {
            return self.models.clear();
        }
        if waiting.is_empty() && scans.is_empty() {
            return;
        }
        if self.models.last().is_none_or(|models| models.generation() != view.generation()) {
            self.models.push(Arc::new(view.models_only()));
            self.models.drain(..self.models.len().saturating_sub(GENERATIONS));
        }
        let models = self.models.last().map_or_else(Weak::new, Arc::downgrade);
        for event in scans {
            let (before, models) = (self.sent_scans, Weak::clone(&models));
            self.sent_scans += event.scans.len() as u64;
            let _ = self.scans.send(Arc::new(FeedMessage::Scanned(FeedScans { models, before, event })));
        }
        for mut piece in waiting {
            piece.models = Weak::clone(&models);
            piece.before = self.sent;
            self.sent += piece.states.len() as u64;
            // All watchers may have just left.
            let _ = self.sender.send(Arc::new(FeedMessage::Applied(piece)));
        }
    }

    /// Notifies the watchers that the map stops.
    pub(crate) fn end(&self, ending: Ending) {
        // There may be no watcher.
        let message = Arc::new(FeedMessage::End(ending));
        let _ = self.sender.send(Arc::clone(&message));
        let _ = self.scans.send(message);
    }
}

#[cfg(test)]
mod tests;
