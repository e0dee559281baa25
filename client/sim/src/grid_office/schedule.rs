//! The time of each scan, and the view that it shows.
//!
//! Invariant: scans are evenly spaced in UTC, independent of changes of the wall clock, and a day of scans lasts
//! 86,400 s; every tile is in exactly one view.

const DAY_NANOS: i64 = 86_400 * 1_000_000_000;

/// A sensor's schedule: it visits its views in turn, with `dwell` scans at each.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ViewSchedule {
    /// Time of scan 0 in nanoseconds UTC.
    pub(crate) start_nanos: i64,
    /// 1 to 86,400.
    pub(crate) scans_per_day: u32,
    /// 1 to the number of tiles.
    pub(crate) views: u32,
    /// At least 1.
    pub(crate) dwell: u32,
    pub(crate) tiles: u32,
}

impl ViewSchedule {
    /// Number of the first scan of a day.
    pub(crate) fn first_scan(&self, day: u32) -> u64 {
        u64::from(day) * u64::from(self.scans_per_day)
    }

    /// The time of a scan, in nanoseconds UTC.
    pub(crate) fn utc_nanos(&self, scan: u64) -> i64 {
        let per_day = u64::from(self.scans_per_day);
        let (day, rest) = ((scan / per_day).cast_signed(), (scan % per_day).cast_signed());
        self.start_nanos + day * DAY_NANOS + rest * DAY_NANOS / per_day.cast_signed()
    }

    /// Number of the first scan at or after a time in nanoseconds UTC.
    pub(crate) fn scan_at(&self, utc_nanos: i64) -> u64 {
        let Ok(since) = u64::try_from(utc_nanos - self.start_nanos) else { return 0 };
        let (day_nanos, per_day) = (DAY_NANOS.unsigned_abs(), u64::from(self.scans_per_day));
        since / day_nanos * per_day + (since % day_nanos * per_day).div_ceil(day_nanos)
    }

    /// The view that a scan shows.
    pub(crate) fn view(&self, scan: u64) -> u32 {
        (scan / u64::from(self.dwell) % u64::from(self.views)) as u32
    }

    /// The first scan of a view that is not before `scan`.
    pub(crate) fn next_of(&self, view: u32, scan: u64) -> u64 {
        let (phase, from, until, round) = self.phase(view, scan);
        match phase {
            _ if phase < from => scan + from - phase,
            _ if phase < until => scan,
            _ => scan + round - phase + from,
        }
    }

    /// The last scan of a view before `scan`.
    pub(crate) fn last_of(&self, view: u32, scan: u64) -> Option<u64> {
        let scan = scan.checked_sub(1)?;
        let (phase, from, until, round) = self.phase(view, scan);
        match phase {
            _ if phase < from => (scan + until).checked_sub(phase + round + 1),
            _ if phase < until => Some(scan),
            _ => Some(scan + until - phase - 1),
        }
    }

    /// Position of a scan in the round of all views, start and end of the view in the round, and the round's length.
    fn phase(&self, view: u32, scan: u64) -> (u64, u64, u64, u64) {
        let (dwell, round) = (u64::from(self.dwell), u64::from(self.dwell) * u64::from(self.views));
        let from = u64::from(view) * dwell;
        (scan % round, from, from + dwell, round)
    }

    /// The slots that a view shows.
    pub(crate) fn slots(&self, view: u32) -> std::ops::Range<u32> {
        let edge = |view: u32| (u64::from(view) * u64::from(self.tiles) / u64::from(self.views)) as u32;
        edge(view)..edge(view + 1)
    }

    /// The view that shows a slot.
    pub(crate) fn view_of(&self, slot: u32) -> u32 {
        (((u64::from(slot) + 1) * u64::from(self.views) - 1) / u64::from(self.tiles)) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scans_are_found_by_time_and_by_view() {
        for (scans_per_day, views, dwell, tiles) in [(17_200, 1, 1, 5), (1000, 7, 1, 100), (77, 3, 40, 4)] {
            let schedule = ViewSchedule { start_nanos: 1_740_960_000_000_000_000, scans_per_day, views, dwell, tiles };
            let shown: Vec<u32> = (0..2500).map(|scan| schedule.view(scan)).collect();
            for scan in 0..2000 {
                let time = schedule.utc_nanos(scan);
                assert_eq!((schedule.scan_at(time), schedule.scan_at(time + 1)), (scan, scan + 1));
                for view in 0..views {
                    let next = (scan..).find(|&scan| shown[scan as usize] == view);
                    assert_eq!(Some(schedule.next_of(view, scan)), next, "view {view} from scan {scan}");
                    let last = (0..scan).rev().find(|&scan| shown[scan as usize] == view);
                    assert_eq!(schedule.last_of(view, scan), last, "view {view} before scan {scan}");
                }
            }
            for slot in 0..tiles {
                assert!(schedule.slots(schedule.view_of(slot)).contains(&slot));
            }
        }
    }
}
