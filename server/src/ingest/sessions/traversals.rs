//! Converts traversals of edges to observations of the edges' states.
//!
//! A traversal is one observation on the wire, with one sequence number. For the map it is one or two observations of
//! ordinary states: `edge/A/B` at its start, and `speed/A/B` or `pace/A/B` if it succeeded. The event holds states and
//! values, so that a replay needs no topology. Failures come with the event (`Observations::failures`), and the site
//! keeps the last ones. The report of a task is likewise an observation of `task/KIND/NODE` at its start, and comes
//! with the event (`Observations::runs`).
//!
//! Invariant: a traversal is taken with all of its observations, in one event, or not at all. Its meaning depends on
//! the topology; the writer makes no event of traversals while an edit of the topology is in flight.

use tidemap_map::{
    event::{Event, Observations},
    ids::RefusalReason,
    live_map::LiveMap,
    task::{TaskRun, WorkReport},
    traversal::Traversal,
};
use tidemap_model::{Sample, StateKind, time::FUTURE_MAX_NANOS};
use tidemap_proto::convert::traversals::{refusal_of, unknown_edge};

use super::{
    super::protocol::{RefusedObservation, SessionId, TraversalBatch},
    Sessions, StreamEvent,
    observations::too_far_ahead,
    states::{Refusal, StateAllocator},
};

impl Sessions {
    /// Converts traversals to an event; adds refusals if an edge does not exist or the map has no room for more states.
    /// `None`: the stream is closed.
    pub(crate) fn traversal_event(
        &mut self,
        id: SessionId,
        batch: TraversalBatch,
        map: &LiveMap,
        now: i64,
    ) -> Option<StreamEvent> {
        let session = self.sessions.get_mut(&id).filter(|session| session.open)?;
        let TraversalBatch { span, traversals, mut refused } = batch;
        let plausible = now.saturating_add(FUTURE_MAX_NANOS);
        let may_wait = map.future() < self.limits.ahead;
        let mut observations = Observations::default();
        for (sequence, report) in traversals {
            let time = match &report {
                WorkReport::Edge(traversal) => traversal.start_nanos,
                WorkReport::Task(run) => run.start_nanos,
            };
            let result = if time > plausible && !may_wait {
                Err((RefusalReason::Time, too_far_ahead(time, self.limits.ahead)))
            } else {
                let allocator = StateAllocator {
                    map,
                    in_flight: &mut self.states_in_flight,
                    renames: &self.renames_in_flight,
                    reportings: &mut self.reportings_in_flight,
                    max: self.limits.states,
                };
                let offset_secs = self.offsets.offset_secs(time);
                match report {
                    WorkReport::Edge(traversal) => take(&mut observations, &traversal, allocator, offset_secs),
                    WorkReport::Task(run) => take_run(&mut observations, run, allocator, offset_secs),
                }
            };
            if let Err((reason, detail)) = result {
                refused.push(RefusedObservation { sequence, reason, detail });
            }
        }
        let envelope = session.envelope(map, &mut self.producers_in_flight, now, span, &mut refused);
        Some(StreamEvent { event: Event::Observations(envelope, observations), refused, tiles_ahead: 0 })
    }
}

/// Appends the observations of a traversal.
fn take(
    observations: &mut Observations,
    traversal: &Traversal,
    mut allocator: StateAllocator<'_>,
    offset_secs: i32,
) -> Result<(), Refusal> {
    let edge = allocator.map.site().topology().edge_named(&traversal.edge).map_err(|error| unknown_edge(&error))?;
    let samples = traversal.samples(edge.extent).map_err(|error| refusal_of(&error))?;
    let wanted: Vec<_> = samples.iter().map(|&(what, _)| (traversal.edge.state(what), what.kind())).collect();
    let states = allocator.states_for(&wanted, &mut observations.new_states)?;
    for (state, (_, value)) in states.into_iter().zip(samples) {
        observations.push(state, Sample { utc_nanos: traversal.start_nanos, offset_secs, value });
    }
    observations.failures.extend(traversal.failure());
    Ok(())
}

/// Appends the observation of a task.
fn take_run(
    observations: &mut Observations,
    run: TaskRun,
    mut allocator: StateAllocator<'_>,
    offset_secs: i32,
) -> Result<(), Refusal> {
    let wanted = [(run.name.state(), StateKind::Probability)];
    for state in allocator.states_for(&wanted, &mut observations.new_states)? {
        let (utc_nanos, value) = (run.start_nanos, run.observed());
        observations.push(state, Sample { utc_nanos, offset_secs, value });
    }
    observations.runs.push(run);
    Ok(())
}
