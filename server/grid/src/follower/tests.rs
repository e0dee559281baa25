//! Compares followed cells with all cells of every scan.

use proptest::prelude::*;

use super::*;
use crate::scan::ScanSource;
use crate::tests::{HOUR, apply, empty};

const TILES: u32 = 3;

/// A scan: the tiles that it sees, and for some cells of a tile whether they are observed and occupied.
type Drawn = ([bool; TILES as usize], Vec<(u32, u16, bool, bool)>);

/// The scan as it is logged; changes the current masks of the tiles.
fn logged(number: usize, (seen, cells): &Drawn, shown: &mut [[Mask; 2]]) -> LoggedScan {
    let seen: Arc<[TileId]> = (0..TILES).filter(|&tile| seen[tile as usize]).map(TileId).collect();
    let mut flips = [const { Vec::new() }; 2];
    for &(tile, cell, observed, occupied) in cells {
        if !seen.contains(&TileId(tile)) {
            continue;
        }
        for ((bits, flips), value) in
            shown[tile as usize].iter_mut().zip(&mut flips).zip([observed, observed && occupied])
        {
            if bits.contains(cell) != value {
                bits.flip(cell);
                flips.push(CellRef::new(TileId(tile), cell));
            }
        }
    }
    flips.iter_mut().for_each(|flips| flips.sort_unstable());
    let [observed_flips, occupied_flips] = flips;
    LoggedScan {
        utc_nanos: number as i64 * HOUR,
        offset_secs: 0,
        source: ScanSource::Cells,
        seen: Some(seen),
        observed_flips,
        occupied_flips,
    }
}

fn drawn() -> impl Strategy<Value = Vec<Drawn>> {
    let cell = (0..TILES, 0_u16..6, any::<bool>(), any::<bool>());
    prop::collection::vec((any::<[bool; TILES as usize]>(), prop::collection::vec(cell, 0..12)), 2..20)
}

proptest! {
    #[test]
    fn followed_cells_are_read_as_they_are(mut scans in drawn(), begin in 0.0..1.0_f64, wanted in any::<u32>()) {
        // The last tile is new after the watch began.
        let begin = 1 + (begin * (scans.len() - 1) as f64) as usize;
        scans[..begin].iter_mut().for_each(|(seen, _)| seen[TILES as usize - 1] = false);
        for (_, cells) in &mut scans {
            cells.sort_unstable();
            cells.dedup_by_key(|cell| (cell.0, cell.1));
        }
        let index = |tile: u32| TileIndex { x: i32::try_from(tile).expect("few"), y: 0, z: 0 };
        let place = |bit: u32| (bit % TILES, u16::try_from(bit / TILES).expect("few"));
        let wanted: Vec<(u32, u16)> = (0..18).filter(|bit| wanted >> bit & 1 == 1).map(place).collect();
        let mut shown = [[Mask::EMPTY; 2]; TILES as usize];
        let mut grid = empty();
        let before = scans[..begin].iter().enumerate().map(|(number, scan)| logged(number, scan, &mut shown)).collect();
        apply(&mut grid, &Scans { new_tiles: (0..TILES - 1).map(index).collect(), scans: before, ..Scans::default() });
        let view = GridView::new(&mut grid);
        let cells = wanted.iter().map(|&(tile, cell)| index(tile).cell(cell));
        let mut follower = CellFollower::new(&view, cells);

        let (mut after, mut expected) = (Vec::new(), Vec::new());
        for (number, scan) in scans[begin..].iter().enumerate() {
            after.push(logged(begin + number, scan, &mut shown));
            for tile in (0..TILES).filter(|&tile| scan.0[tile as usize]) {
                let [observed, occupied] = shown[tile as usize];
                for cell in observed.cells().filter(|&cell| wanted.contains(&(tile, cell))) {
                    let is_occupied = occupied.contains(cell);
                    expected.push((number, CellReading { tile: TileId(tile), index: index(tile), cell, is_occupied }));
                }
            }
        }
        let mut found = Vec::new();
        if !after.is_empty() {
            let after = Scans { new_tiles: vec![index(TILES - 1)], scans: after, ..Scans::default() };
            apply(&mut grid, &after);
            follower.pass(&after, |scan, reading| found.push((scan, reading)));
        }
        prop_assert_eq!(found, expected);
    }
}
