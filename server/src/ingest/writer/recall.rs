//! What the writer can tell of the past: what is not in the store's history yet.
//!
//! Invariant: with the generations before `stored_before` of the store it is every observation that was acknowledged, each
//! once. A question about what a running update has waits for its end.

use std::sync::Arc;

use tidemap_map::history::HistoryPiece;

use super::{
    super::protocol::{Recall, Recalled},
    Writer,
};

impl Writer {
    pub(super) fn recall(&mut self, recall: Recall) {
        if recall.reply.is_closed() {
            return;
        }
        if self.updating_times.is_some_and(|(from, cut)| recall.from_nanos < cut && from < recall.to_nanos) {
            // Who asks has one of a bounded number of turns: there are never more than of these.
            self.waiting_recalls.retain(|waiting| !waiting.reply.is_closed());
            self.waiting_recalls.push(recall);
            return;
        }
        let pieces = self.unsaved.iter().flat_map(|snapshot| &snapshot.history);
        let pieces = pieces.chain(&self.unsaved_history).chain(&self.saving_history);
        let unsaved: Vec<Arc<HistoryPiece>> = pieces.map(Arc::clone).collect();
        // What comes later is told here as pending.
        let next = self.map.generation() + 1;
        let recalled = Recalled {
            pending: self.map.pending_readings(recall.subject, recall.from_nanos, recall.to_nanos, recall.at_most),
            stored_before: unsaved.iter().map(|piece| piece.generation).fold(next, u64::min),
            unsaved,
            newest_nanos: self.map.newest_nanos(),
        };
        // Who asked may have gone away.
        let _ = recall.reply.send(recalled);
    }
}
