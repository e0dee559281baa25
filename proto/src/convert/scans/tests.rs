//! Scans there and back, refusals one by one, parts, and what ends a stream.

use tidemap_grid::{
    index::{CellBox, CellIndex, TileIndex},
    mask::{Mask, TileMasks},
    raycast::Rays,
    spec::GridSpec,
};

use super::*;
use crate::v1::{self, scan::Content};

mod refusals;
mod round_trip;

const LIMITS: ScanLimits = ScanLimits { batch_scans: 64, points: 100, tiles: 1000 };

fn spec(is_flat: bool) -> GridSpec {
    GridSpec { is_flat, ..GridSpec::new(0.1) }
}

fn decoder(spec: &GridSpec) -> ScanDecoder {
    ScanDecoder::new(Some(spec), LIMITS)
}

fn index(x: i32, y: i32, z: i32) -> TileIndex {
    TileIndex { x, y, z }
}

fn mask(cells: &[u16]) -> Mask {
    let mut mask = Mask::EMPTY;
    for &cell in cells {
        mask.insert(cell);
    }
    mask
}

fn masks(observed: &[u16], occupied: &[u16]) -> TileMasks {
    TileMasks::new(mask(observed), mask(occupied)).expect("occupied cells are observed")
}

/// A message of scans a second apart.
fn message(first: u64, new_tiles: &[i32], scans: Vec<Content>) -> v1::ScanBatch {
    let scans: Vec<v1::Scan> = scans.into_iter().map(|content| v1::Scan { content: Some(content) }).collect();
    v1::ScanBatch {
        first_sequence: first,
        new_tiles: new_tiles.to_vec(),
        time_unit_nanos: 1_000_000_000,
        first_time_nanos: 1_000_000_000 * i64::try_from(first).expect("small"),
        time_deltas: (0..scans.len()).map(|i| i64::from(i > 0)).collect(),
        scans,
        ..v1::ScanBatch::default()
    }
}

fn flips(seen: &[u32], observed: &[u32], occupied: &[u32]) -> Content {
    Content::Tiles(v1::TileScan {
        seen: seen.to_vec(),
        observed_flips: pack_flips(observed),
        occupied_flips: pack_flips(occupied),
        ..v1::TileScan::default()
    })
}

/// The message as sent.
fn sent_message(batch: v1::ScanBatch) -> ScanMessage {
    scans_from_wire(batch).expect("possible sequence numbers")
}

fn all(decoder: &mut ScanDecoder, message: v1::ScanBatch) -> Result<Vec<DecodedScan>, ScanError> {
    decoder.begin(scans_from_wire(message)?)?;
    let mut scans = Vec::new();
    while let Some(scan) = decoder.next_scan()? {
        scans.push(scan);
    }
    Ok(scans)
}

fn sent(scan: &DecodedScan) -> &StreamScan {
    match &scan.content {
        Some(ScanContent::Tiles(sent)) => sent,
        other => panic!("not of tiles: {other:?}, {:?}", scan.refusal),
    }
}
