//! A simulated office as a stream of three-dimensional occupancy grids, as a depth camera over an office, or a robot
//! that patrols a building, records them over months. The default size is the size of the office grid published in
//! 2017: 213,000 cells of 0.1 m, 17,200 scans a day, about 15,000 changing cells with about 40 changes a day each.
//!
//! Walls, floors and furniture never move. People follow daily and weekly routines on the wall clock of a time zone;
//! chairs, doors, curtains and belongings follow the people, a cleaner comes in the evening, and edges flicker.
//!
//! Invariant: pure, and the same on every machine: the value of a cell at a time depends on the options and that time
//! only. Only the times of changes are generated, never a cell's value scan by scan.

mod dice;
mod floor;
mod options;
mod routine;
mod scans;
mod schedule;
mod shapes;
mod staff;
mod thing_kind;
mod things;
mod world;

use jiff::tz::TimeZoneDatabase;

pub use self::options::{GridOfficeError, GridOfficeOptions};
pub use self::scans::{DayScans, GridScan, GridStream};
use self::{
    floor::{Floor, TILE_CELLS},
    schedule::ViewSchedule,
    things::locate,
    world::World,
};
use crate::{
    civil_day::{CivilDay, midnight_nanos},
    zone::UnknownZone,
};

/// A simulated office as a stream of occupancy grids.
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
    /// All slots in order: the slots of a view are a slice of it.
    slots: Vec<u32>,
    /// The cells that are always occupied, by slot.
    still: Vec<[u64; 8]>,
    /// By slot and cell, ascending.
    changing: Vec<u32>,
    schedule: ViewSchedule,
    world: World,
}

impl GridOffice {
    /// Maximum number of days of a stream.
    pub const DAYS_MAX: u32 = 20_000;

    /// Generates an office, in well under a second for 20 million cells.
    ///
    /// # Errors
    /// An option out of range, an unknown zone, or fewer changes than the routines make.
    pub fn new(options: &GridOfficeOptions) -> Result<Self, GridOfficeError> {
        let tiles = options.cells.div_ceil(TILE_CELLS);
        options.check(tiles)?;
        let zone = TimeZoneDatabase::bundled().get(&options.zone).map_err(|_| UnknownZone(options.zone.clone()))?;
        let floor = Floor::new(tiles);
        let mut still: Vec<[u64; 8]> = (0..tiles).map(|slot| floor.solid(slot)).collect();
        let inventory = things::place(options.seed, &floor, &still, options.changing_cells);
        for cell in &inventory.cells {
            let (slot, word, bit) = locate(cell.address);
            still[slot][word] &= !bit;
        }
        let schedule = ViewSchedule {
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
            schedule,
            world: World::new(options.seed, zone, inventory, options.changes_per_day)?,
        })
    }

    /// Indices of the tiles, each 0.8 m along x, y and z, with the origin at the centre of the building's floor. The
    /// position in this list is the tile's slot.
    pub fn tiles(&self) -> &[[i32; 3]] {
        &self.tiles
    }

    /// The slots that a view shows, ascending. Each slot is in exactly one view.
    ///
    /// # Panics
    /// If `view` is not below the number of views.
    pub fn view_slots(&self, view: u32) -> &[u32] {
        assert!(view < self.schedule.views, "view {view} is out of range: there are {}", self.schedule.views);
        let slots = self.schedule.slots(view);
        &self.slots[slots.start as usize..slots.end as usize]
    }

    /// The cells of a tile that are always occupied: word z, bit x + 8 * y. None of them is a changing cell.
    ///
    /// # Panics
    /// If there is no tile at `slot`.
    pub fn static_occupied(&self, slot: u32) -> [u64; 8] {
        self.still[slot as usize]
    }

    /// The cells that change, as `slot * 512 + cell` with cell = x + 8 * y + 64 * z, ascending. All others never do.
    pub fn changing_cells(&self) -> &[u32] {
        &self.changing
    }

    /// Whether a cell is occupied at a time in nanoseconds UTC.
    ///
    /// # Panics
    /// If there is no tile at `slot`, or if `cell` is not below 512.
    pub fn truth(&self, slot: u32, cell: u32, utc_nanos: i64) -> bool {
        assert!(cell < TILE_CELLS, "cell {cell} is not one of the {TILE_CELLS} of a tile");
        let address = slot * TILE_CELLS + cell;
        if let Ok(index) = self.changing.binary_search(&address) {
            let day = self.world.day(self.world.day_at(utc_nanos));
            return self.world.filled(&self.world.inventory.cells[index], &day, utc_nanos);
        }
        let (slot, word, bit) = locate(address);
        self.still[slot][word] & bit != 0
    }

    /// The tile as the stream last showed it before a day; all cells free if it did not show the tile. With it,
    /// [`GridOffice::day`] can be read without the earlier days.
    ///
    /// # Panics
    /// If there is no tile at `slot`.
    pub fn shown_before(&self, day: u32, slot: u32) -> [u64; 8] {
        let view = self.schedule.view_of(slot);
        let Some(last) = self.schedule.last_of(view, self.schedule.first_scan(day)) else { return [0; 8] };
        let mut words = self.static_occupied(slot);
        let from = self.changing.partition_point(|&address| address < slot * TILE_CELLS);
        let cells = self.world.inventory.cells[from..].iter();
        let utc_nanos = self.schedule.utc_nanos(last);
        let day = self.world.day(self.world.day_at(utc_nanos));
        for cell in cells.take_while(|cell| cell.address / TILE_CELLS == slot) {
            if self.world.filled(cell, &day, utc_nanos) {
                let (_, word, bit) = locate(cell.address);
                words[word] |= bit;
            }
        }
        words
    }

    /// The scans of a day of 86,400 s; day 0 starts at midnight of the first day.
    ///
    /// # Panics
    /// If `day` is not below [`GridOffice::DAYS_MAX`].
    pub fn day(&self, day: u32) -> DayScans {
        assert!(day < Self::DAYS_MAX, "day {day} is out of range: there are {}", Self::DAYS_MAX);
        scans::day_scans(self, day)
    }
}
