//! Converts traversals of edges and sightings of landmarks to observations of their states.
//!
//! A traversal is one observation on the wire, with one sequence number. For the map it is one or two observations of
//! ordinary states: `edge/A/B` at its start, and `speed/A/B` or `pace/A/B` if it succeeded. The event holds states and
//! values, so that a replay needs no topology. A sighting likewise is an observation of each landmark of its place that
//! was in view. Failures come with the event (`Observations::failures`), and the site
//! keeps the last ones.
//!
//! Invariant: a report is taken with all of its observations, in one event, or not at all. Its meaning depends on the
//! site; the writer makes no event of reports while an edit of the site is in flight.

use tidemap_map::{
    event::{Event, Observations},
    ids::RefusalReason,
    live_map::LiveMap,
    sighting::{PlaceReport, PlaceSample, traversal_samples},
    traversal::Traversal,
};
use tidemap_model::{OffsetCache, Sample, StateKind, time::FUTURE_MAX_NANOS};
use tidemap_proto::convert::{
    sightings::sighting_refusal,
    traversals::{refusal_of, unknown_edge},
};

use super::{
    super::protocol::{RefusedObservation, ReportBatch, SessionId},
    Sessions, StreamEvent,
    observations::too_far_ahead,
    states::{Refusal, StateAllocator},
};

/// Bytes of the observations of one event, with the names of their states: a record of the log has at most 16 MiB.
const EVENT_BYTES_MAX: usize = 12 << 20;
/// Bytes of an observation in the log besides its state's name, at most.
const SAMPLE_BYTES: usize = 48;

impl Sessions {
    /// Converts traversals or sightings to an event; adds refusals if an edge or landmark does not exist or the map has
    /// no room for more states.
    /// `None`: the stream is closed.
    pub(crate) fn report_event(
        &mut self,
        id: SessionId,
        batch: ReportBatch,
        map: &LiveMap,
        now: i64,
    ) -> Option<StreamEvent> {
        let session = self.sessions.get_mut(&id).filter(|session| session.open)?;
        let ReportBatch { span, reports, mut refused } = batch;
        let plausible = now.saturating_add(FUTURE_MAX_NANOS);
        let may_wait = map.future() < self.limits.ahead;
        let mut observations = Observations::default();
        let mut room = EVENT_BYTES_MAX;
        for (sequence, report) in reports {
            let time = report.time_nanos();
            let result = if time > plausible && !may_wait {
                Err((RefusalReason::Time, too_far_ahead(time, self.limits.ahead)))
            } else {
                let allocator = StateAllocator {
                    map,
                    in_flight: &mut self.states_in_flight,
                    renames: &self.renames_in_flight,
                    reportings: &mut self.reportings_in_flight,
                    categorical: &self.categorical_in_flight,
                    max: self.limits.states,
                };
                take(&mut observations, &report, allocator, (&mut self.offsets, &mut room))
            };
            if let Err((reason, detail)) = result {
                refused.push(RefusedObservation { sequence, reason, detail });
            }
        }
        let envelope = session.envelope(map, &mut self.producers_in_flight, now, span, &mut refused);
        Some(StreamEvent { event: Event::Observations(envelope, observations), refused, tiles_ahead: 0 })
    }
}

/// Appends the observations of a report.
fn take(
    observations: &mut Observations,
    report: &PlaceReport,
    mut allocator: StateAllocator<'_>,
    (offsets, room): (&mut OffsetCache, &mut usize),
) -> Result<(), Refusal> {
    let site = allocator.map.site();
    let samples = match report {
        PlaceReport::Traversal(traversal) => {
            let edge = site.topology().edge_named(&traversal.edge).map_err(|error| unknown_edge(&error))?;
            traversal_samples(traversal, edge).map_err(|error| refusal_of(&error))?
        }
        PlaceReport::Sighting(sighting) => sighting.samples(site).map_err(|error| sighting_refusal(&error))?,
        PlaceReport::Task(run) => {
            let (state, kind) = (run.name.state(), StateKind::Probability);
            vec![PlaceSample { state, kind, time_nanos: run.start_nanos, value: run.observed() }]
        }
    };
    let bytes = samples.iter().map(|sample| sample.state.as_str().len() + SAMPLE_BYTES).sum::<usize>();
    if *room < bytes {
        // Landmarks were added since the message was divided.
        let text = "the message stands for too many observations: send the report again, in a message of its own";
        return Err((RefusalReason::StateLimit, text.to_owned()));
    }
    *room -= bytes;
    let wanted: Vec<_> = samples.iter().map(|sample| (sample.state.clone(), sample.kind)).collect();
    let states = allocator.states_for(&wanted, &mut observations.new_states)?;
    for (state, PlaceSample { time_nanos, value, .. }) in states.into_iter().zip(samples) {
        let offset_secs = offsets.offset_secs(time_nanos);
        observations.push(state, Sample { utc_nanos: time_nanos, offset_secs, value });
    }
    observations.failures.extend(report.traversal().and_then(Traversal::failure));
    if let PlaceReport::Task(run) = report {
        observations.runs.push(run.clone());
    }
    Ok(())
}
