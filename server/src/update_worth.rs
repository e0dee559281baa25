//! Whether an update of a map is worth it, in bounded time.
//!
//! The writer hands out an extract of what is pending, and the rest is done from a view. Invariant: what is judged and
//! the model that judges are of the same generation. The writer copies at most [`STATES_MAX`] × [`READINGS_MAX`]
//! readings.

use std::{sync::Arc, time::Duration};

use tidemap_model::UpdateWorth;
use tokio::sync::oneshot;

use crate::ingest::{
    handle::MapHandle,
    protocol::{Command, PendingExtract, ReadPending},
};

/// Of a larger map the states with the largest numbers of pending observations are judged.
const STATES_MAX: usize = 1_000;
/// Readings of a state that are judged.
const READINGS_MAX: usize = 100;
/// A writer that does not answer within this is opening its map, or is busy.
const WITHIN: Duration = Duration::from_secs(1);

/// What learning the pending observations of a map is expected to gain. `None`: the writer does not answer at once, or
/// an update ended meanwhile.
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
    crate::task::blocking(move || view.update_worth(states, READINGS_MAX)).await.ok()
}
