//! The plan of the hall: 30 m × 20 m, with a corridor along its north side, two rooms, pillars, shelves, boards, and
//! wall parts from which few beams return.
//!
//! Invariant: nothing but the table ever moves. Most faces do not lie on the borders of cells of 0.1 m, and one wall
//! and two pillars are at an angle to them.

use super::solid::{Hit, Solid};

/// A kind of things in the hall.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum HallThing {
    /// A wall around the hall.
    OuterWall,
    /// A wall of the long narrow corridor.
    CorridorWall,
    /// A wall of a room, or one that stands free.
    RoomWall,
    /// A pillar.
    Pillar,
    /// A shelf lower than 1 m: only the lower scanner sees it.
    LowShelf,
    /// A board at a height of 1.9 to 2.1 m: only the upper scanner sees it.
    HighBoard,
    /// A wall from which two of five beams return.
    DarkWall,
    /// A wall from which steep beams return only.
    ShinyWall,
    /// A table that stands in the hall from 9 to 12 on working days. Only the lower scanner sees it.
    Table,
}

impl HallThing {
    /// All things that never move.
    pub const STILL: [HallThing; 8] = [
        HallThing::OuterWall,
        HallThing::CorridorWall,
        HallThing::RoomWall,
        HallThing::Pillar,
        HallThing::LowShelf,
        HallThing::HighBoard,
        HallThing::DarkWall,
        HallThing::ShinyWall,
    ];

    /// The name in figures.
    pub fn name(self) -> &'static str {
        match self {
            HallThing::OuterWall => "outer_wall",
            HallThing::CorridorWall => "corridor_wall",
            HallThing::RoomWall => "room_wall",
            HallThing::Pillar => "pillar",
            HallThing::LowShelf => "low_shelf",
            HallThing::HighBoard => "high_board",
            HallThing::DarkWall => "dark_wall",
            HallThing::ShinyWall => "shiny_wall",
            HallThing::Table => "table",
        }
    }

    /// Probability that a beam returns that hits the surface this steeply.
    pub(super) fn returns(self, steepness: f64) -> f64 {
        match self {
            HallThing::DarkWall => 0.4,
            HallThing::ShinyWall => f64::from(u8::from(steepness > STEEP)),
            _ => 1.0,
        }
    }
}

/// Cosine of the angle up to which a beam returns from a shiny surface: 37 degrees.
const STEEP: f64 = 0.8;
/// Walls and pillars are higher than every scanner.
const FULL_M: [f64; 2] = [0.0, 4.0];
const SHELF_M: [f64; 2] = [0.0, 0.9];
const BOARD_M: [f64; 2] = [1.9, 2.1];
const TABLE_M: [f64; 2] = [0.0, 0.8];

/// The hours in which the table is there.
pub(super) const TABLE_HOURS: std::ops::Range<i32> = 9..12;

/// The way of a patrol, a closed line.
pub(super) const ROUTE_M: [[f64; 2]; 33] = [
    [7.5, 2.0],
    // Into the western room and back.
    [7.5, 3.55],
    [3.0, 3.55],
    [7.5, 3.55],
    [7.0, 8.2],
    // Between the low shelves.
    [1.4, 8.8],
    [1.4, 12.25],
    [6.6, 12.25],
    [6.6, 15.6],
    [2.05, 16.4],
    // Through the corridor.
    [2.05, 18.9],
    [27.55, 18.9],
    [27.55, 16.4],
    [23.0, 16.0],
    [25.5, 12.0],
    // Into the eastern room and back.
    [24.55, 8.8],
    [24.55, 3.5],
    [27.5, 3.5],
    [24.55, 3.5],
    [24.55, 8.8],
    [19.0, 9.0],
    [16.3, 11.5],
    [17.5, 15.5],
    [11.0, 16.0],
    // Around the table.
    [11.0, 13.2],
    [9.3, 12.4],
    [9.3, 10.2],
    [11.0, 9.8],
    [12.9, 10.3],
    [12.2, 6.5],
    // Below the boards' height, but not below the boards.
    [14.7, 5.0],
    [14.7, 1.5],
    [7.5, 1.6],
];

/// The things of the hall. Where things touch one cell, the cell is of the first.
#[derive(Clone, Debug)]
pub(super) struct HallPlan {
    pub(super) still: Vec<(HallThing, Solid)>,
    pub(super) table: Solid,
}

impl HallPlan {
    pub(super) fn new() -> Self {
        use HallThing::*;
        let wall = |thing, low, high| (thing, Solid::between(low, high, FULL_M));
        let shelf = |low, high| (LowShelf, Solid::between(low, high, SHELF_M));
        let board = |low, high| (HighBoard, Solid::between(low, high, BOARD_M));
        let pillar = |middle, angle_rad| (Pillar, Solid::turned(middle, [0.4, 0.4], angle_rad, FULL_M));
        Self {
            still: vec![
                // Parts of the outer walls.
                wall(DarkWall, [29.73, 9.0], [30.05, 13.0]),
                wall(ShinyWall, [-0.05, 7.0], [0.25, 10.0]),
                wall(DarkWall, [15.0, -0.05], [18.0, 0.25]),
                shelf([2.5, 10.76], [5.5, 11.24]),
                shelf([2.53, 13.27], [5.53, 13.75]),
                shelf([8.04, 17.42], [12.04, 17.86]),
                board([9.5, 2.8], [12.5, 3.2]),
                board([16.83, 3.55], [17.23, 6.55]),
                board([26.0, 6.5], [29.0, 6.94]),
                pillar([8.03, 9.02], 0.0),
                pillar([8.03, 14.54], 0.3),
                pillar([14.04, 8.96], 0.0),
                pillar([14.04, 14.03], std::f64::consts::FRAC_PI_4),
                // The western room, with a door in the east.
                wall(RoomWall, [6.02, 0.25], [6.14, 3.0]),
                wall(RoomWall, [6.02, 4.1], [6.14, 6.15]),
                wall(RoomWall, [0.25, 6.03], [6.02, 6.15]),
                // The eastern room, with a door in the north.
                wall(RoomWall, [20.91, 0.25], [21.03, 7.14]),
                wall(RoomWall, [21.03, 7.02], [24.0, 7.14]),
                wall(RoomWall, [25.1, 7.02], [29.73, 7.14]),
                (RoomWall, Solid::turned([20.0, 12.5], [4.0, 0.12], 0.44, FULL_M)),
                // The corridor, with two doors in the south.
                wall(CorridorWall, [0.25, 17.94], [1.5, 18.06]),
                wall(CorridorWall, [2.6, 17.94], [27.0, 18.06]),
                wall(CorridorWall, [28.1, 17.94], [29.73, 18.06]),
                wall(CorridorWall, [0.25, 19.76], [29.73, 20.05]),
                wall(OuterWall, [-0.05, -0.05], [0.25, 7.0]),
                wall(OuterWall, [-0.05, 10.0], [0.25, 20.05]),
                wall(OuterWall, [29.73, -0.05], [30.05, 9.0]),
                wall(OuterWall, [29.73, 13.0], [30.05, 20.05]),
                wall(OuterWall, [0.25, -0.05], [15.0, 0.25]),
                wall(OuterWall, [18.0, -0.05], [29.73, 0.25]),
            ],
            table: Solid::between([10.23, 11.12], [11.83, 11.92], TABLE_M),
        }
    }

    /// The things that a plane at a height cuts.
    pub(super) fn plane(&self, height_m: f64, has_table: bool) -> HallPlane {
        let table = has_table.then_some((HallThing::Table, self.table));
        let all = self.still.iter().copied().chain(table);
        HallPlane { things: all.filter(|(_, solid)| solid.stands_at(height_m)).collect() }
    }
}

/// The things of the hall at one height.
#[derive(Clone, Debug)]
pub(super) struct HallPlane {
    things: Vec<(HallThing, Solid)>,
}

impl HallPlane {
    /// The first surface that a beam with a direction of length 1 hits.
    pub(super) fn first_hit(&self, from: [f64; 2], direction: [f64; 2]) -> Option<(HallThing, Hit)> {
        let mut first: Option<(HallThing, Hit)> = None;
        for (thing, solid) in &self.things {
            let Some(hit) = solid.hit(from, direction) else { continue };
            if first.is_none_or(|(_, first)| hit.range_m < first.range_m) {
                first = Some((*thing, hit));
            }
        }
        first
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_patrol_keeps_away_from_all_things() {
        let plan = HallPlan::new();
        let solids = || plan.still.iter().map(|(_, solid)| solid).chain([&plan.table]);
        for (number, from) in ROUTE_M.iter().enumerate() {
            let to = ROUTE_M[(number + 1) % ROUTE_M.len()];
            for step in 0..=100 {
                let place = [0, 1].map(|axis| from[axis] + (to[axis] - from[axis]) * f64::from(step) / 100.0);
                let nearest = solids().map(|solid| solid.distance_m(place)).fold(f64::INFINITY, f64::min);
                assert!(nearest > 0.4, "{place:?} is {nearest} m from a thing");
            }
        }
    }

    #[test]
    fn no_beam_leaves_the_hall() {
        let plane = HallPlan::new().plane(0.2, true);
        for angle in 0..720 {
            let (sin, cos) = libm::sincos(f64::from(angle) * std::f64::consts::PI / 360.0);
            for place in ROUTE_M {
                assert!(plane.first_hit(place, [cos, sin]).is_some(), "from {place:?} to {cos}, {sin}");
            }
        }
    }
}
