//! Converts batches of observations to events.
//!
//! Invariant: each number of an event belongs to a state of the map, or to a state that the event adds; a position and
//! an angle are taken with all of their numbers.

use std::borrow::Cow;

use tidemap_map::{
    event::{Event, Observations, StateShape},
    ids::{RefusalReason, StateId},
    live_map::LiveMap,
};
use tidemap_model::{Sample, cos_sin, time::FUTURE_MAX_NANOS};

use super::{
    super::protocol::{ObservationBatch, RefusedObservation, SessionId},
    Sessions, StreamEvent,
    states::{ObservedState, StateAllocator, StreamState},
};

impl Sessions {
    /// Converts a batch to an event; adds refusals if the map has no room for more states. `None`: the stream is
    /// closed, or there is nothing to log.
    pub(crate) fn observation_event(
        &mut self,
        id: SessionId,
        batch: ObservationBatch,
        map: &LiveMap,
        now: i64,
    ) -> Option<StreamEvent> {
        let session = self.sessions.get_mut(&id).filter(|session| session.open)?;
        session
            .table
            .extend(batch.new_names.into_iter().map(|name| name.map_or(StreamState::Invalid, StreamState::Unused)));
        if batch.span.is_empty() {
            return None;
        }
        let mut refused = batch.refused;
        let mut refuse = |i: usize, reason: RefusalReason, detail: String| {
            let offset = batch.kept.get(i).map_or(i as u64, |&kept| u64::from(kept));
            refused.push(RefusedObservation { sequence: batch.span.first + offset, reason, detail });
        };
        let plausible = now.saturating_add(FUTURE_MAX_NANOS);
        let may_wait = map.future() < self.limits.ahead;
        let mut positions = batch.positions.iter().peekable();
        let mut distributions = batch.shares.iter().peekable();
        let count = batch.table_indices.len();
        let mut observations = Observations {
            states: Vec::with_capacity(count),
            times_nanos: Vec::with_capacity(count),
            values: Vec::with_capacity(count),
            ..Observations::default()
        };
        let mut room = self.state_places.room(&session.client, map.states() + self.states_in_flight.states());
        for i in 0..count {
            let time = batch.times_nanos[i];
            let position = positions.next_if(|(place, _)| *place as usize == i).map(|(_, position)| *position);
            let shares = distributions.next_if(|(place, _)| *place as usize == i).map(|(_, shares)| &**shares);
            if time > plausible && !may_wait {
                refuse(i, RefusalReason::Time, too_far_ahead(time, self.limits.ahead));
                continue;
            }
            let Some(slot) = session.table.get_mut(batch.table_indices[i] as usize) else { continue };
            let mut allocator = StateAllocator { map, in_flight: &mut self.states_in_flight, room: &mut room };
            let has_parts = position.is_some() || shares.is_some();
            let observed =
                match slot.state_for(batch.values[i], has_parts, &mut allocator, &mut observations.new_states) {
                    Ok(observed) => observed,
                    Err(Some((reason, text))) => {
                        refuse(i, reason, text);
                        continue;
                    }
                    Err(None) => continue,
                };
            let offset_secs = self.offsets.offset_secs(time);
            let numbers = match (&position, shares) {
                (Some(position), _) => Cow::from(position.coordinates()),
                (None, Some(shares)) => Cow::from(shares),
                (None, None) => numbers_of(&observed, &batch.values[i..=i]),
            };
            for (&value, state) in numbers.iter().zip(observed.first.0..) {
                observations.push(StateId(state), Sample { utc_nanos: time, offset_secs, value });
            }
        }
        self.state_places.take(&session.client, room.taken());
        let envelope = session.envelope(map, &mut self.producers_in_flight, now, batch.span, &mut refused);
        Some(StreamEvent { event: Event::Observations(envelope, observations), refused, tiles_ahead: 0 })
    }
}

/// The numbers that the states get from an observation of one value.
fn numbers_of<'a>(observed: &ObservedState, value: &'a [f64]) -> Cow<'a, [f64]> {
    match (observed.shape, observed.held, value) {
        (StateShape::Angle, _, &[angle_rad]) => Cow::from(cos_sin(angle_rad).to_vec()),
        (StateShape::Categorical(labels), Some(held), _) => {
            let holds = |state: u32| f64::from(u8::from(state == held.0));
            (observed.first.0..).take(usize::from(labels)).map(holds).collect()
        }
        _ => Cow::from(value),
    }
}

/// The refusal of an observation whose time is in the future, when no more such observations may wait.
pub(super) fn too_far_ahead(time_nanos: i64, max: u64) -> String {
    format!(
        "time {time_nanos} ns is more than 5 minutes ahead of the server's clock, and {max} observations wait for their \
         time already, which is the maximum"
    )
}
