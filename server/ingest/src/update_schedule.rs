//! Decides when a map is updated: on request, at the local midnight of the clock, at the local midnight of imported
//! data, or when too much is pending.
//!
//! The nightly update is due when observations *received* before the map's last local midnight are still pending. So a
//! daemon that was off at midnight catches up. History that is imported at noon waits for the night, or for `tidemap
//! update`. The setting `update_at_midnight = false` turns the nightly update off. With `observe --nightly` the
//! midnights are those of the data. They count after all announcing streams have passed them. An early update takes
//! whole local days, unless all pending observations are of one day.
//!
//! Invariant: one update runs at a time, and a bounded number wait. If an update becomes due while one of the same
//! cause waits, the two are joined, because an update steps through each local day of its observations.

use std::{
    collections::{HashMap, VecDeque},
    sync::Arc,
    time::{Duration, Instant},
};

use tidemap_map::{
    event::UpdateCause,
    live_map::{LiveMap, PendingLimits},
    name::{MapName, ProducerKey},
};
use tidemap_model::time::FUTURE_MAX_NANOS;

use super::sessions::Sessions;
use crate::jobs::{Jobs, UpdateJob};

/// Time for which a producer whose stream broke still counts when a day of imported data closes.
const ANNOUNCEMENT_KEPT: Duration = Duration::from_secs(60);

/// Pending times just after the last cut are lower bounds: interval between two attempts of an update of them.
const UNSURE_NANOS: i64 = 60_000_000_000;

/// Maximum number of waiting updates.
const WAITING_MAX: usize = 16;

#[derive(Debug)]
pub(super) struct DueUpdate {
    pub until_nanos: Option<i64>,
    pub cause: UpdateCause,
    pub job: Arc<UpdateJob>,
}

/// The waiting updates of one map, and the data that makes new ones due.
#[derive(Debug)]
pub(super) struct UpdateSchedule {
    map: MapName,
    jobs: Arc<Jobs>,
    queue: VecDeque<DueUpdate>,
    /// Producers that announced data time and whose stream broke: the greatest time of their data, and the time until
    /// which they count.
    broken: HashMap<ProducerKey, (i64, Instant)>,
    data_midnight_nanos: i64,
    /// The time that all streams of imported data have reached; `None` without such streams.
    reached_nanos: Option<i64>,
    /// The last midnight of the clock that made an update due.
    clock_midnight_nanos: i64,
    limits: PendingLimits,
    at_midnight: bool,
}

impl UpdateSchedule {
    pub(super) fn new(map: MapName, jobs: Arc<Jobs>, limits: PendingLimits, at_midnight: bool) -> Self {
        Self {
            map,
            jobs,
            queue: VecDeque::new(),
            broken: HashMap::new(),
            data_midnight_nanos: i64::MIN,
            reached_nanos: None,
            clock_midnight_nanos: i64::MIN,
            limits,
            at_midnight,
        }
    }

    /// Adds an update; it fails at once if too many wait.
    pub(super) fn push(&mut self, update: DueUpdate) {
        if self.queue.len() < WAITING_MAX {
            self.queue.push_back(update);
        } else {
            update.job.end(Err(format!("{WAITING_MAX} updates of this map are waiting already: try again later")));
        }
    }

    /// Adds the rest that one update has left to the next, before all others.
    pub(super) fn push_first(&mut self, update: DueUpdate) {
        self.queue.push_front(update);
    }

    /// The log did not accept the start of an update: the cause of the update still holds.
    pub(super) fn failed(&mut self, cause: UpdateCause) {
        match cause {
            UpdateCause::Midnight => self.clock_midnight_nanos = i64::MIN,
            UpdateCause::DataTime => self.data_midnight_nanos = i64::MIN,
            UpdateCause::Request | UpdateCause::PendingLimit => {}
        }
    }

    /// This daemon writes the map from now on: a midnight that has passed makes an update due, even if it has done so
    /// before.
    pub(super) fn begin_anew(&mut self) {
        self.clock_midnight_nanos = i64::MIN;
        self.data_midnight_nanos = i64::MIN;
    }

    /// Whether an update waits.
    pub(super) fn is_waited_for(&self) -> bool {
        !self.queue.is_empty()
    }

    /// The next update to run.
    pub(super) fn pop(&mut self) -> Option<DueUpdate> {
        self.queue.pop_front()
    }

    /// Fails all waiting updates.
    pub(super) fn fail_all(&mut self, error: &str) {
        for update in self.queue.drain(..) {
            update.job.end(Err(error.to_owned()));
        }
    }

    /// A stream that announced data time broke.
    pub(super) fn stream_broke(&mut self, key: ProducerKey, reached: i64) {
        self.broken.insert(key, (reached, Instant::now() + ANNOUNCEMENT_KEPT));
    }

    /// A stream of the key opened, or ended on purpose.
    pub(super) fn stream_settled(&mut self, key: &ProducerKey) {
        self.broken.remove(key);
    }

    /// Adds updates that the clock or the number of pending observations has made due. Adds none while the start of an
    /// update is in flight, because its observations still count as pending.
    pub(super) fn check(&mut self, map: &LiveMap, now_nanos: i64) {
        if self.at_midnight {
            self.check_clock(map, now_nanos);
        }
        self.check_waiting_rows(map, now_nanos);
        self.check_pending(map, now_nanos);
    }

    fn due(&mut self, until_nanos: Option<i64>, cause: UpdateCause, now_nanos: i64) {
        if let Some(waiting) = self.queue.iter_mut().find(|update| update.cause == cause) {
            // Only midnights join, and they have an end time.
            waiting.until_nanos = waiting.until_nanos.max(until_nanos);
            return;
        }
        let job = self.jobs.create(self.map.clone(), cause, now_nanos);
        self.queue.push_back(DueUpdate { until_nanos, cause, job });
    }

    /// Adds an update that imported data has made due: a midnight that all announcing streams have passed. Call it
    /// before such a stream ends, because a stream that has ended no longer counts.
    pub(super) fn check_data(&mut self, map: &LiveMap, sessions: &Sessions, now_nanos: i64) {
        let now = Instant::now();
        self.broken.retain(|_, (_, until)| *until > now);
        let open = sessions.data_times().map(|(_, reached)| reached);
        self.reached_nanos = open.chain(self.broken.values().map(|(reached, _)| *reached)).min();
        let Some(reached) = self.reached_nanos else {
            // The import is over; the next one may be of older data.
            self.data_midnight_nanos = i64::MIN;
            return;
        };
        if reached < 0 {
            return;
        }
        let zone = &map.spec().zone;
        let midnight = zone.midnight_nanos(zone.day_of(reached));
        if midnight > self.data_midnight_nanos {
            // The first midnight of an import is the start of its first day: there is nothing before it.
            let due = map.pending_since_nanos().is_some_and(|oldest| oldest < midnight);
            self.data_midnight_nanos = midnight;
            if due {
                self.due(Some(midnight), UpdateCause::DataTime, now_nanos);
            }
        }
    }

    fn check_clock(&mut self, map: &LiveMap, now_nanos: i64) {
        let zone = &map.spec().zone;
        let midnight = zone.midnight_nanos(zone.day_of(now_nanos));
        let missed = map.pending_received_nanos().is_some_and(|received| received < midnight);
        if missed && midnight != self.clock_midnight_nanos {
            self.clock_midnight_nanos = midnight;
            self.due(Some(midnight), UpdateCause::Midnight, now_nanos);
        }
    }

    /// A restart, or another daemon that has become the writer, finds rows that an update has left to the next one.
    fn check_waiting_rows(&mut self, map: &LiveMap, now_nanos: i64) {
        if map.waiting_rows() > 0 && !map.is_updating() && self.queue.is_empty() {
            self.due(Some(map.cut_nanos()), UpdateCause::PendingLimit, now_nanos);
        }
    }

    fn check_pending(&mut self, map: &LiveMap, now_nanos: i64) {
        if map.pending_load(self.limits, false) <= 1.0 || map.is_updating() || !self.queue.is_empty() {
            return;
        }
        // If the clock was set back, observations may be later than any cut: no update could take them yet.
        let latest = now_nanos.saturating_add(FUTURE_MAX_NANOS);
        let may_take = |oldest: i64| {
            let unsure = if oldest == map.cut_nanos() { UNSURE_NANOS } else { 0 };
            oldest.saturating_add(unsure) <= latest
        };
        if !map.pending_since_nanos().is_some_and(may_take) {
            return;
        }
        // Whole days come first, so that the learned models do not depend on the time of an update. A day that a stream
        // of imported data has not passed has not ended.
        let midnight_of = |nanos: i64| map.spec().zone.midnight_nanos(map.spec().zone.day_of(nanos));
        let takes_some = |midnight: &i64| {
            map.cut_nanos() < *midnight && map.pending_since_nanos().is_some_and(|oldest| oldest < *midnight)
        };
        let newest = map.newest_nanos();
        let passed = self.reached_nanos.map(|reached| midnight_of(reached.min(newest))).filter(takes_some);
        let midnight = passed.or_else(|| Some(midnight_of(newest)).filter(takes_some));
        self.due(midnight, UpdateCause::PendingLimit, now_nanos);
    }
}
