//! Messages of scans, and their split into messages of limited size.
//!
//! Invariant: a decoder reads the same from the pieces as from the whole message.

use prost::Message as _;

use super::{EncodedScan, MASK_BYTES};
use crate::{
    convert::columns::greatest_common_divisor,
    v1::{self, scan::Content},
};

/// Maximum number of bytes of a message without its scans and tiles, and of a scan without its columns.
const OVERHEAD: usize = 160;
/// Maximum number of bytes of a time.
const TIME_BYTES: usize = 10;
/// Maximum number of bytes of a number.
const NUMBER_BYTES: usize = 5;

/// A message of encoded scans with their times; the slices have the same length. Use [`split`] if it may be too long.
#[must_use]
pub fn batch(first_sequence: u64, times_nanos: &[i64], scans: Vec<EncodedScan>) -> v1::ScanBatch {
    let new_tiles = scans.iter().flat_map(|scan| &scan.new_tiles).flat_map(|tile| [tile.x, tile.y, tile.z]).collect();
    let wire = |scan: EncodedScan| v1::Scan { content: Some(Content::Tiles(scan.scan)) };
    let scans = scans.into_iter().map(wire).collect();
    let mut batch = v1::ScanBatch { first_sequence, new_tiles, scans, ..v1::ScanBatch::default() };
    set_times(&mut batch, times_nanos);
    batch
}

/// Sets the times of the scans of a message, in the greatest unit that divides their differences.
pub fn set_times(batch: &mut v1::ScanBatch, times_nanos: &[i64]) {
    let deltas = || times_nanos.windows(2).map(|pair| pair[1].wrapping_sub(pair[0]));
    let unit = deltas().fold(0, |unit, delta| greatest_common_divisor(unit, delta.unsigned_abs()));
    let unit = i64::try_from(unit).unwrap_or(1).max(1);
    batch.time_unit_nanos = unit.unsigned_abs();
    batch.first_time_nanos = times_nanos.first().copied().unwrap_or(0);
    batch.time_deltas = times_nanos.first().map(|_| 0).into_iter().chain(deltas().map(|delta| delta / unit)).collect();
}

/// Splits a message into messages of at most `max_bytes` each (at least 4096): between scans, and within scans that are
/// too long for one message.
#[must_use]
pub fn split(batch: v1::ScanBatch, max_bytes: usize) -> Vec<v1::ScanBatch> {
    let room = max_bytes.max(4096) - OVERHEAD;
    if batch.encoded_len() <= room {
        return vec![batch];
    }
    let mut pieces = Vec::new();
    let mut tiles = batch.new_tiles.as_slice();
    let mut time = batch.first_time_nanos;
    let unit = i64::try_from(batch.time_unit_nanos.max(1)).unwrap_or(1);
    let mut sequence = batch.first_sequence;
    let mut piece = v1::ScanBatch::default();
    let mut used = 0;
    let last = batch.scans.len().saturating_sub(1);
    for (number, (mut scan, delta)) in batch.scans.into_iter().zip(batch.time_deltas).enumerate() {
        time = time.wrapping_add(delta.wrapping_mul(unit));
        let goes_on = batch.continues && number == last;
        loop {
            if piece.scans.is_empty() {
                piece.first_sequence = sequence;
                piece.time_unit_nanos = batch.time_unit_nanos;
                piece.first_time_nanos = time;
                // All tiles are sent before the first scan is complete.
                let (now, later) = tiles.split_at(tiles.len().min(room / 2 / NUMBER_BYTES / 3 * 3));
                piece.new_tiles = now.to_vec();
                tiles = later;
                used = now.len() * NUMBER_BYTES;
            }
            let bytes = scan.encoded_len() + TIME_BYTES + NUMBER_BYTES;
            let delta = if piece.scans.is_empty() { 0 } else { delta };
            if used + bytes <= room && tiles.is_empty() {
                piece.scans.push(scan);
                piece.time_deltas.push(delta);
                used += bytes;
                sequence = sequence.saturating_add(1);
                if goes_on {
                    piece.continues = true;
                }
                break;
            }
            if piece.scans.is_empty() {
                piece.scans.push(cut(&mut scan, room - used));
                piece.time_deltas.push(delta);
                piece.continues = true;
            }
            pieces.push(std::mem::take(&mut piece));
        }
    }
    if !piece.scans.is_empty() {
        pieces.push(piece);
    }
    pieces
}

/// Removes the beginning of a scan, of at most about `bytes` bytes, and returns it.
fn cut(scan: &mut v1::Scan, bytes: usize) -> v1::Scan {
    let bytes = bytes.saturating_sub(OVERHEAD + 600);
    let content = match &mut scan.content {
        None => None,
        Some(Content::Tiles(scan)) => {
            let mut left = bytes;
            let mut numbers = |from: &mut Vec<u32>| {
                let part: Vec<u32> = from.drain(..from.len().min(left / NUMBER_BYTES)).collect();
                left -= part.len() * NUMBER_BYTES;
                part
            };
            let (seen, masked) = (numbers(&mut scan.seen), numbers(&mut scan.masked));
            let (observed_flips, occupied_flips) =
                (numbers(&mut scan.observed_flips), numbers(&mut scan.occupied_flips));
            let mut masks = |from: &mut Vec<u8>| {
                let part: Vec<u8> = from.drain(..from.len().min(left / MASK_BYTES * MASK_BYTES)).collect();
                left -= part.len();
                part
            };
            let (observed, occupied) = (masks(&mut scan.observed), masks(&mut scan.occupied));
            Some(Content::Tiles(v1::TileScan { seen, masked, observed, occupied, observed_flips, occupied_flips }))
        }
        Some(Content::Cloud(cloud)) => {
            let xyz_m = cloud.xyz_m.drain(..cloud.xyz_m.len().min(bytes / 12 * 3)).collect();
            let rest = std::mem::take(&mut cloud.xyz_m);
            let first = v1::PointCloud { xyz_m, ..std::mem::take(cloud) };
            cloud.xyz_m = rest;
            Some(Content::Cloud(first))
        }
        Some(Content::Ranges(scan)) => {
            let ranges_m = scan.ranges_m.drain(..scan.ranges_m.len().min(bytes / 4)).collect();
            let rest = std::mem::take(&mut scan.ranges_m);
            let first = v1::RangeScan { ranges_m, ..std::mem::take(scan) };
            scan.ranges_m = rest;
            Some(Content::Ranges(first))
        }
    };
    v1::Scan { content }
}
