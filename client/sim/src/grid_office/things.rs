//! The things that change, and the cells that each thing fills in each pose.
//!
//! Invariant: a cell belongs to at most one thing, a thing's cells are never solid, and the number of changing cells
//! is exactly the number requested.

use super::{
    dice::{Dice, DiceTopic},
    floor::{BAY, CORRIDOR_WALL, DOOR, Floor, FloorRoom, TILE_CELLS},
    shapes::{DOOR_WIDTH, shape},
    thing_kind::ThingKind,
};

/// Something that changes.
#[derive(Clone, Debug)]
pub(crate) struct Thing {
    pub(crate) kind: ThingKind,
    /// The people whose routines it follows, at least one.
    pub(crate) people: Vec<u32>,
}

/// A cell that changes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ChangingCell {
    /// `slot * 512 + cell`.
    pub(crate) address: u32,
    /// Index of its thing.
    pub(crate) thing: u32,
    /// Bit p: filled in pose p of the thing.
    pub(crate) poses: u16,
}

/// Everything that changes.
#[derive(Clone, Debug)]
pub(crate) struct Inventory {
    pub(crate) things: Vec<Thing>,
    /// By address.
    pub(crate) cells: Vec<ChangingCell>,
    /// Number of people, at least 1.
    pub(crate) people: u32,
}

/// Share of the changing cells in percent, and about how many cells one thing has. The rest are edges.
const CLASSES: [(ThingKind, u32, usize); 8] = [
    (ThingKind::Workplace, 36, 600),
    (ThingKind::Belongings, 3, 60),
    (ThingKind::Door, 6, 360),
    (ThingKind::Curtain, 4, 430),
    (ThingKind::Way, 14, 900),
    (ThingKind::Kitchen, 8, 1300),
    (ThingKind::Meeting, 7, 1000),
    (ThingKind::Parcel, 2, 64),
];

/// Share of the edges that change with the daylight, in percent.
const DAYLIGHT_EDGES: u32 = 40;

/// A room by its index, and which of several places in it.
type RoomSpot = (usize, u32);

/// The place of the bits of a cell: slot, word, and the bit in it.
pub(crate) fn locate(address: u32) -> (usize, usize, u64) {
    let cell = address % TILE_CELLS;
    ((address / TILE_CELLS) as usize, (cell / 64) as usize, 1 << (cell % 64))
}

struct Builder<'a> {
    floor: &'a Floor,
    solid: &'a [[u64; 8]],
    changing: Vec<[u64; 8]>,
    things: Vec<Thing>,
    cells: Vec<ChangingCell>,
    /// The workplace of each person.
    desks: Vec<RoomSpot>,
}

/// Places things until `wanted` cells change. `solid` has the solid cells, by slot.
pub(crate) fn place(seed: u64, floor: &Floor, solid: &[[u64; 8]], wanted: u32) -> Inventory {
    let changing = vec![[0; 8]; solid.len()];
    let mut builder = Builder { floor, solid, changing, things: Vec::new(), cells: Vec::new(), desks: Vec::new() };
    let rooms = floor.rooms();
    for (kind, percent, size) in CLASSES {
        let quota = (u64::from(wanted) * u64::from(percent) / 100) as usize;
        builder.place_class(kind, &rooms, quota, size);
    }
    builder.place_edges(seed, wanted as usize);
    let mut cells = builder.cells;
    cells.sort_unstable_by_key(|cell| cell.address);
    Inventory { things: builder.things, cells, people: (builder.desks.len() as u32).max(1) }
}

/// The indices below `count`, so that the first `first` are spread evenly.
fn spread(count: usize, first: usize) -> impl Iterator<Item = usize> {
    let step = (count / first.max(1)).max(1);
    (0..step).flat_map(move |offset| (offset..count).step_by(step))
}

impl Builder<'_> {
    fn place_class(&mut self, kind: ThingKind, rooms: &[FloorRoom], quota: usize, size: usize) {
        let sites = self.sites(kind, rooms);
        let full = self.cells.len() + quota;
        for index in spread(sites.len(), quota.div_ceil(size)) {
            let site @ (room, place) = sites[index];
            let before = self.cells.len();
            let (x, y) = corner(kind, rooms[room], place);
            for ((dx, dy, z), poses) in shape(kind).into_cells() {
                let address = self.floor.address(x + dx, y + dy, z);
                if let Some(address) = address.filter(|_| self.cells.len() < full) {
                    self.take_free(address, poses);
                }
            }
            if self.cells.len() == before {
                continue;
            }
            let people = match kind {
                ThingKind::Workplace => vec![self.desks.len() as u32],
                // The sites of belongings are the desks.
                ThingKind::Belongings => vec![index as u32],
                _ => self.people_of(kind, room),
            };
            if kind == ThingKind::Workplace {
                self.desks.push(site);
            }
            self.things.push(Thing { kind, people });
        }
    }

    /// The possible places of a kind of thing.
    fn sites(&self, kind: ThingKind, rooms: &[FloorRoom]) -> Vec<RoomSpot> {
        let places = match kind {
            ThingKind::Belongings => return self.desks.clone(),
            ThingKind::Workplace => 6,
            ThingKind::Way => 2,
            ThingKind::Parcel => 4,
            _ => 1,
        };
        let fits = |room: &FloorRoom| match kind {
            ThingKind::Workplace => !room.common,
            ThingKind::Kitchen | ThingKind::Meeting => room.common,
            _ => true,
        };
        let fitting = (0..rooms.len()).filter(|&room| fits(&rooms[room]));
        fitting.flat_map(|room| (0..places).map(move |place| (room, place))).collect()
    }

    /// The people that a thing in a room has to do with.
    fn people_of(&self, kind: ThingKind, room: usize) -> Vec<u32> {
        let people = (self.desks.len() as u32).max(1);
        let first = self.things.len() as u32;
        let some = |count: u32| (0..count.min(people)).map(|nth| (first + nth) % people).collect();
        let own: Vec<u32> =
            (0..).zip(&self.desks).filter(|(_, desk)| desk.0 == room).map(|(person, _)| person).collect();
        match kind {
            ThingKind::Door | ThingKind::Curtain if !own.is_empty() => own,
            ThingKind::Kitchen | ThingKind::Meeting => some(12),
            ThingKind::Way => some(2),
            _ => some(3),
        }
    }

    /// Makes a cell change with the thing that is placed next, if it is free.
    fn take_free(&mut self, address: u32, poses: u16) {
        let (slot, word, bit) = locate(address);
        if (self.solid[slot][word] | self.changing[slot][word]) & bit == 0 {
            self.changing[slot][word] |= bit;
            self.cells.push(ChangingCell { address, thing: self.things.len() as u32, poses });
        }
    }

    /// Makes cells change beside steps from free to solid, in upright runs.
    fn place_edges(&mut self, seed: u64, wanted: usize) {
        let first = self.things.len() as u32;
        let edges = [ThingKind::Edge, ThingKind::DaylightEdge].map(|kind| Thing { kind, people: vec![0] });
        self.things.extend(edges);
        let mut dice = Dice::new(seed, DiceTopic::Edges, 0, 0);
        for _ in 0..wanted * 100 {
            let (slot, bit) = (dice.below(self.floor.tiles()), dice.below(63));
            let thing = first + u32::from(dice.chance(DAYLIGHT_EDGES));
            for word in 0..8 {
                let plane = self.solid[slot as usize][word] >> bit;
                if self.cells.len() < wanted && (plane ^ plane >> 1) & 1 == 1 {
                    self.take_edge(slot * TILE_CELLS + word as u32 * 64 + bit, thing);
                }
            }
            if self.cells.len() == wanted {
                return;
            }
        }
        // More than there are edges: any cell will do.
        for address in 0..self.floor.tiles() * TILE_CELLS {
            if self.cells.len() < wanted {
                self.take_edge(address, first + address / 64 % 2);
            }
        }
    }

    /// Makes a cell that is not part of another thing change as an edge.
    fn take_edge(&mut self, address: u32, thing: u32) {
        let (slot, word, bit) = locate(address);
        if self.changing[slot][word] & bit == 0 {
            self.changing[slot][word] |= bit;
            let filled = self.solid[slot][word] & bit != 0;
            self.cells.push(ChangingCell { address, thing, poses: u16::from(filled) });
        }
    }
}

/// Corner of a thing in a room, in cells.
fn corner(kind: ThingKind, room: FloorRoom, place: u32) -> (u32, u32) {
    let (x, y) = match kind {
        ThingKind::Workplace | ThingKind::Belongings => (1 + place % 3 * BAY.0, 1 + place / 3 * BAY.1),
        ThingKind::Door => (DOOR.start, CORRIDOR_WALL - DOOR_WIDTH),
        ThingKind::Curtain => (4, 1),
        ThingKind::Way => (6, CORRIDOR_WALL + 5 + place * 6),
        ThingKind::Kitchen => (3, 9),
        ThingKind::Meeting => (15, 22),
        ThingKind::Parcel | ThingKind::Edge | ThingKind::DaylightEdge => (22 + place * 6, CORRIDOR_WALL + 1),
    };
    (room.x + x, room.y + y)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    fn placed(tiles: u32, wanted: u32) -> Inventory {
        let floor = Floor::new(tiles);
        let solid: Vec<_> = (0..tiles).map(|slot| floor.solid(slot)).collect();
        place(1, &floor, &solid, wanted)
    }

    #[test]
    fn as_many_cells_change_as_were_requested_each_once() {
        for (tiles, wanted) in [(1, 60), (8, 100), (417, 15_000), (417, 26_000), (2000, 15_000)] {
            let inventory = placed(tiles, wanted);
            assert_eq!(inventory.cells.len(), wanted as usize);
            let addresses: BTreeSet<_> = inventory.cells.iter().map(|cell| cell.address).collect();
            assert_eq!(addresses.len(), wanted as usize);
            assert!(inventory.cells.iter().all(|cell| inventory.things.len() > cell.thing as usize));
            assert!(inventory.things.iter().flat_map(|thing| &thing.people).all(|&person| person < inventory.people));
        }
    }

    #[test]
    fn an_office_of_the_published_size_has_things_of_every_kind() {
        let inventory = placed(417, 15_000);
        for (kind, percent, _) in CLASSES {
            let of_kind = |cell: &&ChangingCell| inventory.things[cell.thing as usize].kind == kind;
            let cells = inventory.cells.iter().filter(of_kind).count();
            assert!(cells >= 100 * percent as usize, "{kind:?}: {cells} cells");
        }
    }
}
