//! The cost of ray-casting, estimated in advance, and the permits for expensive casts.
//!
//! Invariant: at most as many expensive casts run at a time as there are processors, in all streams together; waiting
//! casts get their permits in order.

use std::sync::{Condvar, LazyLock, Mutex, MutexGuard, PoisonError};

use tidemap_grid::{
    raycast::{Rays, Readings},
    spec::GridSpec,
};
use tidemap_proto::convert::scans::{SentRays, SentReadings};

use super::RAY_CELLS_MAX;

#[cfg(test)]
mod tests;

/// An upper bound of the cells that rays pass, from their ranges alone.
#[derive(Debug)]
pub(super) struct RayCells {
    per_metre: f64,
    max_cells: f64,
}

impl RayCells {
    pub(super) fn new(spec: &GridSpec) -> RayCells {
        // Along each axis a ray passes one border per cell length, and one more.
        let per_metre = 3f64.sqrt() / spec.resolution_m;
        let across = spec.allowed().size().iter().fold(1u64, |sum, size| sum.saturating_add(*size));
        RayCells { per_metre, max_cells: across.min(RAY_CELLS_MAX) as f64 }
    }

    fn of(&self, ranges: impl Iterator<Item = f64>, max_range_m: f64) -> u64 {
        // A NaN is not a reading, and negative ranges are ignored.
        ranges.map(|range| (range.min(max_range_m).max(0.0) * self.per_metre + 4.0).min(self.max_cells)).sum::<f64>()
            as u64
    }

    /// The bound for a part of a scan as it was sent. The limits may be in another part.
    pub(super) fn of_part(&self, rays: SentRays<'_>) -> u64 {
        self.of_scan(SentRays { max_range_m: None, ..rays })
    }

    /// The bound for a scan that is complete in one message.
    pub(super) fn of_scan(&self, rays: SentRays<'_>) -> u64 {
        let max = rays.max_range_m.map_or(f64::INFINITY, f64::from);
        match rays.readings {
            SentReadings::Points(xyz_m) => self.of(points(xyz_m), max),
            SentReadings::Ranges(ranges_m) => self.of(numbers(ranges_m), max),
        }
    }

    /// The bound for readings that will be ray-cast.
    pub(super) fn of_readings(&self, readings: &Readings) -> u64 {
        let max = readings.max_range_m.map_or(f64::INFINITY, f64::from);
        match &readings.rays {
            Rays::Points(xyz) => self.of(points(xyz), max),
            Rays::Planar { ranges_m, .. } => self.of(numbers(ranges_m), max),
        }
    }
}

fn points(xyz_m: &[f32]) -> impl Iterator<Item = f64> + '_ {
    let points = xyz_m.as_chunks::<3>().0.iter();
    let lengths =
        points.map(|point| point.iter().map(|&along| f64::from(along) * f64::from(along)).sum::<f64>().sqrt());
    lengths.filter(|range| range.is_finite())
}

fn numbers(ranges_m: &[f32]) -> impl Iterator<Item = f64> + '_ {
    ranges_m.iter().map(|&range| f64::from(range)).filter(|range| !range.is_nan())
}

/// The permits of the process, for all streams.
static PERMITS: LazyLock<CastPermits> =
    LazyLock::new(|| CastPermits::new(std::thread::available_parallelism().map_or(1, std::num::NonZero::get)));

/// Waits for a permit; dropping it gives it back. Do not call on async threads.
pub(super) fn permit() -> CastPermit<'static> {
    PERMITS.take()
}

#[derive(Debug)]
struct CastPermits {
    queue: Mutex<Queue>,
    moved: Condvar,
}

#[derive(Debug)]
struct Queue {
    free: usize,
    /// The number of the next cast that requests a permit, and of the next that gets one.
    next: u64,
    first: u64,
}

/// A permit for one expensive cast.
#[derive(Debug)]
pub(super) struct CastPermit<'a>(&'a CastPermits);

impl CastPermits {
    fn new(free: usize) -> CastPermits {
        CastPermits { queue: Mutex::new(Queue { free, next: 0, first: 0 }), moved: Condvar::new() }
    }

    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn take(&self) -> CastPermit<'_> {
        let mut queue = self.queue();
        let own = queue.next;
        queue.next += 1;
        while queue.free == 0 || queue.first != own {
            queue = self.moved.wait(queue).unwrap_or_else(PoisonError::into_inner);
        }
        queue.free -= 1;
        queue.first += 1;
        drop(queue);
        // There may also be a permit for the next cast.
        self.moved.notify_all();
        CastPermit(self)
    }
}

impl Drop for CastPermit<'_> {
    fn drop(&mut self) {
        self.0.queue().free += 1;
        self.0.moved.notify_all();
    }
}
