//! The scans of a day, and the stream of all scans.
//!
//! Invariant: a scan's flips are what differs from the last scan that showed the same tile, ascending; a day is
//! generated from the seed alone, and one day is in memory at a time.

use super::{GridOffice, routine::DAY_END, sensor::Sensor, world::WorldDay};

/// One scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GridScan<'a> {
    /// When it was taken, in nanoseconds UTC.
    pub utc_nanos: i64,
    /// Which view it shows; all cells of the view's tiles are observed. See [`GridOffice::view_slots`].
    pub view: u32,
    /// The cells, as `slot * 512 + cell`, that are occupied and were free when the stream last showed their tile, or
    /// the other way round; ascending. When a tile is shown for the first time: the cells that are occupied.
    pub occupied_flips: &'a [u32],
}

/// The scans of one day of 86,400 s.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DayScans {
    /// Time in nanoseconds UTC and view of each scan.
    scans: Vec<(i64, u32)>,
    /// Where the flips of each scan start; one more than scans.
    starts: Vec<usize>,
    flips: Vec<u32>,
}

impl DayScans {
    /// Number of scans: as many as were asked for in a day.
    #[must_use]
    pub fn len(&self) -> usize {
        self.scans.len()
    }

    /// Never: a day has at least one scan.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.scans.is_empty()
    }

    /// The scan at `index`, if the day has as many.
    #[must_use]
    pub fn get(&self, index: usize) -> Option<GridScan<'_>> {
        let &(utc_nanos, view) = self.scans.get(index)?;
        Some(GridScan { utc_nanos, view, occupied_flips: &self.flips[self.starts[index]..self.starts[index + 1]] })
    }

    /// The scans, by time.
    pub fn iter(&self) -> impl Iterator<Item = GridScan<'_>> {
        (0..self.len()).filter_map(|index| self.get(index))
    }
}

/// What was shown of a view's tiles before a day, and until when they are shown on it.
#[derive(Clone, Copy, Debug)]
struct Look {
    /// The day tells the changes after this time in nanoseconds UTC...
    after_nanos: i64,
    /// ... up to and with this one.
    until_nanos: i64,
    /// The scan of the day that shows the tiles for the first time, at `after_nanos`.
    first: Option<u64>,
}

impl Look {
    /// None where a day does not show the view.
    fn new(sensor: &Sensor, view: u32, day: u32) -> Option<Self> {
        let (start, end) = (sensor.first_scan(day), sensor.first_scan(day + 1));
        let until = sensor.last_of(view, end).filter(|&last| last >= start)?;
        let before = sensor.last_of(view, start);
        let after = before.unwrap_or_else(|| sensor.next_of(view, start));
        let first = before.is_none().then_some(after);
        Some(Self { after_nanos: sensor.utc_nanos(after), until_nanos: sensor.utc_nanos(until), first })
    }
}

/// The scans of a day of the stream, from 0.
pub(crate) fn day_scans(office: &GridOffice, day: u32) -> DayScans {
    let sensor = &office.sensor;
    let start = sensor.first_scan(day);
    let looks: Vec<Option<Look>> = (0..sensor.views).map(|view| Look::new(sensor, view, day)).collect();
    // Index of a scan in the day, and address of a cell that flips in it; by cell.
    let mut flips: Vec<(u32, u32)> = Vec::new();
    let mut unordered = Vec::new();
    for (view, look) in (0..).zip(&looks) {
        if let Some(first) = look.and_then(|look| look.first) {
            let index = (first - start) as u32;
            unordered.push(index as usize);
            for slot in sensor.slots(view) {
                flips.extend(addresses(slot, office.static_occupied(slot)).map(|address| (index, address)));
            }
        }
    }
    changing_flips(office, start, &looks, &mut flips);

    let mut starts = vec![0; sensor.scans_per_day as usize + 1];
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
    let scans = (start..).take(sensor.scans_per_day as usize).map(|scan| (sensor.utc_nanos(scan), sensor.view(scan)));
    DayScans { scans: scans.collect(), starts, flips: by_scan }
}

/// Adds the flips of the cells that change, by cell.
fn changing_flips(office: &GridOffice, start: u64, looks: &[Option<Look>], flips: &mut Vec<(u32, u32)>) {
    let (world, sensor) = (&office.world, &office.sensor);
    let after = looks.iter().flatten().map(|look| look.after_nanos).min().unwrap_or(0);
    let until = looks.iter().flatten().map(|look| look.until_nanos).max().unwrap_or(0);
    let (first, last) = (world.day_at(after), world.day_at(until));
    let days: Vec<WorldDay> = (0..=last.number - first.number).map(|days| world.day(first.plus(days))).collect();
    // After this nothing happens on each day.
    let quiet: Vec<i64> = days.iter().map(|day| day.clock.utc_nanos(DAY_END)).collect();

    let mut changes = Vec::new();
    let mut scans: Vec<u64> = Vec::new();
    for cell in &world.inventory.cells {
        let view = sensor.view_of(cell.address / super::CELLS_PER_TILE);
        let Some(look) = looks[view as usize] else { continue };
        scans.clear();
        let mut first = look.first;
        for (day, &quiet) in days.iter().zip(&quiet) {
            let over = if first.is_some() { day.clock.end_nanos } else { quiet };
            if over <= look.after_nanos {
                continue;
            }
            let mut filled = world.changes(cell, day, &mut changes);
            let mut times = changes.iter().map(|&time| day.clock.utc_nanos(time)).peekable();
            while times.next_if(|&time| time <= look.after_nanos).is_some() {
                filled = !filled;
            }
            scans.extend(first.take().filter(|_| filled));
            for time in times.take_while(|&time| time <= look.until_nanos) {
                let scan = sensor.next_of(view, sensor.scan_at(time));
                // There and back between two looks does not show.
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
        ones.map(move |bit| slot * super::CELLS_PER_TILE + word * 64 + bit)
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
    #[must_use]
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
