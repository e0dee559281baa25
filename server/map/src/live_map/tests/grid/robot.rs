//! A robot that looks at tiles and streams the tiles that it sees.
//!
//! Invariant: a robot sends the difference from its last message about the same tile, whether that message was accepted
//! or not.

use std::sync::Arc;
use tidemap_grid::{
    index::TileIndex,
    log_head::{StreamScan, StreamTiles},
    mask::{Mask, TileMasks},
    scan::ScanSource,
    sensors::ProducerSensor,
};

use crate::name::ProducerKey;

/// Tiles of the world.
const TILES: [TileIndex; 3] =
    [TileIndex { x: 0, y: 0, z: 0 }, TileIndex { x: -1, y: 0, z: 2 }, TileIndex { x: 5, y: -5, z: 0 }];
/// Cells that change.
const CELLS: [u16; 8] = [0, 1, 63, 64, 65, 200, 447, 511];
/// Cells that are observed now and then; the first is always free, the others are always occupied.
const STEADY: [u16; 3] = [300, 301, 302];

/// Sensors that robots may have.
pub(crate) const SENSORS: [ProducerSensor; 3] = [
    ProducerSensor { hit: 0.6, false_alarm: 0.3 },
    ProducerSensor { hit: 0.97, false_alarm: 0.002 },
    ProducerSensor { hit: 0.83, false_alarm: 0.07 },
];

/// A random number below `below`.
pub(crate) fn random(rng: &mut u64, below: usize) -> usize {
    // The generator is SplitMix64.
    *rng = rng.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mixed = (*rng ^ *rng >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    (((u128::from(mixed ^ mixed >> 31)) * below as u128) >> 64) as usize
}

/// The tiles that a robot saw.
#[derive(Clone, Debug)]
pub(crate) struct Seen {
    pub(crate) robot: usize,
    pub(crate) utc_nanos: i64,
    /// The tiles by slot.
    pub(crate) tiles: Vec<(TileIndex, TileMasks)>,
}

/// A robot and its stream.
pub(crate) struct Robot {
    pub(crate) key: ProducerKey,
    /// The sensor that the robot announces.
    pub(crate) sensor: Option<ProducerSensor>,
    pub(crate) source: StreamTiles,
    table: Vec<TileIndex>,
    /// The masks that the robot has sent of each tile of its table.
    shown: Vec<TileMasks>,
    sent: Option<Arc<[u32]>>,
    /// The tiles that the robot sees now.
    sight: Vec<(TileIndex, TileMasks)>,
    looks_at: usize,
}

impl Robot {
    pub(crate) fn new(id: usize, sensor: Option<ProducerSensor>, rng: &mut u64) -> Robot {
        let mut sight: Vec<_> = TILES.map(|tile| (tile, TileMasks::default())).into();
        let turn = random(rng, TILES.len());
        sight.rotate_left(turn);
        Robot {
            key: ProducerKey::new(&format!("robot{id}"), "").expect("valid"),
            sensor,
            source: StreamTiles::default(),
            table: Vec::new(),
            shown: Vec::new(),
            sent: None,
            sight,
            looks_at: 1,
        }
    }

    /// Looks again: the robot sees masks that differ a little from before.
    pub(crate) fn observe(&mut self, robot: usize, utc_nanos: i64, rng: &mut u64) -> Seen {
        if random(rng, 3) == 0 {
            self.looks_at = random(rng, 1 << TILES.len());
        }
        let mut tiles = Vec::new();
        for (slot, (tile, masks)) in self.sight.iter_mut().enumerate() {
            if self.looks_at >> slot & 1 == 0 {
                continue;
            }
            let (mut observed, mut occupied) = (masks.observed(), masks.occupied());
            match random(rng, 8) {
                0..4 => {}
                4 => observed = observed | cells(&CELLS) | cells(&STEADY),
                5 => observed = [Mask::EMPTY, cells(&STEADY), cells(&CELLS[..3])][random(rng, 3)],
                6 => (0..random(rng, 4)).for_each(|_| observed.flip(CELLS[random(rng, CELLS.len())])),
                _ => (0..random(rng, 4)).for_each(|_| occupied.flip(CELLS[random(rng, CELLS.len())])),
            }
            // The steady cells never change.
            let moving = (occupied | cells(&CELLS[..1])).without(cells(&STEADY));
            let moving = if random(rng, 3) == 0 { moving } else { occupied.without(cells(&STEADY)) };
            *masks = TileMasks::clipped(observed, moving | cells(&STEADY[1..]));
            tiles.push((*tile, *masks));
        }
        Seen { robot, utc_nanos, tiles }
    }

    /// Sends the tiles seen in the form of a stream.
    pub(crate) fn send(&mut self, seen: &Seen) -> StreamScan {
        let mut tiles: Vec<(u32, TileMasks)> = Vec::new();
        for &(tile, masks) in &seen.tiles {
            let slot = self.table.iter().position(|known| *known == tile).unwrap_or_else(|| {
                self.table.push(tile);
                self.shown.push(TileMasks::default());
                self.source.push(tile);
                self.table.len() - 1
            });
            tiles.push((u32::try_from(slot).expect("few"), masks));
        }
        tiles.sort_by_key(|(slot, _)| *slot);
        let slots: Vec<u32> = tiles.iter().map(|(slot, _)| *slot).collect();
        let slots = match &self.sent {
            Some(before) if **before == *slots => Arc::clone(before),
            _ => Arc::from(slots),
        };
        self.sent = Some(Arc::clone(&slots));
        let (mut observed_flips, mut occupied_flips) = (Vec::new(), Vec::new());
        for (slot, masks) in tiles {
            let shown = std::mem::replace(&mut self.shown[slot as usize], masks);
            let at = |cell: u16| slot * 512 + u32::from(cell);
            observed_flips.extend((shown.observed() ^ masks.observed()).cells().map(at));
            occupied_flips.extend((shown.occupied() ^ masks.occupied()).cells().map(at));
        }
        StreamScan { utc_nanos: seen.utc_nanos, source: ScanSource::Cells, seen: slots, observed_flips, occupied_flips }
    }
}

fn cells(cells: &[u16]) -> Mask {
    Mask::EMPTY.flipped(cells.iter().copied())
}
