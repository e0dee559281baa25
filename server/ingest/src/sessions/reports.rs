//! Converts reports to an event with the observations of their states.
//!
//! A report is one observation on the wire, with one sequence number. For the map it is one or more observations of
//! ordinary states ([`Report::samples`]). The event contains states and values, so that a replay needs no topology. The
//! event also contains failures and runs of tasks, and the site keeps the last ones.
//!
//! Invariant: a report is taken with all of its observations, in one event, or not at all. Its meaning depends on the
//! site; the writer makes no event of reports while an edit of the site is in flight.

use tidemap_map::{
    event::{Event, Observations},
    ids::RefusalReason,
    live_map::LiveMap,
    report::Report,
    report_sample::ReportSample,
};
use tidemap_model::{OffsetCache, Sample, time::FUTURE_MAX_NANOS};
use tidemap_proto::convert::reports::report_refusal;

use super::{
    super::protocol::{RefusedObservation, ReportBatch, SessionId},
    Sessions, StreamEvent,
    observations::too_far_ahead,
    states::{Refusal, StateAllocator},
};

/// Maximum bytes of the observations of one event, with the names of their states: a record of the log has at most 16
/// MiB.
const EVENT_BYTES_MAX: usize = 12 << 20;

impl Sessions {
    /// Converts reports to an event; adds refusals if an edge or landmark does not exist or the map has
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
        let mut places = self.state_places.room(&session.client, map.states() + self.states_in_flight.states());
        for (sequence, report) in reports {
            let time = report.time_nanos();
            let result = if time > plausible && !may_wait {
                Err((RefusalReason::Time, too_far_ahead(time, self.limits.ahead)))
            } else {
                let allocator = StateAllocator { map, in_flight: &mut self.states_in_flight, room: &mut places };
                take(&mut observations, &report, allocator, (&mut self.offsets, &mut room))
            };
            if let Err((reason, detail)) = result {
                refused.push(RefusedObservation { sequence, reason, detail });
            }
        }
        self.state_places.take(&session.client, places.taken());
        let envelope = session.envelope(map, &mut self.producers_in_flight, now, span, &mut refused);
        Some(StreamEvent { event: Event::Observations(envelope, observations), refused, tiles_ahead: 0 })
    }
}

/// Appends the observations of a report.
fn take(
    observations: &mut Observations,
    report: &Report,
    mut allocator: StateAllocator<'_>,
    (offsets, room): (&mut OffsetCache, &mut usize),
) -> Result<(), Refusal> {
    let site = allocator.map.site();
    let samples = report.samples(site).map_err(|error| report_refusal(&error))?;
    let bytes = report.log_bytes(site);
    if *room < bytes {
        // Landmarks were added since the message was divided.
        let text =
            "the reports of the message contain too many observations: send this one again, in a separate message";
        return Err((RefusalReason::StateLimit, text.to_owned()));
    }
    *room -= bytes;
    let wanted: Vec<_> = samples.iter().map(|sample| (sample.state.clone(), sample.kind)).collect();
    let states = allocator.states_for(&wanted, &mut observations.new_states)?;
    for (state, ReportSample { time_nanos, value, .. }) in states.into_iter().zip(samples) {
        let offset_secs = offsets.offset_secs(time_nanos);
        observations.push(state, Sample { utc_nanos: time_nanos, offset_secs, value });
    }
    observations.failures.extend(report.failure());
    if let Report::TaskRun(run) = report {
        observations.runs.push(run.clone());
    }
    Ok(())
}
