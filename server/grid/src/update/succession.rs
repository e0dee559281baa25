//! The sequence of the readings of a day: the gaps between the observations of a group, and the changes of a cell.
//!
//! Invariant: readings that are not newer than the readings before count in neither, as in a named state. The cost
//! follows the toggles, not the scans, unless scans of the day come late or at equal times.

use super::{
    super::{fade::DayFactors, observed_times::ObservedTimes},
    shared_sums::Times,
};

/// The changes of a cell among its newer readings.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub(super) struct Changes {
    /// Number of changes.
    pub(super) count: u32,
    /// Sum of 1 / time between the readings, per second, over the changes.
    pub(super) rate_sum: f64,
    /// Whether the newest reading is occupied; `None` if none is newer.
    pub(super) last: Option<bool>,
}

impl Times {
    /// The runs of scans at which a bit with these toggles is set.
    fn runs(&self, toggles: &[u32]) -> impl Iterator<Item = std::ops::Range<usize>> {
        let end = self.utc_nanos.len();
        toggles.chunks(2).map(move |run| {
            let from = run.first().map_or(end, |&from| end.min(from as usize));
            from..run.get(1).map_or(end, |&to| end.min(to as usize)).max(from)
        })
    }

    fn at(&self, scan: usize) -> i64 {
        self.utc_nanos.get(scan).copied().unwrap_or(0)
    }

    /// Whether each of the observations with these toggles is newer than the observation before, and than `last_nanos`.
    fn are_newer(&self, observed: &[u32], last_nanos: Option<i64>) -> bool {
        let first = self.runs(observed).next().map(|run| self.at(run.start));
        self.by_time.is_none() && last_nanos.is_none_or(|last| first.is_some_and(|first| first > last))
    }

    /// The times of a group after its observations of the day. `last_nanos`: the time of its last observation before
    /// the day.
    pub(super) fn observe(
        &self,
        before: ObservedTimes,
        observed: &[u32],
        last_nanos: Option<i64>,
        factors: DayFactors,
    ) -> ObservedTimes {
        let mut after = before;
        if self.are_newer(observed, last_nanos) {
            let observations: u64 = self.runs(observed).map(|run| run.len() as u64).sum();
            let had_one = u64::from(last_nanos.is_some());
            after.gaps.observe_many((observations + had_one).saturating_sub(1), |gap| {
                let (scan, before) = self.observation(observed, gap + 1 - had_one);
                let earlier = before.map(|before| self.at(before)).or(last_nanos);
                earlier.map_or(0, |earlier| self.at(scan).abs_diff(earlier))
            });
            self.add_hours(&mut after, self.hours(observed), factors);
            return after;
        }
        let scans = self.by_time(observed);
        let mut hours: Vec<u32> = scans.iter().filter_map(|&scan| self.hours.get(scan).copied()).collect();
        hours.dedup();
        self.add_hours(&mut after, hours, factors);
        let mut last_nanos = last_nanos;
        for nanos in scans.into_iter().map(|scan| self.at(scan)) {
            if last_nanos.is_none_or(|last| nanos > last)
                && let Some(last) = last_nanos.replace(nanos)
            {
                after.gaps.observe_many(1, |_| nanos.abs_diff(last));
            }
        }
        after
    }

    /// The scan of an observation by its number on the day, and the scan of the observation before.
    fn observation(&self, observed: &[u32], number: u64) -> (usize, Option<usize>) {
        let (mut rest, mut before) = (number, None);
        for run in self.runs(observed).filter(|run| !run.is_empty()) {
            let length = run.len() as u64;
            if rest < length {
                // The scan is within the run.
                let scan = run.start + rest as usize;
                return (scan, if rest > 0 { Some(scan - 1) } else { before });
            }
            rest -= length;
            before = Some(run.end - 1);
        }
        (self.utc_nanos.len(), before)
    }

    /// The scans at which a bit with these toggles is set, in the order of their times.
    fn by_time(&self, toggles: &[u32]) -> Vec<usize> {
        let Some(by_time) = &self.by_time else { return self.runs(toggles).flatten().collect() };
        let is_set = self.bits(toggles);
        by_time.iter().map(|&scan| scan as usize).filter(|&scan| is_set.get(scan) == Some(&true)).collect()
    }

    /// Whether a bit with these toggles is set at each scan.
    fn bits(&self, toggles: &[u32]) -> Vec<bool> {
        let mut is_set = vec![false; self.utc_nanos.len()];
        self.runs(toggles).for_each(|run| is_set[run].fill(true));
        is_set
    }

    /// Adds local hours with an observation, given by their numbers.
    fn add_hours(&self, times: &mut ObservedTimes, numbers: Vec<u32>, factors: DayFactors) {
        if factors.known != 1.0 {
            times.scale(factors.known);
        }
        for number in numbers {
            let Some(&(kind, hour)) = self.kinds_and_hours.get(number as usize) else { continue };
            times.hours += factors.of_day;
            let by_hour = &mut times.by_hour[kind][hour];
            *by_hour = (f64::from(*by_hour) + factors.of_day) as f32;
        }
    }

    /// The numbers of the local hours with an observation, where each scan is newer than the scan before.
    fn hours(&self, observed: &[u32]) -> Vec<u32> {
        let mut hours = Vec::new();
        for run in self.runs(observed).filter(|run| !run.is_empty()) {
            let hour = |scan: usize| self.hours.get(scan).copied().unwrap_or(0);
            let (from, to) = (hour(run.start), hour(run.end - 1));
            hours.extend(from..=to);
        }
        hours.dedup();
        hours
    }

    /// The changes of a cell with these toggles of its observed and its occupied bit, after a reading with the value
    /// `last` at `last_nanos`.
    pub(super) fn changes(
        &self,
        observed: &[u32],
        occupied: &[u32],
        last_nanos: Option<i64>,
        last: Option<bool>,
    ) -> Changes {
        let mut changes = Changes { count: 0, rate_sum: 0.0, last };
        let mut last_nanos = last_nanos;
        let mut add = |nanos: i64, is_occupied: bool, last_nanos: Option<i64>| {
            if let (Some(before), true) = (last_nanos, changes.last.is_some_and(|last| last != is_occupied)) {
                changes.count += 1;
                changes.rate_sum += 1.0 / (nanos.abs_diff(before) as f64 / 1e9);
            }
            changes.last = Some(is_occupied);
        };
        // The number of toggles up to a scan; it is odd where the bit is set.
        let mut toggles = 0;
        let mut pass = |scan: usize| {
            while occupied.get(toggles).is_some_and(|&toggle| toggle as usize <= scan) {
                toggles += 1;
            }
            (toggles % 2 == 1, occupied.get(toggles).map_or(usize::MAX, |&toggle| toggle as usize))
        };
        if self.are_newer(observed, last_nanos) {
            for run in self.runs(observed).filter(|run| !run.is_empty()) {
                let mut scan = run.start;
                while scan < run.end {
                    let (is_occupied, next) = pass(scan);
                    let before = if scan > run.start { Some(self.at(scan - 1)) } else { last_nanos };
                    add(self.at(scan), is_occupied, before);
                    scan = next;
                }
                last_nanos = Some(self.at(run.end - 1));
            }
            return changes;
        }
        let is_occupied = self.bits(occupied);
        for scan in self.by_time(observed) {
            let (nanos, is_occupied) = (self.at(scan), is_occupied.get(scan) == Some(&true));
            if last_nanos.is_none_or(|last| nanos > last) {
                add(nanos, is_occupied, last_nanos);
                last_nanos = Some(nanos);
            }
        }
        changes
    }
}

#[cfg(test)]
mod tests;
