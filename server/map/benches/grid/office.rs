//! A simulated office under one robot's eyes all day: cells that change have a daily rhythm and are in one state for 94
//! % of the time.
//!
//! Invariant: the office is identical in each run.

use std::sync::Arc;

use tidemap_grid::{
    index::TileIndex,
    log_head::{LogHead, StreamScan, StreamTiles},
    scan::ScanSource,
    scan::Scans,
    spec::{GridSpec, Retention},
};
use tidemap_map::{
    event::{Envelope, Event, SequenceSpan},
    ids::ProducerId,
    live_map::LiveMap,
    name::{MapName, ProducerKey},
    spec::MapSpec,
    update::UpdateWork,
};

pub(crate) const DAY_NANOS: i64 = 86_400_000_000_000;
pub(crate) const TILES: usize = 416;
pub(crate) const SCANS: usize = 17_200;
/// Cells that change.
pub(crate) const CELLS: usize = 15_000;
/// Changes of a cell on a day.
const CHANGES: usize = 40;
pub(crate) const FLIPS: usize = CELLS * CHANGES;

/// A map with a grid.
pub(crate) fn spec(retention: Retention) -> Arc<MapSpec> {
    Arc::new(MapSpec {
        retention: Retention::None,
        grid: Some(GridSpec { retention, ..GridSpec::new(0.1) }),
        ..MapSpec::new(MapName::new("office").expect("valid"))
    })
}

pub(crate) fn apply(map: &mut LiveMap, event: &Event) -> Option<UpdateWork> {
    map.apply(map.position() + 1, event).expect("consistent")
}

/// The office.
pub(crate) struct Office {
    seed: u64,
    seen: Arc<[u32]>,
}

impl Office {
    pub(crate) fn new() -> Office {
        Office { seed: 1, seen: (0..TILES as u32).collect() }
    }

    fn random(&mut self, below: usize) -> usize {
        self.seed = self.seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.seed >> 33) as usize * below) >> 31
    }

    /// A stream with all tiles in its table.
    pub(crate) fn source() -> StreamTiles {
        let mut source = StreamTiles::default();
        (0..TILES as i32).for_each(|tile| source.push(TileIndex { x: tile % 26, y: tile / 26, z: 0 }));
        source
    }

    /// The scans of a day. Each day begins and ends with all cells that change free.
    pub(crate) fn day(&mut self, day: i64) -> Vec<StreamScan> {
        let mut flips: Vec<Vec<u32>> = vec![Vec::new(); SCANS];
        for number in 0..CELLS {
            let cell = (number % TILES * 512 + (number / TILES) * 14) as u32;
            let busy = SCANS / 8 + number % TILES * 20;
            // The runs of occupied readings are by day rather than by night, and do not touch.
            let mut starts: Vec<usize> = Vec::new();
            while starts.len() < CHANGES / 2 {
                let spread = if self.random(4) == 0 { SCANS } else { SCANS / 4 };
                let start = (busy + self.random(spread)) % (SCANS - 200) + 1;
                if starts.iter().all(|other| other.abs_diff(start) > 100) {
                    starts.push(start);
                }
            }
            for start in starts {
                flips[start].push(cell);
                let length = 10 + self.random(84);
                flips[start + length].push(cell);
            }
        }
        let step = DAY_NANOS / SCANS as i64;
        let all = if day == 0 { (0..TILES as u32 * 512).collect() } else { Vec::new() };
        let first = std::iter::once(all).chain(std::iter::repeat(Vec::new()));
        flips
            .into_iter()
            .zip(first)
            .enumerate()
            .map(|(scan, (mut occupied_flips, observed_flips))| {
                occupied_flips.sort_unstable();
                let utc_nanos = day * DAY_NANOS + scan as i64 * step + self.random(1_000_000_000) as i64;
                StreamScan {
                    utc_nanos,
                    source: ScanSource::Cells,
                    seen: Arc::clone(&self.seen),
                    observed_flips,
                    occupied_flips,
                }
            })
            .collect()
    }

    /// Scans of some tiles, each of which loses sight of three cells of each tile, or sees them again.
    pub(crate) fn flickering_day(&mut self, tiles: usize, scans: usize) -> Vec<StreamScan> {
        let seen: Arc<[u32]> = (0..tiles as u32).collect();
        let step = DAY_NANOS / scans as i64;
        let scan = |scan: usize| {
            let mut cells: Vec<u32> =
                (0..tiles * 3).map(|place| (place / 3 * 512 + place % 3 * 170 + self.random(170)) as u32).collect();
            cells.sort_unstable();
            let (utc_nanos, seen) = (scan as i64 * step + self.random(1_000_000_000) as i64, Arc::clone(&seen));
            StreamScan { utc_nanos, source: ScanSource::Cells, seen, observed_flips: cells, occupied_flips: Vec::new() }
        };
        (0..scans).map(scan).collect()
    }

    /// Scans of some tiles by a robot that comes by on its rounds. Each time it sees the cells on one side of a new
    /// plane. The last scan of a day sees all cells.
    pub(crate) fn patrol_day(
        &mut self,
        day: i64,
        tiles: usize,
        visits: usize,
        scans_per_visit: usize,
    ) -> Vec<StreamScan> {
        let seen: Arc<[u32]> = (0..tiles as u32).collect();
        let mut shown = vec![day > 0; tiles * 512];
        let mut scans = Vec::new();
        for visit in 0..visits {
            for scan in 0..scans_per_visit {
                let is_last = visit + 1 == visits && scan + 1 == scans_per_visit;
                let mut observed_flips = Vec::new();
                if scan == 0 || is_last {
                    for tile in 0..tiles {
                        let normal = [0; 3].map(|_: i64| self.random(201) as i64 - 100);
                        let offset = self.random(800) as i64 - 400;
                        for cell in 0..512 {
                            let place = [cell % 8, cell / 8 % 8, cell / 64].map(|at| at as i64 * 2 - 7);
                            let side: i64 = place.iter().zip(&normal).map(|(at, normal)| at * normal).sum();
                            let is_seen = is_last || side > offset;
                            if std::mem::replace(&mut shown[tile * 512 + cell], is_seen) != is_seen {
                                observed_flips.push((tile * 512 + cell) as u32);
                            }
                        }
                    }
                }
                let since = (visit as i64 * 7200 + scan as i64 * 5) * 1_000_000_000;
                let utc_nanos = day * DAY_NANOS + since + self.random(1_000_000_000) as i64;
                scans.push(StreamScan {
                    utc_nanos,
                    source: ScanSource::Cells,
                    seen: Arc::clone(&seen),
                    observed_flips,
                    occupied_flips: Vec::new(),
                });
            }
        }
        scans
    }

    /// The events that the scans become; the map has applied them.
    pub(crate) fn events(map: &mut LiveMap, sent: &[StreamScan], batch: usize) -> Vec<Event> {
        let key = ProducerKey::new("robot", "").expect("valid");
        let mut front = LogHead::new(map.grid().expect("a grid"));
        let mut source = Office::source();
        let mut events = Vec::new();
        // The masks that the stream showed on the day before.
        if map.position() > 0 {
            let all = (0..TILES as u32 * 512).collect();
            let seen = Arc::clone(&sent[0].seen);
            source.skip(&StreamScan {
                utc_nanos: 0,
                source: ScanSource::Cells,
                seen,
                observed_flips: all,
                occupied_flips: Vec::new(),
            });
        }
        for scans in sent.chunks(batch) {
            let first_sequence = map.producer(&key).map_or(0, |(_, mark)| mark.durable_sequence) + 1;
            let envelope = Envelope {
                producer: ProducerId(0),
                new_producer: (first_sequence == 1).then(|| key.clone().into()),
                incarnation: 1,
                span: SequenceSpan {
                    first: first_sequence,
                    last: first_sequence + scans.len() as u64 - 1,
                    content_crc: 0,
                },
                received_nanos: 100 * DAY_NANOS,
                refused: Vec::new(),
            };
            let mut event = Scans::default();
            for scan in scans {
                let taken = front.take(map.grid().expect("a grid"), 1, &mut source, scan, 0, TILES);
                let taken = taken.expect("room");
                event.new_tiles.extend(taken.new_tiles);
                event.scans.push(taken.scan);
            }
            let event = Event::Scans(envelope, event);
            apply(map, &event);
            events.push(event);
        }
        events
    }
}
