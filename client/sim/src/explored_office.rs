//! A small office for exploration experiments: an occupancy grid with walls, rooms on both sides of a corridor, and
//! things that move with the daily routines of people, like the simulated office of RA-L 2016, section IV.C (Santos et
//! al., "Spatio-temporal exploration strategies"): people, chairs, laptops and doors, twenty of them in an office of
//! four rooms a side.
//!
//! All days are working days of 86,400 s, counted from day 0. Every person has habitual times of arrival, meeting,
//! lunch and departure. Each day differs from the habit by minutes; people take short breaks at any time and are seldom
//! absent.
//!
//! Invariant: pure. The value of a cell at a time depends on the seed, the number of rooms and that time only.

use self::routine::{Person, Whereabouts};

mod routine;

#[cfg(test)]
mod tests;

/// Seconds of a day.
const DAY_SECS: i64 = 86_400;
/// Cells of a room along x and y, including one of its walls.
const ROOM: usize = 25;
/// Cells of the corridor across.
const CORRIDOR: usize = 9;
/// Cells along y: two rooms, three walls beside them, the corridor.
const DEPTH: usize = 2 * ROOM + CORRIDOR + 2;
/// Layers: 2.4 m.
const HEIGHT: usize = 12;
/// Height of doors in cells.
const DOOR_HEIGHT: usize = 10;
/// Doors: of kitchen and meeting room, open while anybody is in the office. Other rooms have no door.
const DOORS: usize = 2;

/// A small office for exploration experiments.
#[derive(Clone, Debug)]
pub struct ExploredOffice {
    rooms_a_side: usize,
    people: Vec<Person>,
    still: Vec<bool>,
}

/// A box of cells; `until` is exclusive.
#[derive(Clone, Copy, Debug)]
struct Block {
    from: [usize; 3],
    until: [usize; 3],
}

fn block(x: std::ops::Range<usize>, y: std::ops::Range<usize>, z: std::ops::Range<usize>) -> Block {
    Block { from: [x.start, y.start, z.start], until: [x.end, y.end, z.end] }
}

/// A room, given by its left wall and its side of the corridor.
#[derive(Clone, Copy, Debug)]
struct ExploredRoom {
    /// Column of the left wall.
    x: usize,
    /// South of the corridor, so that y grows towards the corridor.
    is_south: bool,
}

impl ExploredRoom {
    /// A box of the room: `x` from its left wall, `depth` from the wall with the door into the room, 0 being that wall.
    fn block(self, x: std::ops::Range<usize>, depth: std::ops::Range<usize>, z: std::ops::Range<usize>) -> Block {
        let (near, far) = (ROOM, ROOM + CORRIDOR + 1);
        let y = if self.is_south {
            near + 1 - depth.end..near + 1 - depth.start
        } else {
            far + depth.start..far + depth.end
        };
        block(self.x + x.start..self.x + x.end, y, z)
    }
}

impl ExploredOffice {
    /// Length of a cell's edge, metres.
    pub const CELL_M: f64 = 0.2;
    /// Maximum number of rooms on one side of the corridor.
    pub const ROOMS_MAX: usize = 20;

    /// An office with `rooms_a_side` rooms on each side of its corridor, clamped to 2 to [`Self::ROOMS_MAX`]. Each room
    /// except kitchen and meeting room is the workplace of one person. A different `seed` gives different habits and
    /// days.
    pub fn new(seed: u64, rooms_a_side: usize) -> Self {
        let rooms_a_side = rooms_a_side.clamp(2, Self::ROOMS_MAX);
        let mut office = Self { rooms_a_side, people: Vec::new(), still: Vec::new() };
        office.people = (0..2 * rooms_a_side - 2).map(|person| Person::new(seed, person)).collect();
        let mut still = vec![false; office.size().iter().product()];
        office.build(&mut still);
        office.still = still;
        office
    }

    /// Number of cells along x, y and z.
    pub fn size(&self) -> [usize; 3] {
        [self.rooms_a_side * ROOM + 1, DEPTH, HEIGHT]
    }

    /// The place of the robot's charger, x and y in metres from the corner of cell 0: in the middle of the corridor.
    pub fn charger_m(&self) -> [f64; 2] {
        let middle = |cells: usize| (cells / 2) as f64 * Self::CELL_M + Self::CELL_M / 2.0;
        [middle(self.size()[0]), middle(DEPTH)]
    }

    /// Number of things that move: people, their chairs and laptops, and doors.
    pub fn moving(&self) -> usize {
        3 * self.people.len() + DOORS
    }

    /// The occupied cells at a time in seconds from the first midnight, at least 0: cell (x, y, z) has the index
    /// x + y · size\[0\] + z · size\[0\] · size\[1\].
    pub fn occupied(&self, secs: i64) -> Vec<bool> {
        let (day, second) = (secs.div_euclid(DAY_SECS), secs.rem_euclid(DAY_SECS));
        let mut cells = self.still.clone();
        let mut is_open = false;
        for (index, person) in self.people.iter().enumerate() {
            let now = person.whereabouts(day, second);
            let desk = self.room(index);
            let is_in = now != Whereabouts::Away;
            is_open |= is_in;
            // The laptop is on the desk; the chair is pulled out all day and put back in the evening.
            if is_in {
                self.fill(&mut cells, desk.block(14..16, 22..23, 4..6));
                self.fill(&mut cells, desk.block(14..16, 21..22, 4..5));
            }
            let chair = if is_in { 16 } else { 19 };
            self.fill(&mut cells, desk.block(14..16, chair..chair + 2, 0..3));
            self.fill(&mut cells, desk.block(14..16, chair..chair + 1, 3..5));
            let place = 3 + 3 * (index % 6);
            match now {
                Whereabouts::Away | Whereabouts::Elsewhere => {}
                Whereabouts::Desk => self.fill(&mut cells, desk.block(13..16, 16..18, 2..7)),
                Whereabouts::Lunch => self.fill(&mut cells, self.kitchen().block(place..place + 2, 16..18, 0..8)),
                Whereabouts::Meeting => self.fill(&mut cells, self.meeting().block(place..place + 2, 18..20, 0..7)),
            }
        }
        for room in [self.kitchen(), self.meeting()] {
            let leaf =
                if is_open { room.block(9..10, 1..6, 0..DOOR_HEIGHT) } else { room.block(4..9, 0..1, 0..DOOR_HEIGHT) };
            self.fill(&mut cells, leaf);
        }
        cells
    }

    /// The rooms are ordered from the left, south before north; the last two are meeting room and kitchen.
    fn room(&self, index: usize) -> ExploredRoom {
        ExploredRoom { x: index / 2 * ROOM, is_south: index.is_multiple_of(2) }
    }

    fn meeting(&self) -> ExploredRoom {
        self.room(2 * self.rooms_a_side - 2)
    }

    fn kitchen(&self) -> ExploredRoom {
        self.room(2 * self.rooms_a_side - 1)
    }

    fn fill(&self, cells: &mut [bool], block: Block) {
        self.set(cells, block, true);
    }

    fn set(&self, cells: &mut [bool], Block { from, until }: Block, occupied: bool) {
        let [width, depth, _] = self.size();
        for z in from[2]..until[2] {
            for y in from[1]..until[1] {
                let row = (z * depth + y) * width;
                cells[row + from[0]..row + until[0]].fill(occupied);
            }
        }
    }

    /// Walls and furniture.
    fn build(&self, cells: &mut [bool]) {
        let [width, ..] = self.size();
        for y in [0, ROOM, ROOM + CORRIDOR + 1, DEPTH - 1] {
            self.fill(cells, block(0..width, y..y + 1, 0..HEIGHT));
        }
        for wall in 0..=self.rooms_a_side {
            let x = wall * ROOM;
            self.fill(cells, block(x..x + 1, 0..ROOM, 0..HEIGHT));
            self.fill(cells, block(x..x + 1, ROOM + CORRIDOR + 1..DEPTH, 0..HEIGHT));
        }
        for end in [0, width - 1] {
            self.fill(cells, block(end..end + 1, 0..DEPTH, 0..HEIGHT));
        }
        for index in 0..2 * self.rooms_a_side {
            let room = self.room(index);
            self.set(cells, room.block(4..9, 0..1, 0..DOOR_HEIGHT), false);
            // A shelf in the corner.
            self.fill(cells, room.block(18..25, 1..3, 0..9));
            if index < self.people.len() {
                self.fill(cells, room.block(10..20, 20..24, 3..4));
            } else {
                self.fill(cells, room.block(3..21, 21..24, 3..4));
            }
        }
    }
}
