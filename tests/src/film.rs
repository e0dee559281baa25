//! The simulated office as a film: the observations of each tile by a fixed sensor, scan by scan.
//!
//! Invariant: a film is a function of its options. Scan n, from 0, is the one that its producer sends as number n + 1;
//! every cell of every tile is observed in each.

use tidemap_client::observe::tiles::{Mask, TileIndex, TileMasks};
use tidemap_sim::{GridOffice, GridOfficeOptions, GridStream};

/// Cells of a tile.
const TILE_CELLS: u32 = 512;

/// A cell by its tile's slot and its number in the tile.
pub type FilmCell = (usize, u32);

/// The scans of a number of days.
#[derive(Clone, Debug)]
pub struct Film {
    tiles: Vec<TileIndex>,
    times: Vec<i64>,
    /// The cells that flip in each scan, as slot * 512 + place.
    flips: Vec<Vec<u32>>,
    changing: Vec<u32>,
    per_day: usize,
}

impl Film {
    /// 8192 cells of 0.1 m in 16 tiles, of which 400 change; in London, over the change to summer time on the 30th of
    /// March 2025, from the 27th on.
    ///
    /// # Panics
    /// If the office cannot be simulated.
    #[must_use]
    pub fn new(days: u32, scans_per_day: u32) -> Self {
        let options = GridOfficeOptions {
            cells: 8_000,
            changing_cells: 400,
            scans_per_day,
            first_day: jiff::civil::date(2025, 3, 27),
            ..GridOfficeOptions::default()
        };
        let office = GridOffice::new(&options).expect("an office");
        let mut stream = GridStream::new(&office, days);
        let (mut times, mut flips) = (Vec::new(), Vec::new());
        while let Some(scan) = stream.next() {
            times.push(scan.utc_nanos);
            flips.push(scan.occupied_flips.to_vec());
        }
        let changing = office.changing_cells().to_vec();
        let tiles = office.tiles().iter().map(|&[x, y, z]| TileIndex { x, y, z }).collect();
        Self { tiles, times, flips, changing, per_day: scans_per_day as usize }
    }

    /// The time zone of the office.
    pub const ZONE: &str = "Europe/London";

    /// Number of scans.
    #[must_use]
    pub fn scans(&self) -> usize {
        self.times.len()
    }

    /// Number of scans of the first `days` days of 86,400 seconds.
    #[must_use]
    pub fn scans_of(&self, days: usize) -> usize {
        days * self.per_day
    }

    /// When a scan was made, nanoseconds UTC.
    #[must_use]
    pub fn time(&self, scan: usize) -> i64 {
        self.times[scan]
    }

    /// The tiles, by slot.
    #[must_use]
    pub fn tiles(&self) -> &[TileIndex] {
        &self.tiles
    }

    /// Cells that the office changes, `step` apart.
    pub fn changing(&self, step: usize) -> impl Iterator<Item = FilmCell> {
        self.changing.iter().step_by(step).map(|&cell| ((cell / TILE_CELLS) as usize, cell % TILE_CELLS))
    }

    /// Cells that the office never changes, `step` apart.
    pub fn still(&self, step: usize) -> impl Iterator<Item = FilmCell> {
        let all = 0..self.tiles.len() as u32 * TILE_CELLS;
        let still = all.filter(|cell| self.changing.binary_search(cell).is_err());
        still.step_by(step).map(|cell| ((cell / TILE_CELLS) as usize, cell % TILE_CELLS))
    }

    /// The index of a cell along each axis.
    #[must_use]
    pub fn index(&self, (slot, place): FilmCell) -> [i32; 3] {
        let within = [place % 8, place / 8 % 8, place / 64].map(u32::cast_signed);
        let TileIndex { x, y, z } = self.tiles[slot];
        std::array::from_fn(|axis| [x, y, z][axis] * 8 + within[axis])
    }

    /// The name of a cell as a state.
    #[must_use]
    pub fn name(&self, cell: FilmCell) -> String {
        let [x, y, z] = self.index(cell);
        format!("cell/{x}/{y}/{z}")
    }

    /// All scans in order: the time, and the occupied cells of each tile, by slot.
    pub fn run(&self) -> impl Iterator<Item = (i64, Vec<Mask>)> {
        let mut occupied: Vec<Mask> = vec![Mask::EMPTY; self.tiles.len()];
        self.times.iter().zip(&self.flips).map(move |(&time, flips)| {
            for &cell in flips {
                let (slot, place) = ((cell / TILE_CELLS) as usize, cell % TILE_CELLS);
                occupied[slot].flip(place as u16);
            }
            (time, occupied.clone())
        })
    }

    /// A scan as it is sent: every cell of every tile is observed.
    #[must_use]
    pub fn seen(&self, occupied: &[Mask]) -> Vec<(TileIndex, TileMasks)> {
        let whole = |(&tile, &occupied)| (tile, TileMasks::clipped(Mask::FULL, occupied));
        self.tiles.iter().zip(occupied).map(whole).collect()
    }
}

/// Whether a mask holds a cell.
#[must_use]
pub fn holds(mask: &Mask, place: u32) -> bool {
    mask.contains(place as u16)
}
