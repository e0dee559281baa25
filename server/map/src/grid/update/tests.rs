//! Tiles that are worked off in several batches.

use std::{collections::HashSet, sync::atomic::AtomicU64};

use super::*;
use crate::{
    event::{Envelope, Event, SequenceSpan, UpdateCause},
    grid::{
        index::TileIndex,
        scan::{CellRef, LoggedScan, Scans},
        tests::world::{HOUR, SMALL, spec},
    },
    ids::ProducerId,
    live_map::LiveMap,
    name::ProducerKey,
    snapshot::MapSnapshot,
};

/// How many different sums the groups of all tiles have.
fn sums(snapshot: &MapSnapshot) -> usize {
    let slots = snapshot.grid.iter().flat_map(|grid| &grid.sums);
    let sums: Vec<Arc<TileSums>> = slots.map(|slot| slot.get().expect("in memory")).collect();
    sums.iter().flat_map(|sums| sums.shared()).map(Arc::as_ptr).collect::<HashSet<_>>().len()
}

/// Scans of one day of a fixed sensor that sees all cells of some tiles, and some of them change.
fn fixed_day(day: i64, tiles: u32) -> Event {
    let scan = |number: i64| LoggedScan {
        utc_nanos: (24 * day + number) * HOUR,
        offset_secs: 0,
        seen: Some((0..tiles).map(TileId).collect()),
        observed_flips: if (day, number) == (0, 0) { (0..tiles * 512).map(CellRef).collect() } else { Vec::new() },
        occupied_flips: (0..tiles).map(|tile| CellRef(tile * 512 + u32::try_from(number).expect("small"))).collect(),
    };
    let new_tiles = (0..i32::try_from(tiles).expect("few")).map(|x| TileIndex { x, y: 0, z: 0 });
    Event::Scans(
        Envelope {
            producer: ProducerId(0),
            new_producer: (day == 0).then(|| ProducerKey::new("camera", "").expect("valid").into()),
            incarnation: 1,
            span: SequenceSpan {
                first: day.cast_unsigned() * 8 + 1,
                last: day.cast_unsigned() * 8 + 8,
                content_crc: 0,
            },
            received_nanos: 24 * (day + 1) * HOUR,
            refused: Vec::new(),
        },
        Scans { new_tiles: if day == 0 { new_tiles.collect() } else { Vec::new() }, scans: (0..8).map(scan).collect() },
    )
}

#[test]
fn tiles_seen_alike_share_their_sums_across_batches() {
    let mut map = LiveMap::new(Arc::new(spec(&mut 1)));
    for day in 0..3 {
        map.apply(map.position() + 1, &fixed_day(day, 12)).expect("consistent");
        let start = map.plan_update(None, 24 * (day + 1) * HOUR, UpdateCause::Request);
        let work = map.apply(map.position() + 1, &Event::UpdateStart(start)).expect("consistent").expect("an update");
        let (progress, states) = (AtomicU64::new(0), work.states());
        let snapshot = map.finish_update(work.with_limits(SMALL).run(&progress).expect("in memory"));
        assert_eq!(progress.into_inner(), states);
        assert_eq!((snapshot.grid.as_ref().map(|grid| grid.sums.len()), sums(&snapshot)), (Some(12), 1), "day {day}");
    }
}
