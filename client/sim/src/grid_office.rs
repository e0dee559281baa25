//! The simulated office as a stream of three-dimensional occupancy grids: what a depth camera over an office, or a
//! robot that goes round a building, gives in the course of months. Sized by default after the published office
//! grid of 2017: 213,000 cells of 0.1 m, 17,200 scans a day, some 15,000 cells that change, some 40 times a day each.
//!
//! Walls, floors and furniture stand; people come and go by daily and weekly routines on the wall clock of a time zone,
//! chairs, doors, curtains and belongings follow them, a cleaner comes at night, and edges flicker.
//!
//! Invariant: pure, and the same on every machine: what a cell is at a time depends on the options and that time only.
//! Only times of changes are generated, never a cell's state scan by scan.

mod civil_day;
mod dice;
mod floor;
mod routine;
mod scans;
mod sensor;
mod shapes;
mod staff;
mod things;
mod world;

use jiff::{
    civil::{Date, date},
    tz::TimeZoneDatabase,
};

pub use self::scans::{DayScans, GridScan, GridStream};
use self::{
    civil_day::{CivilDay, midnight_nanos},
    floor::Floor,
    sensor::Sensor,
    things::locate,
    world::World,
};
use crate::UnknownZone;

/// Cells of a tile of 8 x 8 x 8.
const CELLS_PER_TILE: u32 = floor::TILE_CELLS;

/// What a grid office is like.
#[derive(Clone, Debug, PartialEq)]
pub struct GridOfficeOptions {
    /// Another seed gives other people, things and days.
    pub seed: u64,
    /// Name of the time zone in the IANA database by whose wall clocks people live.
    pub zone: String,
    /// The local date at whose midnight the stream starts; 1970 to 2200.
    pub first_day: Date,
    /// Number of cells, rounded up to whole tiles of 512; 1 to 2^31.
    pub cells: u32,
    /// Scans in 86,400 s; 1 to 86,400.
    pub scans_per_day: u32,
    /// How many cells change; at least 1, at most an eighth of all. The routines come out well up to a twelfth, from
    /// about 100,000 cells on; beyond that more of the changing cells are edges.
    pub changing_cells: u32,
    /// How often a changing cell changes in a day, in the mean over cells and weeks; at most 500, and not fewer than
    /// routines alone make: about 4. A sensor that looks every 6 s or oftener sees all of it.
    pub changes_per_day: f64,
    /// 1: a fixed sensor that sees all in each scan. N: one that moves and sees N parts of the building in turn, each
    /// about 1/N of the tiles, at most as many as tiles.
    pub views: u32,
    /// Scans of one view before the next; at least 1.
    pub dwell_scans: u32,
}

impl Default for GridOfficeOptions {
    /// The published office grid, in London in spring, from a Monday on.
    fn default() -> Self {
        Self {
            seed: 1,
            zone: "Europe/London".to_owned(),
            first_day: date(2025, 3, 3),
            cells: 213_000,
            scans_per_day: 17_200,
            changing_cells: 15_000,
            changes_per_day: 40.0,
            views: 1,
            dwell_scans: 1,
        }
    }
}

/// Why there is no such grid office.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GridOfficeError {
    /// The time zone is not known.
    #[error(transparent)]
    Zone(#[from] UnknownZone),
    /// An option is out of its range.
    #[error("{option} has to be {allowed}, and is {given}")]
    OutOfRange {
        /// Name of the option.
        option: &'static str,
        /// Its range.
        allowed: String,
        /// What was given.
        given: String,
    },
    /// People, chairs and doors alone make more changes.
    #[error("changes_per_day is {asked}, and the routines of this office alone make {least:.1}")]
    TooQuiet {
        /// What was given.
        asked: f64,
        /// What routines make.
        least: f64,
    },
}

/// A simulated office as a stream of occupancy grids: what a depth camera over an office, or a robot that goes round a
/// building, gives in the course of months.
///
/// A consumer that keeps one mask per tile can rebuild every scan:
///
/// ```
/// use tidemap_sim::{GridOffice, GridOfficeOptions, GridStream};
///
/// let small = GridOfficeOptions { cells: 20_000, changing_cells: 1_000, scans_per_day: 96, ..Default::default() };
/// let office = GridOffice::new(&small)?;
/// let mut tiles = vec![[0_u64; 8]; office.tiles().len()];
/// let mut stream = GridStream::new(&office, 1);
/// while let Some(scan) = stream.next() {
///     for &flip in scan.occupied_flips {
///         tiles[flip as usize / 512][flip as usize % 512 / 64] ^= 1 << (flip % 64);
///     }
///     let some_cell = office.changing_cells()[500];
///     let (slot, cell) = (some_cell / 512, some_cell % 512);
///     let shown = tiles[slot as usize][cell as usize / 64] >> (cell % 64) & 1 == 1;
///     assert_eq!(shown, office.truth(slot, cell, scan.utc_nanos));
/// }
/// # Ok::<(), tidemap_sim::GridOfficeError>(())
/// ```
#[derive(Clone, Debug)]
pub struct GridOffice {
    tiles: Vec<[i32; 3]>,
    /// 0 to the number of tiles: the slots of a view are a piece of it.
    slots: Vec<u32>,
    /// What is occupied for ever, by slot.
    still: Vec<[u64; 8]>,
    /// By slot and cell, ascending.
    changing: Vec<u32>,
    sensor: Sensor,
    world: World,
}

impl GridOffice {
    /// The most days that a stream has.
    pub const DAYS_MAX: u32 = 20_000;

    /// An office. Takes well under a second for 20 million cells.
    ///
    /// # Errors
    /// An option that is out of its range, a zone that is not known, or too few changes to live by.
    pub fn new(options: &GridOfficeOptions) -> Result<Self, GridOfficeError> {
        let tiles = options.cells.div_ceil(CELLS_PER_TILE);
        check(options, tiles)?;
        let zone = TimeZoneDatabase::bundled().get(&options.zone).map_err(|_| UnknownZone(options.zone.clone()))?;
        let floor = Floor::new(tiles);
        let mut still: Vec<[u64; 8]> = (0..tiles).map(|slot| floor.solid(slot)).collect();
        let inventory = things::place(options.seed, &floor, &still, options.changing_cells);
        for cell in &inventory.cells {
            let (slot, word, bit) = locate(cell.address);
            still[slot][word] &= !bit;
        }
        let sensor = Sensor {
            start_nanos: midnight_nanos(&zone, CivilDay::new(options.first_day)),
            scans_per_day: options.scans_per_day,
            views: options.views,
            dwell: options.dwell_scans,
            tiles,
        };
        Ok(Self {
            tiles: (0..tiles).map(|slot| floor.tile(slot)).collect(),
            slots: (0..tiles).collect(),
            still,
            changing: inventory.cells.iter().map(|cell| cell.address).collect(),
            sensor,
            world: World::new(options.seed, zone, inventory, options.changes_per_day)?,
        })
    }

    /// Indices of the tiles, each 0.8 m along x, y and z, from the middle of the building's floor; the position in this
    /// list is the tile's slot.
    #[must_use]
    pub fn tiles(&self) -> &[[i32; 3]] {
        &self.tiles
    }

    /// The slots that a view shows, ascending. Each slot is in exactly one view.
    ///
    /// # Panics
    /// If `view` is not below the number of views.
    #[must_use]
    pub fn view_slots(&self, view: u32) -> &[u32] {
        assert!(view < self.sensor.views, "view {view} is not one of the {} there are", self.sensor.views);
        let slots = self.sensor.slots(view);
        &self.slots[slots.start as usize..slots.end as usize]
    }

    /// The cells of a tile that are occupied for ever: word z, bit x + 8 * y. None of them is a changing cell.
    ///
    /// # Panics
    /// If there is no tile at `slot`.
    #[must_use]
    pub fn static_occupied(&self, slot: u32) -> [u64; 8] {
        self.still[slot as usize]
    }

    /// The cells that change, as `slot * 512 + cell` with cell = x + 8 * y + 64 * z, ascending. All others never do.
    #[must_use]
    pub fn changing_cells(&self) -> &[u32] {
        &self.changing
    }

    /// Whether a cell is occupied at a time in nanoseconds UTC.
    ///
    /// # Panics
    /// If there is no tile at `slot`, or if `cell` is not below 512.
    #[must_use]
    pub fn truth(&self, slot: u32, cell: u32, utc_nanos: i64) -> bool {
        assert!(cell < CELLS_PER_TILE, "cell {cell} is not one of the {CELLS_PER_TILE} of a tile");
        let address = slot * CELLS_PER_TILE + cell;
        if let Ok(index) = self.changing.binary_search(&address) {
            let day = self.world.day(self.world.day_at(utc_nanos));
            return self.world.filled(&self.world.inventory.cells[index], &day, utc_nanos);
        }
        let (slot, word, bit) = locate(address);
        self.still[slot][word] & bit != 0
    }

    /// The tile as the stream last showed it before a day: all free if it did not. With it, [`GridOffice::day`] can be
    /// read without the days before.
    ///
    /// # Panics
    /// If there is no tile at `slot`.
    #[must_use]
    pub fn shown_before(&self, day: u32, slot: u32) -> [u64; 8] {
        let view = self.sensor.view_of(slot);
        let Some(last) = self.sensor.last_of(view, self.sensor.first_scan(day)) else { return [0; 8] };
        let mut words = self.static_occupied(slot);
        let from = self.changing.partition_point(|&address| address < slot * CELLS_PER_TILE);
        let cells = self.world.inventory.cells[from..].iter();
        let utc_nanos = self.sensor.utc_nanos(last);
        let day = self.world.day(self.world.day_at(utc_nanos));
        for cell in cells.take_while(|cell| cell.address / CELLS_PER_TILE == slot) {
            if self.world.filled(cell, &day, utc_nanos) {
                let (_, word, bit) = locate(cell.address);
                words[word] |= bit;
            }
        }
        words
    }

    /// The scans of a day of 86,400 s, from 0 for the one that starts at midnight of the first day.
    ///
    /// # Panics
    /// If `day` is not below [`GridOffice::DAYS_MAX`].
    #[must_use]
    pub fn day(&self, day: u32) -> DayScans {
        assert!(day < Self::DAYS_MAX, "day {day} is not one of the {} there are", Self::DAYS_MAX);
        scans::day_scans(self, day)
    }
}

fn check(options: &GridOfficeOptions, tiles: u32) -> Result<(), GridOfficeError> {
    let within = |option, given: u32, from: u32, to: u32| {
        let refused =
            || GridOfficeError::OutOfRange { option, allowed: format!("{from} to {to}"), given: given.to_string() };
        (from..=to).contains(&given).then_some(()).ok_or_else(refused)
    };
    within("the year of first_day", u32::try_from(options.first_day.year()).unwrap_or(0), 1970, 2200)?;
    within("cells", options.cells, 1, 1 << 31)?;
    within("scans_per_day", options.scans_per_day, 1, 86_400)?;
    within("changing_cells", options.changing_cells, 1, tiles * CELLS_PER_TILE / 8)?;
    within("views", options.views, 1, tiles)?;
    within("dwell_scans", options.dwell_scans, 1, u32::MAX)?;
    if !(0.0..=500.0).contains(&options.changes_per_day) {
        return Err(GridOfficeError::OutOfRange {
            option: "changes_per_day",
            allowed: "0 to 500".to_owned(),
            given: options.changes_per_day.to_string(),
        });
    }
    Ok(())
}
