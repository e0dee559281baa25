//! The scans of a day, and the stream of all scans.
//!
//! Invariant: a scan's flips are the differences from the last scan that showed the same tile, ascending; a day is
//! generated from the seed alone, and one day is in memory at a time.

use super::{GridOffice, floor::TILE_CELLS, routine::DAY_END, schedule::ViewSchedule, world::WorldDay};

/// One scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GridScan<'a> {
    /// The time of the scan, in nanoseconds UTC.
    pub utc_nanos: i64,
    /// The view that it shows; all cells of the view's tiles are observed. See [`GridOffice::view_slots`].
    pub view: u32,
    /// The cells, as `slot * 512 + cell`, that changed between free and occupied since the stream last showed their
    /// tile; ascending. When a tile is shown for the first time: the occupied cells.
    pub occupied_flips: &'a [u32],
}

/// The scans of one day of 86,400 s.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DayScans {
    /// Time in nanoseconds UTC and view of each scan.
    scans: Vec<(i64, u32)>,
    /// The start of the flips of each scan, and the end of the last; one entry more than there are scans.
    starts: Vec<usize>,
    flips: Vec<u32>,
}

impl DayScans {
    /// Number of scans, [`GridOfficeOptions::scans_per_day`](super::GridOfficeOptions::scans_per_day).
    pub fn len(&self) -> usize {
        self.scans.len()
    }

    /// Always false: a day has at least one scan.
    pub fn is_empty(&self) -> bool {
        self.scans.is_empty()
    }

    /// The scan at `index`, or none past the end of the day.
    pub fn get(&self, index: usize) -> Option<GridScan<'_>> {
        let &(utc_nanos, view) = self.scans.get(index)?;
        Some(GridScan { utc_nanos, view, occupied_flips: &self.flips[self.starts[index]..self.starts[index + 1]] })
    }

    /// The scans, by time.
    pub fn iter(&self) -> impl Iterator<Item = GridScan<'_>> {
        (0..self.len()).filter_map(|index| self.get(index))
    }
}

/// The part of a day in which a view's tiles are shown, and the scan that showed them before.
#[derive(Clone, Copy, Debug)]
struct ViewWindow {
    /// The day's scans report the changes after this time in nanoseconds UTC …
    after_nanos: i64,
    /// … up to and including this one.
    until_nanos: i64,
    /// The scan of the day that shows the tiles for the first time, at `after_nanos`.
    first: Option<u64>,
}

impl ViewWindow {
    /// None if the day does not show the view.
    fn new(schedule: &ViewSchedule, view: u32, day: u32) -> Option<Self> {
        let (start, end) = (schedule.first_scan(day), schedule.first_scan(day + 1));
        let until = schedule.last_of(view, end).filter(|&last| last >= start)?;
        let before = schedule.last_of(view, start);
        let after = before.unwrap_or_else(|| schedule.next_of(view, start));
        let first = before.is_none().then_some(after);
        Some(Self { after_nanos: schedule.utc_nanos(after), until_nanos: schedule.utc_nanos(until), first })
    }
}

/// The scans of a day of the stream, from 0.
pub(crate) fn day_scans(office: &GridOffice, day: u32) -> DayScans {
    let schedule = &office.schedule;
    let start = schedule.first_scan(day);
    let windows: Vec<Option<ViewWindow>> =
        (0..schedule.views).map(|view| ViewWindow::new(schedule, view, day)).collect();
    // Index of a scan in the day, and address of a cell that flips in it; by cell.
    let mut flips: Vec<(u32, u32)> = Vec::new();
    let mut unordered = Vec::new();
    for (view, window) in (0..).zip(&windows) {
        if let Some(first) = window.and_then(|window| window.first) {
            let index = (first - start) as u32;
            unordered.push(index as usize);
            for slot in schedule.slots(view) {
                flips.extend(addresses(slot, office.static_occupied(slot)).map(|address| (index, address)));
            }
        }
    }
    changing_flips(office, start, &windows, &mut flips);

    let mut starts = vec![0; schedule.scans_per_day as usize + 1];
    for &(index, _) in &flips {
        starts[index as usize + 1] += 1;
    }
    for index in 1..starts.len() {
        starts[index] += starts[index - 1];
    }
    let mut next = starts.clone();
    let mut by_scan = vec![0; flips.len()];
    for (index, address) in flips {
        by_scan[next[index as usize]] = address;
        next[index as usize] += 1;
    }
    for index in unordered {
        by_scan[starts[index]..starts[index + 1]].sort_unstable();
    }
    let scans =
        (start..).take(schedule.scans_per_day as usize).map(|scan| (schedule.utc_nanos(scan), schedule.view(scan)));
    DayScans { scans: scans.collect(), starts, flips: by_scan }
}

/// Adds the flips of the cells that change, by cell.
fn changing_flips(office: &GridOffice, start: u64, windows: &[Option<ViewWindow>], flips: &mut Vec<(u32, u32)>) {
    let (world, schedule) = (&office.world, &office.schedule);
    let after = windows.iter().flatten().map(|window| window.after_nanos).min().unwrap_or(0);
    let until = windows.iter().flatten().map(|window| window.until_nanos).max().unwrap_or(0);
    let (first, last) = (world.day_at(after), world.day_at(until));
    let days: Vec<WorldDay> = (0..=last.number - first.number).map(|days| world.day(first.plus(days))).collect();
    // Nothing changes on a day after this time.
    let quiet: Vec<i64> = days.iter().map(|day| day.clock.utc_nanos(DAY_END)).collect();

    let mut changes = Vec::new();
    let mut scans: Vec<u64> = Vec::new();
    for cell in &world.inventory.cells {
        let view = schedule.view_of(cell.address / TILE_CELLS);
        let Some(window) = windows[view as usize] else { continue };
        scans.clear();
        let mut first = window.first;
        for (day, &quiet) in days.iter().zip(&quiet) {
            let over = if first.is_some() { day.clock.end_nanos } else { quiet };
            if over <= window.after_nanos {
                continue;
            }
            let mut filled = world.changes(cell, day, &mut changes);
            let mut times = changes.iter().map(|&time| day.clock.utc_nanos(time)).peekable();
            while times.next_if(|&time| time <= window.after_nanos).is_some() {
                filled = !filled;
            }
            scans.extend(first.take().filter(|_| filled));
            for time in times.take_while(|&time| time <= window.until_nanos) {
                let scan = schedule.next_of(view, schedule.scan_at(time));
                // Two changes between two scans of the view are not visible.
                if scans.last() == Some(&scan) {
                    scans.pop();
                } else {
                    scans.push(scan);
                }
            }
        }
        flips.extend(scans.iter().map(|scan| ((scan - start) as u32, cell.address)));
    }
}

/// The cells of a mask, as `slot * 512 + cell`.
fn addresses(slot: u32, mask: [u64; 8]) -> impl Iterator<Item = u32> {
    (0..8).zip(mask).flat_map(move |(word, bits)| {
        let ones = (0..64).filter(move |bit| bits >> bit & 1 == 1);
        ones.map(move |bit| slot * TILE_CELLS + word * 64 + bit)
    })
}

/// All scans from day 0 on, by time.
#[derive(Clone, Debug)]
pub struct GridStream<'a> {
    office: &'a GridOffice,
    days: u32,
    /// The day that is generated next.
    next_day: u32,
    scans: Option<DayScans>,
    next_scan: usize,
}

impl<'a> GridStream<'a> {
    /// The scans of the first `days` days, at most [`GridOffice::DAYS_MAX`].
    pub fn new(office: &'a GridOffice, days: u32) -> Self {
        Self { office, days: days.min(GridOffice::DAYS_MAX), next_day: 0, scans: None, next_scan: 0 }
    }

    /// The next scan; None after the last.
    #[expect(clippy::should_implement_trait, reason = "a scan borrows from the stream, which an Iterator cannot say")]
    pub fn next(&mut self) -> Option<GridScan<'_>> {
        if self.scans.as_ref().is_none_or(|scans| self.next_scan == scans.len()) {
            if self.next_day == self.days {
                return None;
            }
            // One day at a time is in memory.
            self.scans = None;
            self.scans = Some(self.office.day(self.next_day));
            self.next_day += 1;
            self.next_scan = 0;
        }
        self.next_scan += 1;
        self.scans.as_ref()?.get(self.next_scan - 1)
    }
}
