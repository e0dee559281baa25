//! Takes the scans for an update from a grid: the scans before its cut, including scans that waited for their time.
//!
//! Invariant: a scan is pending exactly if the cut of every update since its arrival was at or before the scan's time.

use std::sync::Arc;

use tidemap_model::LocalDay;

use super::{
    super::{day::GridDay, index::TileId, snapshot::FutureScan},
    LiveGrid,
};

impl LiveGrid {
    /// The pending day of this date; adds it if needed.
    pub(super) fn day_of(days: &mut Vec<GridDay>, day: LocalDay) -> &mut GridDay {
        let at = days.partition_point(|known| known.day < day);
        if days.get(at).is_none_or(|known| known.day != day) {
            // Usually the day before is over.
            if let Some(before) = at.checked_sub(1).and_then(|before| days.get_mut(before)) {
                before.shrink();
            }
            days.insert(at, GridDay::new(day));
        }
        &mut days[at]
    }

    /// Takes the pending scans before an instant, by day, ascending. Scans whose waiting time is over join; also
    /// returns the latest time of the scans that join.
    pub(super) fn take_before(&mut self, cut_nanos: i64) -> (Vec<GridDay>, Option<i64>) {
        let (due, future): (Vec<FutureScan>, Vec<FutureScan>) =
            std::mem::take(&mut self.future).into_iter().partition(|scan| scan.time.utc_nanos < cut_nanos);
        self.future = future;
        let newest = due.iter().map(|scan| scan.time.utc_nanos).max();
        self.join(due);
        let mut taken = Vec::new();
        let mut kept = Vec::new();
        for day in std::mem::take(&mut self.days) {
            let (before, after) = day.split(cut_nanos);
            taken.extend(before);
            kept.extend(after);
        }
        self.days = kept;
        // The scan numbers of a split day start again.
        self.previous = None;
        self.count_pending();
        (taken, newest)
    }

    /// Applies scans whose time has come. From here on they are treated like all other scans. No run continues.
    fn join(&mut self, mut due: Vec<FutureScan>) {
        due.sort_by_key(|scan| scan.time.utc_nanos);
        for scan in due {
            let day = Self::day_of(&mut self.days, LocalDay::of_civil_nanos(scan.time.civil_nanos()));
            let seen: Arc<[TileId]> = scan.tiles.iter().map(|(tile, _)| *tile).collect();
            let number = day.push(scan.time, &seen);
            for &(id, masks) in &scan.tiles {
                day.show(number, id, masks);
            }
            for (id, masks) in scan.tiles {
                self.show_tile(id, scan.time, masks);
            }
        }
    }

    pub(super) fn count_pending(&mut self) {
        self.pending_changes = self.days.iter().map(GridDay::changes).sum();
        self.future_tiles = self.future.iter().map(|scan| scan.tiles.len() as u64).sum();
        self.oldest_pending_nanos = self.days.iter().flat_map(|day| &day.scans).map(|scan| scan.utc_nanos).min();
    }
}
