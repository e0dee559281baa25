//! Encoded scans are decoded, in whatever pieces they travel.

use std::{collections::BTreeMap, sync::Arc};

use prost::Message as _;

use super::*;

type Tiles = BTreeMap<(i32, i32, i32), (Mask, Mask)>;

/// A small generator of numbers, the same in every run.
struct Dice(u64);

impl Dice {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        self.0 >> 33
    }

    fn below(&mut self, bound: u64) -> u64 {
        self.next() % bound
    }
}

fn random_scan(dice: &mut Dice, is_flat: bool, before: &Tiles) -> Vec<(TileIndex, TileMasks)> {
    let layer = if is_flat { Mask([u64::MAX, 0, 0, 0, 0, 0, 0, 0]) } else { Mask::FULL };
    let word = |dice: &mut Dice| dice.next() << 40 ^ dice.next() << 20 ^ dice.next();
    let mut tiles = Vec::new();
    for x in 0..7 {
        if dice.below(4) == 0 {
            continue;
        }
        let at = (x - 3, 2 - x, if is_flat { 0 } else { x % 2 });
        let (observed, occupied) = before.get(&at).copied().unwrap_or((Mask::EMPTY, Mask::EMPTY));
        let masks = match dice.below(5) {
            0 => TileMasks::clipped(observed, occupied),
            1 => TileMasks::clipped(layer, Mask(std::array::from_fn(|_| word(dice))) & layer),
            2 => {
                let observed = Mask(std::array::from_fn(|_| word(dice))) & layer;
                TileMasks::clipped(observed, Mask(std::array::from_fn(|_| word(dice))))
            }
            _ => {
                let (mut observed, mut occupied) = (observed, occupied);
                for _ in 0..dice.below(6) {
                    observed.flip(dice.below(64) as u16);
                    occupied.flip(dice.below(if is_flat { 64 } else { 512 }) as u16);
                }
                TileMasks::clipped(observed, occupied)
            }
        };
        tiles.push((index(at.0, at.1, at.2), masks));
    }
    tiles
}

/// Puts decoded scans back together.
#[derive(Default)]
struct Picture {
    table: Vec<TileIndex>,
    tiles: Tiles,
}

impl Picture {
    fn show(&mut self, scan: &StreamScan) -> Vec<(TileIndex, TileMasks)> {
        for (flips, is_observed) in [(&scan.observed_flips, true), (&scan.occupied_flips, false)] {
            assert!(flips.is_sorted());
            for flip in flips {
                let index = self.table[(flip / 512) as usize];
                let masks = self.tiles.entry((index.x, index.y, index.z)).or_default();
                if is_observed { &mut masks.0 } else { &mut masks.1 }.flip((flip % 512) as u16);
            }
        }
        let shown = scan.seen.iter().map(|&slot| {
            let index = self.table[slot as usize];
            let (observed, occupied) = self.tiles.get(&(index.x, index.y, index.z)).copied().unwrap_or_default();
            (index, TileMasks::new(observed, occupied).expect("occupied cells are observed"))
        });
        let mut shown: Vec<_> = shown.collect();
        shown.sort_by_key(|(index, _)| *index);
        shown
    }
}

fn by_hand(tiles: &[(TileIndex, TileMasks)]) -> u64 {
    let of_tile = |(index, masks): &(TileIndex, TileMasks)| {
        let mut bytes = Vec::new();
        for along in [index.x, index.y, index.z] {
            bytes.extend(along.to_le_bytes());
        }
        for mask in [masks.observed(), masks.occupied()] {
            for byte in 0..64u16 {
                bytes.push((0..8u16).map(|bit| u8::from(mask.contains(byte * 8 + bit)) << bit).sum());
            }
        }
        0x9E37_79B9_7F4A_7C15u64.wrapping_mul(u64::from(crc32c::crc32c(&bytes)))
    };
    tiles.iter().map(of_tile).fold(0, u64::wrapping_add)
}

fn check(is_flat: bool, max_bytes: usize) {
    let mut dice = Dice(7 + max_bytes as u64);
    let spec = spec(is_flat);
    let (mut decoder, mut encoder) = (decoder(&spec), TileTable::default());
    let mut picture = Picture::default();
    let mut known = Tiles::new();
    let mut sequence = 1;
    for _ in 0..30 {
        let (mut scans, mut expected, mut times) = (Vec::new(), Vec::new(), Vec::new());
        for i in 0..dice.below(9) + 1 {
            let tiles = random_scan(&mut dice, is_flat, &known);
            if tiles.is_empty() {
                continue;
            }
            let encoded = encoder.encode(&tiles).expect("no tile twice");
            for (index, masks) in &tiles {
                known.insert((index.x, index.y, index.z), (masks.observed(), masks.occupied()));
            }
            assert_eq!(encoded.digest, by_hand(&tiles));
            expected.push((encoded.digest, tiles));
            times.push(1_000 * sequence as i64 + 50 * i as i64);
            scans.push(encoded);
        }
        let mut decoded = Vec::new();
        for piece in split(batch(sequence, &times, scans), max_bytes) {
            let bytes = piece.encode_to_vec();
            assert!(bytes.len() <= max_bytes, "{} bytes", bytes.len());
            let piece = v1::ScanBatch::decode(bytes.as_slice()).expect("a message");
            picture.table.extend(decoder.begin(sent_message(piece)).expect("well formed"));
            while let Some(scan) = decoder.next_scan().expect("well formed") {
                decoded.push(scan);
            }
        }
        assert_eq!(decoded.len(), expected.len());
        for ((scan, (digest, tiles)), time) in decoded.iter().zip(&mut expected).zip(&times) {
            assert_eq!((scan.sequence, scan.utc_nanos, scan.digest), (sequence, *time, *digest));
            tiles.sort_by_key(|(index, _)| *index);
            let shown = match &scan.content {
                Some(ScanContent::Tiles(scan)) => picture.show(scan),
                other => panic!("{other:?}"),
            };
            assert_eq!(&shown, tiles);
            let is_empty = tiles.iter().all(|(_, masks)| masks.observed().is_empty());
            assert_eq!(scan.refusal.as_ref().map(|refusal| refusal.reason), is_empty.then_some(RefusalReason::Empty));
            sequence += 1;
        }
    }
}

#[test]
fn scans_survive_the_wire() {
    for max_bytes in [1 << 20, 4096] {
        check(false, max_bytes);
        check(true, max_bytes);
    }
}

#[test]
fn a_scan_and_a_table_of_any_size_are_cut_to_the_size_of_messages() {
    let mut dice = Dice(3);
    let tiles: Vec<_> = (0..900)
        .map(|x| (index(x, -x, 5), TileMasks::clipped(Mask::FULL, Mask(std::array::from_fn(|_| dice.next())))))
        .collect();
    let mut encoder = TileTable::default();
    let encoded = encoder.encode(&tiles).expect("tiles");
    let digest = encoded.digest;
    assert!(encoded.scan.observed.is_empty());
    let pieces = split(batch(1, &[5], vec![encoded]), 4096);
    assert!(pieces.len() > 15);
    let mut decoder = decoder(&spec(false));
    let (mut decoded, mut parts) = (Vec::new(), 0);
    for piece in pieces {
        assert!(piece.encoded_len() <= 4096);
        parts += usize::from(piece.continues);
        decoded.extend(all(&mut decoder, piece).expect("well formed"));
    }
    assert!(parts > 0 && decoder.open_sequence().is_none());
    assert_eq!(decoded.iter().map(|scan| (scan.sequence, scan.digest)).collect::<Vec<_>>(), [(1, digest)]);
    assert_eq!(sent(&decoded[0]).observed_flips.len(), 900 * 512);
}

#[test]
fn the_smaller_form_is_sent() {
    let mut encoder = TileTable::default();
    let full = TileMasks::clipped(Mask::FULL, mask(&[3]));
    let first = encoder.encode(&[(index(0, 0, 0), full)]).expect("a tile");
    assert_eq!((first.scan.masked.as_slice(), first.scan.observed.len()), ([0].as_slice(), 0));
    let changed = TileMasks::clipped(Mask::FULL, mask(&[3, 9, 500]));
    let second = encoder.encode(&[(index(0, 0, 0), changed)]).expect("a tile");
    assert_eq!(second.scan, v1::TileScan { occupied_flips: vec![9, 491], ..v1::TileScan::default() });
    let shown =
        [(index(0, 0, 0), TileMasks::clipped(Mask::FULL, mask(&[3, 500]))), (index(4, 0, 0), masks(&[7], &[7]))];
    let third = encoder.encode(&shown).expect("tiles");
    let (seen, observed_flips, occupied_flips) = (vec![0, 2], vec![512 + 7], vec![9, 510]);
    let flips = v1::TileScan { seen, observed_flips, occupied_flips, ..v1::TileScan::default() };
    assert_eq!((third.new_tiles.as_slice(), third.scan), ([index(4, 0, 0)].as_slice(), flips));
    assert_eq!(third.digest, by_hand(&shown));
    assert_eq!(encoder.encode(&[]), Err(TileError::NoTile));
}

#[test]
fn like_scans_share_what_they_saw() {
    let mut decoder = decoder(&spec(false));
    let scans = vec![flips(&[0, 2], &[1, 513], &[1]), flips(&[], &[], &[1]), flips(&[0, 1, 0, 1], &[], &[513])];
    let scans = all(&mut decoder, message(1, &[0, 0, 0, 1, 0, 0], scans)).expect("well formed");
    assert!(scans.iter().all(|scan| scan.refusal.is_none() && Arc::ptr_eq(&sent(scan).seen, &sent(&scans[0]).seen)));
    let other = all(&mut decoder, message(4, &[], vec![flips(&[1, 1], &[], &[])])).expect("well formed");
    assert_eq!(&*sent(&other[0]).seen, [1]);
    assert_eq!(other[0].digest, by_hand(&[(index(1, 0, 0), masks(&[1], &[1]))]));
}

#[test]
fn cells_beyond_the_extent_are_cut_off() {
    let extent = CellBox { min: CellIndex { x: 2, y: 0, z: 0 }, max: CellIndex { x: 8, y: 8, z: 8 } };
    let spec = GridSpec { extent: Some(extent), ..spec(false) };
    let mut decoder = decoder(&spec);
    let scans = vec![flips(&[0, 2], &[0, 2, 600], &[2]), flips(&[1, 1], &[601], &[]), flips(&[0, 1], &[2], &[2])];
    let scans = all(&mut decoder, message(1, &[0, 0, 0, 1, 0, 0], scans)).expect("well formed");
    assert_eq!(sent(&scans[0]).observed_flips, [2]);
    assert_eq!((&*sent(&scans[0]).seen, &scans[0].refusal), ([0].as_slice(), &None));
    let shown = [(index(0, 0, 0), masks(&[0, 2], &[2])), (index(1, 0, 0), masks(&[88], &[]))];
    assert_eq!(scans[0].digest, by_hand(&shown), "of what was sent");
    let reasons: Vec<_> = scans.iter().filter_map(|scan| scan.refusal.as_ref().map(|r| r.reason)).collect();
    assert_eq!(reasons, [RefusalReason::Empty; 2]);
    assert_eq!(sent(&scans[2]).observed_flips, [2], "to be remembered");
    let masked = v1::TileScan {
        seen: vec![0, 1],
        masked: vec![0],
        occupied: mask(&[1, 3]).to_bytes().to_vec(),
        ..v1::TileScan::default()
    };
    let scans = all(&mut decoder, message(4, &[], vec![Content::Tiles(masked)])).expect("well formed");
    assert_eq!(sent(&scans[0]).observed_flips.len(), 6 * 64);
    assert_eq!(sent(&scans[0]).occupied_flips, [3]);
}
