//! Estimates in bounded time whether an update of a map is worth its cost.
//!
//! The writer returns an extract of the pending observations, and the rest is done from a view. Invariant: the judged
//! observations and the judging model are of the same generation. The writer copies at most [`STATES_MAX`] ×
//! [`READINGS_MAX`] readings.

use std::{sync::Arc, time::Duration};

use tidemap_ingest::{
    handle::MapHandle,
    protocol::{Command, PendingExtract, ReadPending},
};
use tidemap_model::UpdateWorth;
use tokio::sync::oneshot;

/// Maximum number of judged states. In a larger map, these are the states with the largest numbers of pending
/// observations.
const STATES_MAX: usize = 1_000;
/// Maximum number of judged readings of a state.
const READINGS_MAX: usize = 100;
/// Time limit for the writer's reply. A writer that takes longer is opening its map, or is busy.
const WITHIN: Duration = Duration::from_secs(1);

/// The expected gain of learning the pending observations of a map. `None`: the writer does not reply at once, or an
/// update ended meanwhile.
pub(crate) async fn of_map(handle: &Arc<MapHandle>) -> Option<UpdateWorth> {
    if handle.view().pending() == 0 {
        return Some(UpdateWorth::default());
    }
    let (reply, extract) = oneshot::channel();
    let read = ReadPending { states_max: STATES_MAX, readings_max: READINGS_MAX, reply };
    if !handle.send(Command::ReadPending(read)) {
        return None;
    }
    let PendingExtract { generation, states } = tokio::time::timeout(WITHIN, extract).await.ok()?.ok()?;
    let view = handle.view();
    if view.generation() != generation || handle.is_replaced() {
        return None;
    }
    tidemap_base::task::blocking(move || view.update_worth(states, READINGS_MAX)).await.ok()
}
