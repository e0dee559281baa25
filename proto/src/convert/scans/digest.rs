//! Digests of scans, by which a producer detects that it continues other data than it sent before.
//!
//! Invariant: a digest depends on what a scan shows, not on how it was split into messages.

use tidemap_grid::{index::TileIndex, mask::TileMasks};

use crate::v1::{self, scan::Content};

/// Factor of the checksum of a tile.
const DIGEST_FACTOR: u64 = 0x9E37_79B9_7F4A_7C15;

/// The digest of one tile; the digest of a scan of tiles is their sum modulo 2^64.
#[must_use]
pub fn tile_digest(index: TileIndex, masks: &TileMasks) -> u64 {
    masks_digest(index_crc(index), masks)
}

/// The checksum of a tile's index, with which its digest begins.
pub(super) fn index_crc(index: TileIndex) -> u32 {
    let mut bytes = [0; 12];
    for (four, along) in bytes.as_chunks_mut::<4>().0.iter_mut().zip([index.x, index.y, index.z]) {
        *four = along.to_le_bytes();
    }
    crc32c::crc32c(&bytes)
}

/// The digest of a tile whose index has this checksum.
pub(super) fn masks_digest(index_crc: u32, masks: &TileMasks) -> u64 {
    let mut bytes = [0; 128];
    bytes[..64].copy_from_slice(&masks.observed().to_bytes());
    bytes[64..].copy_from_slice(&masks.occupied().to_bytes());
    u64::from(crc32c::crc32c_append(index_crc, &bytes)).wrapping_mul(DIGEST_FACTOR)
}

/// Digest of a point cloud.
#[must_use]
pub fn points_digest(cloud: &v1::PointCloud) -> u64 {
    u64::from(floats_crc(pose_crc(cloud.pose.as_ref()), &cloud.xyz_m))
}

/// Digest of a planar scan.
#[must_use]
pub fn ranges_digest(scan: &v1::RangeScan) -> u64 {
    u64::from(floats_crc(pose_crc(scan.pose.as_ref()), &scan.ranges_m))
}

/// Digest of a scan of points or ranges; 0 for tiles, whose digest a table computes.
#[must_use]
pub fn content_digest(content: &Content) -> u64 {
    match content {
        Content::Cloud(cloud) => points_digest(cloud),
        Content::Ranges(scan) => ranges_digest(scan),
        Content::Tiles(_) => 0,
    }
}

/// The checksum of a pose as sent.
pub(super) fn pose_crc(pose: Option<&v1::Pose>) -> u32 {
    let pose = pose.copied().unwrap_or_default();
    let numbers = [pose.x_m, pose.y_m, pose.z_m, pose.qx, pose.qy, pose.qz, pose.qw];
    numbers.iter().fold(0, |crc, number| crc32c::crc32c_append(crc, &number.to_le_bytes()))
}

/// Continues a checksum over numbers as sent.
pub(super) fn floats_crc(crc: u32, numbers: &[f32]) -> u32 {
    let mut bytes = [0; 1024];
    numbers.chunks(bytes.len() / 4).fold(crc, |crc, numbers| {
        for (four, number) in bytes.as_chunks_mut::<4>().0.iter_mut().zip(numbers) {
            *four = number.to_le_bytes();
        }
        crc32c::crc32c_append(crc, &bytes[..4 * numbers.len()])
    })
}

/// The checksum of a stream's content, continued by one scan.
#[must_use]
pub fn content_crc(crc: u32, utc_nanos: i64, digest: u64) -> u32 {
    crc32c::crc32c_append(crc32c::crc32c_append(crc, &utc_nanos.to_le_bytes()), &digest.to_le_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_digest_is_that_of_the_bytes_in_a_row() {
        let pose = Some(v1::Pose { x_m: 1.0, y_m: 2.0, z_m: 3.0, qw: 1.0, ..v1::Pose::default() });
        let xyz_m: Vec<f32> = (0..3000_u16).map(f32::from).collect();
        let mut bytes: Vec<u8> = [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0_f64].iter().flat_map(|n| n.to_le_bytes()).collect();
        bytes.extend(xyz_m.iter().flat_map(|number| number.to_le_bytes()));
        let cloud = v1::PointCloud { pose, xyz_m, ..v1::PointCloud::default() };
        assert_eq!(points_digest(&cloud), u64::from(crc32c::crc32c(&bytes)));
        assert_eq!(ranges_digest(&v1::RangeScan::default()), u64::from(crc32c::crc32c(&[0; 56])));
    }
}
