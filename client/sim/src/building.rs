//! A small building with a floor plan, people, doors and a robot: maps of the floor, readings of rooms, and traversals
//! of a topological map that belong together.
//!
//! Invariant: a day depends on the seed and its date only.

use jiff::civil::Date;
use rand::{Rng as _, rngs::SmallRng};

use crate::draw::{DrawTopic, draws};

/// Width of the building, from west to east, metres.
const WIDTH_M: f64 = 32.0;
/// From south to north, metres.
const HEIGHT_M: f64 = 16.8;
/// The corridor leads from west to east.
const CORRIDOR_SOUTH_M: f64 = 7.0;
const CORRIDOR_NORTH_M: f64 = 9.8;
const WALL_M: f64 = 0.2;
const DAY_SECS: i64 = 86_400;
const READ_EVERY_SECS: i64 = 600;
const DRIVE_EVERY_SECS: i64 = 1_800;

/// A room beside the corridor.
#[derive(Debug)]
struct Room {
    name: &'static str,
    west_m: f64,
    east_m: f64,
    /// Whether the room is north of the corridor, not south of it.
    is_north: bool,
    /// From hour, to hour, and how probably on a working day.
    uses: &'static [(f64, f64, f64)],
}

const ROOMS: [Room; 8] = [
    Room { name: "office-1", west_m: 0.0, east_m: 6.0, is_north: true, uses: &[(8.5, 12.0, 0.9), (13.0, 17.5, 0.85)] },
    Room { name: "office-2", west_m: 6.0, east_m: 12.0, is_north: true, uses: &[(9.0, 12.5, 0.85), (13.5, 18.0, 0.8)] },
    Room { name: "office-3", west_m: 12.0, east_m: 18.0, is_north: true, uses: &[(7.0, 15.0, 0.8)] },
    Room { name: "lab", west_m: 18.0, east_m: 32.0, is_north: true, uses: &[(9.5, 12.0, 0.7), (14.0, 18.5, 0.75)] },
    Room { name: "entrance", west_m: 0.0, east_m: 7.0, is_north: false, uses: &[(8.0, 9.5, 0.6), (17.0, 18.5, 0.6)] },
    Room {
        name: "meeting-room",
        west_m: 7.0,
        east_m: 15.0,
        is_north: false,
        uses: &[(10.0, 11.0, 0.75), (15.0, 16.0, 0.4)],
    },
    Room {
        name: "kitchen",
        west_m: 15.0,
        east_m: 24.0,
        is_north: false,
        uses: &[(8.0, 8.5, 0.3), (12.0, 13.2, 0.95), (15.5, 16.0, 0.5)],
    },
    Room { name: "storage", west_m: 24.0, east_m: 32.0, is_north: false, uses: &[(7.5, 8.0, 0.2), (16.0, 17.0, 0.25)] },
];

/// The places in the corridor, metres from the west.
const CORRIDOR_PLACES_M: [f64; 5] = [3.0, 9.5, 16.0, 22.5, 28.5];
const CORRIDOR_PLACES: [&str; 5] = ["corridor-1", "corridor-2", "corridor-3", "corridor-4", "corridor-5"];

/// Ways between places, each in both directions.
const WAYS: [(&str, &str); 14] = [
    ("corridor-1", "corridor-2"),
    ("corridor-2", "corridor-3"),
    ("corridor-3", "corridor-4"),
    ("corridor-4", "corridor-5"),
    ("entrance", "corridor-1"),
    ("office-1", "corridor-1"),
    ("office-2", "corridor-2"),
    ("meeting-room", "corridor-2"),
    ("office-3", "corridor-3"),
    ("kitchen", "corridor-3"),
    ("kitchen", "corridor-4"),
    ("lab", "corridor-4"),
    ("lab", "corridor-5"),
    ("storage", "corridor-5"),
];

/// A reading of a room or a door.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BuildingReading {
    /// Seconds since midnight.
    pub secs: i64,
    /// The room, or `front-door`.
    pub state: &'static str,
    /// In use, or open.
    pub is_on: bool,
}

/// A drive from a place to the next.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BuildingDrive {
    /// The place it began at.
    pub from: &'static str,
    /// The place it led to.
    pub to: &'static str,
    /// Seconds since midnight when it began.
    pub start_secs: i64,
    /// Seconds since midnight when it ended.
    pub end_secs: i64,
    /// Whether the robot arrived; otherwise the door of the room was closed.
    pub success: bool,
}

/// The floor at a time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FloorPlan {
    /// Cells from west to east.
    pub width: usize,
    /// Cells from south to north.
    pub height: usize,
    /// Whether each cell is occupied, in rows from north to south, each from west to east.
    pub occupied: Vec<bool>,
}

/// A place of the topological map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BuildingPlace {
    /// Name of the place.
    pub name: &'static str,
    /// Metres from the western end.
    pub x_m: f64,
    /// Metres from the southern end.
    pub y_m: f64,
}

/// A day of the building.
#[derive(Debug)]
pub struct BuildingDay {
    seed: u64,
    date: Date,
    /// The uses of each room: from hour, to hour.
    uses: Vec<Vec<(f64, f64)>>,
    front_door: (f64, f64),
}

/// The places: one in each room, and five along the corridor.
#[must_use]
pub fn building_places() -> Vec<BuildingPlace> {
    let of_room = |room: &Room| {
        let y_m = if room.is_north { CORRIDOR_NORTH_M + 2.2 } else { CORRIDOR_SOUTH_M - 1.6 };
        BuildingPlace { name: room.name, x_m: f64::midpoint(room.west_m, room.east_m), y_m }
    };
    let along = CORRIDOR_PLACES.into_iter().zip(CORRIDOR_PLACES_M);
    ROOMS.iter().map(of_room).chain(along.map(|(name, x_m)| BuildingPlace { name, x_m, y_m: 8.4 })).collect()
}

/// The ways between places, each in both directions.
#[must_use]
pub fn building_ways() -> &'static [(&'static str, &'static str)] {
    &WAYS
}

impl BuildingDay {
    /// The day of a date. A different `seed` gives different days, but the same routines.
    #[must_use]
    pub fn new(seed: u64, date: Date) -> BuildingDay {
        let mut rng = draws(seed, DrawTopic::BuildingUse, 0, date);
        let working = if is_working(date) { 1.0 } else { 0.06 };
        let mut of_use = |&(from, to, probable): &(f64, f64, f64)| {
            let shift = (rng.random::<f64>() - 0.5) * 0.7;
            let happens = rng.random::<f64>() < probable * working;
            let longer = (rng.random::<f64>() - 0.5) * 0.5;
            happens.then_some((from + shift, to + shift + longer))
        };
        let uses = ROOMS.iter().map(|room| room.uses.iter().filter_map(&mut of_use).collect()).collect();
        let front_door = (8.0 + rng.random::<f64>() * 0.7, 17.5 + rng.random::<f64>());
        BuildingDay { seed, date, uses, front_door }
    }

    /// The readings of a robot in the day, ascending by time.
    #[must_use]
    pub fn readings(&self) -> Vec<BuildingReading> {
        let mut rng = draws(self.seed, DrawTopic::BuildingReading, 0, self.date);
        let mut readings = Vec::new();
        for begin in (0..DAY_SECS).step_by(READ_EVERY_SECS as usize) {
            let hour = hour_of(begin);
            for (room, of_room) in ROOMS.iter().enumerate() {
                if rng.random::<f64>() < 0.4 {
                    let (secs, is_on) = (begin + rng.random_range(0..500), self.is_used(room, hour));
                    readings.push(BuildingReading { secs, state: of_room.name, is_on });
                }
            }
            if rng.random::<f64>() < 0.5 {
                let is_on = is_working(self.date) && hour > self.front_door.0 && hour < self.front_door.1;
                readings.push(BuildingReading { secs: begin + rng.random_range(0..500), state: "front-door", is_on });
            }
        }
        readings.sort_by_key(|reading| reading.secs);
        readings
    }

    /// The drives of the robot in the day, ascending by time.
    #[must_use]
    pub fn drives(&self) -> Vec<BuildingDrive> {
        let mut rng = draws(self.seed, DrawTopic::BuildingDrive, 0, self.date);
        let places = building_places();
        let place = |name: &str| {
            places.iter().find(|place| place.name == name).map_or((0.0, 0.0), |place| (place.x_m, place.y_m))
        };
        let mut drive = |begin: i64| {
            let hour = hour_of(begin);
            let start_secs = begin + rng.random_range(0..900);
            let way = WAYS[rng.random_range(0..WAYS.len())];
            let (from, to) = if rng.random() { way } else { (way.1, way.0) };
            let room = ROOMS.iter().position(|room| room.name == from || room.name == to);
            let is_lucky = rng.random::<f64>() < 0.5;
            let success = room.is_none_or(|room| {
                ROOMS.get(room).is_some_and(|room| room.name == "entrance") || self.is_used(room, hour) || is_lucky
            });
            let ((x1, y1), (x2, y2)) = (place(from), place(to));
            let speed_m_per_s = if hour > 8.0 && hour < 18.0 { 0.4 } else { 0.6 };
            let end_secs = start_secs + ((x2 - x1).hypot(y2 - y1) / speed_m_per_s).round() as i64;
            BuildingDrive { from, to, start_secs, end_secs, success }
        };
        (0..DAY_SECS).step_by(DRIVE_EVERY_SECS as usize).map(&mut drive).collect()
    }

    /// The floor at a time of the day, in cells of this size.
    #[must_use]
    pub fn floor(&self, secs: i64, cell_m: f64) -> FloorPlan {
        let slot = usize::try_from(secs).unwrap_or(0);
        let mut rng = draws(self.seed, DrawTopic::BuildingFloor, slot, self.date);
        let (hour, mut canvas) = (hour_of(secs), FloorCanvas::new(cell_m));
        canvas.walls();
        for (index, room) in ROOMS.iter().enumerate() {
            self.furnish(index, room, hour, &mut canvas, &mut rng);
        }
        // People in the corridor, and crates that stand there on Monday morning.
        let people = if is_working(self.date) && hour > 7.5 && hour < 18.5 { 5 } else { 0 };
        for _ in 0..people {
            let x = 1.0 + rng.random::<f64>() * (WIDTH_M - 2.0);
            let y = CORRIDOR_SOUTH_M + 0.5 + rng.random::<f64>() * 1.6;
            canvas.fill([x - 0.25, y - 0.25, x + 0.25, y + 0.25], true);
        }
        if hour > 6.0 && hour < 9.5 && self.date.weekday() == jiff::civil::Weekday::Monday {
            canvas.fill([26.0, CORRIDOR_SOUTH_M + 1.6, 29.0, CORRIDOR_NORTH_M - 0.2], true);
        }
        canvas.plan
    }

    /// A room's wall and door, its cupboards along the outer wall, its desks, and the people at them.
    fn furnish(&self, index: usize, room: &Room, hour: f64, canvas: &mut FloorCanvas, rng: &mut SmallRng) {
        let (south, north) = if room.is_north { (CORRIDOR_NORTH_M, HEIGHT_M) } else { (0.0, CORRIDOR_SOUTH_M) };
        canvas.fill([room.east_m - WALL_M, south, room.east_m, north], true);
        let middle = f64::midpoint(room.west_m, room.east_m);
        let door = if room.is_north { CORRIDOR_NORTH_M } else { CORRIDOR_SOUTH_M - WALL_M };
        let is_used = self.is_used(index, hour);
        let is_open = is_used | (rng.random::<f64>() < 0.04);
        canvas.fill([middle - 0.5, door, middle + 0.5, door + WALL_M], !is_open);
        let back = if room.is_north { north - 0.7 } else { 0.2 };
        canvas.fill([room.west_m + 0.4, back, room.east_m - 0.4, back + 0.5], true);
        let desks = ((room.east_m - room.west_m) / 3.0).floor().max(1.0);
        for desk in 0..desks as u32 {
            let x = room.west_m + (f64::from(desk) + 0.5) * (room.east_m - room.west_m) / desks;
            let y = if room.is_north { north - 3.0 } else { 2.4 };
            canvas.fill([x - 0.8, y, x + 0.8, y + 0.8], true);
            let (is_there, dx, dy) = (rng.random::<f64>() < 0.8, rng.random::<f64>(), rng.random::<f64>());
            if is_used && is_there {
                let (px, py) = (x + (dx - 0.5) * 1.6, if room.is_north { y - 0.9 } else { y + 1.5 } + (dy - 0.5) * 0.6);
                canvas.fill([px - 0.3, py - 0.3, px + 0.3, py + 0.3], true);
            }
        }
    }

    fn is_used(&self, room: usize, hour: f64) -> bool {
        self.uses.get(room).is_some_and(|uses| uses.iter().any(|&(from, to)| hour >= from && hour < to))
    }
}

/// A plan that is drawn.
struct FloorCanvas {
    cell_m: f64,
    plan: FloorPlan,
}

impl FloorCanvas {
    fn new(cell_m: f64) -> FloorCanvas {
        let (width, height) = ((WIDTH_M / cell_m).round() as usize, (HEIGHT_M / cell_m).round() as usize);
        FloorCanvas { cell_m, plan: FloorPlan { width, height, occupied: vec![false; width * height] } }
    }

    fn walls(&mut self) {
        for rectangle in [
            [0.0, 0.0, WIDTH_M, WALL_M],
            [0.0, HEIGHT_M - WALL_M, WIDTH_M, HEIGHT_M],
            [0.0, 0.0, WALL_M, HEIGHT_M],
            [WIDTH_M - WALL_M, 0.0, WIDTH_M, HEIGHT_M],
            [0.0, CORRIDOR_SOUTH_M - WALL_M, WIDTH_M, CORRIDOR_SOUTH_M],
            [0.0, CORRIDOR_NORTH_M, WIDTH_M, CORRIDOR_NORTH_M + WALL_M],
        ] {
            self.fill(rectangle, true);
        }
    }

    /// Fills west, south, east, north, metres.
    fn fill(&mut self, rectangle_m: [f64; 4], is_occupied: bool) {
        let FloorPlan { width, height, ref mut occupied } = self.plan;
        let cell = |m: f64, most_cells: usize| ((m / self.cell_m).round().max(0.0) as usize).min(most_cells);
        let [west, south, east, north] = rectangle_m;
        let (columns, rows) = (cell(west, width)..cell(east, width), cell(south, height)..cell(north, height));
        for row in rows {
            let begin = (height - 1 - row) * width;
            if let Some(cells) = occupied.get_mut(begin + columns.start..begin + columns.end.max(columns.start)) {
                cells.fill(is_occupied);
            }
        }
    }
}

fn hour_of(secs: i64) -> f64 {
    secs as f64 / 3_600.0
}

fn is_working(date: Date) -> bool {
    date.weekday().to_monday_zero_offset() < 5
}
