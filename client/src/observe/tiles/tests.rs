//! Scans of random tiles: what is sent as differences is what was seen.

use super::*;
use crate::observe::tiles::packing::runs_from_wire;

fn masks(observed: &[u64], occupied: &[u64]) -> TileMasks {
    let mask = |places: &[u64]| {
        let mut mask = [0; 8];
        places.iter().for_each(|place| mask[(place / 64) as usize] |= 1 << (place % 64));
        mask
    };
    TileMasks { observed: mask(observed), occupied: mask(occupied) }
}

fn seen(x: i32, masks: TileMasks) -> SeenTile {
    SeenTile { tile: [x, -1, 2], masks }
}

const FULL: TileMasks = TileMasks { observed: [u64::MAX; 8], occupied: [0; 8] };

#[test]
fn scans_are_sent_as_differences() -> Result<(), TileError> {
    let mut table = TileTable::default();
    let (new, scan, first) = table.changes(&[seen(4, masks(&[0, 1, 511], &[511])), seen(7, FULL)])?;
    assert_eq!(new, [4, -1, 2, 7, -1, 2]);
    assert_eq!(scan.seen, [0, 2]);
    assert_eq!((scan.masked, scan.observed.len(), scan.occupied.len()), (vec![1], 0, 64));
    assert_eq!(scan.observed_flips, [0, 1, 510]);
    assert_eq!(scan.occupied_flips, [511]);

    let (new, scan, same) = table.changes(&[seen(7, FULL), seen(4, masks(&[0, 1, 511], &[511]))])?;
    assert_eq!((new, scan, same), (vec![], TileScan::default(), first), "the same again costs nothing");

    let (_, scan, other) = table.changes(&[seen(7, TileMasks { occupied: [2, 0, 0, 0, 0, 0, 0, 0], ..FULL })])?;
    assert_eq!((scan.seen, scan.observed_flips, scan.occupied_flips), (vec![1, 1], vec![], vec![513]));
    assert_ne!(other, first);
    let (_, _, back) = table.changes(&[seen(4, masks(&[0, 1, 511], &[511])), seen(7, FULL)])?;
    assert_eq!(back, first, "the digest says what is seen, not how it came to be");
    Ok(())
}

#[test]
fn the_digest_follows_its_definition() -> Result<(), TileError> {
    let mut table = TileTable::default();
    let tile = masks(&[5, 64], &[64]);
    let (.., digest) = table.changes(&[seen(4, tile), seen(-3, FULL)])?;
    let term = |x: i32, masks: TileMasks| {
        let mut bytes: Vec<u8> = [x, -1, 2].iter().flat_map(|coordinate: &i32| coordinate.to_le_bytes()).collect();
        bytes.extend(masks.observed.iter().chain(&masks.occupied).flat_map(|word| word.to_le_bytes()));
        u64::from(crc32c::crc32c(&bytes)).wrapping_mul(0x9E37_79B9_7F4A_7C15)
    };
    assert_eq!(digest, term(4, tile).wrapping_add(term(-3, FULL)));
    Ok(())
}

#[test]
fn whoever_follows_the_wire_knows_what_was_seen() -> Result<(), TileError> {
    let (mut sender, mut receiver, mut follower) = (TileTable::default(), TileTable::default(), Shown::default());
    let mut bits = 1_u64;
    let mut random = || {
        bits = bits.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        bits >> 33
    };
    for round in 0..300 {
        let mut tiles = Vec::new();
        for x in 0..20 {
            if random() % 3 > 0 {
                // Few changes in most rounds, many in some.
                let observed: Mask = std::array::from_fn(|_| !(random() & if round % 7 == 0 { u64::MAX } else { 1 }));
                let occupied = observed.map(|word| word & (random() % 5));
                tiles.push(seen(x, TileMasks { observed, occupied }));
            }
        }
        if tiles.is_empty() {
            continue;
        }
        let (new, scan, digest) = sender.changes(&tiles)?;
        receiver.extend(&new)?;
        assert_eq!(receiver.apply(&scan)?, digest);
        follower.grow(receiver.tiles().len());
        follower.follow(&scan, |_| {});
        assert_eq!(follower.seen().iter().map(|run| run.slots().len()).sum::<usize>(), tiles.len());
        for SeenTile { tile, masks } in tiles {
            let slot = receiver.tiles().iter().position(|&known| known == tile).expect("it is new or known");
            assert_eq!(follower.masks(slot as u32), masks);
            assert_eq!(receiver.shown().masks(slot as u32), masks);
        }
    }
    Ok(())
}

#[test]
fn what_makes_no_sense_is_told() -> Result<(), TileError> {
    let mut table = TileTable::default();
    assert_eq!(table.apply(&TileScan::default()), Err(TileError::NothingBefore));
    assert_eq!(table.extend(&[1, 2]), Err(TileError::Coordinates(2)));
    table.extend(&[1, 2, 3])?;
    assert_eq!(table.extend(&[1, 2, 3]), Err(TileError::Twice([1, 2, 3])));
    let scan = |seen: &[u32]| TileScan { seen: seen.to_vec(), ..TileScan::default() };
    assert_eq!(table.apply(&scan(&[0, 2])), Err(TileError::Slot { slot: 1, tiles: 1 }));
    assert_eq!(table.apply(&scan(&[0])), Err(TileError::Runs(1)));
    assert_eq!(table.apply(&scan(&[0, 0])), Err(TileError::EmptyRun));
    assert!(matches!(table.apply(&scan(&[u32::MAX, 2])), Err(TileError::Slot { .. })));
    let masked = TileScan { masked: vec![0], occupied: vec![0; 63], ..scan(&[0, 1]) };
    assert_eq!(table.apply(&masked), Err(TileError::Masks { what: "occupied", found: 63, tiles: 1 }));
    let flipped = TileScan { observed_flips: vec![500, 12], ..scan(&[0, 1]) };
    assert_eq!(table.apply(&flipped), Err(TileError::Slot { slot: 1, tiles: 1 }));
    let unsound = TileScan { occupied_flips: vec![7], ..scan(&[0, 1]) };
    assert_eq!(table.apply(&unsound), Err(TileError::OccupiedUnobserved([1, 2, 3])));
    let unsound = seen(1, TileMasks { observed: [0; 8], occupied: [1; 8] });
    assert_eq!(table.changes(&[unsound]), Err(TileError::OccupiedUnobserved([1, -1, 2])));
    Ok(())
}

#[test]
fn runs_survive_the_wire() -> Result<(), TileError> {
    let runs = runs_of([0, 1, 2, 7, 9, 10].into_iter());
    assert_eq!(runs_to_wire(&runs), [0, 3, 4, 1, 1, 2]);
    assert_eq!(runs_from_wire(&runs_to_wire(&runs))?, Some(runs));
    assert_eq!(runs_from_wire(&[])?, None);
    Ok(())
}
