//! Tests the effect of streams on the log head. The tests of the whole grid check that scans come out as they went in.

use super::*;
use crate::tests::empty;

const TILE: TileIndex = TileIndex { x: 1, y: 2, z: 3 };
const OTHER: TileIndex = TileIndex { x: 0, y: 0, z: 0 };

fn source(tiles: &[TileIndex]) -> StreamTiles {
    let mut source = StreamTiles::default();
    tiles.iter().for_each(|&tile| source.push(tile));
    source
}

fn scan(seen: &Arc<[u32]>, observed: &[u32], occupied: &[u32]) -> StreamScan {
    let (observed_flips, occupied_flips) = (observed.to_vec(), occupied.to_vec());
    StreamScan { utc_nanos: 1, source: ScanSource::Cells, seen: Arc::clone(seen), observed_flips, occupied_flips }
}

#[test]
fn a_tile_twice_in_a_table_is_one_tile_of_the_scan() {
    let grid = &empty();
    let (mut front, mut source) = (LogHead::new(grid), source(&[TILE, TILE]));
    let both = Arc::from([0, 1]);
    // The second slot wins where the masks of the two slots differ.
    for (observed, expected) in [(&[0, 5, 512][..], &[0][..]), (&[519], &[7]), (&[512, 519, 520], &[0, 7, 8])] {
        let taken = front.take(grid, 1, &mut source, &scan(&both, observed, &[]), 0, 9).expect("room");
        let cells: Vec<u32> = taken.scan.observed_flips.iter().map(|cell| cell.0).collect();
        assert_eq!(cells, expected);
        assert!(taken.scan.seen.is_none_or(|seen| *seen == [TileId(0)]));
    }
}

#[test]
fn flips_of_tiles_that_were_not_seen_are_not_handed_on() {
    let grid = &empty();
    let (mut front, mut source) = (LogHead::new(grid), source(&[OTHER, TILE]));
    let (both, one): (Arc<[u32]>, Arc<[u32]>) = (Arc::from([0, 1]), Arc::from([0]));
    front.take(grid, 1, &mut source, &scan(&both, &[3], &[]), 0, 9).expect("room");
    front.take(grid, 1, &mut source, &scan(&one, &[], &[]), 0, 9).expect("room");
    let taken = front.take(grid, 1, &mut source, &scan(&one, &[4, 600], &[4, 9000]), 0, 9).expect("room");
    assert_eq!((taken.scan.seen, taken.scan.observed_flips.len(), taken.scan.occupied_flips.len()), (None, 1, 1));
    // The flips appear when the tile is seen again.
    let taken = front.take(grid, 1, &mut source, &scan(&both, &[], &[]), 0, 9).expect("room");
    assert_eq!(taken.scan.observed_flips, [CellRef(88 + 512 * taken.scan.observed_flips[0].tile().0)]);
}

#[test]
fn too_many_tiles_leave_the_front_as_it_was() {
    let grid = &empty();
    let (mut front, mut source) = (LogHead::new(grid), source(&[OTHER, TILE]));
    let (both, one): (Arc<[u32]>, Arc<[u32]>) = (Arc::from([0, 1]), Arc::from([0]));
    assert_eq!(front.take(grid, 1, &mut source, &scan(&both, &[3, 600], &[3]), 0, 1), Err(TooManyTiles));
    let taken = front.take(grid, 1, &mut source, &scan(&one, &[], &[]), 0, 1).expect("room");
    assert_eq!((taken.new_tiles, taken.scan.observed_flips), (vec![OTHER], vec![CellRef(3)]));
    let taken = front.take(grid, 1, &mut source, &scan(&both, &[], &[]), 0, 2).expect("room");
    assert_eq!((taken.new_tiles, taken.scan.observed_flips), (vec![TILE], vec![CellRef(600)]));
}
