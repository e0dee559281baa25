//! Scans of random tiles: what is sent as differences is what was seen.

use super::*;
use crate::convert::scans::pack_seen;

fn masks(observed: &[u16], occupied: &[u16]) -> TileMasks {
    let mask = |places: &[u16]| {
        let mut mask = Mask::EMPTY;
        places.iter().for_each(|&place| mask.insert(place));
        mask
    };
    TileMasks::new(mask(observed), mask(occupied)).expect("occupied cells are observed")
}

fn tile(x: i32) -> TileIndex {
    TileIndex { x, y: -1, z: 2 }
}

fn full(occupied: Mask) -> TileMasks {
    TileMasks::clipped(Mask::FULL, occupied)
}

#[test]
fn scans_are_sent_as_differences() -> Result<(), TileError> {
    let mut table = TileTable::default();
    let all = full(Mask::EMPTY);
    let first = table.encode(&[(tile(4), masks(&[0, 1, 511], &[511])), (tile(7), all)])?;
    assert_eq!(first.new_tiles, [tile(4), tile(7)]);
    let scan = first.scan;
    assert_eq!(scan.seen, [0, 2]);
    assert_eq!((scan.masked, scan.observed.len(), scan.occupied.len()), (vec![1], 0, 64));
    assert_eq!(scan.observed_flips, [0, 1, 510]);
    assert_eq!(scan.occupied_flips, [511]);

    let again = table.encode(&[(tile(7), all), (tile(4), masks(&[0, 1, 511], &[511]))])?;
    let nothing = EncodedScan { scan: TileScan::default(), new_tiles: vec![], digest: first.digest };
    assert_eq!(again, nothing, "the same again costs nothing");

    let EncodedScan { scan, digest: other, .. } = table.encode(&[(tile(7), full(Mask([2, 0, 0, 0, 0, 0, 0, 0])))])?;
    assert_eq!((scan.seen, scan.observed_flips, scan.occupied_flips), (vec![1, 1], vec![], vec![513]));
    assert_ne!(other, first.digest);
    let back = table.encode(&[(tile(4), masks(&[0, 1, 511], &[511])), (tile(7), all)])?;
    assert_eq!(back.digest, first.digest, "the digest depends on what is seen, not on how it was made");
    Ok(())
}

#[test]
fn the_digest_follows_its_definition() -> Result<(), TileError> {
    let mut table = TileTable::default();
    let (some, all) = (masks(&[5, 64], &[64]), full(Mask::EMPTY));
    let digest = table.encode(&[(tile(4), some), (tile(-3), all)])?.digest;
    let term = |x: i32, masks: TileMasks| {
        let mut bytes: Vec<u8> = [x, -1, 2].iter().flat_map(|coordinate: &i32| coordinate.to_le_bytes()).collect();
        bytes.extend(masks.observed().0.iter().chain(&masks.occupied().0).flat_map(|word| word.to_le_bytes()));
        u64::from(crc32c::crc32c(&bytes)).wrapping_mul(0x9E37_79B9_7F4A_7C15)
    };
    assert_eq!(digest, term(4, some).wrapping_add(term(-3, all)));
    Ok(())
}

#[test]
fn a_follower_of_the_wire_knows_what_was_seen() -> Result<(), TileError> {
    let (mut sender, mut receiver) = (TileTable::default(), TileTable::default());
    let mut follower = TilePicture::default();
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
                let observed: [u64; 8] =
                    std::array::from_fn(|_| !(random() & if round % 7 == 0 { u64::MAX } else { 1 }));
                let occupied = observed.map(|word| word & (random() % 5));
                tiles.push((tile(x), TileMasks::clipped(Mask(observed), Mask(occupied))));
            }
        }
        if tiles.is_empty() {
            continue;
        }
        let EncodedScan { scan, new_tiles, digest } = sender.encode(&tiles)?;
        let new_tiles: Vec<i32> = new_tiles.iter().flat_map(|tile| [tile.x, tile.y, tile.z]).collect();
        receiver.extend(&new_tiles)?;
        assert_eq!(receiver.apply(&scan)?, digest);
        follower.grow(receiver.tiles().len());
        follower.follow(&scan, |_| {});
        assert_eq!(follower.seen().count(), tiles.len());
        for (tile, masks) in tiles {
            let slot = receiver.tiles().iter().position(|&known| known == tile).expect("it is new or known");
            assert_eq!(follower.masks(slot as u32), masks);
            assert_eq!(receiver.picture().masks(slot as u32), masks);
        }
    }
    Ok(())
}

#[test]
fn invalid_scans_are_refused() -> Result<(), TileError> {
    let mut table = TileTable::default();
    let index = TileIndex { x: 1, y: 2, z: 3 };
    assert_eq!(table.apply(&TileScan::default()), Err(TileError::NothingBefore));
    assert_eq!(table.encode(&[]), Err(TileError::NoTile));
    assert_eq!(table.extend(&[1, 2]), Err(TileError::Coordinates(2)));
    table.extend(&[1, 2, 3])?;
    assert_eq!(table.extend(&[1, 2, 3]), Err(TileError::Twice(index)));
    assert_eq!(table.encode(&[(tile(0), masks(&[], &[])); 2]), Err(TileError::Twice(tile(0))));
    let scan = |seen: &[u32]| TileScan { seen: seen.to_vec(), ..TileScan::default() };
    assert_eq!(table.apply(&scan(&[0, 2])), Err(TileError::RunBeyond { first: 0, length: 2, tiles: 1 }));
    assert_eq!(table.apply(&scan(&[0])), Err(TileError::Runs(1)));
    assert_eq!(table.apply(&scan(&[0, 0])), Err(TileError::EmptyRun));
    assert!(matches!(table.apply(&scan(&[u32::MAX, 2])), Err(TileError::RunBeyond { .. })));
    let masked = TileScan { masked: vec![0], occupied: vec![0; 63], ..scan(&[0, 1]) };
    assert_eq!(table.apply(&masked), Err(TileError::Masks { what: "occupied", found: 63, tiles: 1 }));
    let flipped = TileScan { observed_flips: vec![500, 12], ..scan(&[0, 1]) };
    assert_eq!(table.apply(&flipped), Err(TileError::Slot { slot: 1, tiles: 1 }));
    let unsound = TileScan { occupied_flips: vec![7], ..scan(&[0, 1]) };
    assert_eq!(table.apply(&unsound), Err(TileError::OccupiedUnobserved(index)));
    Ok(())
}

#[test]
fn runs_survive_the_wire() -> Result<(), TileError> {
    let slots = [0, 1, 2, 7, 9, 10];
    let packed = pack_seen(slots);
    assert_eq!(packed, [0, 3, 4, 1, 1, 2]);
    let mut runs = Vec::new();
    unpack_runs(&packed, 11, &mut runs)?;
    assert_eq!(runs, runs_of(slots));
    Ok(())
}
