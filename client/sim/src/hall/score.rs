//! How right a learned grid is.
//!
//! Invariant: a cell of a wall counts if beams ended in it several times, and is found if it or a cell next to it is
//! occupied. A free cell counts if a beam passed it and if its distance from all things is more than the errors of pose
//! and range.

use std::fmt;

use super::{
    plan::HallThing,
    truth::{HallCell, HallTruth},
};

/// Beams that have to end in a cell for it to count as seen.
const SEEN_ENDS: u32 = 3;
/// Distance from all things of the free cells that count.
const FREE_DISTANCE_M: f64 = 0.25;
/// A cell is occupied above this probability, and free below 1 minus it.
const OCCUPIED: f64 = 0.65;

/// A count of cells among others.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CellShare {
    /// The cells that have the property.
    pub found: u32,
    /// All cells that count.
    pub among: u32,
}

impl CellShare {
    fn count(cells: impl Iterator<Item = bool>) -> Self {
        cells.fold(Self::default(), |sum, found| Self { found: sum.found + u32::from(found), among: sum.among + 1 })
    }

    /// The share; 0 if no cell counts.
    pub fn share(self) -> f64 {
        f64::from(self.found) / f64::from(self.among.max(1))
    }
}

impl fmt::Display for CellShare {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.1} % ({} of {})", 100.0 * self.share(), self.found, self.among)
    }
}

/// The figures of a grid without the table.
#[derive(Clone, Debug, PartialEq)]
pub struct HallScore {
    /// The walls that are occupied, or have an occupied cell next to them, by their kind.
    pub walls: Vec<(HallThing, CellShare)>,
    /// The walls that are occupied themselves, by their kind.
    pub walls_in_place: Vec<(HallThing, CellShare)>,
    /// The free cells that are occupied.
    pub false_walls: CellShare,
    /// The free cells that are free.
    pub free: CellShare,
    /// Occupied cells that no beam can reach, behind walls.
    pub hidden_walls: u32,
}

/// The figures of the table at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TableScore {
    /// The table's cells that are free.
    pub free: CellShare,
    /// The table's seen sides that are occupied.
    pub occupied: CellShare,
}

impl HallScore {
    /// The figures of a grid that has this probability of each cell; `None`: the cell is unknown.
    pub fn new(truth: &HallTruth, probability: impl Fn([i32; 2]) -> Option<f64>) -> Self {
        let is_still = |cell: &&HallCell| cell.thing.is_some_and(|thing| thing != HallThing::Table);
        let seen = |thing: HallThing| {
            truth.cells().iter().filter(move |cell| cell.thing == Some(thing) && cell.ends >= SEEN_ENDS)
        };
        let away = || truth.cells().iter().filter(|cell| !is_still(cell) && cell.distance_m >= FREE_DISTANCE_M);
        let is_occupied = |cell: &HallCell| probability(cell.index).is_some_and(|value| value > OCCUPIED);
        let is_free = |cell: &HallCell| probability(cell.index).is_some_and(|value| value < 1.0 - OCCUPIED);
        let shares = |is_found: &dyn Fn(&HallCell) -> bool| {
            HallThing::STILL.map(|thing| (thing, CellShare::count(seen(thing).map(is_found)))).to_vec()
        };
        Self {
            walls: shares(&|cell| is_found(cell.index, &probability)),
            walls_in_place: shares(&is_occupied),
            false_walls: CellShare::count(away().filter(|cell| cell.is_passed).map(is_occupied)),
            free: CellShare::count(away().filter(|cell| cell.is_passed).map(is_free)),
            hidden_walls: away().filter(|cell| !cell.is_passed && is_occupied(cell)).count() as u32,
        }
    }

    /// The walls of all kinds that are occupied, or have an occupied cell next to them.
    pub fn recall(&self) -> CellShare {
        sum(&self.walls)
    }

    /// The walls of all kinds that are occupied themselves.
    pub fn recall_in_place(&self) -> CellShare {
        sum(&self.walls_in_place)
    }
}

impl fmt::Display for HallScore {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "walls within one cell: {}; in their cells: {}", self.recall(), self.recall_in_place())?;
        for ((thing, share), (_, in_place)) in self.walls.iter().zip(&self.walls_in_place) {
            writeln!(f, "  {}: {share}; {in_place}", thing.name())?;
        }
        writeln!(f, "free cells that are walls: {}", self.false_walls)?;
        writeln!(f, "free cells that are free: {}", self.free)?;
        write!(f, "cells behind walls that are walls: {}", self.hidden_walls)
    }
}

impl TableScore {
    /// The figures of a grid that has this probability of each cell; `None`: the cell is unknown.
    pub fn new(truth: &HallTruth, probability: impl Fn([i32; 2]) -> Option<f64>) -> Self {
        let table = || truth.cells().iter().filter(|cell| cell.thing == Some(HallThing::Table));
        let sides = table().filter(|cell| cell.ends >= SEEN_ENDS);
        Self {
            free: CellShare::count(table().map(|cell| probability(cell.index).is_some_and(|p| p < 1.0 - OCCUPIED))),
            occupied: CellShare::count(sides.map(|cell| is_found(cell.index, &probability))),
        }
    }
}

fn sum(shares: &[(HallThing, CellShare)]) -> CellShare {
    shares.iter().fold(CellShare::default(), |sum, (_, share)| CellShare {
        found: sum.found + share.found,
        among: sum.among + share.among,
    })
}

/// Whether the cell or one next to it is occupied.
fn is_found([x, y]: [i32; 2], probability: &impl Fn([i32; 2]) -> Option<f64>) -> bool {
    let mut around = (-1..=1).flat_map(|up| (-1..=1).map(move |right| [x + right, y + up]));
    around.any(|cell| probability(cell).is_some_and(|value| value > OCCUPIED))
}
